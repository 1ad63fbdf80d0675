"""Which of a completed surface was observed, how sure the rest is, and detections in another frame."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from toy_bodies import T_WORLD_OBJECT, detection_of, refined, slab

from gfp_grasp.level import level_frame, mark_observed, move_detection
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, OrientedBox, SupportPlane

EYE = np.array([0.1, 0.2, 1.0])  # in the frame of the body


def grid(spacing, size=(0.1, 0.06), z=0.0):
    """Points of a level plane about the origin, one each `spacing`."""
    x, y = (np.arange(-s / 2, s / 2 + 1e-9, spacing) for s in size)
    x, y = np.meshgrid(x, y)
    return np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(-1, 3)


def marked(mesh, detection, sigma_m=None):
    """Of a mesh in the body's frame, put into the world where the detection is."""
    vertices = apply_T(T_WORLD_OBJECT, np.asarray(mesh.vertices))
    nothing = np.full(len(vertices), np.nan)
    return mark_observed(
        vertices,
        np.asarray(mesh.faces),
        detection.cloud,
        sensor_sigma_m=detection.sensor_sigma_m,
        sigma_m=nothing if sigma_m is None else sigma_m,
    )


def sheet(z=0.0, *, facing_up=True):
    """An open level sheet."""
    box = slab((0.1, 0.06, 0.01), edge_m=0.01)
    mesh = trimesh.Trimesh(box.vertices.copy(), box.faces[box.face_normals[:, 2] > 0.99])
    mesh.vertices[:, 2] = z
    if not facing_up:
        mesh.invert()
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize(
    ("spacing", "sigma_m", "reach_m"),
    [(0.004, 0.001, 0.010), (0.001, 0.004, 0.012), (0.001, 0.0001, 0.0025)],
)
def test_a_vertex_is_observed_within_three_sigmas_or_two_and_a_half_spacings_of_a_point(spacing, sigma_m, reach_m):
    detection = detection_of(grid(spacing), EYE, sensor_sigma_m=sigma_m)
    observed, _ = marked(sheet(0.9 * reach_m), detection)
    inner = (np.abs(sheet().vertices[:, :2]) < (0.045, 0.025)).all(axis=1)
    assert observed[inner].all() == (spacing < 0.9 * reach_m)
    observed, _ = marked(sheet(1.01 * reach_m), detection)
    assert not observed.any()


def test_what_faces_away_is_not_observed():
    detection = detection_of(grid(0.002), EYE)
    assert marked(sheet(), detection)[0].all()
    assert not marked(sheet(facing_up=False), detection)[0].any()


def test_what_something_of_the_same_surface_hides_is_not_observed():
    """Two level sheets, 4 mm apart, both of them near points: the lower one is hidden by the upper."""
    upper, lower = sheet(0.002), sheet(-0.002)
    both = trimesh.util.concatenate([upper, lower])
    assert isinstance(both, trimesh.Trimesh)
    observed, _ = marked(both, detection_of(grid(0.002), EYE))
    is_upper = np.asarray(both.vertices)[:, 2] > 0
    inner = (np.abs(both.vertices[:, :2]) < (0.045, 0.025)).all(axis=1)
    assert observed[is_upper].all()
    assert not observed[~is_upper & inner].any()
    blind, _ = marked(both, replace(detection_of(grid(0.002))))
    assert blind.all()  # without a viewpoint nothing is known to be hidden


def test_sigma_is_the_sensors_and_a_tenth_of_the_distance_where_the_deformation_does_not_tell():
    mesh = sheet(0.03)
    sigma_m = np.full(len(mesh.vertices), np.nan)
    sigma_m[::2] = 0.007
    detection = detection_of(grid(0.002), EYE, sensor_sigma_m=0.0015)
    _, found = marked(mesh, detection, sigma_m)
    assert found[::2] == pytest.approx(np.full(len(found[::2]), 0.007))
    assert found[1::2] == pytest.approx(np.full(len(found[1::2]), np.hypot(0.0015, 0.1 * 0.03)), rel=0.01)


def test_an_inner_wall_opposite_the_viewer_is_observed_through_the_mouth_and_the_near_one_is_not():
    """An open box, off its own middle, seen slantwise from above: its far inner wall is seen, its near one is not."""
    outer = trimesh.creation.box(bounds=[[-0.04, -0.03, 0], [0.06, 0.05, 0.05]])
    inner = trimesh.creation.box(bounds=[[-0.035, -0.025, 0.005], [0.055, 0.045, 0.1]])
    mesh = refined(trimesh.boolean.difference([outer, inner], engine="manifold"), 0.008)
    vertices = np.asarray(mesh.vertices)
    observed, _ = marked(mesh, detection_of(vertices, (0.6, 0.0, 0.3)))
    high = (vertices[:, 2] > 0.035) & (vertices[:, 2] < 0.049) & (np.abs(vertices[:, 1] - 0.01) < 0.02)
    assert observed[high & (np.abs(vertices[:, 0] + 0.035) < 1e-6)].all()
    assert not observed[high & (np.abs(vertices[:, 0] - 0.055) < 1e-6)].any()
    assert observed[high & (np.abs(vertices[:, 0] - 0.06) < 1e-6)].all()
    assert not observed[high & (np.abs(vertices[:, 0] + 0.04) < 1e-6)].any()


def test_a_detection_moves_with_all_that_it_holds():
    T = make_T(rotation_about((3, -1, 2), 0.8), (0.3, 0.1, -0.4))
    points = np.random.default_rng(0).uniform(0, 0.1, (200, 3))
    K = np.array([[300.0, 0, 16], [0, 300, 12], [0, 0, 1]])
    image = DepthImage(np.ones((24, 32), np.float32), K, T_WORLD_OBJECT)
    normal = np.array([1.0, 2.0, 2.0]) / 3
    detection = replace(
        detection_of(points, EYE),
        up=normal,
        support=SupportPlane(normal, 0.25),
        box=OrientedBox(T_WORLD_OBJECT, np.array([0.1, 0.2, 0.3])),
        view=image,
    )
    moved = move_detection(detection, T)
    assert moved.up == pytest.approx(T[:3, :3] @ normal)
    assert moved.support is not None
    assert moved.support.normal == pytest.approx(T[:3, :3] @ normal)
    on_plane = 0.25 * normal + np.cross(normal, [0.3, 0.1, 0.7])
    assert moved.support.normal @ apply_T(T, on_plane) == pytest.approx(moved.support.height_m)
    assert detection.cloud.viewpoint is not None
    assert moved.cloud.viewpoint == pytest.approx(apply_T(T, detection.cloud.viewpoint))
    assert moved.box.T_world_box == pytest.approx(T @ T_WORLD_OBJECT)
    assert moved.box.extents == pytest.approx([0.1, 0.2, 0.3])
    assert isinstance(moved.view, DepthImage)
    assert moved.view.T_world_camera == pytest.approx(T @ T_WORLD_OBJECT)
    np.testing.assert_array_equal(moved.view.depth_m, image.depth_m)
    back = move_detection(moved, invert_T(T))
    assert back.cloud.points == pytest.approx(detection.cloud.points)


@pytest.mark.parametrize("side", [1, -1])
def test_without_a_viewpoint_x_of_the_level_frame_is_the_short_side(side):
    """A block four times as long as wide, upright along a tilted up; the side of its tail says which way x points."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.02, -0.08, -0.03), (0.02, 0.08, 0.03), (3000, 3))
    tail = rng.uniform((0.02, -0.01, -0.01), (0.035, 0.01, 0.01), (60, 3))
    points = np.concatenate([points, tail * (side, 1, 1)])
    T = level_frame(apply_T(T_WORLD_OBJECT, points), 3 * T_WORLD_OBJECT[:3, 2], None)
    assert T[:3, 2] == pytest.approx(T_WORLD_OBJECT[:3, 2])
    assert side * (T[:3, 0] @ T_WORLD_OBJECT[:3, 0]) > 0.99
    assert T[:3, 3] == pytest.approx(apply_T(T_WORLD_OBJECT, points.mean(axis=0)))
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


def test_with_a_viewpoint_x_of_the_level_frame_points_to_it():
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (300, 3))
    T = level_frame(apply_T(T_WORLD_OBJECT, points), T_WORLD_OBJECT[:3, 2], apply_T(T_WORLD_OBJECT, (0.3, -0.4, 0.9)))
    sight = np.array([0.3, -0.4, 0]) - points.mean(axis=0) * (1, 1, 0)
    assert T[:3, 0] == pytest.approx(T_WORLD_OBJECT[:3, :3] @ sight / np.linalg.norm(sight))
