"""Results of every view under every method, and the methods side by side."""

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
from gfp_grasp.metrics import mean_of_groups
from gfp_grasp.types import REASONS

# Normal quantile of a two-sided 95 % interval.
_Z95 = 1.959963984540054
BRACKETS = ("oracle", "observed")


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """One view of one object under one method: the best grasp, tried on the true object and on the completion.

    Attributes:
        object: Name of the object.
        category: Class of the object, "" where unknown.
        completer: Name of the method: the completer's, and behind a slash the planner's if it is not `antipodal`.
        view: Number of the view.
        episode_seed: Seed that a reset of the environment makes the same episode from.
        success: Whether the true object was held.
        reason: Reason for which the trial on the true object ended, one of REASONS.
        lift_m: Height that the true object gained.
        slip_m: Largest slip of the true object while it was held.
        falls_free: Whether the true object fell when the jaws opened at last.
        least_friction: Least friction of the true object at which the same grasp holds, None where it holds at none.
        margin: How often that friction can be doubled until it is the highest tried (`envs.octaves`), 0 where no
            friction holds; None in rows of before there were margins.
        mass_kg: Mass of the true object.
        friction: Coefficient of sliding friction of the true object.
        grip_n: Force limit of each jaw.
        completed_success: Whether the completion, simulated in the object's place, was held.
        completed_reason: Reason for which the trial on the completion ended.
        quality: Quality that the planner gave the grasp, None where no grasp was found.
        width_m: Opening of the jaws, None where no grasp was found.
        cd_m: Chamfer distance of the completion to the truth, visible surfaces; None where there is no completion.
        f_score: F-score at 5 mm, None where there is no completion.
        note: Error that kept a grasp from being found.
        rank_held: Rank of the first of the best few grasps that held the true object, 1 the best; None where none did.
        timings_s: Seconds by stage; they alone differ between equal runs.
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
    least_friction: float | None = None
    margin: float | None = None
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
    """All rows of a score with the settings that they were made under.

    Attributes:
        settings: Objects, views, seed and the numbers of a trial.
        rows: In the order of objects, views, methods.
    """

    settings: Mapping[str, object]
    rows: tuple[ScoreRow, ...]

    def completers(self) -> dict[str, dict[str, Any]]:
        """Summary of each method, in the order of their first rows.

        `attempts` (the number of views), `successes`, `success_rate`, `ci95` (Wilson) and `reasons` count the trials on
        the true objects; `margin` is the mean of the rows' margins, `margin_ci95` its interval by resampling objects;
        `any_of_best` counts the views on which one of the best few grasps held. `completed_world` counts the trials on
        the completions, and has their `precision` (the share of the grasps that held there which held on the truth) and
        `recall` (the share of the grasps that held on the truth which held there), None where no grasp held. `cd_m` is
        the mean over the views that were completed, `num_completed` their number, `timings_s` the mean by stage.
        """
        return {name: _summary(rows) for name, rows in self._by_method().items()}

    def classes(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Success on the true objects by class and method, {class: {method: {"attempts", "successes", ...}}}."""
        categories = sorted({row.category for row in self.rows})
        return {
            category: {
                name: _rates([row.reason for row in rows], sum(row.success for row in rows))
                for name, rows in self._by_method(category).items()
            }
            for category in categories
        }

    def paired(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Every method beside every other.

        {method: {other: {"pairs" (views that both have), "only_this" and "only_other" (views on which one of the two
        held), "p" (exact McNemar, two-sided), "margin" (mean of this margin less the other's) and "margin_ci95" (by
        resampling objects)}}}, the brackets first.
        """
        held = {(row.completer, row.object, row.view): row for row in self.rows}
        methods = self._by_method()
        others = [name for name in dict.fromkeys((*BRACKETS, *methods)) if name in methods]
        return {
            method: {other: _paired(held, method, other) for other in others if other != method} for method in methods
        }

    def table(self) -> list[dict[str, str]]:
        """Figures of each method, as text for printing."""
        return [_table_row(name, summary) for name, summary in self.completers().items()]

    def to_json(self) -> str:
        """`{"settings", "completers", "classes", "paired", "trials"}`; equal runs differ in `timings_s` alone."""
        content = {
            "settings": dict(self.settings),
            "completers": self.completers(),
            "classes": self.classes(),
            "paired": self.paired(),
            "trials": [asdict(row) for row in self.rows],
        }
        return json.dumps(content, indent=1, allow_nan=False)

    def write(self, path: str | Path) -> None:
        """Write the JSON.

        Raises:
            CannotWrite: There is no room, no right, or no such place.
        """
        write_whole(path, self.to_json() + "\n")

    def _by_method(self, category: str | None = None) -> dict[str, list[ScoreRow]]:
        """Rows of each method, over all classes or one."""
        found: dict[str, list[ScoreRow]] = {}
        for row in self.rows:
            if category is None or row.category == category:
                found.setdefault(row.completer, []).append(row)
        return found


def method_names(method: str) -> tuple[str, str]:
    """Names of a method's completer and planner: "gfpnet/top-down", or "gfpnet" with the default planner."""
    name, _, planner = method.partition("/")
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


def _paired(rows: Mapping[tuple[str, str, int], ScoreRow], method: str, rival: str) -> dict[str, Any]:
    pairs = [
        (mine, rows[rival, thing, view])
        for (name, thing, view), mine in rows.items()
        if name == method and (rival, thing, view) in rows
    ]
    only_this = sum(mine.success and not other.success for mine, other in pairs)
    only_other = sum(other.success and not mine.success for mine, other in pairs)
    gains = [
        (mine.object, mine.margin - other.margin)
        for mine, other in pairs
        if mine.margin is not None and other.margin is not None
    ]
    return {
        "pairs": len(pairs),
        "only_this": only_this,
        "only_other": only_other,
        "p": mcnemar_p(only_this, only_other),
        **_margin(gains),
    }


def _margin(values: Sequence[tuple[str, float]]) -> dict[str, Any]:
    """Mean of margins and its interval, from the name of each object and its value; nothing of no rows."""
    if not values:
        return {}
    groups: dict[str, list[float]] = {}
    for name, value in values:
        groups.setdefault(name, []).append(value)
    mean, low, high = mean_of_groups(list(groups.values()))
    return {"margin": mean, "margin_ci95": [low, high]}


def _summary(rows: Sequence[ScoreRow]) -> dict[str, Any]:
    distances = [row.cd_m for row in rows if row.cd_m is not None]
    both = sum(row.success and row.completed_success for row in rows)
    on_truth, on_completed = sum(row.success for row in rows), sum(row.completed_success for row in rows)
    return {
        **_rates([row.reason for row in rows], on_truth),
        **_margin([(row.object, row.margin) for row in rows if row.margin is not None]),
        "any_of_best": sum(row.rank_held is not None for row in rows),
        "cd_m": float(np.mean(distances)) if distances else None,
        "num_completed": len(distances),
        "completed_world": {
            **_rates([row.completed_reason for row in rows], on_completed),
            "precision": both / on_completed if on_completed else None,
            "recall": both / on_truth if on_truth else None,
        },
        "timings_s": {stage: float(np.mean([row.timings_s[stage] for row in rows])) for stage in rows[0].timings_s},
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


def _table_row(name: str, summary: Mapping[str, Any]) -> dict[str, str]:
    failures = {reason: count for reason, count in summary["reasons"].items() if reason != "held"}
    return {
        "completer": name,
        "true world": _rate_text(summary),
        "margin": _margin_text(summary),
        "of best few": f"{summary['any_of_best']}/{summary['attempts']}",
        "completed world": _rate_text(summary["completed_world"]),
        "precision, recall": ", ".join(_share(summary["completed_world"][key]) for key in ("precision", "recall")),
        "CD mm": "-" if summary["cd_m"] is None else f"{1000 * summary['cd_m']:.1f}",
        "failures": ", ".join(f"{reason} {count}" for reason, count in failures.items()) or "-",
    }


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _margin_text(summary: Mapping[str, Any]) -> str:
    if "margin" not in summary:
        return "-"
    low, high = summary["margin_ci95"]
    return f"{summary['margin']:.2f} [{low:.2f}, {high:.2f}]"


def _rate_text(rates: Mapping[str, Any]) -> str:
    low, high = rates["ci95"]
    return f"{rates['successes']}/{rates['attempts']} = {rates['success_rate']:.2f} [{low:.2f}, {high:.2f}]"
