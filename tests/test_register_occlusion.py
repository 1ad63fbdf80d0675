"""The edge of what hides a part of an object: where there is one, on which side, and what is not known beyond it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tilted_table import UP, in_level_frame, tilted_detection
from toy_wedge import camera_at

from gfp_grasp.level import make_level_view
from gfp_grasp.register.occlusion import behind_occluder, cut_off, is_cut_off
from gfp_grasp.transforms import apply_T, make_T
from gfp_grasp.types import DepthImage, PointCloud

Z = np.array([0.0, 0.0, 1.0])


def _pillar(side: np.ndarray, *, above_m: float | None = None, below_m: float | None = None):
    """The view of a round pillar along UP, seen from above; its part beyond a plane through the viewpoint is hidden.

    Returns:
        The level view, and in its frame the outward normal of the plane and the viewpoint.
    """
    R = np.column_stack([side, np.cross(UP, side), UP])
    rng = np.random.default_rng(6)
    angle, height = rng.uniform(-np.pi / 2, np.pi / 2, 20000), rng.uniform(0, 0.3, 20000)
    local = np.column_stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), height])
    eye = np.array([1.2, 0.0, 0.6])
    normal = np.array([0.0, 0.25, 1.0]) / np.hypot(0.25, 1.0)
    if above_m is not None:
        normal = np.array([(above_m - 0.6) / 1.15, 0.25, 1.0])
    if below_m is not None:
        normal = np.array([-(below_m - 0.6) / 1.15, 0.25, -1.0])
    normal /= np.linalg.norm(normal)
    shift = np.array([0.3, 0.4, 0.1])
    if above_m is not None or below_m is not None:
        local = local[(local - eye) @ normal < 0]
    evidence = make_level_view(tilted_detection(local @ R.T + shift, R @ eye + shift))
    return evidence, R @ normal @ evidence.T_world_level[:3, :3], in_level_frame(evidence, R @ eye + shift)


SIDE = np.cross(UP, (0.2, 1.0, 0.1)) / np.linalg.norm(np.cross(UP, (0.2, 1.0, 0.1)))


def test_the_straight_edge_of_what_hides_the_top_is_found_with_its_side():
    evidence, normal, viewpoint = _pillar(SIDE, above_m=0.2)
    hidden = cut_off(evidence)
    assert hidden.cut is not None
    assert evidence.silhouette is not None
    assert hidden.silhouette is not None
    assert hidden.cut @ normal > np.cos(np.deg2rad(3))
    assert hidden.floor_sigma_m == evidence.floor_sigma_m  # the foot is seen
    axis, foot = evidence.points.mean(axis=0), in_level_frame(evidence, np.array([0.3, 0.4, 0.1]))
    beyond = axis + Z * (0.22 - (axis - foot) @ Z)
    beside = axis + 0.09 * np.cross(Z, SIDE @ evidence.T_world_level[:3, :3])
    assert evidence.silhouette.free_space_violation(np.array([beyond, beside]))[0].tolist() == [0, 1]
    assert hidden.silhouette.free_space_violation(np.array([beyond, beside]))[0].tolist() == [1]
    assert hidden.viewpoint == pytest.approx(viewpoint)
    # Nothing is known from the very edge on.
    along = (evidence.points - viewpoint) @ normal
    just_beyond = evidence.points + (0.004 - along)[:, None] * normal
    assert len(evidence.silhouette.free_space_violation(just_beyond)[0]) > 50
    assert len(hidden.silhouette.free_space_violation(just_beyond)[0]) < 5


@pytest.mark.parametrize(
    ("columns", "depth_m", "hides"), [((10, 60), 0.5, True), ((10, 33), 0.5, True), ((10, 30), 0.5, False),
                                      ((10, 60), 1.0, False), ((10, 60), 0.0, False), ((10, 60), 0.799, False)]
)  # fmt: skip
def test_what_a_view_shows_nearer_along_one_end_hides_how_the_object_goes_on(columns, depth_m, hides):
    depth, mask = np.full((48, 64), 1.2, dtype=np.float32), np.zeros((48, 64), dtype=bool)
    mask[20:40, 25:41] = True
    depth[mask] = 0.8
    depth[8:20, slice(*columns)] = depth_m
    K = np.array([[60.0, 0, 30], [0, 70, 19], [0, 0, 1]])
    view = DepthImage(depth, K, make_T(Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), (0.1, 0.2, 0.3)))
    detection = replace(tilted_detection(view.points()[mask], view.viewpoint), view=view, mask=mask)
    evidence = make_level_view(detection)
    found = behind_occluder(evidence)
    assert is_cut_off(evidence) is hides
    if not hides:
        assert found is evidence
        return
    assert found.cut is not None
    assert evidence.silhouette is not None
    unknown = replace(evidence, cloud=PointCloud(evidence.cloud.points, None))
    assert behind_occluder(unknown) is unknown
    upward = np.array([0.0, -70.0, 1.0])  # the row of the object's first pixels is one below the middle of the picture
    R = evidence.silhouette.view.moved(np.eye(4)).T_world_camera[:3, :3]  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(found.cut, R @ upward / np.linalg.norm(upward), atol=1e-9)
    beside = mask.copy()
    beside[:8] = True  # the object goes on beyond what stands before it
    depth[:8, 25:41] = 0.8
    apart = replace(detection, view=replace(view, depth_m=depth), mask=beside & (depth == np.float32(0.8)))
    whole = make_level_view(apart)
    assert behind_occluder(whole) is whole


def test_an_end_is_hidden_where_a_clear_edge_or_the_cut_of_the_evidence_says_so():
    evidence, normal, _ = _pillar(SIDE, above_m=0.2)
    assert is_cut_off(evidence)
    unknown = replace(evidence, cloud=PointCloud(evidence.cloud.points, None), silhouette=None)
    assert not is_cut_off(unknown)
    assert is_cut_off(replace(unknown, cut=normal))


def test_without_a_straight_edge_nothing_is_known_beyond_what_faces_the_viewpoint():
    evidence, _, _ = _pillar(SIDE, above_m=0.2)
    hidden = cut_off(evidence, edge=None)
    assert hidden.cut is None
    assert hidden.silhouette is not None
    axis = evidence.points.mean(axis=0)
    beyond, beside = axis + 0.14 * Z, axis + 0.09 * np.cross(Z, SIDE @ evidence.T_world_level[:3, :3])
    assert hidden.silhouette.free_space_violation(np.array([beyond, beside]))[0].tolist() == [1]
    assert hidden.floor_sigma_m == evidence.floor_sigma_m


def test_where_the_foot_is_hidden_a_guessed_floor_may_be_far_below_but_a_seen_one_stays():
    evidence, normal, _ = _pillar(SIDE, below_m=0.1)
    hidden = cut_off(evidence)
    assert hidden.cut is not None
    assert hidden.cut @ normal > np.cos(np.deg2rad(3))
    assert hidden.floor_sigma_m == (evidence.floor_sigma_m[0], np.inf)
    seen = replace(evidence, floor_seen=True)
    assert cut_off(seen).floor_sigma_m == evidence.floor_sigma_m


def test_a_ball_has_no_straight_edge():
    rng = np.random.default_rng(6)
    directions = rng.normal(size=(20000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    viewpoint = np.array([1.2, 0.3, 0.7])
    points = 0.05 * directions[directions @ viewpoint > 0.06]
    evidence = make_level_view(tilted_detection(points, viewpoint))
    assert cut_off(evidence).cut is None
    assert not is_cut_off(evidence)


def _facing_plate(flat: np.ndarray):
    """The view of a flat plate that faces the viewpoint, and the axes of the plate in its frame."""
    viewpoint, centre = np.array([0.9, -0.5, 1.1]), np.array([0.1, 0.2, 0.3])
    T = camera_at(viewpoint, centre)
    points = apply_T(T, np.column_stack([flat, np.full(len(flat), np.linalg.norm(viewpoint - centre))]))
    view = make_level_view(tilted_detection(points, viewpoint))
    return view, view.T_world_level[:3, :3].T @ T[:3, :3]


def test_a_straight_edge_is_one_only_where_nothing_lies_beyond_it():
    flat = np.random.default_rng(5).uniform(-0.06, 0.06, (20000, 2))
    square, flat = flat, flat[np.hypot(*flat.T) < 0.06]
    segment, axes = _facing_plate(flat[flat[:, 0] < 0.03])
    cut = cut_off(segment).cut
    assert cut is not None
    assert cut @ axes[:, 0] > 0.99
    # An edge that is short beside the outline may be the plate's own: here the end of an arm of a cross.
    cross, _ = _facing_plate(square[np.abs(square).min(axis=1) < 0.012])
    assert cut_off(cross).cut is None
    # The sides of a slot are straight and face the viewpoint, but the plate goes on beyond them.
    slotted, _ = _facing_plate(flat[(np.abs(flat[:, 0]) > 0.012) | (flat[:, 1] < -0.04)])
    assert cut_off(slotted).cut is None


def test_a_few_wrong_normals_make_no_edge_of_the_straight_side_of_a_pillar():
    evidence, _, viewpoint = _pillar(SIDE)
    toward = viewpoint - evidence.points
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    wrong = np.random.default_rng(0).random(len(toward)) < 0.3
    sides = np.abs((evidence.points - evidence.points.mean(axis=0)) @ np.cross(UP, SIDE)) > 0.03
    normals = np.where((wrong & sides)[:, None], toward, np.where(sides[:, None], np.cross(UP, SIDE), -toward))
    assert cut_off(replace(evidence, normals=normals)).cut is None
    normals = np.where(sides[:, None], toward, -toward)
    assert cut_off(replace(evidence, normals=normals)).cut is not None


def test_a_faint_edge_is_one_of_a_surface_at_a_slant_or_where_less_of_the_outline_lies_on_it():
    flat = np.random.default_rng(5).uniform(-0.06, 0.06, (20000, 2))
    segment, axes = _facing_plate(flat[(flat[:, 0] < 0.03) & (np.hypot(*flat.T) < 0.06)])
    sight = segment.viewpoint - segment.points
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    across = np.cross(sight, axes[:, 1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for cosine, clear, faint in ((0.55, True, True), (0.45, False, True), (0.35, False, True), (0.25, False, False)):
        tilted = replace(segment, normals=cosine * sight + np.sqrt(1 - cosine**2) * across)
        assert (cut_off(tilted).cut is not None, cut_off(tilted, edge="faint").cut is not None) == (clear, faint)
    cross, _ = _facing_plate(flat[np.abs(flat).min(axis=1) < 0.02])  # a third of its outline's extent
    assert cut_off(cross).cut is None
    assert cut_off(cross, edge="faint").cut is not None
