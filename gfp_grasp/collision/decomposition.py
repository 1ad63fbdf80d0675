"""CoACD or V-HACD on any mesh: checked first, run in a guarded child, tried again when lost, made fit for MuJoCo."""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.convex import convex_part, convex_parts, volume_m3
from gfp_grasp.collision.fidelity import union_error_m, volume_ratios
from gfp_grasp.collision.guard import CancelSign, ChildLostError, run_guarded
from gfp_grasp.collision.merging import groups_of, merge_tree
from gfp_grasp.collision.store import decomposition_key, read_parts, write_parts
from gfp_grasp.errors import Cancelled, DecompositionFailed, InvalidMesh, InvalidOption
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.types import CollisionMesh, ConvexPart

# An attempt that hangs must leave time for the next.
_SHARE_OF_TIME = 0.6
# Breaks exact coplanarity, on which CoACD aborts; 1e-6 of a mug is 0.1 micrometre.
_JITTER = 1e-6
_LEAST_VOXELS = 10_000
# MuJoCo keeps meshes in float32, which is 0.001 mm coarse here: further out, parts are made of what is left there.
_NEAR_M = 10.0
_NAMES = {"coacd": "CoACD", "vhacd": "V-HACD"}

TellStage = Callable[[str], object]


def decompose(
    mesh: trimesh.Trimesh,
    *,
    config: DecomposeConfig | None = None,
    progress: TellStage | None = None,
    cancel: CancelSign | None = None,
) -> CollisionMesh:
    """Split a mesh into convex parts with CoACD or V-HACD.

    Either runs in a child process, so that an abort, a hang or a lack of memory there is an error here. A lost attempt
    is followed by one with vertices jittered by a millionth of the diagonal, then by coarser ones, CoACD's last
    remeshed. What the same call gave before comes from the cache; what a lack of time made coarser is not kept there.

    Args:
        mesh: Metres, any frame. What is no watertight volume, or crosses itself, is made one first: CoACD aborts,
            hangs or inflates its walls otherwise.
        config: Engine, its options and limits; None for the defaults.
        progress: Told the stage that begins: "checking", "repairing", "decomposing, attempt 1" and so on, "measuring".
        cancel: A threading.Event, say: once it is set, from another thread, the child is killed and Cancelled raised.

    Returns:
        Parts that MuJoCo compiles, their two-sided error, and in `notes`: attempts, lost (why each was), dropped
        (slivers), repair_m (largest distance between the mesh and the solid that was made of it, which the other
        figures refer to), volume_ratio (summed volume of the parts over the solid's), union_volume_ratio (overlaps
        counted once), memory_limit (whether it holds), cached (whether they come from the cache), and of the attempt
        that succeeded threshold and preprocess_mode, or vhacd_resolution.

    Raises:
        InvalidMesh: Empty, not finite, badly indexed, flat, too small for MuJoCo, or past repair.
        DecompositionFailed: Every attempt was lost; the message says how.
        InvalidOption: The engine's wheel is not installed.
        Cancelled: `cancel` was set.
    """
    config = config or DecomposeConfig()
    check_engine(config)
    started = time.monotonic()
    tell = progress or (lambda stage: None)
    tell("checking")
    used = _used(check_mesh(mesh))
    key = decomposition_key(used, config) if config.cache else None
    known = None if key is None else read_parts(key)
    if known is not None:
        return replace(known, seconds=time.monotonic() - started, notes={**known.notes, "cached": True})
    _whole_hull(used)  # flat things are named as such, before any repair is tried
    tell("repairing")
    solid, repair_m = make_solid(used)
    made, hurried = _attempted(solid, config, started, tell, cancel)
    made = replace(made, seconds=time.monotonic() - started, notes={**made.notes, "repair_m": repair_m})
    if key is not None and not hurried:
        write_parts(key, made)
    return made


def check_engine(config: DecomposeConfig) -> None:
    """Refuse an engine whose wheel is not there.

    Raises:
        InvalidOption: It is not installed.
    """
    if config.engine == "vhacd" and importlib.util.find_spec("vhacdx") is None:
        raise InvalidOption(
            "engine is 'vhacd', and the wheel vhacdx is not installed: pip install 'gfp-grasp[vhacd]', or take 'coacd'"
        )


def _attempted(
    solid: trimesh.Trimesh, config: DecomposeConfig, started: float, tell: TellStage, cancel: CancelSign | None
) -> tuple[CollisionMesh, bool]:
    """Parts of a solid by the first attempt that gives any, and whether time ran out for one before it."""
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
        clouds = _within_budget([_as_kept(points) for points, _ in hulls], config)
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
        f"{config.time_limit_s:g} s ({'; '.join(lost) or 'no time for one'}): raise time_limit_s or "
        f"memory_limit_mb, or simplify the mesh ({len(solid.vertices)} vertices)"
    )


def hull(mesh: trimesh.Trimesh, *, max_vertices: int | None = None) -> CollisionMesh:
    """The convex hull of a mesh as its only part.

    Args:
        mesh: Metres.
        max_vertices: Most vertices of it, at least 4; None for no limit.

    Raises:
        InvalidMesh: Empty, not finite, badly indexed, flat, or too small for MuJoCo.
    """
    if max_vertices is not None and max_vertices < 4:
        raise InvalidOption(f"max_vertices is {max_vertices}; at least 4, or None, is expected")
    started = time.monotonic()
    used = _used(check_mesh(mesh))
    part = _whole_hull(used, max_vertices)
    error = union_error_m([part], used, rng=np.random.default_rng(0))
    ratio = float(volume_m3(part) / used.volume) if used.is_volume else float("nan")
    notes = {"dropped": 0, "volume_ratio": ratio, "union_volume_ratio": ratio}
    return CollisionMesh((part,), error, "hull", time.monotonic() - started, notes)


def _whole_hull(mesh: trimesh.Trimesh, max_vertices: int | None = None) -> ConvexPart:
    part = convex_part(_as_kept(np.asarray(mesh.vertices)), max_vertices=max_vertices)
    if part is None:
        extents = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
        raise InvalidMesh(
            f"mesh of {extents} m, {np.abs(mesh.vertices).max():.3g} m from the origin, is flat or smaller than what "
            "MuJoCo's float32 can hold: 0.1 mm of thickness and 0.1 mm3 are needed; are the units metres?"
        )
    return part


def _as_kept(points: np.ndarray) -> np.ndarray:
    far = len(points) and np.abs(points).max() > _NEAR_M
    return points.astype(np.float32).astype(np.float64) if far else points


def _used(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy without vertices that no face names: nobody has checked those."""
    kept = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    kept.remove_unreferenced_vertices()
    return kept


def _variation(solid: trimesh.Trimesh, config: DecomposeConfig, step: int) -> tuple[np.ndarray, dict]:
    """Vertices and the engine's options: as asked (step 0), then jittered, then coarser, then also remeshed."""
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
