"""Bench of what breaks programs: `gfp-grasp bench hostile`.

Hostile meshes go through validation and, fewer of them, through decompose. Each must come out as a valid result or as a
named error, in time, and leave no process behind. The work is done in processes of its own, so that a crash or a hang
is a figure here.
"""

from __future__ import annotations

import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.hostile_meshes import KINDS, hostile_mesh
from gfp_grasp.bench.rows import Row
from gfp_grasp.collision import DecomposeConfig, close_workers, decompose, hull, idle_pids
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.meshes import check_mesh, make_solid, triangle_normals
from gfp_grasp.types import CollisionMesh, ConvexPart

BAD = ("crash", "hang", "invalid", "zombie")
# What a step may take beyond its own limit before it counts as a hang: the repair of a soup of triangles, which has
# none, is 15 s of work for a core that has nothing else to do.
_MARGIN_S = 100.0
_VALIDATION_LIMIT_S = 20.0
_FLAT = 1e-6  # share of a part's size by which its own corners may stand out of its faces
_QUICK = DecomposeConfig(
    threshold=0.2, mcts_iterations=60, mcts_nodes=10, resolution=1000, max_convex_hull=16, time_limit_s=20, cache=False
)
Job = tuple[str, int]


@dataclass(frozen=True, kw_only=True)
class HostileRow(Row):
    """One mesh in one step.

    Attributes:
        step: "validate" or "decompose".
        number: Number of the mesh.
        kind: Kind of the mesh.
        outcome: "valid", the class of a named error, or one of BAD.
        s: Time of the step, s.
        why: Description of what was wrong; None where there is nothing more to tell.
    """

    step: str
    number: int
    kind: str
    outcome: str
    s: float
    why: str | None = None


@dataclass(frozen=True)
class HostileConfig:
    """Which meshes are sent.

    Attributes:
        count: Number of meshes that are checked and made solid, or hulled, in turn.
        coacd: Number of meshes, the first of the same, that are decomposed.
        seed: Seed of the meshes.
    """

    count: int = 10_000
    coacd: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.count, self.coacd, self.seed) < 0 or self.count + self.coacd == 0:
            raise InvalidOption(f"count is {self.count}, coacd {self.coacd}, seed {self.seed}: none may be negative")


def bench_hostile(
    *,
    config: HostileConfig = HostileConfig(),
    known: Mapping[str, Any] | None = None,
    workers: int = 1,
    progress: Callable[[Iterable[HostileRow], int], Iterable[HostileRow]] | None = None,
    save: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Send hostile meshes through validation and decomposition.

    Args:
        config: Number of meshes, and their seed.
        known: An earlier report, whose rows are kept if it had the same seed; the bad ones are made anew.
        workers: Number of processes.
        progress: Wraps the stream of rows.
        save: Given the report so far, every hundred rows.

    Returns:
        {"settings", "bad": {"crash", "hang", "invalid", "zombie": how many}, "rows": {step: {kind: {outcome: count}}},
        "seconds": {step: median and largest}, "trials": every `HostileRow`}.
    """
    if workers < 1:
        raise InvalidOption(f"workers is {workers}; at least 1 is expected")
    steps = {"validate": config.count, "decompose": config.coacd}
    jobs = [(step, number) for step, count in steps.items() for number in range(count)]
    jobs.sort(key=lambda job: job[1] / steps[job[0]])  # a run that is stopped has had its share of both
    rows: dict[Job, HostileRow] = {}
    if known is not None and known.get("settings", {}).get("seed") == config.seed:
        former = [HostileRow(**record) for record in known["trials"]]
        rows = {(row.step, row.number): row for row in former if row.outcome not in BAD}
        rows = {job: rows[job] for job in jobs if job in rows}
    left = [job for job in jobs if job not in rows]
    watch = progress or (lambda stream, total: stream)
    for done, row in enumerate(watch(_run(left, config.seed, workers), len(left)), 1):
        rows[row.step, row.number] = row
        if save is not None and done % 100 == 0:
            save(_report(config, rows))
    return _report(config, rows)


def _report(config: HostileConfig, done: Mapping[Job, HostileRow]) -> dict[str, Any]:
    ordered = [done[job] for job in sorted(done, key=lambda job: (job[0] == "decompose", job[1]))]
    rows: dict[str, dict[str, dict[str, int]]] = {}
    seconds: dict[str, dict[str, float]] = {}
    for step in ("validate", "decompose"):
        mine = [row for row in ordered if row.step == step]
        if not mine:
            continue
        rows[step] = {kind: dict(Counter(row.outcome for row in mine if row.kind == kind)) for kind in KINDS}
        taken = np.array([row.s for row in mine])
        seconds[step] = {"median": round(float(np.median(taken)), 3), "largest": round(float(taken.max()), 3)}
    bad = {name: sum(row.outcome == name for row in ordered) for name in BAD}
    return {
        "settings": {**asdict(config), "time_limit_s": _QUICK.time_limit_s, "margin_s": _MARGIN_S},
        "done": {step: sum(figures.values()) for step, figures in _sums(rows).items()},
        "bad": bad,
        "outcomes": _sums(rows),
        "seconds": seconds,
        "rows": rows,
        "trials": [row.to_json() for row in ordered],
    }


def _sums(rows: Mapping[str, Mapping[str, Mapping[str, int]]]) -> dict[str, dict[str, int]]:
    return {step: dict(sum(map(Counter, kinds.values()), Counter())) for step, kinds in rows.items()}


def _run(jobs: list[Job], seed: int, workers: int) -> Iterator[HostileRow]:
    """Rows as they are done: one thread for each process, which starts it anew when it is lost."""
    waiting: SimpleQueue[Job] = SimpleQueue()
    answers: SimpleQueue[HostileRow | BaseException] = SimpleQueue()
    for job in jobs:
        waiting.put(job)
    stop = threading.Event()
    threads = [
        threading.Thread(target=_oversee, args=(waiting, answers, seed, stop), daemon=True) for _ in range(workers)
    ]
    for thread in threads:
        thread.start()
    try:
        for _ in jobs:
            answer = answers.get()
            if isinstance(answer, BaseException):
                raise answer
            yield answer
    finally:
        stop.set()
        for thread in threads:
            thread.join(10)


def _oversee(waiting: SimpleQueue, answers: SimpleQueue, seed: int, stop: threading.Event) -> None:
    worker = None
    try:
        while not stop.is_set():
            try:
                step, number = waiting.get_nowait()
            except Empty:
                return
            worker = worker or _Worker(seed)
            row, worker = worker.ask(step, number, stop)
            if row is not None:
                answers.put(row)
    except BaseException as error:
        answers.put(error)
        raise
    finally:
        if worker is not None:
            worker.end()


class _Worker:
    """A process that does jobs, and its life's end when one of them takes it along."""

    def __init__(self, seed: int) -> None:
        context = get_context("spawn")
        self._seed = seed
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, seed))
        self._process.start()
        theirs.close()
        self._pipe.recv()  # the libraries are loaded

    def ask(self, step: str, number: int, stop: threading.Event) -> tuple[HostileRow | None, _Worker | None]:
        """The row, and the worker for the next one; None for a process that is lost."""
        limit_s = (_QUICK.time_limit_s if step == "decompose" else _VALIDATION_LIMIT_S) + _MARGIN_S
        started = time.monotonic()
        self._pipe.send((step, number))
        lost = partial(HostileRow, step=step, number=number, kind=tuple(KINDS)[number % len(KINDS)])
        while not self._pipe.poll(0.2):
            if stop.is_set():
                self.end()
                return None, None
            if time.monotonic() - started > limit_s:
                self.end()
                return lost(outcome="hang", s=round(limit_s, 3), why=f"over {limit_s:g} s"), None
        try:
            return self._pipe.recv(), self
        except (EOFError, OSError):
            self._process.join(10)
            why = f"the process ended with {self._process.exitcode}"
            self.end()
            return lost(outcome="crash", s=round(time.monotonic() - started, 3), why=why), None

    def end(self) -> None:
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _work(pipe: Connection, seed: int) -> None:
    pipe.send("ready")
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        while True:
            try:
                step, number = pipe.recv()
            except EOFError:
                close_workers()
                return
            pipe.send(measure_mesh(step, number, seed=seed))


def measure_mesh(step: str, number: int, *, seed: int) -> HostileRow:
    """Send one mesh through one step, in this process.

    Args:
        step: "validate" (check, then make solid or hull, in turn) or "decompose".
        number: Number of the mesh.
        seed: Seed of the meshes.
    """
    kind, mesh = hostile_mesh(number, seed=seed)
    started = time.monotonic()
    why: str | None = None
    try:
        why = _decomposed(mesh) if step == "decompose" else _validated(mesh, hulled=number // len(KINDS) % 2 == 1)
        outcome = "valid" if why is None else "invalid"
    except GfpGraspError as error:
        outcome = type(error).__name__
        if outcome == "DecompositionFailed":
            why = str(error)[:300]
    except (ArithmeticError, AssertionError, LookupError, MemoryError, RuntimeError, TypeError, ValueError) as error:
        outcome, why = "crash", f"{type(error).__name__}: {str(error)[:200]}"
    s = round(time.monotonic() - started, 3)
    if left := _left_behind():
        outcome, why = "zombie", f"processes {sorted(left)} were left"
    return HostileRow(step=step, number=number, kind=kind, outcome=outcome, s=s, why=why)


def _validated(mesh: trimesh.Trimesh, *, hulled: bool) -> str | None:
    """None, or what is wrong with the result."""
    check_mesh(mesh)
    if hulled:
        return _fault(hull(mesh))
    solid, moved_m = make_solid(mesh)
    sound = solid.is_volume and np.isfinite(solid.vertices).all() and solid.volume > 0 and np.isfinite(moved_m)
    return None if sound else f"no solid: volume {solid.volume}, moved by {moved_m} m"


def _decomposed(mesh: trimesh.Trimesh) -> str | None:
    return _fault(decompose(mesh, config=_QUICK))


def _fault(collision: CollisionMesh) -> str | None:
    if not collision.parts:
        return "no parts"
    if not np.isfinite(collision.error_m).all():
        return f"error_m is {collision.error_m}"
    for number, part in enumerate(collision.parts):
        if not np.isfinite(part.vertices).all():
            return f"part {number} is not finite"
        if not _convex(part):
            return f"part {number} is not convex"
    return _refused(collision.parts)


def _convex(part: ConvexPart) -> bool:
    """Whether no corner stands out of any face that has a direction."""
    local = part.vertices - part.vertices.mean(axis=0)
    corners = local[part.faces]
    normals = triangle_normals(corners)
    length, size = np.linalg.norm(normals, axis=1), float(np.ptp(local, axis=0).max())
    wide = length > 1e-9 * size**2
    normals = normals[wide] / length[wide, None]
    heights = local @ normals.T - np.einsum("ij,ij->i", normals, corners[wide, 0])
    return bool(wide.any() and heights.max() <= _FLAT * size)


def _refused(parts: tuple[ConvexPart, ...]) -> str | None:
    """Why MuJoCo does not compile the parts; None where it does."""
    import mujoco  # half a second, which the command line's help need not wait for

    spec = mujoco.MjSpec()  # pyright: ignore[reportAttributeAccessIssue]
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for number, part in enumerate(parts):
        spec.add_mesh(name=f"part_{number}", uservert=part.vertices.ravel(), userface=part.faces.ravel())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"part_{number}", density=1000)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        spec.compile()
    except ValueError as error:
        return f"MuJoCo: {error}"
    return None


def _left_behind() -> set[int]:
    """Children of this process that are neither idle and alive nor gone; none where there is no /proc."""
    if sys.platform != "linux":
        return set()
    found = set()
    for task in Path("/proc/self/task").iterdir():
        try:
            found |= {int(pid) for pid in (task / "children").read_text().split()}
        except FileNotFoundError:  # a thread that has just ended
            continue
    return found - idle_pids()
