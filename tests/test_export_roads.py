"""The road under the objects of a scan, as a simulator takes it."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from toy_street import ROAD_M, toy_street

from gfp_grasp.completion import CompletedScene
from gfp_grasp.export import roads_under
from gfp_grasp.scenes import check_file
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import SupportPlane

UP = np.array([0.0, 0.0, 1.0])


def sloping(scene: CompletedScene, number: int, normal: tuple[float, float, float], height_m: float) -> CompletedScene:
    """The scene with another road under one of its objects."""
    made = list(scene)
    one = made[number]
    support = SupportPlane(np.array(normal), height_m)
    made[number] = replace(one, detection=replace(one.detection, support=support))
    made[number].__dict__["collision"] = one.collision
    return replace(scene, completions=tuple(made))


def test_a_level_road_is_the_floor_alone() -> None:
    scene = toy_street()
    slabs, floor_m = roads_under(scene.bodies(), [one.detection.support for one in scene], UP)
    assert slabs == ()
    assert floor_m == pytest.approx(ROAD_M)


def test_without_a_known_road_there_is_neither_floor_nor_slab() -> None:
    assert roads_under(toy_street().bodies(), [None] * 3, UP) == ((), None)


def test_an_object_on_higher_road_gets_a_slab_that_reaches_its_feet_and_a_little_beyond() -> None:
    scene = toy_street(raised_m=0.3)
    (slab,), floor_m = roads_under(scene.bodies(), [one.detection.support for one in scene], UP)
    assert floor_m == pytest.approx(ROAD_M)
    assert slab.name == "car_road"
    low, high = scene[0].mesh.bounds
    np.testing.assert_allclose(slab.T_world_slab[:2, 3], (low + high)[:2] / 2, atol=1e-9)
    np.testing.assert_allclose(slab.half_m[:2], (high - low)[:2] / 2 + 0.1, atol=1e-9)
    assert slab.T_world_slab[2, 3] + slab.half_m[2] == pytest.approx(ROAD_M + 0.3)


def test_the_top_of_a_slab_lies_in_the_sloping_road() -> None:
    scene = sloping(toy_street(), 0, (0.05, 0.0, 1.0), -1.0)
    support = scene[0].detection.support
    assert support is not None
    (slab,), floor_m = roads_under(scene.bodies(), [one.detection.support for one in scene], UP)
    corners = np.array([(x, y, 1.0) for x in (-1, 1) for y in (-1, 1)]) * slab.half_m
    top = apply_T(slab.T_world_slab, corners)
    np.testing.assert_allclose(support.distances(top), 0.0, atol=1e-9)
    assert floor_m is not None
    assert floor_m <= top[:, 2].min() + 1e-9


def test_an_exported_street_loads_and_its_vehicles_stand_still_on_either_road(tmp_path: Path) -> None:
    path = toy_street(raised_m=0.3).export(tmp_path / "street.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.geom("floor").type, model.geom("car_road").type) == (
        mujoco.mjtGeom.mjGEOM_PLANE,
        mujoco.mjtGeom.mjGEOM_BOX,
    )
    assert model.geom("floor").pos[2] == pytest.approx(ROAD_M)
    checks = check_file(path)
    assert [check.name for check in checks] == ["car", "car_2", "pedestrian"]
    for check in checks:
        assert check.stands
        assert check.travel_m < 0.001
        assert check.overlap_m < 0.001


def test_up_of_a_street_is_the_mean_of_the_road_s_normals_under_its_objects() -> None:
    scene = sloping(toy_street(), 0, (0.3, 0.0, 1.0), -1.0)
    normals = np.array([one.detection.support.normal for one in scene if one.detection.support is not None])
    np.testing.assert_allclose(scene.up, normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0)))
