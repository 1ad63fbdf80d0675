"""What is read from one detection: floor, outline, free space, and the edge of what hides a part."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from toy_wedge import camera_at, positions, toy_evidence, wedge_primitive, wedge_state

from gfp_grasp.clouds import estimate_normals, thin
from gfp_grasp.level import make_level_view
from gfp_grasp.register import part_is_seen
from gfp_grasp.register.occlusion import behind_occluder, cut_off
from gfp_grasp.register.state import surface_samples
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_between
from gfp_grasp.types import (
    BODY_REGIONS,
    DepthImage,
    Detection,
    FittedPrimitive,
    LevelView,
    OrientedBox,
    PointCloud,
    SupportPlane,
)

UP = np.array([0.35, -0.2, 1.0]) / np.linalg.norm([0.35, -0.2, 1.0])  # of a table that is not level
Z = np.array([0.0, 0.0, 1.0])


def _here(view: LevelView, points: np.ndarray) -> np.ndarray:
    """World points in the frame of a level view."""
    return apply_T(invert_T(view.T_world_level), points)


def _detection(points, viewpoint=None, **changes) -> Detection:
    box = OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0))
    given = {"up": UP, "support": None, "category": "wedge", "scores": {}, "box": box, "sensor_sigma_m": 0.0021}
    return Detection(cloud=PointCloud(points, viewpoint), **{**given, **changes})


def _block(count: int = 3000) -> np.ndarray:
    """Points in a block that stands along UP, its lowest at a height of 0.2 m."""
    points = np.random.default_rng(0).uniform((0.5, 0.1, 0.2), (0.58, 0.23, 0.5), (count, 3))
    points[:10, 2] = 0.2
    return points @ rotation_between((0, 0, 1), UP).T


# ---- thinning


def test_of_two_points_as_near_their_mean_the_same_one_is_kept_whatever_the_order():
    cells = np.stack(np.meshgrid(*[np.arange(12)] * 3), axis=-1).reshape(-1, 3)
    points = np.concatenate([cells * 0.3 + 0.1, cells * 0.3 + (0.13, 0.14, 0.12)])
    count = int(len(cells) * 0.95)
    first = thin(points, count)
    assert len(first) < len(points)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(points))
        assert np.array_equal(thin(points[order], count), first)


def test_each_kept_point_is_the_nearest_to_the_mean_of_its_cell():
    near, far = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.5, 0.0, 0.0]]), np.array([[10.0, 10.0, 0.0]])
    assert thin(np.concatenate([near, far, near + np.array([0, 10.0, 0])]), 3).tolist() == [
        [0.2, 0, 0],
        [0.2, 10, 0],
        [10, 10, 0],
    ]


# ---- the floor


@pytest.mark.parametrize(("elevation_deg", "hidden_m"), [(30.0, 0.002), (90.0, 0.004), (-40.0, 0.0)])
def test_more_of_a_foot_is_out_of_sight_the_steeper_the_view(elevation_deg, hidden_m):
    points = _block()
    sideways = np.cross(UP, (1.0, 0, 0)) / np.linalg.norm(np.cross(UP, (1.0, 0, 0)))
    angle = np.deg2rad(elevation_deg)
    viewpoint = points.mean(axis=0) + 1.3 * (np.cos(angle) * sideways + np.sin(angle) * UP)
    for view, expected in (
        (make_level_view(_detection(points, viewpoint)), 0.2 - hidden_m),
        (make_level_view(_detection(points)), 0.2),
    ):
        lowest = apply_T(view.T_world_level, np.array([0.0, 0.0, view.floor_m]))
        assert lowest @ UP == pytest.approx(expected, abs=1e-6)


def test_a_guessed_floor_is_surer_from_above_than_from_below_and_a_seen_one_alike():
    guessed = make_level_view(_detection(_block()))
    assert not guessed.floor_seen
    assert guessed.floor_sigma_m == (0.0015, 0.003)
    seen = make_level_view(_detection(_block(), support=SupportPlane(UP, 0.17)))
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
    evidence = make_level_view(_detection(points, viewpoint))
    assert 400 <= len(evidence.points) <= 480
    assert 1000 <= len(evidence.dense_points) <= 1200
    assert KDTree(evidence.dense_points).query(evidence.points)[0].max() == 0
    assert KDTree(points).query(apply_T(evidence.T_world_level, evidence.dense_points))[0].max() < 1e-12
    outward = (evidence.points - _here(evidence, centre)) / 0.06
    nearest = KDTree(evidence.dense_points).query(evidence.points)[1]
    assert np.array_equal(evidence.normals, evidence.dense_normals[nearest])
    assert np.einsum("ni,ni->n", evidence.normals, outward).min() > 0.98
    assert evidence.oriented
    assert evidence.sigma_m == 0.0021
    blind = make_level_view(_detection(points))
    assert not blind.oriented
    assert blind.silhouette is None
    outward = (blind.points - _here(blind, centre)) / 0.06
    assert np.abs(np.einsum("ni,ni->n", blind.normals, outward)).min() > 0.98
    few = evidence.few(40)
    assert len(few.points) == 40
    kept = KDTree(evidence.points).query(few.points)[1]
    assert (np.diff(kept) > 0).all()
    assert np.array_equal(few.normals, evidence.normals[kept])
    assert evidence.few(1000) is evidence


def test_normals_of_a_tilted_plane_are_its_own():
    rng = np.random.default_rng(4)
    R = rotation_between((0, 0, 1), UP)
    points = np.column_stack([rng.uniform(-1, 1, (500, 2)), np.zeros(500)]) @ R.T + 3.0
    for viewpoint, sign in ((points.mean(axis=0) + 2 * UP, 1), (points.mean(axis=0) - 2 * UP, -1)):
        assert np.allclose(estimate_normals(points, points[:50], viewpoint), sign * UP, atol=1e-9)


# ---- the outline


def test_a_picture_says_free_only_up_to_what_it_saw_beside_the_object():
    depth = np.full((40, 50), 1.5)
    depth[:, 30:] = 0.0  # nothing came back
    depth[30:, :] = 0.4  # something nearer
    mask = np.zeros((40, 50), dtype=bool)
    mask[10:20, 12:22] = True
    depth[mask] = 0.9
    viewpoint = np.array([0.8, -0.4, 1.0])
    points = _block()
    T = camera_at(viewpoint, points.mean(axis=0))
    K = np.array([[60.0, 0, 24], [0, 70.0, 19], [0, 0, 1]])
    detection = _detection(points, viewpoint, view=DepthImage(depth, K, T), mask=mask)
    view = make_level_view(detection)
    silhouette = view.silhouette
    assert silhouette is not None
    assert silhouette.certain
    assert not silhouette.free_range_m[mask].any()

    def out(row, column, z) -> bool:
        point = np.array([[(column - 24) * z / 60, (row - 19) * z / 70, z]])
        return len(silhouette.free_space_violation(_here(view, apply_T(T, point)))[0]) == 1

    assert not out(15, 15, 0.5)
    assert out(15, 25, 1.4)
    assert not out(15, 25, 1.6)
    assert not out(15, 35, 0.5)
    assert out(35, 15, 0.3)
    assert not out(35, 15, 0.5)
    # The way back leads to the nearest pixel of the object: eight columns to the left and five rows up.
    index, back = silhouette.free_space_violation(
        _here(view, apply_T(T, np.array([[(29 - 24) / 60.0, (24 - 19) / 70.0, 1.0]])))
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
    view = make_level_view(_detection(points, viewpoint))
    silhouette = view.silhouette
    assert silhouette is not None
    assert not silhouette.certain
    radius, angle = np.meshgrid(np.linspace(0, 0.057, 40), np.linspace(0, 2 * np.pi, 60))

    def on_disc(radius, z=distance):
        x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
        return _here(view, apply_T(T, np.column_stack([x, y, np.full(radius.size, z)])))

    assert len(silhouette.free_space_violation(on_disc(radius))[0]) == 0
    around = on_disc(np.full_like(radius, 0.075))
    index, back = silhouette.free_space_violation(around)
    assert len(index) == len(around)
    # At any depth: a cloud does not say how far the sensor sees beside it.
    assert len(silhouette.free_space_violation(on_disc(np.full_like(radius, 0.075 * 3), 3 * distance))[0]) == len(
        around
    )
    inward = _here(view, centre) - around[index]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    assert np.linalg.norm(back, axis=1) == pytest.approx(0.015, abs=0.006)
    assert np.einsum("ni,ni->n", inward, back).min() > 0.008


def test_pixels_are_where_the_camera_sees_points():
    viewpoint, points = np.array([0.8, -0.4, 1.0]), _block()
    T = camera_at(viewpoint, points.mean(axis=0))
    K = np.array([[60.0, 0, 24], [0, 70.0, 19], [0, 0, 1]])
    mask = np.zeros((40, 50), dtype=bool)
    mask[5, 6] = True
    detection = _detection(points, viewpoint, view=DepthImage(np.ones((40, 50)), K, T), mask=mask)
    view = make_level_view(detection)
    assert view.silhouette is not None
    seen = apply_T(invert_T(T), points)
    z = seen[:, 2]
    column, row = view.silhouette.pixel_of(_here(view, points)).T
    assert column == pytest.approx(60 * seen[:, 0] / z + 24)
    assert row == pytest.approx(70 * seen[:, 1] / z + 19)


# ---- something hides a part


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
    evidence = make_level_view(_detection(local @ R.T + shift, R @ eye + shift))
    return evidence, R @ normal @ evidence.T_world_level[:3, :3], _here(evidence, R @ eye + shift)


SIDE = np.cross(UP, (0.2, 1.0, 0.1)) / np.linalg.norm(np.cross(UP, (0.2, 1.0, 0.1)))


def test_the_straight_edge_of_what_hides_the_top_is_found_with_its_side():
    evidence, normal, viewpoint = _pillar(SIDE, above_m=0.2)
    hidden = cut_off(evidence)
    assert hidden.cut is not None
    assert evidence.silhouette is not None
    assert hidden.silhouette is not None
    assert hidden.cut @ normal > np.cos(np.deg2rad(3))
    assert hidden.floor_sigma_m == evidence.floor_sigma_m  # the foot is seen
    axis, foot = evidence.points.mean(axis=0), _here(evidence, np.array([0.3, 0.4, 0.1]))
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
    detection = replace(_detection(view.points()[mask], view.viewpoint), view=view, mask=mask)
    evidence = make_level_view(detection)
    found = behind_occluder(evidence)
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
    evidence = make_level_view(_detection(points, viewpoint))
    assert cut_off(evidence).cut is None


def _facing_plate(flat: np.ndarray):
    """The view of a flat plate that faces the viewpoint, and the axes of the plate in its frame."""
    viewpoint, centre = np.array([0.9, -0.5, 1.1]), np.array([0.1, 0.2, 0.3])
    T = camera_at(viewpoint, centre)
    points = apply_T(T, np.column_stack([flat, np.full(len(flat), np.linalg.norm(viewpoint - centre))]))
    view = make_level_view(_detection(points, viewpoint))
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


# ---- a handle


def test_a_handle_is_seen_where_enough_points_lie_on_it_and_off_the_body():
    primitive = wedge_primitive()
    x = primitive.vertices[:, 0]
    primitive = replace(
        primitive, regions=np.where(x > 0.06, 2, 0).astype(np.uint8), region_names=(*BODY_REGIONS, "handle"), spec=None
    )
    state = wedge_state()
    fit = FittedPrimitive(
        primitive, make_T(state.R, state.t), np.exp(state.log_scale), state.coefficients, residual_m=0.001
    )
    samples = surface_samples(primitive)
    world = state.world(samples.local(state.coefficients))
    held = (primitive.on_region("handle")[primitive.faces[samples.face]]).all(axis=1)
    off_body = np.flatnonzero(held & (KDTree(world[~held]).query(world)[0] > 0.012))
    near_body = np.flatnonzero(held & (KDTree(world[~held]).query(world)[0] < 0.004))
    body = world[~held][:200]
    normal = UP

    def seen(points) -> bool:
        return part_is_seen(fit, "handle", toy_evidence(np.concatenate([body, points])))

    assert seen(world[off_body[:6]] + 0.006 * normal)
    assert not seen(world[off_body[:5]])
    assert not seen(world[near_body[:50]])
    assert not seen(world[off_body[:50]] + 0.05 * normal)
    for regions in (np.zeros(len(x)), np.full(len(x), 2)):
        bare = replace(fit, primitive=replace(primitive, regions=regions.astype(np.uint8)))
        assert not part_is_seen(bare, "handle", toy_evidence(world))


# ---- samples of the surface


def test_samples_lie_on_the_surface_in_proportion_to_its_area_and_follow_the_modes():
    primitive = wedge_primitive()
    samples = surface_samples(primitive, 400)
    corners = primitive.vertices[primitive.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for side in range(3):
        for end in (0, 1):
            part = np.abs(corners[..., side] - np.sort(corners[..., side].ravel())[-end]).max(axis=1) < 1e-9
            share = area[part].sum() / area.sum()
            assert (part[samples.face]).mean() == pytest.approx(share, abs=0.02)
    assert samples.weights.min() >= 0
    assert samples.weights.sum(axis=1) == pytest.approx(np.ones(400))
    coefficients = np.array([1.0, -2.0, 0.5])
    moved = primitive.shape(coefficients, np.ones(3))[primitive.faces[samples.face]]
    expected = np.einsum("mc,mcd->md", samples.weights, moved)
    assert samples.local(coefficients) == pytest.approx(expected)
    state = wedge_state()
    assert positions(state, primitive) == pytest.approx(
        apply_T(
            make_T(state.R, state.t), np.exp(state.log_scale) * surface_samples(primitive, 60).local(state.coefficients)
        )
    )
