"""Known or unknown, and what it is worth: views of classes, of classes that the library lacks, and of no class."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gfp_grasp.complete import CompleteConfig
from gfp_grasp.misfit import Misfit
from gfp_grasp.openset import is_unknown_by_look, probability_by_look, probability_unknown
from gfp_grasp.parallel import Progress
from gfp_grasp.train import SIGHTS, OpenSetConfig, OpenSetRow, openset_rows

_THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 1.0)
_SORTS = ("known", "left_out", "mixture")


def bench_openset(
    *, config: OpenSetConfig = OpenSetConfig(), workers: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Measure the decision between a class's answer and the class-free one on the test split.

    Args:
        config: What is looked at.
        workers: Processes.
        progress: Wraps the stream of things.

    Returns:
        {"curve": {one of SIGHTS: one entry a threshold}, "rows": {sort: figures at the threshold of
        CompleteConfig}, "threshold", "trials"}. An entry of the curve says which share of the things of a class is
        answered as unknown (`lost`), and for things whose class is left out and for mixtures which share is
        (`caught`), and which is or comes nearer to the truth than 0.6 of the hull (`caught_or_good`).
    """
    rows = openset_rows("test", config, workers=workers, progress=progress)
    return {
        **report_of(rows),
        "trials": [row.to_json() for row in rows],
    }


def report_of(rows: Sequence[OpenSetRow]) -> dict[str, Any]:
    """The figures of some rows, see `bench_openset`."""
    chosen = CompleteConfig().unknown_above
    views = {name: [row for row in rows if row.sight == name] for name in SIGHTS}
    return {
        "threshold": chosen,
        "curve": {name: [_point(some, threshold) for threshold in _THRESHOLDS] for name, some in views.items()},
        "rows": {
            name: {sort: _figures(own, chosen) for sort, own in _by_sort(some).items()} for name, some in views.items()
        },
    }


def is_unknown(row: OpenSetRow, threshold: float) -> bool:
    """Whether a view is answered without a class."""
    if row.fit is None or row.misfit is None:
        return True
    unknown = 0.0
    if threshold < 1:
        unknown = probability_unknown(row.look, row.fit)
        by_look = is_unknown_by_look(probability_by_look(row.look), threshold, lambda: row.cut_off)
        if by_look or unknown >= threshold:
            return True
    return bool(Misfit(*row.misfit).faults(unknown=unknown))


def _by_sort(rows: Sequence[OpenSetRow]) -> dict[str, list[OpenSetRow]]:
    return {sort: [row for row in rows if row.sort == sort] for sort in _SORTS if any(row.sort == sort for row in rows)}


def _point(rows: Sequence[OpenSetRow], threshold: float) -> dict[str, float]:
    """One point of the operating curve."""
    point = {"threshold": threshold}
    for sort, some in _by_sort(rows).items():
        unknown = np.array([is_unknown(row, threshold) for row in some])
        good = np.array([not row.lost for row in some])
        if sort == "known":
            point["lost"] = round(float(unknown.mean()), 4)
        else:
            point[f"caught_{sort}"] = round(float(unknown.mean()), 4)
            point[f"caught_or_good_{sort}"] = round(float((unknown | good).mean()), 4)
    return point


def _figures(rows: Sequence[OpenSetRow], threshold: float) -> dict[str, Any]:
    """Mean Chamfer distances of the ways to answer, and of the answer; views where all of them gave one."""
    told = [row for row in rows if row.cd_m is not None and row.classfree_cd_m is not None]
    unknown = [is_unknown(row, threshold) for row in told]
    answers = [row.classfree_cd_m if un else row.cd_m for row, un in zip(told, unknown, strict=True)]
    means = {"class": [r.cd_m for r in told], "classfree": [r.classfree_cd_m for r in told], "answer": answers}
    hull = np.array([row.hull_cd_m for row in told])
    figures: dict[str, Any] = {"views": len(rows), "unknown": round(float(np.mean(unknown)), 4)}
    for name, values in (means | {"hull": hull}).items():
        cd_m = np.array(values, dtype=float)
        figures[name] = {
            "cd_m": round(float(cd_m.mean()), 5),
            "of_hull": round(float(cd_m.mean() / hull.mean()), 3),
            "worst_of_hull": round(float((cd_m / hull).max()), 3),
        }
    return figures
