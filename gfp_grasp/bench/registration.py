"""Bench of registrations: `gfp-grasp bench registration`.

Views of the procedural test split, class and support known. Each start is followed by the same refinement, so that the
rows tell what a proposal or PCRNet's start is worth.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.rows import Row
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.meshes import sample_surface
from gfp_grasp.metrics import chamfer_m
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import recognise
from gfp_grasp.register import STARTS, FitConfig, fit_primitive
from gfp_grasp.scenes import shipped_families
from gfp_grasp.shapes import split_seeds
from gfp_grasp.train import View, ViewsConfig, render_views, shape_source
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import FittedPrimitive, GenericPrimitive

_SAMPLES = 4096


@dataclass(frozen=True)
class RegistrationConfig:
    """Which views are measured.

    Attributes:
        views: Number of views of each shape.
        limit: Most shapes of each family; None takes the whole test split.
        seed: Seed of views and noise.
        mean_size: Starts have the mean size, so that the size is left to the refinement.
    """

    views: int = 4
    limit: int | None = None
    seed: int = 0
    mean_size: bool = False

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InvalidOption(f"views is {self.views}; at least 1 is expected")


@dataclass(frozen=True, kw_only=True)
class FitRow(Row):
    """One fit of one view from one start; None where a figure does not apply.

    Attributes:
        family: Class of the shape.
        seed: Number of the shape within its class.
        view: Number of the view.
        start: Kind of start.
        ms: Time of the fit, ms.
        axis_deg: Angle between the upright axes.
        yaw_deg: Turn about the upright axis, where the class has a handle.
        offset_m: Distance between the objects' middles.
        size: Relative error of the diagonal.
        cd_m: Chamfer distance between fitted and true surface, hidden parts and all.
        wrong_rest: Whether the hypothesis of rest is wrong.
        error: Message of the error that ended the fit.
    """

    family: str
    seed: int
    view: int
    start: str
    ms: float
    axis_deg: float | None = None
    yaw_deg: float | None = None
    offset_m: float | None = None
    size: float | None = None
    cd_m: float | None = None
    wrong_rest: bool | None = None
    error: str | None = None


def bench_registration(
    *,
    starts: Sequence[str] = STARTS,
    config: RegistrationConfig = RegistrationConfig(),
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """Errors of fits from each start.

    Args:
        starts: Some of STARTS.
        config: Shapes and views.
        workers: Number of processes.
        progress: Wraps the stream of finished shapes.

    Returns:
        {"settings", "rows": {class: {start: {"axis_deg", "yaw_deg", "offset_m", "size", "cd_m", "wrong_rest", "ms",
        "views", "failed"}}}, "trials": every `FitRow`}. Errors are medians over the views that were fitted;
        `wrong_rest` is the share of those whose hypothesis of rest is wrong.

    Raises:
        InvalidOption: An unknown start.
    """
    unknown = set(starts) - set(STARTS)
    if unknown:
        raise InvalidOption(f"unknown starts {sorted(unknown)}; legal are {', '.join(STARTS)}")
    families = shipped_families()
    jobs = [(family, int(seed)) for family in families for seed in split_seeds(family, "test")[: config.limit]]
    run = partial(_rows_of_shape, starts=tuple(starts), config=config)
    flat = [row for rows in pmap(run, jobs, workers=workers, progress=progress) for row in rows]
    rows = {
        family: {s: _summarise([row for row in flat if row.family == family and row.start == s]) for s in starts}
        for family in families
    }
    rows["all"] = {s: _summarise([row for row in flat if row.start == s]) for s in starts}
    settings = {**asdict(config), "view": asdict(ViewsConfig())}
    return {"settings": settings, "rows": rows, "trials": [row.to_json() for row in flat]}


def _rows_of_shape(job: tuple[str, int], *, starts: tuple[str, ...], config: RegistrationConfig) -> list[FitRow]:
    family, seed = job
    library = PrimitiveLibrary.shipped()
    primitive, rows = library.primitive(family), []
    for number, view in enumerate(
        render_views(shape_source(family, seed), num_views=config.views, first_seed=config.seed)
    ):
        for start in starts:
            began = time.perf_counter()
            fit_config = replace(FitConfig(size=(1.0, 1.0, 1.0) if config.mean_size else None), start=start)  # pyright: ignore[reportArgumentType]
            errors: dict[str, Any]
            try:
                detection = view.detection()
                if start == "proposal":
                    detection = recognise(detection, library)
                errors = _errors(fit_primitive(detection, primitive, config=fit_config), view, primitive)
            except FitDiverged as error:
                errors = {"error": str(error)}
            milliseconds = round(1000 * (time.perf_counter() - began), 1)
            rows.append(FitRow(family=family, seed=seed, view=number, start=start, ms=milliseconds, **errors))
    return rows


def _errors(fit: FittedPrimitive, view: View, primitive: GenericPrimitive) -> dict[str, Any]:
    """Fields of a `FitRow` that compare a fit with the truth."""
    R, R_true = fit.T_world_object[:3, :3], view.T_world_object[:3, :3]
    mesh, rng = view.source.load_mesh(), np.random.default_rng(view.seed)
    fitted = sample_surface(trimesh.Trimesh(fit.vertices_world(), primitive.faces, process=False), _SAMPLES, rng)[0]
    true = apply_T(view.T_world_object, sample_surface(mesh, _SAMPLES, rng)[0])
    size, size_true = (float(np.linalg.norm(np.ptp(points, axis=0))) for points in (fitted, true))
    middle, middle_true = ((points.min(axis=0) + points.max(axis=0)) / 2 for points in (fitted, true))
    errors: dict[str, Any] = {
        "axis_deg": _degrees(R[:, 2], R_true[:, 2]),
        "offset_m": float(np.linalg.norm(middle - middle_true)),
        "size": abs(size / size_true - 1.0),
        "cd_m": chamfer_m(fitted, true),
        "wrong_rest": fit.hypothesis != view.resting,
    }
    if primitive.on_part.any():  # without a handle, most members are round and have no yaw
        level = R_true[:, 0] - (R_true[:, 0] @ R[:, 2]) * R[:, 2]
        errors["yaw_deg"] = _degrees(R[:, 0], level)
    return errors


def _degrees(a: np.ndarray, b: np.ndarray) -> float:
    cosine = a @ b / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _summarise(rows: Sequence[FitRow]) -> dict[str, float | int | None]:
    fitted = [row for row in rows if row.error is None]

    def median(name: str) -> float | None:
        values = [value for row in fitted if (value := getattr(row, name)) is not None]
        return round(float(np.median(values)), 5) if values else None

    return {
        **{name: median(name) for name in ("axis_deg", "yaw_deg", "offset_m", "size", "cd_m", "ms")},
        "wrong_rest": round(float(np.mean([bool(row.wrong_rest) for row in fitted])), 4) if fitted else None,
        "views": len(rows),
        "failed": len(rows) - len(fitted),
    }
