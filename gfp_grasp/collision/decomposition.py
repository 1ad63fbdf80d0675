"""CoACD on any mesh: checked first, run in a guarded child, tried again when it dies, and made fit for MuJoCo."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.convex import convex_part, convex_parts, volume_m3
from gfp_grasp.collision.fidelity import union_error_m, volume_ratios
from gfp_grasp.collision.guard import ChildLostError, run_guarded
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.types import CollisionMesh, ConvexPart

# An attempt that hangs must leave time for the next.
_SHARE_OF_TIME = 0.6
# Breaks exact coplanarity, on which CoACD aborts; 1e-6 of a mug is 0.1 micrometre.
_JITTER = 1e-6


def decompose(mesh: trimesh.Trimesh, *, config: DecomposeConfig | None = None) -> CollisionMesh:
    """Split a mesh into convex parts with CoACD.

    CoACD runs in a child process, so that an abort, a hang or a lack of memory there is an error here. A lost attempt
    is followed by one with vertices jittered by a millionth of the diagonal, then by coarser ones, the last remeshed.

    Args:
        mesh: Metres, any frame. What is no watertight volume, or crosses itself, is made one first: CoACD aborts,
            hangs or inflates its walls otherwise.
        config: Options of CoACD and limits; None for the defaults.

    Returns:
        Parts that MuJoCo compiles, their two-sided error, and in `notes`: attempts, lost (why each was), dropped
        (slivers), repair_m (largest distance between the mesh and the solid that was made of it, which the other
        figures refer to), volume_ratio (summed volume of the parts over the solid's), union_volume_ratio (overlaps
        counted once), threshold and preprocess_mode of the attempt that succeeded, memory_limit (whether it holds).

    Raises:
        InvalidMesh: Empty, not finite, badly indexed, flat, too small for MuJoCo, or past repair.
        DecompositionFailed: Every attempt was lost; the message says how.
    """
    config = config or DecomposeConfig()
    started = time.monotonic()
    used = _used(check_mesh(mesh))
    _whole_hull(used)  # flat things are named as such, before any repair is tried
    solid, repair_m = make_solid(used)
    lost: list[str] = []
    step = 0
    for attempt in range(config.attempts):
        vertices, options = _variation(solid, config, step)
        left = config.time_limit_s - (time.monotonic() - started)
        if left <= 0:
            break
        limit = left if attempt == config.attempts - 1 else left * _SHARE_OF_TIME
        try:
            hulls, said = run_guarded(
                vertices, solid.faces, options, time_limit_s=limit, memory_limit_mb=config.memory_limit_mb
            )
        except ChildLostError as error:
            lost.append(str(error))
            step = max(step + 1, 2) if error.out_of_time else step + 1  # jitter cures crashes, not slowness
            continue
        parts, dropped = convex_parts(points for points, _ in hulls)
        if not parts:
            lost.append(f"all {dropped} parts were slivers")
            step += 1
            continue
        _warn_of(said, config)
        ratio, union_ratio = volume_ratios(parts, solid, rng=np.random.default_rng(0))
        notes = {
            "attempts": attempt + 1,
            "lost": tuple(lost),
            "dropped": dropped,
            "repair_m": repair_m,
            "volume_ratio": ratio,
            "union_volume_ratio": union_ratio,
            "threshold": options["threshold"],
            "preprocess_mode": options["preprocess_mode"],
            "memory_limit": said["memory_limit"] and config.memory_limit_mb is not None,
        }
        error = union_error_m(parts, solid, rng=np.random.default_rng(config.seed))
        return CollisionMesh(parts, error, "coacd", time.monotonic() - started, notes)
    raise DecompositionFailed(
        f"CoACD gave no parts in {len(lost)} of {config.attempts} attempts within {config.time_limit_s:g} s "
        f"({'; '.join(lost) or 'no time for one'}): raise time_limit_s or memory_limit_mb, or simplify the "
        f"mesh ({len(solid.vertices)} vertices)"
    )


def hull(mesh: trimesh.Trimesh, *, max_vertices: int | None = None) -> CollisionMesh:
    """The convex hull of a mesh as its only part.

    Args:
        mesh: Metres.
        max_vertices: Most vertices of it; None for no limit.

    Raises:
        InvalidMesh: Empty, not finite, badly indexed, flat, or too small for MuJoCo.
    """
    started = time.monotonic()
    used = _used(check_mesh(mesh))
    part = _whole_hull(used, max_vertices)
    error = union_error_m([part], used, rng=np.random.default_rng(0))
    ratio = float(volume_m3(part) / used.volume) if used.is_volume else float("nan")
    notes = {"dropped": 0, "volume_ratio": ratio, "union_volume_ratio": ratio}
    return CollisionMesh((part,), error, "hull", time.monotonic() - started, notes)


def _whole_hull(mesh: trimesh.Trimesh, max_vertices: int | None = None) -> ConvexPart:
    part = convex_part(np.asarray(mesh.vertices), max_vertices=max_vertices)
    if part is None:
        extents = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
        raise InvalidMesh(
            f"mesh of {extents} m is flat or smaller than what MuJoCo can hold: "
            "0.1 mm of thickness and 0.1 mm3 are needed; are the units metres?"
        )
    return part


def _used(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy without vertices that no face names: nobody has checked those."""
    kept = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    kept.remove_unreferenced_vertices()
    return kept


def _variation(solid: trimesh.Trimesh, config: DecomposeConfig, step: int) -> tuple[np.ndarray, dict]:
    """Vertices and CoACD's options: as asked (step 0), then jittered, then coarser, then also remeshed."""
    vertices = np.array(solid.vertices)
    mode = config.preprocess_mode
    if mode == "auto":
        mode = "off"
    config = replace(config, preprocess_mode=mode)
    if step > 0:
        diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        rng = np.random.default_rng([config.seed, step])
        vertices += rng.uniform(-1, 1, vertices.shape) * _JITTER * diagonal * step
    if step > 1:
        threshold = config.threshold * 1.5 ** (step - 1)
        threshold = threshold if config.real_metric else min(threshold, 1.0)
        # The least that CoACD documents: a fraction of the default's time.
        config = replace(config, threshold=threshold, mcts_nodes=10, mcts_iterations=60, resolution=1000)
    if step > 2:
        config = replace(config, preprocess_mode="on")
    return vertices, config.coacd_options()


def _warn_of(said: dict[str, object], config: DecomposeConfig) -> None:
    if config.memory_limit_mb is not None and not said["memory_limit"]:
        warnings.warn(
            "this platform does not enforce memory_limit_mb: CoACD ran without it", RuntimeWarning, stacklevel=3
        )
    defaults = DecomposeConfig().coacd_options()
    ignored = [name for name in said["unknown_options"] if config.coacd_options()[name] != defaults[name]]  # type: ignore[union-attr]
    if ignored:
        warnings.warn(f"the installed coacd has no {', '.join(ignored)}: ignored", RuntimeWarning, stacklevel=3)
