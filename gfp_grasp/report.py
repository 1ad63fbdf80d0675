"""Trials of completers, and their summary side by side."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from gfp_grasp.journal import write_whole
from gfp_grasp.types import REASONS

# Normal quantile of a two-sided 95 % interval.
_Z95 = 1.959963984540054
BRACKETS = ("oracle", "observed")


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One object, one view, one completer, its best grasp.

    Attributes:
        object: Name of the object.
        category: Its class, "" where unknown.
        completer: Name of the completer.
        view: Number of the view.
        episode_seed: Seed of the environment's reset.
        success: Whether the true object was held.
        reason: What happened to it, one of REASONS.
        lift_m: Height it gained.
        slip_m: Largest slip while it was held.
        falls_free: Whether it fell when the jaws opened at last.
        mass_kg: Its mass.
        friction: Its coefficient of sliding friction.
        grip_n: Force limit of each jaw.
        completed_success: Whether the completion, simulated in its place, was held.
        completed_reason: What happened to that.
        quality: The planner's, None where no grasp was found.
        width_m: Opening of the jaws, None where no grasp was found.
        cd_m: Chamfer distance of the completion to the truth, visible surfaces; None where there is no completion.
        f_score: F-score at 5 mm, None where there is no completion.
        note: Error that kept a grasp from being found.
        rank_held: Rank of the first of the best few grasps that held the true object, 1 the best; None where none did.
        timings_s: Seconds by stage; the one thing that differs between equal runs.
    """

    object: str
    category: str
    completer: str
    view: int
    episode_seed: int
    success: bool
    reason: str
    lift_m: float
    slip_m: float
    falls_free: bool
    mass_kg: float
    friction: float
    grip_n: float
    completed_success: bool
    completed_reason: str
    quality: float | None
    width_m: float | None
    cd_m: float | None
    f_score: float | None
    note: str = ""
    rank_held: int | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Report:
    """All trials of a score with what they ran under.

    Attributes:
        settings: Objects, views, seed and the numbers of the trial.
        trials: In the order of objects, views, completers.
    """

    settings: Mapping[str, object]
    trials: tuple[Trial, ...]

    def completers(self) -> dict[str, dict[str, Any]]:
        """Summary of each completer, in the order of their first trials.

        `attempts`, `successes`, `success_rate`, `ci95` (Wilson) and `reasons` are those on the true objects;
        `any_of_best` the views on which one of the best few grasps held; `completed_world` has the same for the
        simulated completions, and their `precision` (of the grasps that held there, how many held on the truth) and
        `recall` (of those that held on the truth, how many held there), None where there were none; `cd_m` is the mean
        over the views that were completed, `num_completed` their number, `timings_s` the mean
        by stage.
        """
        names = dict.fromkeys(trial.completer for trial in self.trials)
        return {name: _summary([trial for trial in self.trials if trial.completer == name]) for name in names}

    def classes(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Success on the true objects by class and row, {class: {row: {"attempts", "successes", ...}}}."""
        found: dict[str, dict[str, dict[str, Any]]] = {}
        for category in sorted({trial.category for trial in self.trials}):
            mine = [trial for trial in self.trials if trial.category == category]
            rows = dict.fromkeys(trial.completer for trial in mine)
            of_row = {row: [trial for trial in mine if trial.completer == row] for row in rows}
            found[category] = {
                row: _rates([t.reason for t in trials], sum(t.success for t in trials))
                for row, trials in of_row.items()
            }
        return found

    def paired(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Every row beside those that bracket it, and beside other planners' of its completer, on the same views.

        {row: {other: {"pairs", "only_this", "only_other" (views on which one of the two held), "p" (exact McNemar,
        two-sided)}}}, of the brackets that were scored, and the other planners.
        """
        held = {(t.completer, t.object, t.view): t.success for t in self.trials}
        names = dict.fromkeys(t.completer for t in self.trials)
        return {
            name: {
                other: _paired(held, name, other)
                for other in dict.fromkeys((*BRACKETS, *names))
                if other in names and other != name and (other in BRACKETS or row_names(other)[0] == row_names(name)[0])
            }
            for name in names
        }

    def table(self) -> list[dict[str, str]]:
        """One row a completer, as text for printing."""
        return [_row(name, summary) for name, summary in self.completers().items()]

    def to_json(self) -> str:
        """`{"settings", "completers", "classes", "paired", "trials"}`; equal runs differ in `timings_s` alone."""
        content = {
            "settings": dict(self.settings),
            "completers": self.completers(),
            "classes": self.classes(),
            "paired": self.paired(),
            "trials": [asdict(trial) for trial in self.trials],
        }
        return json.dumps(content, indent=1, allow_nan=False)

    def write(self, path: str | Path) -> None:
        """Write the JSON.

        Raises:
            CannotWrite: There is no room, no right, or no such place.
        """
        write_whole(path, self.to_json() + "\n")


def row_names(row: str) -> tuple[str, str]:
    """Of the completer and the planner of a row: "gfpnet/top-down", or "gfpnet" with the planner that goes unnamed."""
    name, _, planner = row.partition("/")
    return name, planner or "antipodal"


def wilson_interval(successes: int, attempts: int) -> tuple[float, float]:
    """95 % interval of a success rate (Wilson 1927, doi:10.1080/01621459.1927.10502953); (0, 1) without attempts."""
    if attempts == 0:
        return 0.0, 1.0
    rate, spread = successes / attempts, _Z95**2 / attempts
    centre = (rate + spread / 2) / (1 + spread)
    half = np.sqrt(spread * (rate * (1 - rate) + spread / 4)) / (1 + spread)
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def mcnemar_p(only_first: int, only_second: int) -> float:
    """Exact two-sided McNemar test of paired successes (1947, doi:10.1007/BF02295996); 1 without a difference."""
    differing = only_first + only_second
    return float(binomtest(only_first, differing, 0.5).pvalue) if differing else 1.0


def _paired(held: Mapping[tuple[str, str, int], bool], name: str, rival: str) -> dict[str, Any]:
    pairs = [
        (success, held[rival, thing, view])
        for (completer, thing, view), success in held.items()
        if completer == name and (rival, thing, view) in held
    ]
    only_this = sum(mine and not other for mine, other in pairs)
    only_other = sum(other and not mine for mine, other in pairs)
    p = mcnemar_p(only_this, only_other)
    return {"pairs": len(pairs), "only_this": only_this, "only_other": only_other, "p": p}


def _summary(trials: Sequence[Trial]) -> dict[str, Any]:
    distances = [trial.cd_m for trial in trials if trial.cd_m is not None]
    both = sum(trial.success and trial.completed_success for trial in trials)
    on_truth, on_completed = sum(t.success for t in trials), sum(t.completed_success for t in trials)
    return {
        **_rates([trial.reason for trial in trials], on_truth),
        "any_of_best": sum(trial.rank_held is not None for trial in trials),
        "cd_m": float(np.mean(distances)) if distances else None,
        "num_completed": len(distances),
        "completed_world": {
            **_rates([trial.completed_reason for trial in trials], on_completed),
            "precision": both / on_completed if on_completed else None,
            "recall": both / on_truth if on_truth else None,
        },
        "timings_s": {stage: float(np.mean([t.timings_s[stage] for t in trials])) for stage in trials[0].timings_s},
    }


def _rates(reasons: Sequence[str], successes: int) -> dict[str, Any]:
    counts = Counter(reasons)
    return {
        "attempts": len(reasons),
        "successes": successes,
        "success_rate": successes / len(reasons),
        "ci95": list(wilson_interval(successes, len(reasons))),
        "reasons": {reason: counts[reason] for reason in REASONS if counts[reason]},
    }


def _row(name: str, summary: Mapping[str, Any]) -> dict[str, str]:
    failures = {reason: count for reason, count in summary["reasons"].items() if reason != "held"}
    return {
        "completer": name,
        "true world": _rate_text(summary),
        "of best few": f"{summary['any_of_best']}/{summary['attempts']}",
        "completed world": _rate_text(summary["completed_world"]),
        "precision, recall": ", ".join(_share(summary["completed_world"][key]) for key in ("precision", "recall")),
        "CD mm": "-" if summary["cd_m"] is None else f"{1000 * summary['cd_m']:.1f}",
        "failures": ", ".join(f"{reason} {count}" for reason, count in failures.items()) or "-",
    }


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _rate_text(rates: Mapping[str, Any]) -> str:
    low, high = rates["ci95"]
    return f"{rates['successes']}/{rates['attempts']} = {rates['success_rate']:.2f} [{low:.2f}, {high:.2f}]"
