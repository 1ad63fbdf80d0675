"""The guarded child without a child: how it is started, watched and told from others, and what it does with a job."""

import io
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace

import numpy as np
import pytest

import gfp_grasp
from gfp_grasp.collision.engines import guard, worker
from gfp_grasp.collision.engines.guard import Child, ChildLostError, _Watch, receive_message, run_guarded, send_message
from gfp_grasp.errors import Cancelled


class _Process:
    """Answers with what it is given, and remembers what was done to it."""

    def __init__(self, answer: bytes = b"", *, code: int | None = None) -> None:
        self.pid, self.returncode, self.done = 4711, code, []
        self.stdin: io.BytesIO | None = io.BytesIO()
        self.stdout: io.BytesIO | None = io.BytesIO(answer)

    def kill(self) -> None:
        self.done.append("kill")

    def wait(self, timeout: float | None = None) -> int:
        self.done.append(f"wait {timeout}")
        return self.returncode or 0

    def poll(self) -> int | None:
        return self.returncode


def _message(header: dict, arrays=()) -> bytes:
    stream = io.BytesIO()
    send_message(stream, header, arrays)
    return stream.getvalue()


def _child(process: _Process, *, engine: str = "coacd", limit: int | None = 512, log: bytes = b"") -> Child:
    return Child(process, engine, limit, io.BytesIO(log))  # type: ignore[arg-type]


def test_a_child_is_python_with_the_worker_in_a_session_and_an_environment_of_its_own(monkeypatch) -> None:
    started: list = []

    def popen(command, **knobs):
        started.append((command, knobs))
        return _Process(_message({"ready": True, "memory_limit": len(command) > 6}))

    monkeypatch.setattr(subprocess, "Popen", popen)
    limited, free = Child.start("vhacd", 700), Child.start("coacd", None)
    worker_of = [sys.executable, "-P", "-m", "gfp_grasp.collision.engines.worker"]
    assert [command for command, _ in started] == [[*worker_of, "vhacd", "700"], [*worker_of, "coacd"]]
    knobs = started[0][1]
    assert (knobs["stdin"], knobs["stdout"], knobs["start_new_session"]) == (subprocess.PIPE, subprocess.PIPE, True)
    assert knobs["stderr"] is limited.log
    assert (limited.memory_limit_holds, free.memory_limit_holds) == (False, False)
    assert (limited.engine, limited.memory_limit_mb, free.memory_limit_mb) == ("vhacd", 700, None)
    home = str(Path(gfp_grasp.__file__).parents[1])
    environment = knobs["env"]
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == home
    assert {*filter(None, sys.path)} <= {*environment["PYTHONPATH"].split(os.pathsep)}
    assert environment["OPENBLAS_NUM_THREADS"] == environment["MKL_NUM_THREADS"] == "1"
    assert environment["MALLOC_ARENA_MAX"] == "2"
    assert environment["PATH"] == os.environ["PATH"]


def test_a_child_has_a_minute_to_start(monkeypatch) -> None:
    asked: list = []
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: _Process())
    monkeypatch.setattr(Child, "ask", lambda self, *given: (asked.append(given), ({"memory_limit": True}, []))[1])
    assert Child.start("coacd", 600).memory_limit_holds is True
    assert asked == [(None, 60.0, None)]


def test_a_child_that_cannot_be_started_or_says_nothing_leaves_nothing_open(monkeypatch) -> None:
    logs: list = []

    def refuse(*_, stderr, **__):
        logs.append(stderr)
        raise OSError("no such file")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.raises(ChildLostError, match="could not be started: no such file"):
        Child.start("coacd", None)
    assert logs[0].closed
    silent = _Process(code=3)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: silent)
    with pytest.raises(ChildLostError, match="exit status 3"):
        Child.start("coacd", None)
    assert silent.done == ["wait 10", "kill", "wait None"]
    assert silent.stdin is not None
    assert silent.stdin.closed


@pytest.mark.parametrize(
    ("code", "name"),
    [(-11, "SIGSEGV"), (-9, "SIGKILL"), (-200, "signal 200"), (0, "exit status 0"), (7, "exit status 7")],
)
def test_how_a_child_ended_is_named(code: int, name: str) -> None:
    assert guard._exit_name(code) == name


def test_the_last_words_of_a_child_are_on_one_line_and_no_longer_than_400_bytes() -> None:
    said = b"early " * 100 + b"\n  terminate called\n\n what(): bad_alloc \xff\n"
    with pytest.raises(ChildLostError) as caught:
        _child(_Process(code=-6), log=said)._answer(None)
    words = str(caught.value)
    assert words.startswith("the child ended with SIGABRT: ")
    assert words.endswith("early terminate called what(): bad_alloc \ufffd")
    assert len(words) < 30 + 400
    with pytest.raises(ChildLostError, match=r"SIGABRT$"):
        _child(_Process(code=-6))._answer(None)


def test_a_watch_kills_when_time_is_over_or_the_job_is_called_off_and_not_before() -> None:
    sign = threading.Event()
    process = _Process()
    watch = _Watch(process, 30.0, sign)  # type: ignore[arg-type]
    watch.end()
    watch.tell(None)
    assert process.done == []
    late = _Watch(process, 0.0123, None)  # type: ignore[arg-type]
    late._thread.join(5)
    assert process.done == ["kill"]
    with pytest.raises(ChildLostError, match=r"no answer within 0.0123 s") as caught:
        late.tell(None)
    assert caught.value.out_of_time
    sign.set()
    called = _Watch(process, 30.0, sign)  # type: ignore[arg-type]
    called._thread.join(5)
    assert process.done == ["kill", "kill"]
    with pytest.raises(Cancelled, match="at work"):
        called.tell(None)
    assert called._thread.daemon


@pytest.mark.parametrize(("sign", "limit_s", "waits"), [(True, 9.0, 0.05), (True, 0.03, 0.03), (False, 9.0, 9.0)])
def test_a_sign_is_looked_at_every_twentieth_of_a_second(monkeypatch, sign: bool, limit_s: float, waits: float) -> None:
    waited: list[float] = []

    class Done(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            waited.append(timeout or 0.0)
            return True

    watch = _Watch(_Process(), 30.0, None)  # type: ignore[arg-type]
    watch.end()
    watch._done, watch._limit_s = Done(), limit_s
    watch._cancel = threading.Event() if sign else None
    watch._run()
    assert waited == [pytest.approx(waits, rel=0.3)]


def test_an_answer_that_came_too_late_is_none() -> None:
    process = _Process(_message({"a": 1}))
    child = _child(process)

    class Late(io.BytesIO):
        def read(self, count: int | None = -1) -> bytes:
            time.sleep(0.05)
            return super().read(count)

    process.stdout = Late(_message({"a": 1}))
    with pytest.raises(ChildLostError, match="no answer"):
        child.ask(None, 0.01, None)
    child = _child(_Process(_message({"a": 1}, [np.arange(3)])))
    header, (numbers,) = child.ask(({"b": 2}, [np.ones(2)]), 30.0, None)
    assert (header, numbers.tolist()) == ({"a": 1}, [0, 1, 2])
    assert child.process.stdin is not None
    sent, (ones,) = receive_message(io.BytesIO(child.process.stdin.getvalue()))  # type: ignore[attr-defined]
    assert (sent, ones.tolist()) == ({"b": 2}, [1, 1])


@pytest.fixture
def idle(monkeypatch) -> list[Child]:
    waiting: list[Child] = []
    monkeypatch.setattr(guard, "_idle", waiting)
    return waiting


def test_a_job_goes_to_the_waiting_child_of_its_engine_and_memory(idle, monkeypatch) -> None:
    wrong, dead, right = _child(_Process(), engine="vhacd"), _child(_Process(code=1)), _child(_Process())
    other = _child(_Process(), limit=None)
    idle += [wrong, dead, other, right]
    monkeypatch.setattr(Child, "start", lambda engine, limit: (engine, limit))
    assert guard._take("coacd", 512) is right
    assert idle == [wrong, other]
    assert dead.log.closed
    assert guard.idle_pids() == {4711}
    assert guard._take("coacd", 600) == ("coacd", 600)
    guard.close_workers()
    assert idle == []
    assert [child.process.done for child in (wrong, other)] == [["kill", "wait None"]] * 2  # type: ignore[attr-defined]


def test_a_job_is_sent_as_numbers_and_its_hulls_come_in_pairs(idle) -> None:
    hulls = [np.ones((4, 3)), np.array([[0, 1, 2]]), 2 * np.ones((5, 3)), np.array([[2, 3, 4]])]
    child = _child(_Process(_message({"num_parts": 2, "unknown": ["x"]}, hulls)))
    child.memory_limit_holds = True
    idle.append(child)
    found, said = run_guarded(
        np.ones((3, 3), np.float32), np.array([[0, 1, 2]], np.int64), {"a": 1}, time_limit_s=9, memory_limit_mb=512
    )
    assert [(len(points), faces.tolist()) for points, faces in found] == [(4, [[0, 1, 2]]), (5, [[2, 3, 4]])]
    assert said == {"memory_limit": True, "unknown_options": ["x"]}
    assert idle == [child]
    options, (vertices, faces) = receive_message(io.BytesIO(child.process.stdin.getvalue()))  # type: ignore[union-attr]
    assert (options, vertices.dtype, faces.dtype) == ({"a": 1}, np.float64, np.int32)


def test_a_child_that_was_lost_is_killed_and_not_kept(idle) -> None:
    busy = _child(_Process())
    idle[:] = [busy]
    with pytest.raises(ChildLostError, match="exit status 0"):
        run_guarded(np.ones((3, 3)), np.array([[0, 1, 2]]), {}, time_limit_s=5, memory_limit_mb=512)
    assert idle == []
    assert busy.process.done == ["wait 10", "kill", "wait None"]  # type: ignore[attr-defined]
    assert busy.log.closed


def test_a_fork_forgets_the_children_of_its_parent(idle, monkeypatch) -> None:
    monkeypatch.setattr(guard, "_lock", threading.Lock())
    child = _child(_Process())
    idle.append(child)
    guard._forget_after_fork()
    assert idle == []
    assert child.process.returncode == 0
    assert child.process.done == []  # type: ignore[attr-defined]
    assert child.log.closed


class _Resource:
    RLIMIT_CORE, RLIMIT_AS = "core", "space"

    def __init__(self, *, refuses: bool = False) -> None:
        self.set: list = []
        self._refuses = refuses

    def setrlimit(self, which: str, limits: tuple[int, int]) -> None:
        if self._refuses and which == "space":
            raise ValueError("not here")
        self.set.append((which, limits))


def test_a_worker_limits_its_memory_in_mebibytes_and_says_whether_that_holds(monkeypatch) -> None:
    for arguments, refuses, holds, limits in (
        (["3"], False, True, [("core", (0, 0)), ("space", (3 * 2**20, 3 * 2**20))]),
        ([], False, True, [("core", (0, 0))]),
        (["3"], True, False, [("core", (0, 0))]),
    ):
        fake = _Resource(refuses=refuses)
        monkeypatch.setitem(sys.modules, "resource", fake)  # type: ignore[arg-type]
        assert worker._limit_memory(arguments) is holds
        assert fake.set == limits
    monkeypatch.setitem(sys.modules, "resource", None)
    assert worker._limit_memory(["3"]) is False


def test_a_worker_leaves_out_what_its_coacd_does_not_know(monkeypatch) -> None:
    calls: list = []

    def run_coacd(mesh, threshold=0.05, seed=0):
        calls.append((mesh, threshold, seed))
        return ["hull"]

    fake = SimpleNamespace(set_log_level=calls.append, run_coacd=run_coacd, Mesh=lambda v, f: (v, f))
    monkeypatch.setitem(sys.modules, "coacd", fake)  # type: ignore[arg-type]
    hulls, unknown = worker._coacd()(np.ones(1), np.zeros(1), {"seed": 3, "threshold": 0.1, "zeal": 1, "ardour": 2})
    assert (hulls, unknown) == (["hull"], ["ardour", "zeal"])
    assert calls == ["error", ((np.ones(1), np.zeros(1)), 0.1, 3)]


def test_a_worker_hands_vhacd_each_face_behind_the_number_of_its_corners(monkeypatch) -> None:
    calls: list = []
    fake = SimpleNamespace(compute_vhacd=lambda *given, **options: (calls.append((given, options)), ["hull"])[1])
    monkeypatch.setitem(sys.modules, "vhacdx", fake)  # type: ignore[arg-type]
    assert worker._vhacd()(np.ones((2, 3)), np.array([[0, 1, 2], [4, 5, 6]]), {"resolution": 9}) == (["hull"], [])
    ((vertices, polygons), options) = calls[0]
    assert polygons.tolist() == [3, 0, 1, 2, 3, 4, 5, 6]
    assert (polygons.dtype, options, len(vertices)) == (np.uint32, {"resolution": 9}, 2)


def test_a_worker_answers_each_job_until_its_input_ends(monkeypatch) -> None:
    answers = io.BytesIO()
    jobs = [({"a": 1}, [np.ones((3, 3)), np.array([[0, 1, 2]])])] * 2
    stream = io.BytesIO(b"".join(_message(*job) for job in jobs))
    done: list[int] = []
    waiting: SimpleQueue = SimpleQueue()
    monkeypatch.setattr(worker.os, "_exit", done.append)
    worker._read_jobs(stream, waiting)
    assert done == [0]
    assert waiting.qsize() == 2

    class Over(Exception):
        pass

    class Jobs(SimpleQueue):
        def get(self, *_, **__):
            if waiting.empty():
                raise Over
            return waiting.get()

    engine = lambda vertices, faces, options: ([(vertices, faces)], [*options])  # noqa: E731
    monkeypatch.setattr(worker, "_take_over_streams", lambda: (io.BytesIO(), answers))
    monkeypatch.setattr(worker, "_limit_memory", lambda arguments: arguments == ["77"])
    monkeypatch.setattr(worker, "_vhacd", lambda: engine)
    monkeypatch.setattr(worker.queue, "SimpleQueue", Jobs)
    monkeypatch.setattr(worker, "_read_jobs", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["worker", "vhacd", "77"])
    with pytest.raises(Over):
        worker.main()
    answers.seek(0)
    assert receive_message(answers)[0] == {"ready": True, "memory_limit": True}
    for _ in range(2):
        header, (points, triangles) = receive_message(answers)
        assert header == {"num_parts": 1, "unknown": ["a"]}
        assert (points.shape, triangles.tolist()) == ((3, 3), [[0, 1, 2]])
