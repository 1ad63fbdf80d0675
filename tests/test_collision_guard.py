"""CoACD may crash, hang or be interrupted: the caller sees a named error, and no process is left behind."""

import importlib.util
import io
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.collision import DecomposeConfig, close_workers, decompose, idle_pids
from gfp_grasp.collision.engines import guard
from gfp_grasp.collision.engines.guard import ChildLostError, receive_message, run_guarded, send_message
from gfp_grasp.errors import Cancelled, DecompositionFailed, InvalidMesh

QUICK = DecomposeConfig(mcts_iterations=60, mcts_nodes=10, resolution=1000, cache=False)
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")


def raw(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False, validate=False)


def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.1, 0.08, 0.06))


def one_nan() -> trimesh.Trimesh:
    solid = box()
    vertices = np.array(solid.vertices)
    vertices[3, 1] = np.nan
    return raw(vertices, np.array(solid.faces))


def bad_index() -> trimesh.Trimesh:
    solid = box()
    faces = np.array(solid.faces)
    faces[0, 0] = 99
    return raw(np.array(solid.vertices), faces)


def flat() -> trimesh.Trimesh:
    return raw(np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]]), np.array([[0, 1, 2], [1, 3, 2]]))


def inside_out() -> trimesh.Trimesh:
    solid = box()
    return raw(np.array(solid.vertices), np.array(solid.faces)[:, ::-1])


def half_turned() -> trimesh.Trimesh:
    solid = box()
    faces = np.array(solid.faces)
    faces[::2] = faces[::2, ::-1]
    return raw(np.array(solid.vertices), faces)


def doubled_faces() -> trimesh.Trimesh:
    solid = box()
    return raw(np.array(solid.vertices), np.concatenate([solid.faces, solid.faces]))


def soup() -> trimesh.Trimesh:
    solid = box()
    return raw(np.array(solid.triangles).reshape(-1, 3), np.arange(36).reshape(-1, 3))


def needles() -> trimesh.Trimesh:
    solid = box()
    return raw(np.array(solid.vertices), np.concatenate([solid.faces, [[0, 0, 1], [2, 2, 2]]]))


def stray_nan() -> trimesh.Trimesh:
    solid = box()
    return raw(np.concatenate([solid.vertices, [[np.nan] * 3]]), np.array(solid.faces))


def crossing() -> trimesh.Trimesh:
    other = box()
    other.apply_translation((0.05, 0.03, 0.02))
    return trimesh.util.concatenate([box(), other])  # pyright: ignore[reportReturnType]


def opened() -> trimesh.Trimesh:
    solid = box()
    return raw(np.array(solid.vertices), np.array(solid.faces)[:-2])


def cup_with_torus() -> trimesh.Trimesh:
    profile = [[0, 0], [0.04, 0], [0.04, 0.1], [0.036, 0.1], [0.036, 0.004], [0, 0.004]]
    cup = trimesh.creation.revolve(np.array(profile), sections=24)
    torus = trimesh.creation.torus(0.025, 0.006, major_sections=12, minor_sections=8)
    torus.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0), (0, 0, 0)))
    torus.apply_translation((0.05, 0, 0.05))
    return trimesh.boolean.union([cup, torus])


@pytest.mark.parametrize("make", [trimesh.Trimesh, one_nan, bad_index, flat])
def test_a_broken_mesh_is_refused_in_a_moment(make):
    started = time.monotonic()
    with pytest.raises(InvalidMesh):
        decompose(make())
    assert time.monotonic() - started < 1


@pytest.mark.parametrize("make", [inside_out, half_turned, doubled_faces, soup, needles, stray_nan])
def test_a_box_that_can_be_cleaned_comes_out_as_a_box(make):
    found = decompose(make(), config=QUICK)
    assert found.notes["preprocess_mode"] == "off"
    assert found.notes["volume_ratio"] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(("make", "volume"), [(crossing, 8.6e-4), (opened, 4.8e-4)])
def test_a_mesh_that_is_no_volume_is_made_one_first(make, volume):
    found = decompose(make(), config=QUICK)
    assert sum(part.to_trimesh().volume for part in found.parts) == pytest.approx(volume, rel=0.1)
    assert found.error_m[0] < 1e-3
    assert found.notes["repair_m"] == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_the_union_of_a_cup_and_a_torus_which_aborts_coacd_is_decomposed():
    found = decompose(cup_with_torus(), config=QUICK)
    assert len(found.parts) > 5
    assert sum(part.to_trimesh().volume for part in found.parts) < 1.6 * cup_with_torus().volume


def test_a_crash_is_contained_and_leaves_nothing_behind_for_the_next_job():
    solid = box()
    faces = np.array(solid.faces)
    faces[0, 0] = 80_000_000  # two gigabytes past the vertices: no such memory, whatever lies near them
    for _ in range(2):
        with pytest.raises(ChildLostError, match=r"SIG|exit status"):
            guarded(np.array(solid.vertices), faces)
        assert len(guarded(np.array(box().vertices), np.array(box().faces))[0]) == 1


def test_a_child_is_used_again_while_all_goes_well():
    close_workers()
    decompose(box(), config=QUICK)
    first = children()
    decompose(box(), config=QUICK)
    assert children() == first


def test_a_lost_attempt_is_told_and_made_up_for(monkeypatch):
    calls = []

    def lost_once(vertices, faces, options, **limits):
        calls.append((vertices.copy(), options))
        if len(calls) == 1:
            raise ChildLostError("the child ended with SIGABRT")
        return run_guarded(vertices, faces, options, **limits)

    monkeypatch.setattr("gfp_grasp.collision.attempts.run_guarded", lost_once)
    found = decompose(box(), config=QUICK)
    assert found.notes["attempts"] == 2
    assert found.notes["lost"] == ("the child ended with SIGABRT",)
    moved = np.abs(calls[1][0] - calls[0][0]).max()
    assert 0 < moved <= 1e-6 * np.linalg.norm([0.1, 0.08, 0.06])
    assert calls[0][1] == calls[1][1]


def test_when_all_is_lost_the_error_says_how_often_and_why(monkeypatch):
    def lost(*_, **__):
        raise ChildLostError("the child ended with SIGSEGV")

    monkeypatch.setattr("gfp_grasp.collision.attempts.run_guarded", lost)
    with pytest.raises(DecompositionFailed, match=r"3 of 3 attempts.*SIGSEGV"):
        decompose(box(), config=DecomposeConfig(attempts=3, cache=False))


@LINUX
def test_a_lack_of_memory_is_contained():
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=0.1)
    sphere.vertices[:, 0] *= 1 + 3 * np.abs(sphere.vertices[:, 2])
    vertices = np.tile(np.array(sphere.vertices), (60, 1))
    faces = np.concatenate([sphere.faces + i * len(sphere.vertices) for i in range(60)])
    guarded(np.array(box().vertices), np.array(box().faces), memory_limit_mb=None)  # an idle child without a limit
    started = time.monotonic()
    with pytest.raises(ChildLostError, match=r"MemoryError|bad_alloc|SIGSEGV|SIGABRT|SIGKILL"):
        run_guarded(vertices, faces, QUICK.coacd_options(), time_limit_s=120, memory_limit_mb=512)
    assert time.monotonic() - started < 60


@LINUX
def test_each_child_has_the_engine_and_the_memory_that_its_job_asked_for():
    close_workers()
    solid = box_arrays()
    guarded(*solid, memory_limit_mb=None)
    (unlimited,) = idle_pids()
    guarded(*solid, memory_limit_mb=2048)
    (limited,) = idle_pids() - {unlimited}
    assert address_space(unlimited) == "unlimited"
    assert address_space(limited) == str(2048 * 2**20)
    guarded(*solid, memory_limit_mb=2048)
    guarded(*solid, memory_limit_mb=None)
    assert idle_pids() == {unlimited, limited}


@LINUX
@pytest.mark.skipif(importlib.util.find_spec("vhacdx") is None, reason="needs the extra vhacd")
def test_a_child_of_one_engine_is_no_other_engines():
    close_workers()
    solid = box_arrays()
    guarded(*solid)
    options = DecomposeConfig(engine="vhacd", vhacd_resolution=20_000).engine_options()
    run_guarded(*solid, options, engine="vhacd", time_limit_s=60, memory_limit_mb=4096)
    engines = {Path(f"/proc/{pid}/cmdline").read_text().split("\0")[4] for pid in idle_pids()}
    assert engines == {"coacd", "vhacd"}


@LINUX
def test_at_most_two_children_wait_and_those_that_end_are_waited_for():
    close_workers()
    waiting = [guard._take("coacd", None) for _ in range(3)]
    pids = [child.process.pid for child in waiting]
    for child in waiting:
        guard._give_back(child)
    assert idle_pids() == set(pids[:2])
    assert not Path(f"/proc/{pids[2]}").exists()
    assert [os.getsid(pid) for pid in pids[:2]] == pids[:2]  # Ctrl-C in a terminal is not for them
    close_workers()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)


@LINUX
def test_a_child_that_has_died_while_it_waited_is_replaced():
    close_workers()
    solid = box_arrays()
    guarded(*solid)
    (pid,) = idle_pids()
    os.kill(pid, signal.SIGKILL)
    assert wait_for(lambda: not idle_pids())
    assert len(guarded(*solid)[0]) == 1
    assert pid not in idle_pids()
    assert len(idle_pids()) == len(guard._idle) == 1


def test_a_job_that_was_called_off_before_its_turn_takes_no_child(monkeypatch):
    def refuse(*_):
        raise AssertionError("a child was taken")

    monkeypatch.setattr(guard, "_take", refuse)
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Cancelled, match="before"):
        run_guarded(*box_arrays(), {}, time_limit_s=1, memory_limit_mb=None, cancel=cancel)


@LINUX
def test_the_child_says_which_options_it_does_not_know_and_does_without_them():
    hulls, said = run_guarded(
        *box_arrays(), {**QUICK.coacd_options(), "of_tomorrow": 1}, time_limit_s=60, memory_limit_mb=4096
    )
    assert said == {"memory_limit": True, "unknown_options": ["of_tomorrow"]}
    ((points, faces),) = hulls
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.1, 0.08, 0.06], atol=1e-6)
    assert faces.shape[1] == 3


@pytest.mark.parametrize("cut", [1, 7, 8, 20, -1])
def test_a_message_comes_out_of_the_pipe_as_it_went_in_or_not_at_all(cut: int):
    arrays = [np.arange(6.0).reshape(2, 3), np.array([[7, 8]], np.int32), np.zeros((0, 3))]
    stream = io.BytesIO()
    send_message(stream, {"a": [1, "b"]}, [arrays[0].T.copy().T, *arrays[1:]])
    whole = stream.getvalue()
    header, back = receive_message(io.BytesIO(whole + b"the next one"))
    assert header == {"a": [1, "b"]}
    for one, other in zip(arrays, back, strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
    with pytest.raises(EOFError, match="bytes came"):
        receive_message(io.BytesIO(whole[:cut]))


@LINUX
def test_no_process_is_left_when_time_runs_out():
    close_workers()
    before = children()  # multiprocessing's own, where an earlier test had workers
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    with pytest.raises(ChildLostError, match="no answer"):
        run_guarded(np.array(sphere.vertices), np.array(sphere.faces), {}, time_limit_s=0.02, memory_limit_mb=None)
    assert children() <= before


def test_threads_work_side_by_side():
    results = []
    threads = [threading.Thread(target=lambda: results.append(decompose(box(), config=QUICK))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [len(result.parts) for result in results] == [1, 1, 1]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_process_starts_its_own_child():
    decompose(box(), config=QUICK)
    ours = children()
    process = multiprocessing.get_context("fork").Process(target=decompose, args=(box(),), kwargs={"config": QUICK})
    process.start()
    process.join(60)
    assert process.exitcode == 0
    assert children() == ours
    assert len(decompose(box(), config=QUICK).parts) == 1


SCRIPT = """
import trimesh
from gfp_grasp import decompose
print(len(decompose(trimesh.creation.box((0.1, 0.1, 0.1))).parts))
"""


def test_a_script_without_a_main_guard_prints_what_it_prints_and_nothing_more(tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "json.py").write_text("raise SystemExit('imported by accident')")
    done = subprocess.run(
        [sys.executable, "-P", tmp_path / "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\n", "")


LONG = """
import signal, sys, numpy as np, trimesh
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs inherit it ignored
from gfp_grasp.collision.engines.guard import run_guarded
ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
ball.vertices *= 1 + 0.3 * np.sin(ball.vertices[:, :1] * 90)
options = {"threshold": 0.01, "preprocess_mode": "off", "mcts_iterations": 2000}
print("started", flush=True)
run_guarded(np.array(ball.vertices), np.array(ball.faces), options, time_limit_s=100, memory_limit_mb=None)
"""


@LINUX
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_or_killed_caller_takes_its_child_along(how):
    caller = subprocess.Popen([sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert caller.stdout is not None
    caller.stdout.readline()
    child = wait_for(lambda: children(caller.pid))
    assert child
    time.sleep(1)
    caller.send_signal(how)
    _, said = caller.communicate(timeout=20)
    assert caller.returncode != 0
    if how == signal.SIGINT:
        assert b"KeyboardInterrupt" in said
    assert wait_for(lambda: not any(runs(pid) for pid in child))


def guarded(vertices: np.ndarray, faces: np.ndarray, memory_limit_mb: int | None = 4096):
    options = {**QUICK.coacd_options(), "preprocess_mode": "off"}
    return run_guarded(vertices, faces, options, time_limit_s=60, memory_limit_mb=memory_limit_mb)


def box_arrays() -> tuple[np.ndarray, np.ndarray]:
    return np.array(box().vertices), np.array(box().faces)


def address_space(pid: int) -> str:
    """What a process may take of address space, bytes."""
    (line,) = [line for line in Path(f"/proc/{pid}/limits").read_text().splitlines() if "address space" in line]
    return line.split()[3]


def children(pid: int | str = "self") -> set[int]:
    if sys.platform != "linux":
        return set()
    found = set()
    for task in Path(f"/proc/{pid}/task").iterdir():
        found |= {int(child) for child in (task / "children").read_text().split()}
    return found


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(")")[-1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def wait_for(condition, limit_s: float = 20):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    return None
