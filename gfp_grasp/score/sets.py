"""What completion is worth: scores of several sets of objects side by side, and all of them taken together."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.score.report import Report, ScoreRow

TOGETHER = "together"
_FIGURES = ("attempts", "successes", "success_rate", "ci95", "margin", "margin_ci95", "cd_m", "completed_world")


def read_report(path: str | Path) -> Report:
    """The report that `Report.write` wrote.

    Raises:
        UnreadableFile: There is no such file, or it holds something else.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return Report(content["settings"], tuple(ScoreRow(**trial) for trial in content["trials"]))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableFile(
            f"{path.name} is no score ({type(error).__name__}: {error}): give files of `gfp-grasp score --json`"
        ) from error


def study(scores: Mapping[str, str | Path]) -> dict[str, Any]:
    """Scores of several sets of objects, each by itself and all together.

    Args:
        scores: Name of each set and the JSON of `gfp-grasp score` on it, all under the same completers.

    Returns:
        {"sets": {name: {"settings", "completers", "paired", "broken_promises"}}}, the last set `TOGETHER`, whose
        intervals resample the objects of all. "paired" is `Report.paired`. "broken_promises" counts, for each
        completer, how the trials on the true object ended whose grasp held in the completed world.

    Raises:
        UnreadableFile: A file that is no score.
        InvalidOption: No file, a set called `TOGETHER`, rows without a margin, or other completers in one than in
            another.
    """
    if not scores or TOGETHER in scores:
        raise InvalidOption(f"sets are {', '.join(scores) or 'none'}; at least one is expected, none called {TOGETHER}")
    reports = {name: read_report(path) for name, path in scores.items()}
    for name, report in reports.items():
        if any(row.margin is None for row in report.rows):
            raise InvalidOption(f"{name} has rows without a margin, as older versions wrote them: score it again")
    methods = {name: list(report.completers()) for name, report in reports.items()}
    first = next(iter(methods))
    for name, found in methods.items():
        if found != methods[first]:
            raise InvalidOption(
                f"{name} has completers {', '.join(found)} and {first} {', '.join(methods[first])}; "
                "the same are expected, in the same order"
            )
    rows = [replace(row, object=f"{name}/{row.object}") for name, report in reports.items() for row in report.rows]
    sets = {**reports, TOGETHER: Report({}, tuple(rows))}
    return {"sets": {name: _set_of(report) for name, report in sets.items()}}


def _set_of(report: Report) -> dict[str, Any]:
    completers = {
        name: {key: figures[key] for key in _FIGURES if key in figures} for name, figures in report.completers().items()
    }
    broken: dict[str, Counter[str]] = {name: Counter() for name in completers}
    for row in report.rows:
        if row.completed_success and not row.success:
            broken[row.completer][row.reason] += 1
    return {
        "settings": dict(report.settings),
        "completers": completers,
        "paired": report.paired(),
        "broken_promises": {name: dict(counts) for name, counts in broken.items()},
    }
