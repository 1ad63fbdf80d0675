"""Trials of completers, and their summary side by side."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gfp_grasp.types import REASONS

# Normal quantile of a two-sided 95 % interval.
_Z95 = 1.959963984540054


@dataclass(frozen=True)
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
        completed_success: Whether the completion, simulated in its place, was held.
        completed_reason: What happened to that.
        quality: The planner's, None where no grasp was found.
        width_m: Opening of the jaws, None where no grasp was found.
        cd_m: Chamfer distance of the completion to the truth, visible surfaces; None where there is no completion.
        f_score: F-score at 5 mm, None where there is no completion.
        note: Error that kept a grasp from being found.
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
    completed_success: bool
    completed_reason: str
    quality: float | None
    width_m: float | None
    cd_m: float | None
    f_score: float | None
    note: str = ""
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
        `completed_world` has the same for the simulated completions; `cd_m` is the mean over the views that were
        completed, `num_completed` their number.
        """
        names = dict.fromkeys(trial.completer for trial in self.trials)
        return {name: _summary([trial for trial in self.trials if trial.completer == name]) for name in names}

    def table(self) -> list[dict[str, str]]:
        """One row a completer, as text for printing."""
        return [_row(name, summary) for name, summary in self.completers().items()]

    def to_json(self) -> str:
        """`{"settings", "completers", "trials"}`; equal runs differ in `timings_s` alone."""
        content = {
            "settings": dict(self.settings),
            "completers": self.completers(),
            "trials": [asdict(trial) for trial in self.trials],
        }
        return json.dumps(content, indent=1, allow_nan=False)

    def write(self, path: str | Path) -> None:
        """Write the JSON."""
        Path(path).write_text(self.to_json() + "\n", encoding="utf-8")


def wilson_interval(successes: int, attempts: int) -> tuple[float, float]:
    """95 % interval of a success rate (Wilson 1927, doi:10.1080/01621459.1927.10502953); (0, 1) without attempts."""
    if attempts == 0:
        return 0.0, 1.0
    rate, spread = successes / attempts, _Z95**2 / attempts
    centre = (rate + spread / 2) / (1 + spread)
    half = np.sqrt(spread * (rate * (1 - rate) + spread / 4)) / (1 + spread)
    return max(0.0, float(centre - half)), min(1.0, float(centre + half))


def _summary(trials: Sequence[Trial]) -> dict[str, Any]:
    distances = [trial.cd_m for trial in trials if trial.cd_m is not None]
    return {
        **_rates([trial.reason for trial in trials], sum(trial.success for trial in trials)),
        "cd_m": float(np.mean(distances)) if distances else None,
        "num_completed": len(distances),
        "completed_world": _rates(
            [trial.completed_reason for trial in trials], sum(trial.completed_success for trial in trials)
        ),
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
        "completed world": _rate_text(summary["completed_world"]),
        "CD mm": "-" if summary["cd_m"] is None else f"{1000 * summary['cd_m']:.1f}",
        "failures": ", ".join(f"{reason} {count}" for reason, count in failures.items()) or "-",
    }


def _rate_text(rates: Mapping[str, Any]) -> str:
    low, high = rates["ci95"]
    return f"{rates['successes']}/{rates['attempts']} = {rates['success_rate']:.2f} [{low:.2f}, {high:.2f}]"
