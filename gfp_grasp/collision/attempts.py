"""Attempts of an engine on one solid: as asked, with jitter, coarser, remeshed, until one gives parts."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.convex import convex_parts
from gfp_grasp.collision.engines.guard import CancelSign, ChildLostError, run_guarded
from gfp_grasp.collision.fidelity import union_error_m, volume_ratios
from gfp_grasp.collision.levels import groups_of, merge_tree
from gfp_grasp.collision.parts import diagonal_m
from gfp_grasp.errors import Cancelled, DecompositionFailed
from gfp_grasp.types import CollisionMesh

# An attempt that hangs must leave time for the next.
_SHARE_OF_TIME = 0.6
# Breaks exact coplanarity, on which CoACD aborts; 1e-6 of a mug is 0.1 micrometre.
_JITTER = 1e-6
_LEAST_VOXELS = 10_000
# MuJoCo keeps meshes in float32, which is 0.001 mm coarse here: further out, parts are made of what is left there.
_NEAR_M = 10.0
_NAMES = {"coacd": "CoACD", "vhacd": "V-HACD"}

TellStage = Callable[[str], object]


def attempted(
    solid: trimesh.Trimesh,
    config: DecomposeConfig,
    started: float,
    tell: TellStage,
    cancel: CancelSign | None,
    *,
    num_given: int,
) -> tuple[CollisionMesh, bool]:
    """Parts of a solid by the first attempt that gives any, and whether time ran out for one before it.

    num_given, the faces of the mesh that the solid was made of, is for the message where none does.
    """
    lost: list[str] = []
    most = config.max_ch_vertex if config.decimate else None
    step, hurried = 0, False
    for attempt in range(config.attempts):
        vertices, options = _variation(solid, config, step)
        left = config.time_limit_s - (time.monotonic() - started)
        if left <= 0:
            break
        if cancel is not None and cancel.is_set():
            raise Cancelled("called off before the decomposition was done")
        tell(f"decomposing, attempt {attempt + 1}")
        limit = left if attempt == config.attempts - 1 else left * _SHARE_OF_TIME
        try:
            hulls, said = run_guarded(
                vertices,
                solid.faces,
                options,
                engine=config.engine,
                time_limit_s=limit,
                memory_limit_mb=config.memory_limit_mb,
                cancel=cancel,
            )
        except ChildLostError as error:
            lost.append(str(error))
            hurried = hurried or error.out_of_time
            step = max(step + 1, 2) if error.out_of_time else step + 1  # jitter cures crashes, not slowness
            continue
        clouds = _within_budget([in_float32(points) for points, _ in hulls], config)
        parts, dropped = convex_parts(clouds, max_vertices=most)
        if not parts:
            lost.append(f"all {dropped} parts were slivers" if dropped else "it gave none")
            step += 1
            continue
        _warn_of(said, config)
        tell("measuring")
        ratio, union_ratio = volume_ratios(parts, solid, rng=np.random.default_rng(0))
        notes = {
            "attempts": attempt + 1,
            "lost": tuple(lost),
            "dropped": dropped,
            "volume_ratio": ratio,
            "union_volume_ratio": union_ratio,
            **_told(options),
            "memory_limit": said["memory_limit"] and config.memory_limit_mb is not None,
            "cached": False,
        }
        error = union_error_m(parts, solid, rng=np.random.default_rng(config.seed))
        return CollisionMesh(parts, error, config.engine, 0.0, notes), hurried
    raise DecompositionFailed(
        f"{_NAMES[config.engine]} gave no parts in {len(lost)} of {config.attempts} attempts within "
        f"{config.time_limit_s:g} s ({'; '.join(lost) or 'no time for one'}): raise time_limit_s "
        f"(--time-limit) or memory_limit_mb, or simplify the mesh ({num_given} faces came, the solid made of them has "
        f"{len(solid.faces)})"
    )


def in_float32(points: np.ndarray) -> np.ndarray:
    """The points (n, 3) m as MuJoCo will hold them, where that is a difference."""
    far = len(points) and np.abs(points).max() > _NEAR_M
    return points.astype(np.float32).astype(np.float64) if far else points


def _variation(solid: trimesh.Trimesh, config: DecomposeConfig, step: int) -> tuple[np.ndarray, dict]:
    """Vertices and the engine's options: as asked (step 0), then jittered, then coarser, then also remeshed."""
    vertices = np.array(solid.vertices)
    mode = config.preprocess_mode
    if mode == "auto":
        mode = "off"
    config = replace(config, preprocess_mode=mode)
    if step > 0:
        rng = np.random.default_rng([config.seed, step])
        vertices += rng.uniform(-1, 1, vertices.shape) * _JITTER * diagonal_m(vertices) * step
    if step > 1:
        threshold = config.threshold * 1.5 ** (step - 1)
        threshold = threshold if config.real_metric else min(threshold, 1.0)
        # The least that CoACD documents: a fraction of the default's time.
        config = replace(config, threshold=threshold, mcts_nodes=10, mcts_iterations=60, resolution=1000)
        voxels = max(config.vhacd_resolution // 4 ** (step - 1), _LEAST_VOXELS)
        config = replace(config, vhacd_resolution=voxels)
    if step > 2:
        config = replace(config, preprocess_mode="on")
    return vertices, config.engine_options()


def _within_budget(clouds: list[np.ndarray], config: DecomposeConfig) -> list[np.ndarray]:
    """Point sets of hulls, merged where an engine gave more of them than were asked for."""
    if not 0 < config.max_convex_hull < len(clouds):
        return clouds
    parts, _ = convex_parts(clouds)
    groups = groups_of(merge_tree(parts), len(parts), config.max_convex_hull)
    return [np.concatenate([parts[i].vertices for i in group]) for group in groups]


def _told(options: dict) -> dict[str, object]:
    """What an attempt may have changed of what was asked for."""
    if "preprocess_mode" in options:
        return {"threshold": options["threshold"], "preprocess_mode": options["preprocess_mode"]}
    return {"vhacd_resolution": options["resolution"]}


def _warn_of(said: dict[str, object], config: DecomposeConfig) -> None:
    if config.memory_limit_mb is not None and not said["memory_limit"]:
        warnings.warn(
            f"this platform does not enforce memory_limit_mb: {_NAMES[config.engine]} ran without it",
            RuntimeWarning,
            stacklevel=4,
        )
    defaults = DecomposeConfig().coacd_options()
    ignored = [name for name in said["unknown_options"] if config.coacd_options()[name] != defaults[name]]  # type: ignore[union-attr]
    if ignored:
        warnings.warn(f"the installed coacd has no {', '.join(ignored)}: ignored", RuntimeWarning, stacklevel=4)
