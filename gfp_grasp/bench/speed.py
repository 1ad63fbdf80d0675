"""Bench of time and memory: `gfp-grasp bench speed`.

Clouds of the test split, of 2000 to 20 000 points, become a mesh and convex parts; ICP and PCRNet are timed on the same
clouds in the same run, as the times of one machine say little beside those of another.
"""

from __future__ import annotations

import gc
import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.bench.views import see
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.detect import detect_single
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import load_primitive
from gfp_grasp.register import FitConfig, fit_evidence, gather_evidence, icp_config, pcrnet_config
from gfp_grasp.scenes import load_objects
from gfp_grasp.types import PointCloud

SIZES = (2000, 5000, 20_000)


def bench_speed(
    objects: str = "cup,mug,bottle", *, limit: int = 30, calls: int = 0, seed: int = 0, progress=None
) -> dict[str, object]:
    """Time completions by stage, registrations beside each other, and watch the memory over many calls.

    Args:
        objects: Families or folder.
        limit: Objects.
        calls: Completions that memory is watched over; 0 leaves it out.
        seed: Of the views.
        progress: Wraps the stream of clouds.

    Returns:
        {"sizes": {points: {"median_ms", "p95_ms", "stages_ms": {stage: median}}}, "all": the same over all sizes,
        "registration_ms": {name: median}, "memory": {"calls", "rss_mb": [at ten points of the run]}}.
    """
    if limit < 1 or calls < 0:
        raise InvalidOption(f"limit is {limit} and calls {calls}; at least one object, and no negative calls")
    clouds = [
        (source.category, see(source.load_mesh(), np.random.default_rng([seed, i]), protocol="standard").cloud)
        for i, source in enumerate(load_objects(objects, limit=limit))
    ]
    watch = progress or (lambda stream, total: stream)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for _, cloud in clouds[:3]:  # what is loaded once is loaded
            _timed(cloud)
        timed = {size: [_timed(_of_size(cloud, size)) for _, cloud in watch(clouds, len(clouds))] for size in SIZES}
        report: dict[str, object] = {
            "objects": len(clouds),
            "sizes": {str(size): _figures(laps) for size, laps in timed.items()},
            "all": _figures([lap for laps in timed.values() for lap in laps]),
            "registration_ms": _registrations(clouds),
        }
        if calls:
            report["memory"] = _memory([cloud for _, cloud in clouds], calls, watch)
    return report


def _timed(cloud: PointCloud) -> dict[str, float]:
    start = time.perf_counter()
    done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint)
    meshed = time.perf_counter()
    assert done.parts
    end = time.perf_counter()
    return {**done.timings_s, "parts": end - meshed, "total": end - start}


def _figures(laps: list[dict[str, float]]) -> dict[str, object]:
    total = np.array([lap["total"] for lap in laps])
    stages = [stage for stage in laps[0] if stage != "total"]
    return {
        "median_ms": _ms(np.median(total)),
        "p95_ms": _ms(np.quantile(total, 0.95)),
        "stages_ms": {stage: _ms(np.median([lap[stage] for lap in laps])) for stage in stages},
    }


def _registrations(clouds: list[tuple[str, PointCloud]]) -> dict[str, float]:
    """Median milliseconds from evidence to a fit, class given."""
    found = [
        (load_primitive(category), gather_evidence(detect_single(c.points, viewpoint=c.viewpoint, category=category)))
        for category, c in clouds
    ]
    configs: dict[str, FitConfig] = {"icp": icp_config(), "pcrnet": pcrnet_config(), "registration": FitConfig()}
    answer = {}
    for name, config in configs.items():
        fit_evidence(found[0][1], found[0][0], config=config)
        answer[name] = _ms(
            np.median([_seconds(lambda p=p, e=e, c=config: fit_evidence(e, p, config=c)) for p, e in found])
        )
    return answer


def _memory(clouds: list[PointCloud], calls: int, watch: Callable) -> dict[str, object]:
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


def resident_mb() -> float:
    """Memory of this process; the most it ever had where the system does not tell the present."""
    status = Path("/proc/self/statm")
    if status.is_file():
        return round(int(status.read_text().split()[1]) * resource.getpagesize() / 1e6, 1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)


def _seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _ms(seconds: float) -> float:
    return round(1000 * float(seconds), 1)
