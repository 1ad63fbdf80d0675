"""V-HACD, several meshes at once, and jobs that are called off."""

import importlib.util
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from test_collision_guard import LINUX, children, runs, wait_for

from gfp_grasp.collision import DecomposeConfig, close_workers, decompose, decompose_many
from gfp_grasp.errors import Cancelled, DecompositionFailed, InvalidMesh, InvalidOption
from gfp_grasp.types import CollisionMesh

QUICK = DecomposeConfig(mcts_iterations=60, mcts_nodes=10, resolution=1000, cache=False)
LONG = DecomposeConfig(threshold=0.01, mcts_iterations=2000, cache=False)
VHACD = DecomposeConfig(engine="vhacd", vhacd_resolution=20_000, cache=False)
HAS_VHACD = pytest.mark.skipif(importlib.util.find_spec("vhacdx") is None, reason="needs the extra vhacd")


def box(x: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.box((x, 0.08, 0.06))


def bumpy() -> trimesh.Trimesh:
    """Star-shaped, and minutes of work for CoACD."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    ball.vertices *= 1 + 0.3 * np.sin(ball.vertices[:, :1] * 90)
    return ball


def corner() -> trimesh.Trimesh:
    bounds = [[[0, 0, 0], [0.1, 0.02, 0.02]], [[0, 0, 0], [0.02, 0.1, 0.02]]]
    return trimesh.boolean.union([trimesh.creation.box(bounds=bound) for bound in bounds])


@HAS_VHACD
def test_vhacd_splits_an_l_into_parts_of_its_volume_and_the_same_ones_again():
    found, again = decompose(corner(), config=VHACD), decompose(corner(), config=VHACD)
    assert found.made_by == "vhacd"
    assert len(found.parts) >= 2
    assert found.notes["union_volume_ratio"] == pytest.approx(1, abs=0.1)
    assert found.notes["vhacd_resolution"] == 20_000
    assert found.error_m[0] < 2e-3
    for one, other in zip(found.parts, again.parts, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


@HAS_VHACD
def test_the_budgets_of_parts_and_corners_reach_vhacd():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    few = DecomposeConfig(
        engine="vhacd", vhacd_resolution=20_000, cache=False, max_convex_hull=1, decimate=True, max_ch_vertex=16
    )
    (part,) = decompose(ball, config=few).parts
    assert len(part.vertices) <= 16
    assert few.vhacd_options()["asyncACD"] is False


def test_a_missing_wheel_is_named_with_what_installs_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "vhacdx", None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for call in (lambda: decompose(box(), config=VHACD), lambda: decompose_many([box()], config=VHACD)):
        with pytest.raises(InvalidOption, match=r"pip install 'gfp-grasp\[vhacd\]'"):
            call()


def test_many_meshes_come_back_in_order_each_as_parts_or_as_its_error():
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    meshes = [box(0.1), flat, box(0.2), trimesh.Trimesh(), box(0.3)]
    found = list(decompose_many(meshes, config=QUICK, workers=2))
    assert [type(result) for result in found] == [CollisionMesh, InvalidMesh, CollisionMesh, InvalidMesh, CollisionMesh]
    for mesh, result in zip(meshes, found, strict=True):
        if isinstance(result, CollisionMesh):
            np.testing.assert_allclose(result.parts[0].vertices.max(axis=0), mesh.bounds[1], atol=1e-4)


def test_no_meshes_are_no_results_and_no_workers_are_refused():
    assert list(decompose_many([])) == []
    for workers in (0, True, 1.5):
        with pytest.raises(InvalidOption, match="workers"):
            decompose_many([box()], workers=workers)  # pyright: ignore[reportArgumentType]


def test_a_failure_is_a_result_and_not_raised():
    short = DecomposeConfig(time_limit_s=0.01, cache=False)
    (found,) = decompose_many([box()], config=short, workers=1)
    assert isinstance(found, DecompositionFailed)


def test_a_job_that_is_called_off_ends_at_once_and_leaves_no_child():
    close_workers()
    before = children()
    cancel = threading.Event()
    stages = []

    def tell(stage: str) -> None:
        stages.append(stage)
        if stage.startswith("decomposing"):
            threading.Timer(1.0, cancel.set).start()

    with pytest.raises(Cancelled):
        decompose(bumpy(), config=LONG, progress=tell, cancel=cancel)
    assert stages == ["checking", "repairing", "decomposing, attempt 1"]
    assert children() == before
    with pytest.raises(Cancelled):
        decompose(box(), config=QUICK, cancel=cancel)
    assert children() == before


def test_stages_are_told_in_their_order():
    stages = []
    decompose(box(), config=QUICK, progress=stages.append)
    assert stages == ["checking", "repairing", "decomposing, attempt 1", "measuring"]


@LINUX
def test_closing_the_stream_ends_the_children_at_work():
    close_workers()
    before = children()
    stream = decompose_many([box(), bumpy(), bumpy(), bumpy()], config=LONG, workers=2)
    assert isinstance(next(stream), CollisionMesh)
    assert wait_for(lambda: children() - before)
    started = time.monotonic()
    stream.close()  # pyright: ignore[reportAttributeAccessIssue]
    assert time.monotonic() - started < 8
    close_workers()  # the one that the box has left idle
    assert children() == before


@LINUX
def test_ctrl_c_ends_the_children_at_work(tmp_path: Path):
    start = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # background jobs ignore it
    (tmp_path / "script.py").write_text(f"{start}\n{SCRIPT.format(body=LEFT)}\nprint(list(stream))\n")
    caller = subprocess.Popen(
        [sys.executable, "-P", tmp_path / "script.py"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert caller.stdout is not None
    assert wait_for(lambda: len(children(caller.pid)) == 2)
    time.sleep(2)
    at_work = children(caller.pid)
    assert len(at_work) == 2
    caller.send_signal(signal.SIGINT)
    _, said = caller.communicate(timeout=20)
    assert b"KeyboardInterrupt" in said
    assert wait_for(lambda: not any(runs(pid) for pid in at_work))


SCRIPT = """
import trimesh
from gfp_grasp.collision import DecomposeConfig, decompose_many
{body}
"""
ALL = "print([len(r.parts) for r in decompose_many([trimesh.creation.box((0.1, 0.1, 0.1))] * 3)])"
LEFT = """import numpy as np
ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
ball.vertices *= 1 + 0.3 * np.sin(ball.vertices[:, :1] * 90)
config = DecomposeConfig(threshold=0.01, mcts_iterations=2000, cache=False)
stream = decompose_many([trimesh.creation.box((0.1, 0.1, 0.1)), *[ball] * 5], config=config)
print([len(next(stream).parts)])
"""


@pytest.mark.parametrize(("body", "said"), [(ALL, "[1, 1, 1]\n"), (LEFT, "[1]\n")])
def test_a_script_without_a_main_guard_may_use_it_and_end_before_it_is_done(tmp_path: Path, body: str, said: str):
    (tmp_path / "script.py").write_text(SCRIPT.format(body=body))
    done = subprocess.run([sys.executable, "-P", tmp_path / "script.py"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, said, "")
