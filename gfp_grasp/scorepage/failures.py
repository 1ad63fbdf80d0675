"""Which failures are worth a look, and what is shown of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gfp_grasp.report import Report, Trial

ORACLE = "oracle"
MOST, MOST_OF_ONE_OBJECT = 8, 2
RULE = (
    f"Shown are at most {MOST} failures, at most {MOST_OF_ONE_OBJECT} of one object. Rows take turns, the one with the "
    "most successes first; each shows the failure with the largest Chamfer distance that it has left, those without a "
    "completion last."
)
# Where the process died under a trial, making it again would be the death of this one.
_LOST = "WorkerLost"


@dataclass(frozen=True)
class Exhibit:
    """A failure with its pictures.

    Attributes:
        trial: What is shown.
        picture: File name beside the page, "" where there is none.
        clip: The same, "" where there was no grasp to try.
        note: What there is to say about them.
    """

    trial: Trial
    picture: str = ""
    clip: str = ""
    note: str = ""


def choose_failures(report: Report) -> tuple[Trial, ...]:
    """Failed trials of the completers under test, by RULE, where the true mesh led to a grasp that held.

    Where the oracle was not scored, every failure may be chosen. Neither depends on anything but the report.
    """
    turns = [_worst_first(report, row) for row in _best_first(report)]
    chosen: list[Trial] = []
    while any(turns) and len(chosen) < MOST:
        for left in turns:
            while left and _count(chosen, left[0].object) >= MOST_OF_ONE_OBJECT:
                left.pop(0)
            if left and len(chosen) < MOST:
                chosen.append(left.pop(0))
    return tuple(chosen)


def is_oracle(row: str) -> bool:
    """Whether a row completes by the true mesh, whichever planner it has."""
    return row.partition("/")[0] == ORACLE


def has_oracle(report: Report) -> bool:
    """Whether there is such a row."""
    return any(is_oracle(trial.completer) for trial in report.trials)


def _best_first(report: Report) -> list[str]:
    summaries = report.completers()
    rows = [row for row in summaries if not is_oracle(row)]
    return sorted(rows, key=lambda row: -summaries[row]["successes"])


def _worst_first(report: Report, row: str) -> list[Trial]:
    held = {(trial.object, trial.view) for trial in report.trials if is_oracle(trial.completer) and trial.success}
    bracketed = has_oracle(report)
    failed = [
        trial
        for trial in report.trials
        if trial.completer == row
        and not trial.success
        and not trial.note.startswith(_LOST)
        and (not bracketed or (trial.object, trial.view) in held)
    ]
    return sorted(failed, key=lambda trial: -1.0 if trial.cd_m is None else trial.cd_m, reverse=True)


def _count(chosen: Sequence[Trial], name: str) -> int:
    return sum(trial.object == name for trial in chosen)
