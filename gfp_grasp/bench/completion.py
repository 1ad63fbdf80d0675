"""Bench of completions: `gfp-grasp bench completion`.

Each object is seen from random views (20 to 60 degrees up, 0.6 m away, 240x320, 35 degree field, 1 mm noise), turned
by any yaw on a table of any height. A method is given the object's points and the viewpoint, and up; nothing else. Its
answer is compared with 8192 samples of the true surface that can be seen from outside or through an opening.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.complete import CompleteConfig, complete_to_mesh
from gfp_grasp.completers import complete_as_observed, mirrored_cloud
from gfp_grasp.deform import DeformConfig
from gfp_grasp.detect import detect_single
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.metrics import chamfer_m, f_score, visible_surface
from gfp_grasp.parallel import pmap
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import load_objects
from gfp_grasp.transforms import make_T, rotation_about

METHODS = ("partial", "hull", "mirror", "registration", "gfs", "gfpnet-paper", "gfpnet", "gfpnet-pcrnet-start")
_SAMPLES = 8192
_UNDEFORMED = "registration"
_RESAMPLINGS = 2000


@dataclass(frozen=True)
class CompletionBench:
    """What is measured on.

    Attributes:
        views: Views of each object.
        seed: Of views, noise and samples.
        split: Of the procedural families.
        limit: Objects of a family or folder; None takes all.
        give_category: Tell the methods the true class.
        noise_m: Standard deviation of the depth noise.
    """

    views: int = 16
    seed: int = 0
    split: str = "test"
    limit: int | None = None
    give_category: bool = False
    noise_m: float = 0.001

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InvalidOption(f"views is {self.views}; at least 1 is expected")


def bench_completion(
    objects: str,
    *,
    methods: Sequence[str] = METHODS,
    config: CompletionBench = CompletionBench(),
    workers: int = 1,
    progress=None,
) -> dict[str, object]:
    """Measure completions of a procedural family, or of the cups, mugs and bottles of a folder of meshes.

    Args:
        objects: Family ("cup", "mug", "bottle", "all") or folder; of a folder, files whose name starts with a class
            that has no primitive are left out.
        methods: Some of METHODS.
        config: Views and noise.
        workers: Processes.
        progress: Wraps the stream of finished views.

    Returns:
        {"settings", "rows": {class: {method: {"cd_m", "f_score", "ms", "views", "failed"}}}, "paired": {class:
        {method: {"gain_m", "ci95_m", "gain_share", "wins", "pairs"}}}, "trials": [...]}. Pairs set a method against
        "registration", the same fit undeformed, on the same view: the mean of what it takes off the Chamfer distance,
        its 95 % interval over objects (bootstrap), its share of the undeformed distance, and the share of views won.

    Raises:
        InvalidOption: An unknown method.
    """
    unknown = set(methods) - set(METHODS)
    if unknown:
        raise InvalidOption(f"unknown methods {sorted(unknown)}; legal are {', '.join(METHODS)}")
    sources = [
        s
        for s in load_objects(objects, split=config.split, limit=config.limit)
        if s.category in ("cup", "mug", "bottle")
    ]
    jobs = [(source, view) for source in sources for view in range(config.views)]
    trials = pmap(partial(_trial, methods=tuple(methods), config=config), jobs, workers=workers, progress=progress)
    flat = [row for rows in trials for row in rows]
    classes = sorted({row["category"] for row in flat})
    rows = {
        c: {m: _summary([r for r in flat if r["category"] == c and r["method"] == m]) for m in methods} for c in classes
    }
    rows["all"] = {m: _summary([r for r in flat if r["method"] == m]) for m in methods}
    rivals = [m for m in methods if m != _UNDEFORMED and _UNDEFORMED in methods]
    paired = {
        c: {m: _paired([r for r in flat if c in ("all", r["category"])], m) for m in rivals} for c in (*classes, "all")
    }
    settings = {"objects": [s.name for s in sources], "samples": _SAMPLES, **asdict(config)}
    return {"settings": settings, "rows": rows, "paired": paired, "trials": flat}


def _trial(job, *, methods: tuple[str, ...], config: CompletionBench) -> list[dict]:
    source, number = job
    name_seed = int.from_bytes(hashlib.sha256(source.name.encode()).digest()[:4], "little")
    rng = np.random.default_rng([config.seed, number, name_seed])
    mesh, cloud = _see(source.load_mesh(), rng, config)
    truth = visible_surface(mesh, _SAMPLES, rng)
    rows = []
    for method in methods:
        start = time.perf_counter()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                points, category = _METHOD[method](cloud, source.category if config.give_category else None, rng)
            row = {"cd_m": chamfer_m(points, truth), "f_score": f_score(points, truth), "class_found": category}
        except GfpGraspError as error:
            row = {"cd_m": None, "f_score": 0.0, "error": type(error).__name__}
        row |= {"ms": round(1000 * (time.perf_counter() - start), 1)}
        rows.append({"object": source.name, "category": source.category, "view": number, "method": method, **row})
    return rows


def _see(mesh: trimesh.Trimesh, rng: np.random.Generator, config: CompletionBench):
    height = float(rng.uniform(-0.3, 0.9))
    low = float(mesh.bounds[0, 2])
    T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), (0, 0, height - low))
    placed = mesh.copy()
    placed.apply_transform(T)
    K = intrinsics(320, 240, 35.0)
    camera = sample_viewpoint(rng, target=placed.bounds.mean(axis=0))
    image, index = render_mesh_view([placed], T_world_camera=camera, K=K, width=320, height=240, table_height=height)
    image = apply_sensor(image, SensorModel.gaussian(config.noise_m), rng)
    return placed, cloud_of(image, (index == 0) & (image.depth_m > 0))


def _partial(cloud, category, rng):
    del category, rng
    return cloud.points, ""


def _detection(cloud, category):
    return detect_single(cloud.points, viewpoint=cloud.viewpoint, up=np.array([0, 0, 1.0]), category=category)


def _hull(cloud, category, rng):
    return visible_surface(complete_as_observed(_detection(cloud, category)).mesh, _SAMPLES, rng), ""


def _mirror(cloud, category, rng):
    del rng
    return mirrored_cloud(_detection(cloud, category)), ""


def _completed(config: CompleteConfig) -> Callable:
    def complete(cloud, category, rng):
        done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, category=category, config=config)
        return visible_surface(done.mesh, _SAMPLES, rng), done.category

    return complete


def _summary(rows: list[dict]) -> dict[str, object]:
    errors = [r["cd_m"] for r in rows if r["cd_m"] is not None]
    found = [r["class_found"] == r["category"] for r in rows if r.get("class_found")]
    return {
        "cd_m": round(float(np.mean(errors)), 5) if errors else None,
        "cd_median_m": round(float(np.median(errors)), 5) if errors else None,
        "f_score": round(float(np.mean([r["f_score"] for r in rows])), 4) if rows else None,
        "class_found": round(float(np.mean(found)), 4) if found else None,
        "ms": round(float(np.median([r["ms"] for r in rows])), 1) if rows else None,
        "views": len(rows),
        "failed": len(rows) - len(errors),
    }


def _paired(rows: list[dict], method: str) -> dict[str, object]:
    """What a method gains on the undeformed fit, view by view; the interval resamples whole objects."""
    errors = {(r["object"], r["view"], r["method"]): r["cd_m"] for r in rows if r["cd_m"] is not None}
    pairs = [(o, errors[o, v, _UNDEFORMED], e) for (o, v, m), e in errors.items() if m == method]
    gains: dict[str, list[float]] = {}
    for name, before, after in pairs:
        gains.setdefault(name, []).append(before - after)
    if not gains:
        return {"pairs": 0}
    sums, counts = (np.array([f(g) for g in gains.values()], dtype=float) for f in (np.sum, len))
    drawn = np.random.default_rng(0).integers(len(gains), size=(_RESAMPLINGS, len(gains)))
    low, high = np.quantile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), [0.025, 0.975])
    gain = float(sums.sum() / counts.sum())
    return {
        "gain_m": round(gain, 6),
        "ci95_m": [round(float(low), 6), round(float(high), 6)],
        "gain_share": round(gain / float(np.mean([before for _, before, _ in pairs])), 4),
        "wins": round(float(np.mean([after < before for _, before, after in pairs])), 4),
        "pairs": len(pairs),
    }


_METHOD = {
    "partial": _partial,
    "hull": _hull,
    "mirror": _mirror,
    "registration": _completed(CompleteConfig(deform=DeformConfig(method="none"))),
    "gfs": _completed(CompleteConfig(deform=DeformConfig(method="gfs"))),
    "gfpnet-paper": _completed(CompleteConfig(deform=DeformConfig(method="gfpnet-paper"))),
    "gfpnet": _completed(CompleteConfig()),
    "gfpnet-pcrnet-start": _completed(CompleteConfig(fit=FitConfig(start="pcrnet"))),
}
