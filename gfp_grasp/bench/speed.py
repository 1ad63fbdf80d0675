"""Benches of calls: `gfp-grasp bench speed`, `gfp-grasp bench resets` and `gfp-grasp bench stability`.

Time: clouds of the test split, of 2000 to 20 000 points, become a mesh and convex parts; ICP and PCRNet are timed on
the same clouds in the same run, as the times of one machine say little beside those of another. Memory: episodes of the
environment come and go, and nothing of them may stay; there are more objects than it keeps compiled, so that scenes are
also thrown away and made anew. Stability: the same call twice gives the same bits, and a cloud that was moved rigidly
about up gives the moved answer.
"""

from __future__ import annotations

import gc
import time
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.bench.memory import resident_mb
from gfp_grasp.bench.methods import view_object
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.detect import detect_single
from gfp_grasp.envs import GfpGraspEnv
from gfp_grasp.errors import InvalidOption
from gfp_grasp.level import make_level_view
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, fit_best, icp_config, pcrnet_config
from gfp_grasp.scenes import ObjectSource, label_of, load_objects
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import PointCloud

SIZES = (2000, 5000, 20_000)
_POINTS = 10  # memory is measured so often in a run of resets
# A small picture: it takes less time, and what stays of an episode is not its picture.
_SMALL = {"image_width": 120, "image_height": 90, "num_points": 256}


def bench_speed(
    objects: str = "all", *, limit: int = 30, calls: int = 0, seed: int = 0, progress=None
) -> dict[str, Any]:
    """Time completions by stage, registrations beside each other, and watch the memory over many calls.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        limit: Most objects in all.
        calls: Number of completions that memory is watched over; 0 leaves it out.
        seed: Seed of the views.
        progress: Wraps the stream of clouds.

    Returns:
        {"sizes": {points: {"median_ms", "p95_ms", "stages_ms": {stage: median, 0 where most answers do without}}},
        "all": the same over all sizes, "classfree": the same over the answers of no class, where there are some,
        "registration_ms": {name: median over the objects of a class}, "memory": {"calls", "rss_mb": [at ten points of
        the run]}}.
    """
    if limit < 1 or calls < 0:
        raise InvalidOption(f"limit is {limit} and calls {calls}; at least one object, and no negative calls")
    clouds = [
        (source.category, view_object(source.load_mesh(), np.random.default_rng([seed, i]), protocol="standard").cloud)
        for i, source in enumerate(load_objects(objects, limit=limit))
    ]
    watch = progress or (lambda stream, total: stream)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _, cloud in clouds[:3]:  # what is loaded once is loaded
            _timed(cloud)
        timed = {size: [_timed(_of_size(cloud, size)) for _, cloud in watch(clouds, len(clouds))] for size in SIZES}
        laps = [lap for some in timed.values() for lap in some]
        without_class = [lap for lap in laps if "classfree" in lap]
        report: dict[str, object] = {
            "objects": len(clouds),
            "sizes": {str(size): _figures(some) for size, some in timed.items()},
            "all": _figures(laps),
            "registration_ms": _registrations(clouds),
        }
        if without_class:
            report["classfree"] = {"answers": len(without_class), **_figures(without_class)}
        if calls:
            report["memory"] = _memory([cloud for _, cloud in clouds], calls, watch)
    return report


def bench_resets(
    objects: str = "all",
    *,
    resets: int = 10_000,
    completer: str = "mirror",
    limit: int = 20,
    seed: int = 0,
    progress=None,
    **options: object,
) -> dict[str, Any]:
    """Memory of the process over many resets of one environment.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        resets: Number of resets.
        completer: Name of the completer; a cheap one measures the environment, another one measures itself as well.
        limit: Most objects in all; each is loaded once before the count begins, as parts that are not in the cache yet
            would be made in the first resets.
        seed: Seed of the first reset; those after it go on from there.
        progress: Wraps the stream of resets.
        **options: More of `gfp_grasp.envs.config.EnvConfig`; the picture is small unless they say otherwise.

    Returns:
        {"settings", "rss_mb": resident memory in MB at ten points of the run, "resets_per_s": in seconds of CPU time}.

    Raises:
        InvalidOption: Fewer than ten resets, or an option that the environment refuses.
    """
    if resets < _POINTS:
        raise InvalidOption(f"resets is {resets}; at least {_POINTS} are expected, for as many points of measurement")
    chosen = {"objects": objects, "completer": completer, "limit": limit, **_SMALL, **options}
    env = GfpGraspEnv(**chosen)
    for number in range(len(env.sources)):
        env.reset(seed=seed, options={"object": number})
    marks = {resets * (i + 1) // _POINTS for i in range(_POINTS)}
    resident, seconds = [], 0.0
    for done in (progress or (lambda stream, total: stream))(range(1, resets + 1), resets):
        start = time.process_time()
        env.reset(seed=seed if done == 1 else None)
        seconds += time.process_time() - start
        if done in marks:
            resident.append(resident_mb())
    env.close()
    return {
        "settings": {
            **chosen,
            "objects": label_of(objects),
            "num_objects": len(env.sources),
            "resets": resets,
            "seed": seed,
        },
        "rss_mb": resident,
        "resets_per_s": round(resets / seconds, 2),
    }


def _timed(cloud: PointCloud) -> dict[str, float]:
    start = time.perf_counter()
    done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint)
    meshed = time.perf_counter()
    assert done.parts
    end = time.perf_counter()
    return {**done.timings_s, "parts": end - meshed, "total": end - start}


def _figures(laps: list[dict[str, float]]) -> dict[str, Any]:
    total = np.array([lap["total"] for lap in laps])
    stages = [stage for stage in dict.fromkeys(stage for lap in laps for stage in lap) if stage != "total"]
    return {
        "median_ms": _ms(np.median(total)),
        "p95_ms": _ms(np.quantile(total, 0.95)),
        "stages_ms": {stage: _ms(np.median([lap.get(stage, 0.0) for lap in laps])) for stage in stages},
    }


def _registrations(clouds: list[tuple[str, PointCloud]]) -> dict[str, float]:
    """Median milliseconds from evidence to a fit, class given."""
    library = PrimitiveLibrary.shipped()
    found = [
        (
            library.primitive(category),
            make_level_view(detect_single(c.points, viewpoint=c.viewpoint, category=category)),
        )
        for category, c in clouds
        if category in library.categories
    ]
    if not found:
        return {}
    configs: dict[str, FitConfig] = {"icp": icp_config(), "pcrnet": pcrnet_config(), "registration": FitConfig()}
    answer = {}
    for name, config in configs.items():
        fit_best(found[0][1], [(found[0][0], 0.0)], config=config)
        answer[name] = _ms(
            np.median([_seconds(lambda p=p, e=e, c=config: fit_best(e, [(p, 0.0)], config=c)) for p, e in found])
        )
    return answer


def _memory(clouds: list[PointCloud], calls: int, watch: Callable) -> dict[str, Any]:
    every = max(1, calls // 10)
    resident = []
    for call in watch(range(calls), calls):
        done = complete_to_mesh(clouds[call % len(clouds)].points, viewpoint=clouds[call % len(clouds)].viewpoint)
        assert len(done.mesh.faces)
        if (call + 1) % every == 0:
            gc.collect()
            resident.append(resident_mb())
    return {"calls": calls, "rss_mb": resident}


def _of_size(cloud: PointCloud, size: int) -> PointCloud:
    """The cloud with so many points: drawn from it, or added between its own and their nearest neighbours."""
    rng, points = np.random.default_rng(0), cloud.points
    if len(points) >= size:
        return PointCloud(points[rng.choice(len(points), size, replace=False)], cloud.viewpoint)
    more = rng.integers(len(points), size=size - len(points))
    near = np.asarray(KDTree(points).query(points[more], k=4)[1])[np.arange(len(more)), rng.integers(1, 4, len(more))]
    share = rng.uniform(0.2, 0.8, (len(more), 1))
    between = share * points[more] + (1 - share) * points[near]
    return PointCloud(np.concatenate([points, between]), cloud.viewpoint)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _ms(seconds: float) -> float:
    return round(1000 * float(seconds), 1)


def bench_stability(
    objects: str = "all",
    *,
    motions: int = 200,
    limit: int = 20,
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """Complete each object twice, and after rigid motions about up.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        motions: Number of motions in all, shared out over the objects.
        limit: Most objects in all.
        seed: Seed of views and motions.
        workers: Number of processes.
        progress: Wraps the stream of objects.

    Returns:
        {"objects", "same_bits": whether every repeated call gave the same vertices, "motions", "moved_mm": median,
        95 % and largest over the motions of the mean surface distance between the moved answer and the answer to the
        moved cloud, "share_within_1_mm"}.
    """
    if motions < 1 or limit < 1:
        raise InvalidOption(f"{motions} motions of {limit} objects; at least one of each is expected")
    known = PrimitiveLibrary.shipped().categories
    sources = [s for s in load_objects(objects, limit=limit) if s.category in known]
    jobs = [(source, len(range(i, motions, len(sources))), i) for i, source in enumerate(sources)]
    answers = pmap(partial(_stability, seed=seed), jobs, workers=workers, progress=progress)
    moved_mm = np.concatenate([moved for _, moved in answers])
    return {
        "objects": len(sources),
        "same_bits": all(same for same, _ in answers),
        "motions": len(moved_mm),
        "moved_mm": [round(float(q), 4) for q in (*np.quantile(moved_mm, [0.5, 0.95]), moved_mm.max())],
        "share_within_1_mm": round(float((moved_mm < 1.0).mean()), 4),
    }


def _stability(job: tuple[ObjectSource, int, int], *, seed: int) -> tuple[bool, np.ndarray]:
    source, motions, number = job
    rng = np.random.default_rng([seed, number])
    cloud = view_object(source.load_mesh(), rng).cloud
    assert cloud.viewpoint is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first, again = (complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint).mesh for _ in range(2))
        moved_mm = []
        for _ in range(motions):
            T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), rng.uniform(-2, 2, 3))
            points, place = apply_T(T, cloud.points), apply_T(T, cloud.viewpoint)
            back = complete_to_mesh(points, viewpoint=place).mesh.copy()
            back.apply_transform(invert_T(T))
            moved_mm.append(1000 * _apart_m(first, back))
    return bool(np.array_equal(first.vertices, again.vertices)), np.array(moved_mm)


def _apart_m(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Mean distance of the vertices of each from the surface of the other."""

    def one_way(points: np.ndarray, mesh: trimesh.Trimesh) -> float:
        return float(trimesh.proximity.closest_point(mesh, points)[1].mean())

    return 0.5 * (one_way(np.asarray(a.vertices), b) + one_way(np.asarray(b.vertices), a))
