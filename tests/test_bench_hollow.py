"""The bench of hollow things, with insides, marbles and pegs whose answers are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import box_part, l_shape

from gfp_grasp.bench import bench_hollow, hollow
from gfp_grasp.bench.hollow import HollowRow
from gfp_grasp.bench.vessels import Inside
from gfp_grasp.errors import FitDiverged
from gfp_grasp.types import CollisionMesh, PointCloud

VIEWPOINT = np.array([0.3, 0.4, 0.5])
PARTS = (box_part([0, 0, 0], [0.1, 0.02, 0.02]), box_part([0, 0.02, 0], [0.02, 0.06, 0.02]))
WHOLE = (box_part([0, 0, 0], [0.1, 0.06, 0.02]),)


def box(height: float) -> trimesh.Trimesh:
    return box_part([0, 0, 0], [0.06, 0.06, height]).to_trimesh()


def inside(floor_m: float, room_m: float = 0.02) -> Inside:
    return Inside(np.array([0.03, 0.03, floor_m + 0.01]), floor_m, 0.08, 0.09, room_m)


def completion(mesh: trimesh.Trimesh, handle=()) -> Any:
    """What the bench reads of a completion."""
    regions = {"handle": np.isin(np.arange(len(mesh.vertices)), handle)}
    primitive = SimpleNamespace(on_region=regions.__getitem__)
    return SimpleNamespace(
        mesh=mesh,
        category="mug",
        collision=CollisionMesh(PARTS, (0.0, 0.0, 0.0), "carried", 0.0),
        fit=SimpleNamespace(primitive=primitive),
    )


@pytest.fixture
def dropped(monkeypatch) -> list:
    """Marbles end 4 mm above z = 0 in the parts, and 60 mm below it in the hull."""
    dropped = []

    def drop(parts, start, *, radius_m):
        dropped.append((parts, start, radius_m))
        return np.array([0.0, 0.0, (0.004 if len(parts) == 2 else -0.06) + radius_m])

    monkeypatch.setattr(hollow, "drop_marble", drop)
    return dropped


def marble(monkeypatch, own: Inside | None, true: Inside | None) -> tuple[dict, Any, trimesh.Trimesh]:
    done, truth = completion(box(0.1)), box(0.12)
    monkeypatch.setattr(hollow, "inside_of", lambda mesh: own if mesh is done.mesh else true)
    return hollow._marble(done, PARTS, WHOLE, truth), done, truth


def test_a_marble_falls_into_the_parts_and_into_the_hull_from_above_both_rims(monkeypatch, dropped):
    own = inside(0.003)
    found, _, _ = marble(monkeypatch, own, inside(0.0015))
    assert found == {"marble_off_mm": 2.5, "off_own_mm": 1.0, "hull_off_mm": -61.5}
    assert [parts for parts, _, _ in dropped] == [PARTS, WHOLE]
    for _, start, radius_m in dropped:
        assert radius_m == 0.006
        assert start.rim_m == 0.12
        np.testing.assert_array_equal(start.middle, own.middle)


def test_a_completion_that_is_closed_is_tried_where_the_truth_is_open(monkeypatch, dropped):
    true = inside(0.0015)
    found, _, _ = marble(monkeypatch, None, true)
    assert found == {"marble_off_mm": 2.5, "off_own_mm": None, "hull_off_mm": -61.5}
    np.testing.assert_array_equal(dropped[0][1].middle, true.middle)


@pytest.mark.parametrize("true", [None, inside(0.0, room_m=0.006)])
def test_what_no_marble_gets_into_is_not_tried(monkeypatch, dropped, true):
    assert marble(monkeypatch, None, true)[0] == {}
    assert marble(monkeypatch, inside(0.003), true)[0] == {"opened": True}
    assert dropped == []


def test_what_a_marble_just_gets_into_is_tried(monkeypatch, dropped):
    assert "marble_off_mm" in marble(monkeypatch, None, inside(0.0, room_m=0.0061))[0]


@pytest.mark.parametrize(("room_m", "radius_m"), [(0.02, 0.005), (0.005, 0.003)])
def test_a_handle_hangs_on_a_peg_that_its_hole_has_room_for(monkeypatch, room_m, radius_m):
    done = completion(l_shape(), handle=(0, 3))
    middle, through = np.array([0.0, 0.1, 0.2]), np.array([1.0, 0.0, 0.0])
    asked = []

    def hangs(mesh, parts, *peg):
        asked.append((mesh, parts, peg))
        return len(parts) == 2

    def hole(mesh, handle):
        assert np.flatnonzero(handle).tolist() == [0, 3]
        return middle, through, room_m

    monkeypatch.setattr(hollow, "hangs", hangs)
    monkeypatch.setattr(hollow, "handle_hole", hole)
    assert hollow._peg(done, PARTS, WHOLE) == (True, False)
    assert [(mesh is done.mesh, parts) for mesh, parts, _ in asked] == [(True, PARTS), (True, WHOLE)]
    assert all(peg == (middle, through, pytest.approx(radius_m)) for _, _, peg in asked)
    monkeypatch.setattr(hollow, "handle_hole", lambda mesh, handle: None)
    assert hollow._peg(done, PARTS, WHOLE) is None


def test_what_has_no_handle_is_not_hung(monkeypatch):
    monkeypatch.setattr(hollow, "handle_hole", lambda *_: pytest.fail("there is no handle"))
    assert hollow._peg(completion(l_shape()), PARTS, WHOLE) is None


@pytest.mark.parametrize(("true_deg", "found"), [(4.9, 12.35), (5.1, None)])
def test_only_what_truly_stands_is_put_down(monkeypatch, true_deg, found):
    monkeypatch.setattr(hollow, "tilt_deg", lambda mesh, parts: 12.3456 if parts is PARTS else true_deg)
    assert hollow._stand(completion(l_shape()), PARTS, box(0.1)) == found


def test_rows_are_counted_by_what_was_tried():
    def row(**figures):
        return HollowRow(object="a", category="cup", **figures)

    rows = [
        row(marble_off_mm=-3.0, off_own_mm=2.0, hull_off_mm=8.0, tilt_deg=5.0, hung=(True, False)),
        row(marble_off_mm=10.0, off_own_mm=10.5, hull_off_mm=-70.0, tilt_deg=5.1, hung=(True, True)),
        row(marble_off_mm=1.0, off_own_mm=1.0, hull_off_mm=-70.0),
        row(marble_off_mm=-50.0, off_own_mm=-9.0, hull_off_mm=None, hung=(False, False)),
        row(marble_off_mm=2.0, hull_off_mm=-70.0, tilt_deg=0.5),
        row(opened=True),
        row(failed="FitDiverged: no"),
    ]
    assert hollow._figures(rows) == {
        "objects": 7,
        "failed": 1,
        "marble": {
            "tried": 5,
            "completed_closed": 1,
            "kept": 3,
            "kept_on_own": 3,
            "off_mm": [3.0, 10.0],
            "hull_kept": 1,
            "opened": 1,
        },
        "peg": {"tried": 3, "hung": 2, "hull_hung": 1},
        "stand": {"tried": 3, "stood": 2},
    }
    assert hollow._figures(rows[5:])["marble"]["off_mm"] is None


def test_each_object_is_completed_from_one_view_and_goes_through_all_tests(tmp_path, monkeypatch):
    l_shape().export(tmp_path / "mug__ell.ply")
    box(0.05).export(tmp_path / "cup__low.ply")
    box(0.1).export(tmp_path / "cup__tall.ply")
    draws, asked = [], []

    def view(mesh, rng):
        draws.append(float(rng.uniform()))
        return SimpleNamespace(mesh=mesh, cloud=PointCloud(np.arange(30.0).reshape(10, 3), VIEWPOINT))

    def complete(points, *, viewpoint):
        asked.append((points, viewpoint))
        if len(asked) == 2:
            raise FitDiverged("nothing fits")
        return completion(l_shape())

    fakes = {
        "view_object": view,
        "complete_to_mesh": complete,
        "_marble": lambda done, parts, whole, truth: {"marble_off_mm": 1.0, "off_own_mm": 2.0, "hull_off_mm": 30.0},
        "_peg": lambda done, parts, whole: (True, len(whole) == 2),
        "_stand": lambda done, parts, truth: round(float(truth.extents[2]), 3),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(hollow, name, fake)
    watched = []
    report = bench_hollow(str(tmp_path), seed=3, limit=3, progress=lambda rows, total: (watched.append(total), rows)[1])
    assert watched == [3]
    assert report["settings"] == {"objects": tmp_path.name, "num_objects": 3, "seed": 3}
    done = {"taken_for": "mug", "made_by": "carried", "marble_off_mm": 1.0, "off_own_mm": 2.0, "hull_off_mm": 30.0}
    assert report["trials"] == [
        {"object": "low", "category": "cup", **done, "hung": (True, False), "tilt_deg": 0.05},
        {"object": "tall", "category": "cup", "failed": "FitDiverged: nothing fits"},
        {"object": "ell", "category": "mug", **done, "hung": (True, False), "tilt_deg": 0.02},
    ]
    assert list(report["rows"]) == ["cup", "mug"]
    assert (report["rows"]["cup"]["objects"], report["rows"]["cup"]["failed"]) == (2, 1)
    assert draws == [float(np.random.default_rng([3, number]).uniform()) for number in range(3)]
    for points, viewpoint in asked:
        np.testing.assert_array_equal(points, np.arange(30.0).reshape(10, 3))
        np.testing.assert_array_equal(viewpoint, VIEWPOINT)
