"""How near completions of things of any kind come to the truth, against the hull of what was seen."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import KDTree, QhullError

from gfp_grasp.errors import GfpGraspError
from gfp_grasp.meshes import sample_surface
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.train.classfree_data import PLAIN, SeenThing, SightConfig, Thing, seen_things
from gfp_grasp.types import CompletedShape, Detection

_SAMPLES = 8192
_WORST = 0.99  # quantile of the ratios beside the largest

Complete = Callable[[Detection], CompletedShape]  # the shape in the detection's frame


@dataclass(frozen=True, kw_only=True)
class HullRow:
    """One completion of one view.

    Attributes:
        kind: Family or kind of mixture.
        number: Of the thing within it.
        view: Of the thing.
        cd_m: Chamfer distance of the completion to the truth, m; None where there is no answer.
        hull_cd_m: That of the convex hull of what was seen.
        two_sigma: Share of the vertices whose distance from the truth is below two sigma.
        seconds: Processor time that the completion took.
        error: Name of the error where there is no answer.
    """

    kind: str
    number: int
    view: int
    cd_m: float | None
    hull_cd_m: float
    two_sigma: float | None = None
    seconds: float = 0.0
    error: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Figures that apply."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def measure_against_hull(
    complete: Complete,
    things: Sequence[Thing],
    *,
    num_views: int = 2,
    sight: SightConfig = PLAIN,
    workers: int = 1,
    progress: Progress | None = None,
) -> list[HullRow]:
    """Completions of views of things; a view whose points have no hull is left out.

    Args:
        complete: Completes a detection; importable by name where there are several workers.
        things: What is looked at.
        num_views: Views of each.
        sight: How they are looked at.
        workers: Processes.
        progress: Wraps the stream of things.
    """
    measure = partial(_rows, complete=complete, num_views=num_views, sight=sight)
    return [row for rows in pmap(measure, things, workers=workers, progress=progress) for row in rows]


def summarise_against_hull(rows: Sequence[HullRow]) -> dict[str, Any]:
    """Figures of all rows, and of each kind under "kinds".

    A kind has views, cd_m and hull_cd_m (means over the views with an answer), ratio (of these two means), worst (the
    largest ratio of one view) and failed (views without an answer); all rows together have also the 99 % quantile of
    the ratios (worst_99), two_sigma (mean) and seconds (median).
    """
    answered = [row for row in rows if row.cd_m is not None]
    kinds = {kind: _figures([row for row in rows if row.kind == kind]) for kind in sorted({row.kind for row in rows})}
    figures = _figures(rows)
    if answered:
        figures |= {
            "worst_99": round(float(np.quantile(_ratios(answered), _WORST)), 3),
            "two_sigma": round(float(np.mean([row.two_sigma or 0.0 for row in answered])), 3),
            "seconds": round(float(np.median([row.seconds for row in answered])), 3),
        }
    return figures | {"kinds": kinds}


def _figures(rows: Sequence[HullRow]) -> dict[str, Any]:
    answered = [row for row in rows if row.cd_m is not None]
    figures: dict[str, Any] = {"views": len(rows), "failed": len(rows) - len(answered)}
    if answered:
        cd_m, hull_m = (float(np.mean([getattr(row, name) for row in answered])) for name in ("cd_m", "hull_cd_m"))
        figures |= {"cd_m": round(cd_m, 5), "hull_cd_m": round(hull_m, 5), "ratio": round(cd_m / hull_m, 3)}
        figures["worst"] = round(float(_ratios(answered).max()), 3)
    return figures


def _ratios(rows: Sequence[HullRow]) -> np.ndarray:
    return np.array([row.cd_m for row in rows], dtype=float) / np.array([row.hull_cd_m for row in rows])


def _rows(thing: Thing, *, complete: Complete, num_views: int, sight: SightConfig) -> list[HullRow]:
    rows = (_row(seen, view, complete) for view, seen in enumerate(seen_things(thing, num_views, sight)))
    return [row for row in rows if row is not None]


def _row(seen: SeenThing, view: int, complete: Complete) -> HullRow | None:
    rng = seen.thing.rng(view, 1)
    try:
        hull = trimesh.convex.convex_hull(np.asarray(seen.detection.cloud.points))
    except QhullError:
        return None
    truth = visible_surface(seen.mesh, _SAMPLES, rng)
    named = {"kind": seen.thing.kind, "number": seen.thing.number, "view": view}
    hull_cd_m = chamfer_m(visible_surface(hull, _SAMPLES, rng), truth)
    started = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            shape = complete(seen.detection)
    except GfpGraspError as error:
        return HullRow(**named, cd_m=None, hull_cd_m=hull_cd_m, error=type(error).__name__)
    seconds = time.process_time() - started
    within = position_errors_m(shape, seen.mesh, rng) < 2 * shape.sigma_m
    cd_m = chamfer_m(visible_surface(shape.mesh, _SAMPLES, rng), truth)
    return HullRow(**named, cd_m=cd_m, hull_cd_m=hull_cd_m, two_sigma=float(within.mean()), seconds=round(seconds, 4))


def position_errors_m(shape: CompletedShape, truth: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    """Distance (v,) m of the vertices of a completed shape from the true surface, to within its samples' spacing."""
    points, normals, _ = sample_surface(truth, 4 * _SAMPLES, rng)
    vertices = np.asarray(shape.mesh.vertices)
    near = KDTree(points).query(vertices)[1]
    return np.abs(np.einsum("vi,vi->v", vertices - points[near], normals[near]))
