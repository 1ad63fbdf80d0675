"""A spinning LiDAR: where its shots go, what they meet, and what it tells of it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import trimesh

from gfp_grasp.camera import HDL_64, LidarModel, scan_meshes, scan_scene
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.transforms import apply_T, make_T, rotation_about

RINGS = LidarModel(elevation_deg=(5.0, 0.0, -10.0, -30.0), columns=360, nearest_m=0.5)
POSE = make_T(rotation_about((0, 0, 1), 0.4), (3.0, -1.0, 1.7))


def test_each_shot_goes_where_the_picture_says_it_went():
    """A ball about the sensor is met everywhere, and its points lie along the rays."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=8.0).apply_translation(POSE[:3, 3])
    image, index = scan_meshes([ball], T_world_sensor=POSE, lidar=RINGS)
    assert image.shape == (4, 360)
    assert (index == 0).all()
    along = image.points() - POSE[:3, 3]
    np.testing.assert_allclose(
        along / np.linalg.norm(along, axis=2, keepdims=True), RINGS.rays() @ POSE[:3, :3].T, atol=1e-6
    )
    pixels, range_m = image.project(image.points())
    np.testing.assert_allclose(pixels[2, 77], (77, 2), atol=1e-4)
    np.testing.assert_allclose(range_m, image.range_m, rtol=1e-5)


def test_ground_and_a_wall_are_met_at_the_distances_of_the_book():
    """The ring at -30 degrees meets the ground at 2 h, the level one a wall 6 m ahead, the high one nothing."""
    wall = trimesh.creation.box(bounds=[[6.0, -20.0, -1.0], [7.0, 20.0, 2.0]])
    T = make_T(None, (0.0, 0.0, 1.7))
    image, index = scan_meshes([wall], T_world_sensor=T, lidar=RINGS, ground_m=0.0)
    ahead, aside = 180, 90  # column 0 looks backwards, and the columns go clockwise: 90 looks to the left
    assert image.range_m[3, aside] == pytest.approx(3.4, rel=1e-5)
    assert (index[3, aside], index[1, ahead], index[0, 0]) == (1, 0, -1)
    assert image.range_m[1, ahead] == pytest.approx(6.0, rel=1e-5)
    assert image.range_m[2, ahead] == pytest.approx(6.0 / np.cos(np.deg2rad(10)), rel=1e-5)
    assert image.range_m[1, ahead + 30] == pytest.approx(6.0 / np.cos(np.deg2rad(30)), rel=1e-5)
    assert image.range_m[0, 0] == 0
    assert image.range_m[1, aside] == 0


def test_noise_and_losses_are_as_stated_and_repeatable():
    noisy = LidarModel(RINGS.elevation_deg, 2000, sigma_m=0.03, lost_share=0.2)
    shell = trimesh.creation.box((20.0, 20.0, 20.0)).apply_translation(POSE[:3, 3])
    clean, _ = scan_meshes([shell], T_world_sensor=POSE, lidar=noisy)
    image, index = scan_meshes([shell], T_world_sensor=POSE, lidar=noisy, rng=np.random.default_rng(3))
    again, _ = scan_meshes([shell], T_world_sensor=POSE, lidar=noisy, rng=np.random.default_rng(3))
    back = image.range_m > 0
    assert back.mean() == pytest.approx(0.8, abs=0.015)
    np.testing.assert_array_equal(index == 0, back)
    assert (image.range_m - clean.range_m)[back].std() == pytest.approx(0.03, rel=0.03)
    np.testing.assert_array_equal(image.range_m, again.range_m)


def test_what_is_too_near_or_too_far_does_not_come_back():
    walls = [trimesh.creation.box(bounds=[[x, -1, -1], [x + 0.01, 1, 1]]) for x in (0.4, 130.0)]
    walls += [trimesh.creation.box(bounds=[[-1, y, -1], [1, y + 0.01, 1]]) for y in (5.0,)]
    image, index = scan_meshes(walls, T_world_sensor=np.eye(4), lidar=RINGS)
    assert index[1, 180] == -1
    assert (index[1, 90], image.range_m[1, 90]) == (2, pytest.approx(5.0))
    assert scan_meshes(walls[1:2], T_world_sensor=np.eye(4), lidar=RINGS)[0].range_m[1, 180] == 0


def test_a_mujoco_scene_is_scanned_like_its_meshes():
    xml = """<mujoco><worldbody><geom name="road" type="plane" size="0 0 1"/>
    <body pos="9 2 0.8" euler="0 0 30"><freejoint/><geom name="car" type="box" size="2 0.8 0.8"/></body>
    <geom name="hidden" type="sphere" size="1" pos="4 0 1.7" group="3"/></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)  # pyright: ignore[reportAttributeAccessIssue]
    data = mujoco.MjData(model)  # pyright: ignore[reportAttributeAccessIssue]
    mujoco.mj_forward(model, data)  # pyright: ignore[reportAttributeAccessIssue]
    box = trimesh.creation.box((4, 1.6, 1.6))
    box.apply_transform(make_T(rotation_about((0, 0, 1), np.pi / 6), (9, 2, 0.8)))
    T = make_T(rotation_about((0, 0, 1), 0.2), (0, 0, 1.73))
    by_mujoco, geom = scan_scene(model, data, T_world_sensor=T, lidar=RINGS)
    by_embree, index = scan_meshes([box], T_world_sensor=T, lidar=RINGS, ground_m=0.0)
    assert ((geom == model.geom("car").id) == (index == 0)).mean() > 0.998
    assert (index == 0).sum() > 12
    both = (by_mujoco.range_m > 0) & (by_embree.range_m > 0) & ((index == 0) == (geom == model.geom("car").id))
    np.testing.assert_allclose(by_mujoco.range_m[both], by_embree.range_m[both], rtol=1e-4)
    np.testing.assert_allclose(apply_T(np.linalg.inv(T), by_mujoco.points()[3, 100])[2], -1.73, atol=1e-4)


def test_the_default_is_a_velodyne_hdl_64():
    assert len(HDL_64.elevation_deg) == 64
    assert (HDL_64.elevation_deg[0], HDL_64.elevation_deg[-1]) == (2.0, -24.33)
    assert 360 / HDL_64.columns == pytest.approx(0.1728, abs=1e-4)
    assert HDL_64.height_m == 1.73


def test_nonsense_is_refused():
    with pytest.raises(InvalidOption, match="highest down"):
        LidarModel((0.0, 1.0), 100)
    with pytest.raises(InvalidOption, match=r"lost_share 1\.0"):
        LidarModel((1.0, 0.0), 100, lost_share=1.0)
    broken = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(InvalidMesh, match="not finite"):
        scan_meshes([broken], T_world_sensor=np.eye(4))
