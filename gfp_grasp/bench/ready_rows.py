"""Rows of the bench of readiness, and what they come to: medians of what was answered, shares of what was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gfp_grasp.bench.rows import Row

MOST_CHAMFER_M = 0.002
MOST_CUT_M = 0.001


@dataclass(frozen=True, kw_only=True)
class ViewRow(Row):
    """One completer on one view of one object; None where there is no figure, and `error` says why.

    Attributes:
        group: Set of objects that the object belongs to.
        object: Name of the object.
        category: True class of the object.
        view: Number of the view.
        hidden: Share of the object's pixels behind a board.
        completer: Name of the completer.
        chamfer_m: Mean of both mean nearest distances between the completion and the truth, m.
        tilt_deg: Tilt after 2 s in MuJoCo, and that of the file's floor against the true table.
        travel_m: Way in these 2 s, m.
        stands: Whether both are small.
        seconds: Time from the picture to the mesh and its convex parts; None for the truth itself.
        error: Name of the error that ended completion or simulation.
    """

    group: str
    object: str
    category: str
    view: int
    hidden: float
    completer: str
    chamfer_m: float | None = None
    tilt_deg: float | None = None
    travel_m: float | None = None
    stands: bool | None = None
    seconds: float | None = None
    error: str | None = None


@dataclass(frozen=True, kw_only=True)
class SceneRow(Row):
    """One completer on all objects of one picture.

    Attributes:
        scene: Number of the scene.
        completer: Name of the completer.
        objects: Number of objects that were asked for.
        cuts_m: How deep each object that was completed cuts into a neighbour in the scene's file, at the start, m.
        unparted_m: The same where the scene has not made the objects give way to each other.
        error: Name of the error of the last object that is missing, or of the scene's file.
    """

    scene: int
    completer: str
    objects: int
    cuts_m: tuple[float, ...] = ()
    unparted_m: tuple[float, ...] = ()
    error: str | None = None


def summarise(views: Sequence[ViewRow], scenes: Sequence[SceneRow]) -> dict[str, Any]:
    """Figures of one completer.

    A share counts a view or an object without an answer as one that misses the wish. Medians and means are over the
    answers, None where there is none.

    Args:
        views: Its views, of one group, each at every share of hidden pixels.
        scenes: Its scenes; without any, their figures are left out.

    Returns:
        {"views", "failed" (without a Chamfer distance), "chamfer_median_mm", "chamfer_mean_mm", "under_2_mm" (share),
        "not_simulated", "tilt_median_deg", "travel_median_mm", "stands" (share), "seconds_median", "seconds_p95",
        "hidden": {percent: the figures from "views" to "stands"}, and of scenes "scenes", "objects", "missing",
        "cut_most_mm" (the deepest of all), "cut_over_1_mm" (share), "unparted_most_mm", "unparted_over_1_mm"}.
    """
    seconds = [row.seconds for row in views if row.seconds is not None and row.hidden == 0.0]
    answer = {
        **_of_views([row for row in views if row.hidden == 0.0]),
        "seconds_median": round(float(np.median(seconds)), 3) if seconds else None,
        "seconds_p95": round(float(np.quantile(seconds, 0.95)), 3) if seconds else None,
        "hidden": {
            f"{100 * share:.0f}": _of_views([row for row in views if row.hidden == share])
            for share in sorted({row.hidden for row in views} - {0.0})
        },
    }
    return answer | _of_scenes(scenes) if scenes else answer


def _of_views(rows: Sequence[ViewRow]) -> dict[str, Any]:
    chamfers = [row.chamfer_m for row in rows if row.chamfer_m is not None]
    rested = [row for row in rows if row.stands is not None]
    return {
        "views": len(rows),
        "failed": len(rows) - len(chamfers),
        "chamfer_median_mm": _median(chamfers, 1000.0),
        "chamfer_mean_mm": round(1000.0 * float(np.mean(chamfers)), 3) if chamfers else None,
        "under_2_mm": _share([chamfer_m < MOST_CHAMFER_M for chamfer_m in chamfers], len(rows)),
        "not_simulated": len(rows) - len(rested),
        "tilt_median_deg": _median([row.tilt_deg for row in rested if row.tilt_deg is not None]),
        "travel_median_mm": _median([row.travel_m for row in rested if row.travel_m is not None], 1000.0),
        "stands": _share([bool(row.stands) for row in rested], len(rows)),
    }


def _of_scenes(rows: Sequence[SceneRow]) -> dict[str, Any]:
    objects = sum(row.objects for row in rows)
    answer: dict[str, Any] = {"scenes": len(rows), "objects": objects}
    for name in ("cut", "unparted"):
        cuts = [cut_m for row in rows for cut_m in (row.cuts_m if name == "cut" else row.unparted_m)]
        answer["missing"] = objects - len(cuts)
        answer[f"{name}_most_mm"] = round(1000.0 * max(cuts), 3) if cuts else None
        misses = [True] * answer["missing"] + [cut_m > MOST_CUT_M for cut_m in cuts]
        answer[f"{name}_over_1_mm"] = _share(misses, objects)
    return answer


def _median(values: Sequence[float], factor: float = 1.0) -> float | None:
    return round(factor * float(np.median(values)), 3) if values else None


def _share(hits: Sequence[bool], of: int) -> float | None:
    return round(sum(hits) / of, 4) if of else None
