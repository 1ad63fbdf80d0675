"""What a level view says of one detection: its floor, its points and normals, its outline, what is free beside it."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from tilted_table import UP, in_level_frame, tilted_block, tilted_detection
from toy_wedge import camera_at

from gfp_grasp.level import make_level_view
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import DepthImage, SupportPlane

# ---- the floor


@pytest.mark.parametrize(("elevation_deg", "hidden_m"), [(30.0, 0.002), (90.0, 0.004), (-40.0, 0.0)])
def test_more_of_a_foot_is_out_of_sight_the_steeper_the_view(elevation_deg, hidden_m):
    points = tilted_block()
    sideways = np.cross(UP, (1.0, 0, 0)) / np.linalg.norm(np.cross(UP, (1.0, 0, 0)))
    angle = np.deg2rad(elevation_deg)
    viewpoint = points.mean(axis=0) + 1.3 * (np.cos(angle) * sideways + np.sin(angle) * UP)
    for view, expected in (
        (make_level_view(tilted_detection(points, viewpoint)), 0.2 - hidden_m),
        (make_level_view(tilted_detection(points)), 0.2),
    ):
        lowest = apply_T(view.T_world_level, np.array([0.0, 0.0, view.floor_m]))
        assert lowest @ UP == pytest.approx(expected, abs=1e-6)


def test_a_guessed_floor_is_surer_from_above_than_from_below_and_a_seen_one_alike():
    guessed = make_level_view(tilted_detection(tilted_block()))
    assert not guessed.floor_seen
    assert guessed.floor_sigma_m == (0.0015, 0.003)
    seen = make_level_view(tilted_detection(tilted_block(), support=SupportPlane(UP, 0.17)))
    assert seen.floor_seen
    assert (seen.floor_m, seen.floor_sigma_m) == (0.0, (0.002, 0.002))
    assert seen.T_world_level[:3, 3] @ UP == pytest.approx(0.17)  # the origin lies on the support
    assert seen.T_world_level[:3, 2] == pytest.approx(UP)


# ---- points and normals


def test_evidence_keeps_points_of_the_cloud_with_normals_that_face_the_viewpoint():
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(6000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    centre, viewpoint = np.array([0.4, -0.3, 0.9]), np.array([1.4, 0.3, 1.5])
    facing = directions @ (viewpoint - centre) > 0.07 * np.linalg.norm(viewpoint - centre)
    points = centre + 0.06 * directions[facing]
    evidence = make_level_view(tilted_detection(points, viewpoint))
    assert 400 <= len(evidence.points) <= 480
    assert 1000 <= len(evidence.dense_points) <= 1200
    assert KDTree(evidence.dense_points).query(evidence.points)[0].max() == 0
    assert KDTree(points).query(apply_T(evidence.T_world_level, evidence.dense_points))[0].max() < 1e-12
    outward = (evidence.points - in_level_frame(evidence, centre)) / 0.06
    nearest = KDTree(evidence.dense_points).query(evidence.points)[1]
    assert np.array_equal(evidence.normals, evidence.dense_normals[nearest])
    assert np.einsum("ni,ni->n", evidence.normals, outward).min() > 0.98
    assert evidence.oriented
    assert evidence.sigma_m == 0.0021
    blind = make_level_view(tilted_detection(points))
    assert not blind.oriented
    assert blind.silhouette is None
    outward = (blind.points - in_level_frame(blind, centre)) / 0.06
    assert np.abs(np.einsum("ni,ni->n", blind.normals, outward)).min() > 0.98
    few = evidence.few(40)
    assert len(few.points) == 40
    kept = KDTree(evidence.points).query(few.points)[1]
    assert (np.diff(kept) > 0).all()
    assert np.array_equal(few.normals, evidence.normals[kept])
    assert evidence.few(1000) is evidence


# ---- the outline


def test_a_picture_says_free_only_up_to_what_it_saw_beside_the_object():
    depth = np.full((40, 50), 1.5)
    depth[:, 30:] = 0.0  # nothing came back
    depth[30:, :] = 0.4  # something nearer
    mask = np.zeros((40, 50), dtype=bool)
    mask[10:20, 12:22] = True
    depth[mask] = 0.9
    viewpoint = np.array([0.8, -0.4, 1.0])
    points = tilted_block()
    T = camera_at(viewpoint, points.mean(axis=0))
    K = np.array([[60.0, 0, 24], [0, 70.0, 19], [0, 0, 1]])
    detection = tilted_detection(points, viewpoint, view=DepthImage(depth, K, T), mask=mask)
    view = make_level_view(detection)
    silhouette = view.silhouette
    assert silhouette is not None
    assert silhouette.certain
    assert not silhouette.free_range_m[mask].any()

    def out(row, column, z) -> bool:
        point = np.array([[(column - 24) * z / 60, (row - 19) * z / 70, z]])
        return len(silhouette.free_space_violation(in_level_frame(view, apply_T(T, point)))[0]) == 1

    assert not out(15, 15, 0.5)
    assert out(15, 25, 1.4)
    assert not out(15, 25, 1.6)
    assert not out(15, 35, 0.5)
    assert out(35, 15, 0.3)
    assert not out(35, 15, 0.5)
    # The way back leads to the nearest pixel of the object: eight columns to the left and five rows up.
    index, back = silhouette.free_space_violation(
        in_level_frame(view, apply_T(T, np.array([[(29 - 24) / 60.0, (24 - 19) / 70.0, 1.0]])))
    )
    assert index.tolist() == [0]
    assert view.T_world_level[:3, :3] @ back[0] @ T[:3, :3] == pytest.approx([-8 / 60, -5 / 70, 0])


def test_the_outline_of_a_sparse_cloud_has_no_holes_and_ends_where_the_cloud_ends():
    rng = np.random.default_rng(1)
    flat = (np.indices((30, 30)).reshape(2, -1).T + rng.uniform(0, 1, (900, 2))) / 15 - 1
    rim = np.arange(200) / 200 * 2 * np.pi
    flat = 0.06 * np.concatenate([flat[np.hypot(*flat.T) < 1], np.column_stack([np.cos(rim), np.sin(rim)])])
    viewpoint, centre = np.array([0.9, -0.5, 1.1]), np.array([0.1, 0.2, 0.3])
    T = camera_at(viewpoint, centre)
    distance = float(np.linalg.norm(viewpoint - centre))
    points = apply_T(T, np.column_stack([flat, np.full(len(flat), distance)]))
    view = make_level_view(tilted_detection(points, viewpoint))
    silhouette = view.silhouette
    assert silhouette is not None
    assert not silhouette.certain
    radius, angle = np.meshgrid(np.linspace(0, 0.057, 40), np.linspace(0, 2 * np.pi, 60))

    def on_disc(radius, z=distance):
        x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
        return in_level_frame(view, apply_T(T, np.column_stack([x, y, np.full(radius.size, z)])))

    assert len(silhouette.free_space_violation(on_disc(radius))[0]) == 0
    around = on_disc(np.full_like(radius, 0.075))
    index, back = silhouette.free_space_violation(around)
    assert len(index) == len(around)
    # At any depth: a cloud does not say how far the sensor sees beside it.
    assert len(silhouette.free_space_violation(on_disc(np.full_like(radius, 0.075 * 3), 3 * distance))[0]) == len(
        around
    )
    inward = in_level_frame(view, centre) - around[index]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    assert np.linalg.norm(back, axis=1) == pytest.approx(0.015, abs=0.006)
    assert np.einsum("ni,ni->n", inward, back).min() > 0.008


def test_pixels_are_where_the_camera_sees_points():
    viewpoint, points = np.array([0.8, -0.4, 1.0]), tilted_block()
    T = camera_at(viewpoint, points.mean(axis=0))
    K = np.array([[60.0, 0, 24], [0, 70.0, 19], [0, 0, 1]])
    mask = np.zeros((40, 50), dtype=bool)
    mask[5, 6] = True
    detection = tilted_detection(points, viewpoint, view=DepthImage(np.ones((40, 50)), K, T), mask=mask)
    view = make_level_view(detection)
    assert view.silhouette is not None
    seen = apply_T(invert_T(T), points)
    z = seen[:, 2]
    column, row = view.silhouette.pixel_of(in_level_frame(view, points)).T
    assert column == pytest.approx(60 * seen[:, 0] / z + 24)
    assert row == pytest.approx(70 * seen[:, 1] / z + 19)
