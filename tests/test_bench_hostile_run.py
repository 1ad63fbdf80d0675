"""The bench of hostile meshes as a run: its order, its reports on the way, and processes that are lost."""

import subprocess
import sys
import threading
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from clocks import SteadyClock

from gfp_grasp.bench import HostileConfig, bench_hostile, hostile
from gfp_grasp.bench.hostile import HostileRow, measure_mesh
from gfp_grasp.bench.hostile_meshes import KINDS
from gfp_grasp.collision import DecomposeConfig
from gfp_grasp.errors import DecompositionFailed, InvalidMesh, InvalidOption
from gfp_grasp.types import CollisionMesh, ConvexPart


def row(step: str, number: int, outcome: str = "valid", s: float = 0.5) -> HostileRow:
    return HostileRow(step=step, number=number, kind=tuple(KINDS)[number % len(KINDS)], outcome=outcome, s=s)


@pytest.fixture(autouse=True)
def own_children(monkeypatch) -> None:
    """Processes that earlier tests started (a resource tracker, say) were not left behind by a mesh."""
    left_behind = hostile._left_behind
    others = left_behind()
    monkeypatch.setattr(hostile, "_left_behind", lambda: left_behind() - others)


@pytest.fixture
def runs(monkeypatch) -> list:
    """The jobs, the seed and the number of processes of each run; every job is valid."""
    runs = []

    def run(jobs, seed, workers):
        runs.append((list(jobs), seed, workers))
        return iter([row(*job) for job in jobs])

    monkeypatch.setattr(hostile, "_run", run)
    return runs


def test_both_steps_have_their_share_whenever_the_run_is_stopped(runs):
    report = bench_hostile(config=HostileConfig(count=6, coacd=2, seed=4), workers=3)
    v, d = "validate", "decompose"
    assert runs == [([(v, 0), (d, 0), (v, 1), (v, 2), (v, 3), (d, 1), (v, 4), (v, 5)], 4, 3)]
    assert [(t["step"], t["number"]) for t in report["trials"]] == [*((v, n) for n in range(6)), (d, 0), (d, 1)]
    assert report["settings"] == {"count": 6, "coacd": 2, "seed": 4, "time_limit_s": 20, "margin_s": 100.0}
    assert report["done"] == {"validate": 6, "decompose": 2}
    assert report["outcomes"] == {"validate": {"valid": 6}, "decompose": {"valid": 2}}
    assert report["rows"]["decompose"]["nan"] == {"valid": 1}
    assert report["rows"]["decompose"]["soup"] == {}
    assert report["seconds"] == {s: {"median": 0.5, "largest": 0.5} for s in ("validate", "decompose")}


def test_the_report_so_far_is_saved_every_hundred_rows(runs):
    saved = []
    bench_hostile(config=HostileConfig(count=250, coacd=0), save=lambda report: saved.append(len(report["trials"])))
    assert saved == [100, 200]


def test_rows_of_the_same_seed_are_kept_and_bad_ones_are_made_anew(runs):
    config = HostileConfig(count=4, coacd=1, seed=7)
    former = [row("validate", 0, "InvalidMesh"), *(row("validate", n + 1, bad) for n, bad in enumerate(hostile.BAD))]
    known = {"settings": {"seed": 7}, "trials": [r.to_json() for r in former]}
    assert bench_hostile(config=config, known=known)["outcomes"]["validate"] == {"InvalidMesh": 1, "valid": 3}
    assert sorted(runs[0][0]) == [("decompose", 0), ("validate", 1), ("validate", 2), ("validate", 3)]
    for other in ({**known, "settings": {"seed": 8}}, {"trials": known["trials"]}):
        bench_hostile(config=config, known=other)
        assert len(runs.pop()[0]) == 5


def test_a_config_of_no_mesh_is_refused_and_one_step_may_be_left_out():
    assert HostileConfig(count=0, coacd=1).seed == 0
    assert HostileConfig(count=1, coacd=0).coacd == 0
    for wrong in ({"count": 0, "coacd": 0}, {"seed": -1}, {"coacd": -1}):
        with pytest.raises(InvalidOption, match="none may be negative"):
            HostileConfig(**wrong)


class Context:
    """Stands for processes that are spawned: what comes out of the pipe is told beforehand."""

    def __init__(self, answers: list) -> None:
        self.answers = ["ready", *answers]
        self.sent: list = []
        self.done: list = []
        self.exitcode = -6

    def Pipe(self):
        return self, self

    def Process(self, target, args):
        assert target is hostile._work
        assert args == (self, 9)
        return self

    def start(self):
        self.done.append("start")

    def kill(self):
        self.done.append("kill")

    def join(self, timeout=None):
        self.done.append(f"join {timeout}")

    def close(self):
        self.done.append("close")

    def send(self, job):
        self.sent.append(job)

    def poll(self, seconds):
        assert seconds == 0.2
        return bool(self.answers)

    def recv(self):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture
def worker(monkeypatch):
    def make(*answers):
        context = Context(list(answers))
        monkeypatch.setattr(hostile, "get_context", lambda way: context if way == "spawn" else None)
        monkeypatch.setattr(hostile, "time", SteadyClock(40.0))
        return hostile._Worker(9), context

    return make


def test_a_process_that_answers_is_kept(worker):
    one, context = worker(row("validate", 3))
    assert one.ask("validate", 3, threading.Event()) == (row("validate", 3), one)
    assert context.sent == [("validate", 3)]
    assert context.done == ["start", "close"]


@pytest.mark.parametrize(("step", "limit_s"), [("validate", 105), ("decompose", 120)])
def test_a_process_that_does_not_answer_in_time_is_a_hang_and_ends(worker, monkeypatch, step, limit_s):
    monkeypatch.setattr(hostile, "_VALIDATION_LIMIT_S", 5.0)
    one, context = worker()
    assert one.ask(step, 24, threading.Event()) == (
        HostileRow(step=step, number=24, kind="nan", outcome="hang", s=limit_s, why=f"over {limit_s} s"),
        None,
    )
    assert context.done == ["start", "close", "kill", "join None", "close"]


def test_validation_has_as_much_time_as_a_decomposition():
    assert hostile._VALIDATION_LIMIT_S == hostile._QUICK.time_limit_s == 20
    assert hostile._MARGIN_S == 100


@pytest.mark.parametrize("error", [EOFError(), ConnectionResetError()])
def test_a_process_that_dies_is_a_crash_with_its_status(worker, error):
    one, context = worker(error)
    assert one.ask("decompose", 1, threading.Event()) == (
        HostileRow(step="decompose", number=1, kind="nan", outcome="crash", s=40.0, why="the process ended with -6"),
        None,
    )
    assert context.done == ["start", "close", "join 10", "kill", "join None", "close"]


def test_a_run_that_is_stopped_waits_for_no_answer(worker):
    one, context = worker()
    stop = threading.Event()
    stop.set()
    assert one.ask("validate", 1, stop) == (None, None)
    assert context.done[-3:] == ["kill", "join None", "close"]


def test_a_lost_process_is_replaced_and_every_process_is_ended(monkeypatch):
    made: list[Any] = []

    class Worker:
        def __init__(self, seed):
            assert seed == 5
            self.ended = False
            made.append(self)

        def ask(self, step, number, stop):
            return row(step, number), None if number == 1 else self

        def end(self):
            self.ended = True

    monkeypatch.setattr(hostile, "_Worker", Worker)
    found = list(hostile._run([("validate", n) for n in range(4)], 5, 1))
    assert [r.number for r in found] == [0, 1, 2, 3]
    assert [worker.ended for worker in made] == [False, True]


def test_an_error_of_a_thread_is_raised_by_the_run():
    waiting: SimpleQueue = SimpleQueue()
    answers: SimpleQueue = SimpleQueue()
    waiting.put("no job")
    with pytest.raises(ValueError, match="unpack"):
        hostile._oversee(waiting, answers, 0, threading.Event())
    assert isinstance(answers.get_nowait(), ValueError)


def test_a_process_works_until_its_pipe_is_closed(monkeypatch):
    closed = []
    monkeypatch.setattr(hostile, "close_workers", lambda: closed.append(True))
    monkeypatch.setattr(hostile, "measure_mesh", lambda step, number, seed: (step, number, seed))
    context = Context([("validate", 3), ("decompose", 4), EOFError()])
    context.answers.pop(0)
    hostile._work(context, 6)  # type: ignore[arg-type]
    assert context.sent == ["ready", ("validate", 3, 6), ("decompose", 4, 6)]
    assert closed == [True]


@pytest.fixture
def steps(monkeypatch) -> list:
    """Which step was taken with a mesh; each is right."""
    steps = []
    whole = CollisionMesh((), (0.0, 0.0, 0.0), "hull", 0.0)
    monkeypatch.setattr(hostile, "time", SteadyClock(0.125))
    monkeypatch.setattr(hostile, "_fault", lambda found: None)
    monkeypatch.setattr(hostile, "hull", lambda mesh: (steps.append("hull"), whole)[1])
    monkeypatch.setattr(hostile, "decompose", lambda mesh, config: (steps.append(config), whole)[1])
    monkeypatch.setattr(hostile, "make_solid", lambda mesh: (steps.append("solid"), (mesh, 0.0))[1])
    return steps


def test_meshes_are_made_solid_and_hulled_in_turn_a_lap_of_kinds_each(steps):
    laps = [measure_mesh("validate", 0 + lap * len(KINDS), seed=0) for lap in range(4)]
    assert steps == ["solid", "hull", "solid", "hull"]
    assert [(r.step, r.kind, r.outcome, r.s, r.why) for r in laps] == [("validate", "sound", "valid", 0.125, None)] * 4
    measure_mesh("decompose", 0, seed=0)
    assert steps[-1] == DecomposeConfig(
        threshold=0.2,
        mcts_iterations=60,
        mcts_nodes=10,
        resolution=1000,
        max_convex_hull=16,
        time_limit_s=20,
        cache=False,
    )


@pytest.mark.parametrize(
    ("error", "outcome", "why"),
    [
        (DecompositionFailed("x" * 400), "DecompositionFailed", "x" * 300),
        (InvalidMesh("it has no face"), "InvalidMesh", None),
        (IndexError("y" * 400), "crash", "IndexError: " + "y" * 200),
    ],
)
def test_what_a_step_raises_is_its_outcome(steps, monkeypatch, error, outcome, why):
    def fails(mesh, config):
        raise error

    monkeypatch.setattr(hostile, "decompose", fails)
    found = measure_mesh("decompose", 0, seed=0)
    assert (found.outcome, found.why) == (outcome, why)


def test_a_process_that_a_step_leaves_behind_is_told(steps, monkeypatch):
    monkeypatch.setattr(hostile, "_left_behind", lambda: {12, 7})
    found = measure_mesh("validate", 0, seed=0)
    assert (found.outcome, found.why) == ("zombie", "processes [7, 12] were left")


@pytest.mark.skipif(sys.platform != "linux", reason="no /proc to see processes in")
def test_a_child_that_is_not_an_idle_worker_was_left_behind(monkeypatch):
    before = hostile._left_behind()
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        assert hostile._left_behind() - before == {child.pid}
        monkeypatch.setattr(hostile, "idle_pids", lambda: {child.pid})
        assert child.pid not in hostile._left_behind()
    finally:
        child.kill()
        child.communicate()
    monkeypatch.setattr(hostile, "sys", SimpleNamespace(platform="darwin"))
    assert hostile._left_behind() == set()


def test_what_is_wrong_with_parts_is_named():
    cube = trimesh.creation.box((0.1, 0.1, 0.1))
    part = ConvexPart(cube.vertices, cube.faces)
    dent = np.array(cube.vertices)
    dent[0] *= 0.1

    def fault(*parts, error_m=(0.0, 0.0, 0.0)):
        return hostile._fault(CollisionMesh(parts, error_m, "hull", 0.0))

    assert fault() == "no parts"
    assert fault(part) is None
    assert fault(part, error_m=(0.0, np.nan, 0.0)) == "error_m is (0.0, nan, 0.0)"
    assert fault(part, ConvexPart(dent, cube.faces)) == "part 1 is not convex"


@pytest.mark.parametrize(("out", "convex"), [(0.5e-6, True), (2e-6, False)])
def test_a_corner_may_stand_out_of_a_face_by_a_millionth_of_the_size(out, convex):
    """A pyramid of height 1 on a square with one corner lower: one diagonal of the base is a ridge, one is not."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, -out], [0, 1, 0], [0.5, 0.5, 1]], dtype=float)
    faces = np.array([[0, 3, 1], [1, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    flipped = np.array([[0, 2, 1], [0, 3, 2], *faces[2:]])
    assert hostile._convex(ConvexPart(vertices, flipped))
    assert hostile._convex(ConvexPart(vertices, faces)) == convex
