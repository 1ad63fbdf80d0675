"""Objects of a picture: their names, their grasps, which stay clear of near neighbours, and what all of it took."""

import numpy as np
import pytest
import trimesh
from recorded_calls import Recorder, recorded
from toy_completions import toy_completion, toy_errors, toy_fit, toy_grasps, toy_item

from gfp_grasp.drawing import Item, gripper_mesh, items_of, joined_boxes, make_item, plan_among
from gfp_grasp.grasps import Gripper


@pytest.fixture(autouse=True)
def planner(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """Plans two grasps, within 2.5 s of the clock."""
    ticks = iter(np.arange(10.0, 100.0, 2.5))
    monkeypatch.setattr("gfp_grasp.drawing.items.time.perf_counter", lambda: float(next(ticks)))
    return recorded(monkeypatch, "gfp_grasp.drawing.items.plan_grasps", toy_grasps(2))


def test_planning_is_timed_and_sees_the_completion_as_it_is(planner: Recorder) -> None:
    own = toy_completion()
    grasps, seconds = plan_among(own, [own], seed=7)
    assert (len(grasps), seconds) == (2, 2.5)
    (among, num), named = planner.only
    assert (num, named) == (16, {"seed": 7})
    assert among.mesh is own.mesh
    assert among.observed is own.observed
    assert among.sigma_m is own.sigma_m
    assert among.detection is own.detection
    assert len(among.parts) == 2


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sense", [-1, 1])
@pytest.mark.parametrize(("gap_m", "in_the_way"), [(0.14, True), (0.16, False)])
def test_parts_of_a_neighbour_are_in_the_way_where_it_is_nearer_than_15_cm(
    axis: int, sense: int, gap_m: float, in_the_way: bool, planner: Recorder
) -> None:
    own = toy_completion()
    place = np.array([0.0, 0.0, 0.05])
    place[axis] += sense * ((0.06, 0.08, 0.10)[axis] + gap_m)
    other = toy_completion(tuple(place))
    plan_among(own, [other, own], seed=0)
    parts = planner.only[0][0].parts
    assert parts[:2] == own.parts
    assert parts[2:] == (other.parts if in_the_way else ())


def test_objects_are_named_by_class_and_number_and_only_a_lone_one_has_the_truth(
    planner: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    compare = recorded(monkeypatch, "gfp_grasp.drawing.items.completion_errors", toy_errors())
    truth = trimesh.creation.box()
    mug, cup = toy_completion(), toy_completion((0.1, 0.0, 0.05), category="cup")
    items = items_of((mug, cup), truth, seed=3)
    assert [item.name for item in items] == ["mug-1", "cup-2"]
    assert [(item.truth, item.errors) for item in items] == [(None, None)] * 2
    assert all(len(call[0][0].parts) == 4 for call in planner.calls)
    assert all(call[1] == {"seed": 3} for call in planner.calls)
    assert not compare.calls
    (item,) = items_of((cup,), truth, seed=3)
    assert (item.name, item.truth, item.errors, item.grasp_s) == ("cup-1", truth, compare.answer, 2.5)
    assert len(item.grasps) == 2
    (mesh, true), named = compare.only
    assert (mesh, true) == (cup.mesh, truth)
    assert named["rng"].random() == np.random.default_rng(3).random()


def test_an_object_without_truth_has_no_errors() -> None:
    own = toy_completion()
    item = make_item("own", own, (own,), None, seed=0)
    assert (item.name, item.completion, item.truth, item.errors) == ("own", own, None, None)


def test_boxes_that_touch_keep_eight_corners_each_and_so_does_the_gripper() -> None:
    boxes = np.array([[[0, 0, 0], [1, 1, 1]], [[1, 0, 0], [2, 1, 1]]], dtype=float)
    assert joined_boxes(boxes).vertices.shape == (16, 3)
    (grasp,) = toy_grasps(1)
    assert len(gripper_mesh(grasp).vertices) == 8 * len(Gripper().solids(np.array([grasp.width_m]))[0])


def test_an_item_tells_its_residual_and_the_seconds_of_all_stages() -> None:
    assert toy_item().seconds == 1.25
    assert np.isnan(toy_item().residual_m)
    fitted = toy_item(completion=toy_completion(fit=toy_fit()))
    assert fitted.residual_m == 0.00234
    bare = Item("own", fitted.completion)
    assert (bare.grasps, bare.outcome, bare.world, bare.grasp_s) == ((), None, "", 0.0)
