"""CoACD or V-HACD on any mesh: checked, made a solid, split in a guarded child, measured, and kept on disk.

Several meshes are decomposed side by side by threads that each wait for a guarded child.
"""

from __future__ import annotations

import atexit
import importlib.util
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from queue import Empty, SimpleQueue

import numpy as np
import trimesh

from gfp_grasp.collision.attempts import TellStage, attempted, in_float32
from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.convex import convex_part
from gfp_grasp.collision.engines.guard import CancelSign
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.collision.levels import PartLevels, levels_of
from gfp_grasp.collision.parts import diagonal_m, volume_m3
from gfp_grasp.collision.store import decomposition_key, read_parts, write_parts
from gfp_grasp.errors import GfpGraspError, InvalidMesh, InvalidOption
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.types import CollisionMesh, ConvexPart

# CoACD's thresholds for a template. A mug's mean has 121 parts at 0.02, which miss it by 0.2 mm on average; a bottle's
# has too few at that. What is nearly a block has ten that miss it by 0.09 mm, and at 0.01 CoACD may be at work for a
# quarter of an hour.
_LEVEL_THRESHOLDS = (0.02, 0.01)
_FEWEST_PARTS = 32
_CLOSE = 0.0005  # mean error, as a share of the diagonal, that fewer parts may have


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
    solid, repair_m = make_solid(used, time_limit_s=config.time_limit_s / 2)
    made, hurried = attempted(solid, config, started, tell, cancel, num_given=len(mesh.faces))
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


def part_levels(mesh: trimesh.Trimesh) -> PartLevels:
    """Decompose a template finely with CoACD, and merge its parts in the order that harms least.

    Takes minutes.

    Args:
        mesh: Watertight, m.

    Raises:
        InvalidMesh: See decompose.
        DecompositionFailed: See decompose.
    """
    parts: tuple[ConvexPart, ...] = ()
    for threshold in _LEVEL_THRESHOLDS:
        found = decompose(mesh, config=DecomposeConfig(threshold=threshold, time_limit_s=1800.0))
        parts = found.parts
        if len(parts) >= _FEWEST_PARTS or found.error_m[0] <= _CLOSE * diagonal_m(np.asarray(mesh.vertices)):
            break
    return levels_of(parts, mesh)


def _whole_hull(mesh: trimesh.Trimesh, max_vertices: int | None = None) -> ConvexPart:
    part = convex_part(in_float32(np.asarray(mesh.vertices)), max_vertices=max_vertices)
    if part is None:
        extents = " x ".join(f"{extent:.3g}" for extent in np.ptp(mesh.vertices, axis=0))
        raise InvalidMesh(
            f"mesh of {extents} m, {np.abs(mesh.vertices).max():.3g} m from the origin, is flat or smaller than what "
            "MuJoCo's float32 can hold: 0.1 mm of thickness and 0.1 mm3 are needed; are the units metres?"
        )
    return part


def _used(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy without vertices that no face names: nobody has checked those."""
    kept = trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), process=False)
    kept.remove_unreferenced_vertices()
    return kept


# How long a cancelled thread is waited for: it may be repairing a mesh, which cannot be interrupted.
_PATIENCE_S = 5.0


def decompose_many(
    meshes: Iterable[trimesh.Trimesh],
    *,
    config: DecomposeConfig | None = None,
    workers: int = 2,
    cancel: CancelSign | None = None,
) -> Iterator[CollisionMesh | GfpGraspError]:
    """Decompose several meshes at once, as `decompose` does one.

    Needs no main guard in a script. Closing the iterator, letting go of it or Ctrl-C kills the children at work.

    Args:
        meshes: Metres, each in any frame.
        config: For all of them; None for the defaults.
        workers: Child processes at work at a time, at least 1.
        cancel: Once it is set, what is not done yet comes as Cancelled.

    Returns:
        For each mesh, in their order and as they are done: its parts, or the error that `decompose` has for it.

    Raises:
        InvalidOption: workers is below 1, or the engine's wheel is not installed.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InvalidOption(f"workers is {workers!r}; a whole number, at least 1, is expected")
    config = config or DecomposeConfig()
    check_engine(config)
    return _stream(list(meshes), config, workers, cancel)


def _stream(
    meshes: list[trimesh.Trimesh], config: DecomposeConfig, workers: int, cancel: CancelSign | None
) -> Iterator[CollisionMesh | GfpGraspError]:
    stop = _Stop(cancel)
    jobs: SimpleQueue[tuple[Future, trimesh.Trimesh]] = SimpleQueue()
    futures = [Future() for _ in meshes]
    for job in zip(futures, meshes, strict=True):
        jobs.put(job)
    # Daemons, not an executor's threads: at the interpreter's end those would work off all that is left.
    threads = [threading.Thread(target=_work, args=(jobs, config, stop), daemon=True) for _ in meshes[:workers]]

    def end() -> None:
        stop.called_off.set()
        for thread in threads:
            if thread.ident is not None:
                thread.join(_PATIENCE_S)

    # A daemon that the interpreter's end finds at work holds what other libraries then miss, and say so.
    atexit.register(end)
    try:
        for thread in threads:
            thread.start()
        for future in futures:
            yield future.result()
    finally:
        atexit.unregister(end)
        end()


def _work(jobs: SimpleQueue, config: DecomposeConfig, stop: _Stop) -> None:
    while not stop.called_off.is_set():
        try:
            future, mesh = jobs.get_nowait()
        except Empty:
            return
        try:
            future.set_result(decompose(mesh, config=config, cancel=stop))
        except GfpGraspError as error:
            future.set_result(error)
        except BaseException as error:  # our own mistake: the caller's thread shall see it
            future.set_exception(error)
            raise


class _Stop:
    """A sign that is set when the stream has been closed or the caller's own sign is set."""

    def __init__(self, cancel: CancelSign | None) -> None:
        self.called_off = threading.Event()
        self._cancel = cancel

    def is_set(self) -> bool:
        return self.called_off.is_set() or (self._cancel is not None and self._cancel.is_set())
