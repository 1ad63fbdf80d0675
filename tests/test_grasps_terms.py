"""Each term of the planner on bodies without symmetry, in poses without symmetry, against known answers."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from gfp_grasp.grasps import GraspConfig, Gripper, clearance, contact, plan
from gfp_grasp.grasps.clearance import clearance_around, height_above, hidden_share
from gfp_grasp.grasps.contact import Contacts, find_contacts, load_ratio, obstacle_of, surface_of
from gfp_grasp.grasps.plan import cast_closing_lines, plan_grasps, poses_about
from gfp_grasp.meshes import sample_surface
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, Detection, Grasp, OrientedBox, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
TILTED = make_T(rotation_about((1, -2, 0.5), 0.8), (0.3, -0.1, 0.2))
GRIPPER = Gripper()


def grid(size_x, size_z, y, step=0.0005):
    """Points (n, 3) on a rectangle of the plane of that y, edges included, centred on x = z = 0."""
    x, z = (np.linspace(-s / 2, s / 2, round(s / step) + 1) for s in (size_x, size_z))
    return np.stack([*np.meshgrid(x, z), np.full((len(z), len(x)), y)], axis=-1).reshape(-1, 3)[:, [0, 2, 1]]


def sheet(points, normal_y, certainty=1.0):
    return points, np.tile([0.0, normal_y, 0.0], (len(points), 1)), np.full(len(points), certainty)


def contacts_of(*sheets, T=TILTED, opening_m=0.06, friction=0.5) -> Contacts:
    """Contacts of one gripper pose with sheets that are given in the gripper's frame."""
    points, normals, certainty = (np.concatenate(arrays) for arrays in zip(*sheets, strict=True))
    return find_contacts(
        T[None],
        np.array([opening_m]),
        apply_T(T, points),
        normals @ T[:3, :3].T,
        certainty,
        gripper=GRIPPER,
        friction=friction,
    )


def wide_and_narrow():
    """A face of 16 by 20 mm at y = 12 mm and one of 6 by 10 mm at y = -18 mm, as a frustum has them."""
    return sheet(grid(0.016, 0.020, 0.012), 1.0, 1.0), sheet(grid(0.006, 0.010, -0.018), -1.0, 0.2)


def test_first_touches_are_measured_from_the_gripper_s_own_origin_in_any_pose():
    contacts = contacts_of(*wide_and_narrow())
    assert (contacts.low_m[0], contacts.high_m[0]) == (pytest.approx(-0.018), pytest.approx(0.012))


def test_levers_are_those_of_the_narrow_face():
    contacts = contacts_of(*wide_and_narrow(), friction=0.4)
    across = 0.4 * 0.030
    twist = 2 * 0.4 * np.hypot(0.006, 0.010) / np.sqrt(12)
    # A turn about x is resisted along z, a turn about z along x; the grid's ends count whole, hence 5 %.
    levers = [across + 0.010, twist, across + 0.006]
    np.testing.assert_allclose(contacts.levers_m[0], np.diag(levers), rtol=0.1, atol=1e-9)
    swapped = contacts_of(*(sheet(p * (1, -1, 1), -n[0, 1], c[0]) for p, n, c in wide_and_narrow()), friction=0.4)
    np.testing.assert_allclose(swapped.levers_m, contacts.levers_m, rtol=1e-9, atol=1e-12)


def test_a_ridge_across_the_pads_resists_no_turn_about_itself_however_it_lies():
    """The rim of a pan between the pads, 18 mm long and 1 mm wide, level and at 40 degrees to the pads."""
    rim = [sheet(grid(0.018, 0.001, y), side) for y, side in ((0.002, 1.0), (-0.002, -1.0))]
    about = rotation_about((0, 1, 0), np.deg2rad(40))
    turned = [(points @ about.T, normals, certainty) for points, normals, certainty in rim]
    level, slanted = (contacts_of(*sheets, friction=0.5).levers_m[0] for sheets in (rim, turned))
    across = 0.5 * 0.004
    assert np.diag(level)[[0, 2]] == pytest.approx([across + 0.001, across + 0.018], rel=0.15)
    np.testing.assert_allclose(slanted, about @ level @ about.T, atol=1e-4)


def test_certainty_is_the_mean_of_both_sides_however_many_points_each_has():
    assert contacts_of(*wide_and_narrow()).certainty[0] == pytest.approx((1.0 + 0.2) / 2)


def test_certainty_is_one_half_where_one_side_is_seen_and_the_other_is_a_guess():
    seen, guessed = sheet(grid(0.01, 0.01, 0.02), 1.0, 1.0), sheet(grid(0.01, 0.01, -0.02), -1.0, 0.0)
    assert contacts_of(seen, guessed).certainty[0] == pytest.approx(0.5)


def test_a_face_that_looks_away_from_the_pad_is_not_touched():
    """The far sheet of a wall 0.5 mm thick looks inwards: neither its normal nor its place counts."""
    (points, normals, certainty), narrow = wide_and_narrow()
    lining = sheet(grid(0.020, 0.024, 0.0115), -1.0, 0.0)
    with_lining = contacts_of((points, normals, certainty), lining, narrow)
    without = contacts_of((points, normals, certainty), narrow)
    for name in ("squareness", "certainty", "levers_m", "high_m", "low_m"):
        np.testing.assert_allclose(getattr(with_lining, name), getattr(without, name), rtol=1e-9, err_msg=name)
    mirrored = [sheet(p * (1, -1, 1), -n[0, 1], c[0]) for p, n, c in ((points, normals, certainty), lining, narrow)]
    assert contacts_of(*mirrored).certainty[0] == pytest.approx(0.6)
    assert contacts_of(*mirrored).squareness[0] == pytest.approx(1.0)


def test_squareness_is_the_cosine_of_the_worse_side():
    sine, cosine = np.sin(0.3), np.cos(0.3)
    square = sheet(grid(0.01, 0.01, 0.02), 1.0)
    points = grid(0.01, 0.01, -0.02)
    slanted = points, np.tile([sine, -cosine, 0.0], (len(points), 1)), np.ones(len(points))
    assert contacts_of(square, slanted).squareness[0] == pytest.approx(cosine)
    mirrored = points * (1, -1, 1), np.tile([sine, cosine, 0.0], (len(points), 1)), np.ones(len(points))
    assert contacts_of(mirrored, sheet(points, -1.0)).squareness[0] == pytest.approx(cosine)


def test_a_millimetre_below_the_first_touch_is_still_touched_and_more_is_not():
    front, other = sheet(grid(0.004, 0.004, 0.02), 1.0, 1.0), sheet(grid(0.01, 0.01, -0.02), -1.0, 1.0)
    for depth_m, certainty in ((0.0009, 0.75), (0.0011, 1.0)):
        behind = sheet(grid(0.004, 0.004, 0.02 - depth_m), 1.0, 0.0)
        assert contacts_of(front, behind, other).certainty[0] == pytest.approx(certainty)


def test_what_stands_outside_the_jaws_is_not_touched():
    inner = wide_and_narrow()
    beyond = sheet(grid(0.02, 0.02, 0.031), 1.0, 0.0), sheet(grid(0.02, 0.02, -0.031), -1.0, 0.0)
    without, contacts = contacts_of(*inner), contacts_of(*inner, *beyond)
    for name, array in vars(without).items():
        np.testing.assert_array_equal(getattr(contacts, name), array, err_msg=name)


def test_the_pad_ends_where_the_gripper_s_does():
    inner = wide_and_narrow()
    (x, z), other = GRIPPER.pad.low_high[1, [0, 2]], sheet(grid(0.002, 0.002, 0.02), 1.0, 0.0)
    for shift, touched in ((x - 0.0005, True), (x + 0.0015, False)):
        moved = other[0] + (shift, 0, 0), *other[1:]
        assert (contacts_of(*inner, moved).high_m[0] > 0.015) == touched
    for shift, touched in ((z - 0.0005, True), (z + 0.0015, False)):
        moved = other[0] - (0, 0, shift), *other[1:]
        assert (contacts_of(*inner, moved).high_m[0] > 0.015) == touched


def test_contacts_do_not_depend_on_how_many_poses_are_looked_at_at_once(monkeypatch):
    mesh = trimesh.creation.cone(0.03, 0.08, sections=32)
    points, normals, _ = sample_surface(mesh, 800, np.random.default_rng(0))
    poses = np.stack([make_T(rotation_about((0, 0, 1), a), (0, 0, 0.01 * a)) for a in np.linspace(0, 5, 11)])
    weights = np.random.default_rng(1).uniform(size=800)
    boxes = np.full(11, 0.08)

    def found():
        return find_contacts(poses, boxes, points, normals, weights, gripper=GRIPPER, friction=0.5)

    whole = found()
    assert np.isfinite(whole.certainty).sum() > 5
    monkeypatch.setattr(contact, "_CHUNK", 1)
    for name, array in vars(found()).items():
        np.testing.assert_array_equal(array, getattr(whole, name), err_msg=name)
    monkeypatch.setattr(clearance, "_CHUNK", 1)
    one_by_one = clearance_around(poses, boxes, points, gripper=GRIPPER, standoff_m=0.1)
    monkeypatch.undo()
    np.testing.assert_array_equal(one_by_one, clearance_around(poses, boxes, points, gripper=GRIPPER, standoff_m=0.1))


def test_grasps_that_touch_nothing_on_one_side_are_nan_throughout():
    contacts = contacts_of(sheet(grid(0.01, 0.01, 0.02), 1.0))
    assert all(np.isnan(array).all() for array in vars(contacts).values())
    two = replace(contacts)
    assert len(two.take(np.array([False])).low_m) == 0


# What a grasp carries


def load_of(T, levers, *, friction=0.5, sway=0.0, up=UP, centre=(0, 0, 0)):
    levers = np.diag(levers) if np.ndim(levers) == 1 else levers
    return float(load_ratio(T[None], levers[None], np.asarray(centre), up, friction=friction, sway=sway)[0])


def by_hand(T, levers, *, friction, sway, up, centre, num=8):
    """The limit surface, pull by pull, in the world's frame."""
    x, y, z = T[:3, :3].T
    arm = centre - T[:3, 3]
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    needed = []
    for turn in 2 * np.pi * np.arange(num) / num:
        pull = sway * (np.cos(turn) * side + np.sin(turn) * np.cross(up, side)) - up
        torque = np.cross(arm, pull)
        slide = np.sqrt((pull @ x) ** 2 + (pull @ z) ** 2)
        turns = [2 * friction * (torque @ axis) / lever for axis, lever in zip((x, y, z), levers, strict=True)]
        needed.append(np.sqrt(slide**2 + np.sum(np.square(turns))))
    return 1 / max(1.0, *needed)


@pytest.mark.parametrize("seed", range(8))
def test_the_load_ratio_is_that_of_the_limit_surface_in_any_pose(seed):
    rng = np.random.default_rng(seed)
    up = rotation_about(rng.normal(size=3), 0.4) @ UP
    T = make_T(rotation_about(rng.normal(size=3), rng.uniform(0.5, 2.5)), rng.normal(size=3) / 10)
    levers, centre = rng.uniform(0.005, 0.04, 3), rng.normal(size=3) / 10
    known = by_hand(T, levers, friction=0.35, sway=0.25, up=up, centre=centre)
    assert 0 < known < 1
    assert load_of(T, levers, friction=0.35, sway=0.25, up=up, centre=centre) == pytest.approx(known, rel=1e-9)


def test_a_weight_along_the_closing_axis_is_borne_by_the_jaws_themselves():
    upright = make_T(rotation_about((1, 0, 0), np.pi / 2))  # closes along the world's z
    assert load_of(upright, (0.01, 0.01, 0.01)) == 1.0
    # With a sway of less than 1 it is still the whole load and never more.
    assert load_of(upright, (0.01, 0.01, 0.01), sway=0.5) == 1.0


def test_a_pad_that_resists_no_turn_at_all_carries_little_and_not_nan():
    beside = make_T(rotation_about((1, 0, 0), np.pi), (0.05, 0, 0))
    share = load_of(beside, (0.0, 0.0, 0.0))
    assert share == pytest.approx(1 / np.hypot(1, 2 * 0.5 * 0.05 / 1e-4))
    assert load_of(make_T(rotation_about((1, 0, 0), np.pi)), (0.0, 0.0, 0.0)) == 1.0


def test_the_weight_that_a_grasp_bears_is_what_friction_holds_between_the_pads_and_less_beside_them():
    """A block 60 by 40 by 100 mm, taken across its 40 mm at the middle, and 15 mm beside it."""
    block = trimesh.creation.box((0.06, 0.04, 0.1)).apply_translation((0.3, 0.1, 0.05))
    detection = SimpleNamespace(support=SupportPlane(UP, 0.0), up=UP)
    completion: Any = SimpleNamespace(mesh=block, detection=detection, observed=np.ones(8, bool), sigma_m=np.zeros(8))
    down = np.diag([1.0, -1.0, -1.0])
    grasps = [Grasp(make_T(down, (0.3 + beside, 0.1, 0.05)), 0.06) for beside in (0.0, 0.015)]
    borne = plan.bearable_weight(completion, grasps, friction=0.7, grip_n=30.0)
    spread = np.linalg.norm((GRIPPER.pad.low_high[1] - GRIPPER.pad.low_high[0])[[0, 2]]) / np.sqrt(12)
    held = 2 * 0.7 * 30.0 / np.sqrt(1.09 + np.array([0.0, 0.015 / spread]) ** 2)
    np.testing.assert_allclose(borne, held, rtol=0.05)
    assert borne[1] < 0.7 * borne[0]
    assert plan.bearable_weight(completion, [], friction=0.7, grip_n=30.0).shape == (0,)


# Clearance


def test_clearance_is_that_of_the_swept_boxes_in_any_pose():
    rng = np.random.default_rng(0)
    T = np.stack([make_T(rotation_about(rng.normal(size=3), 1.0 + k), rng.normal(size=3)) for k in range(5)])
    opening = np.linspace(0.0, 0.08, 5)
    local = rng.uniform(-0.15, 0.15, (40, 3))
    for one, width in zip(T, opening, strict=True):
        boxes = GRIPPER.solids(np.array([width]))[0]
        boxes[:, 0, 2] -= 0.07
        outside = np.maximum(boxes[:, 0] - local[:, None], local[:, None] - boxes[:, 1]).max(axis=2)
        found = clearance_around(one[None], np.array([width]), apply_T(one, local), gripper=GRIPPER, standoff_m=0.07)
        assert found[0] == pytest.approx(outside.min(), abs=1e-6)


def test_the_height_above_a_slanted_support_is_that_of_the_lowest_corner_of_the_whole_approach():
    normal = rotation_about((1, 2, 0), 0.3) @ UP
    support = SupportPlane(normal, 0.05)
    for turn in (0.4, 2.9):  # from above, and from below, where the approach begins lower than it ends
        T = make_T(rotation_about((2, 1, 0.3), turn), (0.1, 0.2, 0.6))
        corners = []
        for low, high in GRIPPER.solids(np.array([0.05]))[0]:
            picks = [np.where(mask, high, low) for mask in np.ndindex(2, 2, 2)]
            corners += [corner + shift for corner in picks for shift in ([0, 0, 0], [0, 0, -0.07])]
        known = (apply_T(T, corners) @ normal).min() - 0.05
        found = height_above(T[None], np.array([0.05]), support, gripper=GRIPPER, standoff_m=0.07)
        assert found[0] == pytest.approx(known, abs=1e-9)


# Closing lines and poses


def prism(profile, depth_m):
    """A convex profile of (x, z) m as a solid of that depth along y."""
    corners = [(x, y, z) for x, z in profile for y in (-depth_m / 2, depth_m / 2)]
    return trimesh.convex.convex_hull(np.array(corners))


def wedge():
    """Two faces at 20 degrees to each other: a closing line square to one meets the other within 20 degrees."""
    half = np.tan(np.deg2rad(10)) * 0.1
    return prism([(-half - 0.01, 0), (half + 0.01, 0), (0.01, 0.1), (-0.01, 0.1)], 0.05)


@pytest.mark.parametrize("friction", [0.1, 0.5])
def test_closing_lines_end_on_the_mesh_within_the_cone_of_both_normals(friction):
    mesh, config = wedge(), GraspConfig(friction=friction, num_rays=2000)
    start, end = cast_closing_lines(mesh, UP, config=config, rng=np.random.default_rng(0))
    assert len(start) > 20
    length = np.linalg.norm(end - start, axis=1)
    assert length.min() > 5e-4
    assert length.max() <= config.max_width_m
    directions = (end - start) / length[:, None]
    for points, outward in ((start, -directions), (end, directions)):
        _, distance, face = trimesh.proximity.closest_point(mesh, points)
        assert distance.max() < 1e-4
        cosine = np.einsum("ij,ij->i", mesh.face_normals[face], outward)
        assert cosine.min() > 1 / np.hypot(1, friction) - 1e-3
        assert cosine.min() < 1 / np.hypot(1, friction) + 0.1  # the cone is used to its edge


def test_a_line_has_to_lie_in_the_cones_of_both_ends():
    """One upright face, and one that leans by 20 degrees: no line is within 6 degrees of both normals."""
    mesh = prism([(-0.02, 0), (0.02 + np.tan(np.deg2rad(20)) * 0.1, 0), (0.02, 0.1), (-0.02, 0.1)], 0.2)
    for friction, found in ((0.1, False), (0.3, True)):
        config = GraspConfig(friction=friction)
        start, end = cast_closing_lines(mesh, UP, config=config, rng=np.random.default_rng(0))
        across = np.abs((end - start)[:, 0]) > 0.03
        assert across.any() == found


@pytest.mark.parametrize(("thickness_m", "found"), [(0.0004, False), (0.0006, True)])
def test_a_sheet_is_pinched_from_half_a_millimetre_on(thickness_m, found):
    sheet = trimesh.creation.box((0.1, thickness_m, 0.1))
    start, _ = cast_closing_lines(sheet, UP, config=GraspConfig(friction=0.1), rng=np.random.default_rng(0))
    assert bool(len(start)) == found


def test_slanted_faces_of_a_wedge_are_met_by_level_lines():
    start, end = cast_closing_lines(wedge(), UP, config=GraspConfig(), rng=np.random.default_rng(0))
    slope = np.abs((end - start)[:, 2]) / np.linalg.norm(end - start, axis=1)
    assert (slope < 1e-6).mean() > 0.2  # a third of the rays are level
    assert (slope > 0.1).mean() > 0.2  # others go along a normal or off it


def test_every_wall_that_a_ray_leaves_is_an_end_of_a_closing_line():
    """A square tube: pinched by one wall of 3 mm, or across all of it, 50 mm."""
    outer, inner = trimesh.creation.box((0.05, 0.05, 0.1)), trimesh.creation.box((0.044, 0.044, 0.2))
    tube = trimesh.boolean.difference([outer, inner])
    start, end = cast_closing_lines(tube, UP, config=GraspConfig(friction=0.05), rng=np.random.default_rng(0))
    length = np.linalg.norm(end - start, axis=1)
    thin, whole = np.abs(length - 0.003) < 2e-4, np.abs(length - 0.05) < 1e-3
    assert thin.mean() > 0.2
    across_the_hollow = whole & (np.abs((start + end)[:, :2] / 2).max(axis=1) < 0.02)
    assert across_the_hollow.mean() > 0.1
    assert (thin | whole | (np.abs(length - 0.047) < 1e-3)).all()


def test_closing_lines_are_spread_over_a_neck_as_well_as_a_belly():
    neck = trimesh.creation.cylinder(0.004, 0.03, sections=24)
    neck.apply_translation((0, 0, 0.115))
    belly = trimesh.creation.cylinder(0.03, 0.1, sections=48)
    belly.apply_translation((0, 0, 0.05))
    bottle = trimesh.boolean.union([belly, neck])
    start, end = cast_closing_lines(bottle, UP, config=GraspConfig(num_lines=100), rng=np.random.default_rng(0))
    assert len(start) <= 100
    on_neck = (start[:, 2] > 0.1) & (np.linalg.norm(end - start, axis=1) < 0.01)
    area_share = 2 * 0.004 * 0.03 / (2 * 0.03 * 0.1)
    assert on_neck.mean() > 2 * area_share


def test_poses_close_along_their_line_from_all_sides_but_below():
    start, end = np.array([[0.1, 0.2, 0.3]]), np.array([[0.12, 0.23, 0.31]])
    up = rotation_about((1, 0, 0), 0.2) @ UP
    config = GraspConfig(num_directions=36, max_climb=0.1)
    T, width, at_tip = poses_about(start, end, up, config=config)
    line = (end - start)[0]
    np.testing.assert_allclose(width, np.linalg.norm(line))
    np.testing.assert_allclose(T[:, :3, 1], np.tile(line / np.linalg.norm(line), (len(T), 1)))
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0)
    approach = T[:, :3, 2]
    assert (approach @ up).max() <= 0.1 + 1e-12
    assert (approach @ up).max() > -0.1  # level approaches are among them
    steepest = -up - (-up @ T[0, :3, 1]) * T[0, :3, 1]
    steepest /= np.linalg.norm(steepest)
    assert (approach @ steepest).max() == pytest.approx(1.0)  # the first direction comes as straight down as may be
    middle = (start + end)[0] / 2
    np.testing.assert_allclose(T[~at_tip, :3, 3], np.tile(middle, ((~at_tip).sum(), 1)))
    np.testing.assert_allclose(T[at_tip, :3, 3], middle - config.tip_offset_m * approach[at_tip])
    assert at_tip.sum() == (~at_tip).sum() >= 18


def test_a_line_that_is_upright_has_level_poses_about_it():
    T, _, _ = poses_about(np.zeros((1, 3)), np.array([[0, 0, 0.05]]), UP, config=GraspConfig(num_directions=4))
    np.testing.assert_allclose(T[:, :3, 2] @ UP, 0.0, atol=1e-12)
    assert len(T) == 8
    assert np.isfinite(T).all()
    np.testing.assert_allclose(plan._across(np.eye(3), np.ones(3)) @ np.ones(3), np.full(3, np.sqrt(2)))


# Surface, obstacles, visibility


@dataclass(frozen=True)
class Completed:
    mesh: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    observed: np.ndarray
    sigma_m: np.ndarray
    detection: Detection


def completion_of(
    mesh, *, observed: Any = True, sigma_m: Any = 0.0, support=None, view=None, mask=None, viewpoint=None, parts=()
):
    points = np.asarray(mesh.vertices)
    box = OrientedBox(np.eye(4), np.ptp(points, axis=0))
    cloud = PointCloud(points, viewpoint)
    detection = Detection(cloud, UP, support, "", {}, box, view=view, mask=mask)
    seen = np.broadcast_to(observed, (len(points),))
    return Completed(mesh, tuple(parts), seen, np.broadcast_to(sigma_m, (len(points),)), detection)


def test_a_point_is_as_certain_as_the_corners_of_its_face():
    mesh = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], process=False)
    completion = completion_of(mesh, observed=np.array([True, False, False]), sigma_m=np.array([9.0, 0.01, 0.02]))
    surface = surface_of(completion, GraspConfig(doubt_length_m=0.01), np.random.default_rng(0))
    assert surface.certainty == pytest.approx(np.full(4000, (1 + np.exp(-1) + np.exp(-2)) / 3))
    unknown = replace(completion, sigma_m=np.full(3, np.nan))
    surface = surface_of(unknown, GraspConfig(), np.random.default_rng(0))
    assert surface.certainty == pytest.approx(np.full(4000, 1 / 3))
    trusting = surface_of(unknown, GraspConfig(doubt_length_m=np.inf), np.random.default_rng(0))
    assert (trusting.certainty == 1).all()


def test_obstacles_are_the_surface_the_parts_with_their_corners_and_what_stands_about():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    mesh.apply_translation((0, 0, 0.05))
    part = trimesh.creation.icosphere(radius=0.01)
    part.apply_translation((0.2, 0, 0.1))
    eye = make_T(np.diag([1.0, -1.0, -1.0]), (0, 0, 1.0))  # looks straight down from 1 m
    K = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    depth = np.ones((100, 100), dtype=np.float32)  # the table
    depth[45:55, 45:55] = 0.9  # the object
    depth[45:55, 75:80] = 0.92  # a neighbour, about 25 cm away along x
    depth[45:55, 95:99] = 0.92  # another, about 43 cm away: out of reach
    depth[80:84, 45:55] = 0.995  # too low to tell from the table
    mask = np.zeros((100, 100), dtype=bool)
    mask[45:55, 45:55] = True
    view = DepthImage(depth, K, eye)
    support = SupportPlane(UP, 0.0)
    completion = completion_of(mesh, support=support, view=view, mask=mask, parts=(part,))
    config, rng = GraspConfig(num_points=200), np.random.default_rng(0)
    surface = surface_of(completion, config, rng)
    obstacle = obstacle_of(completion, surface, config, rng)
    rows = {tuple(row) for row in obstacle.round(9)}
    assert {tuple(row) for row in surface.points.round(9)} <= rows
    assert {tuple(row) for row in np.asarray(part.vertices).round(9)} <= rows
    on_part = np.abs(np.linalg.norm(obstacle - (0.2, 0, 0.1), axis=1) - 0.01) < 1e-3
    assert on_part.sum() == 100 + len(part.vertices)
    beside = obstacle[(np.abs(obstacle[:, 2] - 0.08) < 1e-6) & (obstacle[:, 0] > 0.22)]
    assert len(beside) == 50
    assert np.abs(beside[:, 0] - 0.25).max() < 0.05
    assert len(obstacle) == 200 + 100 + len(part.vertices) + 50
    alone = replace(completion, detection=replace(completion.detection, view=None, mask=None))
    assert len(obstacle_of(alone, surface, config, rng)) == len(obstacle) - 50
    unsupported = replace(completion, detection=replace(completion.detection, support=None))
    assert len(obstacle_of(unsupported, surface, config, rng)) == len(obstacle) - 50


def test_what_was_seen_and_not_completed_is_kept_clear_of_but_strays_are_not():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    rng = np.random.default_rng(2)
    clump = (0.05, 0.0, 0.01) + 0.002 * rng.uniform(-1, 1, (8, 3))
    fewer = (-0.05, 0.0, 0.01) + 0.002 * rng.uniform(-1, 1, (7, 3))
    near = (0.0, 0.028, 0.0) + 0.002 * rng.uniform(-1, 1, (20, 3))
    completion = completion_of(mesh)
    cloud = PointCloud(np.concatenate([near, clump, fewer]))
    completion = replace(completion, detection=replace(completion.detection, cloud=cloud))
    config = GraspConfig(num_points=2000)
    surface = surface_of(completion, config, rng)
    obstacle = obstacle_of(completion, surface, config, rng)
    off = obstacle[np.abs(obstacle[:, 0]) > 0.021]
    assert {tuple(row) for row in off.round(9)} == {tuple(row) for row in clump.round(9)}
    assert len(obstacle) == len(surface.points) + 8


def test_samples_of_parts_are_shared_out_by_area():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    small, large = trimesh.creation.icosphere(radius=0.01), trimesh.creation.icosphere(radius=0.03)
    small.apply_translation((1, 0, 0))
    large.apply_translation((-1, 0, 0))
    completion = completion_of(mesh, parts=(small, large))
    config, rng = GraspConfig(num_points=400), np.random.default_rng(0)
    x = obstacle_of(completion, surface_of(completion, config, rng), config, rng)[:, 0]
    corners = len(small.vertices)
    assert ((x > 0.5).sum() - corners, (x < -0.5).sum() - corners) == (21, 180)  # each rounded up


def test_the_hidden_share_counts_eight_places_in_each_box_of_the_jaws():
    """A plate hides exactly one jaw of two from a camera behind it."""
    plate = trimesh.creation.box((0.3, 0.001, 0.3))
    T = make_T(rotation_about((0, 0, 1), 0.3) @ rotation_about((1, 0, 0), 0.2), (0.4, 0.1, 0.0))
    plate.apply_transform(T)
    eye = apply_T(T, np.array([[0.01, 0.5, 0.02]]))[0]
    assert hidden_share(T[None], np.array([0.06]), plate, eye, GRIPPER)[0] == pytest.approx(0.5)
    both = make_T(T[:3, :3], apply_T(T, np.array([[0, -0.2, 0.0]]))[0])
    before = make_T(T[:3, :3], apply_T(T, np.array([[0, 0.2, 0.0]]))[0])
    shares = hidden_share(np.stack([both, before]), np.full(2, 0.06), plate, eye, GRIPPER)
    np.testing.assert_array_equal(shares, [1.0, 0.0])


def test_places_are_three_fifths_of_the_way_to_the_corners_of_the_boxes():
    """Two boxes a jaw, 20 mm wide along x: a plate that hides all beyond 5 mm, or beyond 7 mm, of a far camera."""
    opening, eye = np.array([0.06]), np.array([0.0, 1000.0, 0.0])
    for inner_m, share in ((0.005, 0.5), (0.007, 0.0)):
        plate = trimesh.creation.box(bounds=[[inner_m, 0.2, -0.3], [0.3, 0.201, 0.3]])
        assert hidden_share(np.eye(4)[None], opening, plate, eye, GRIPPER)[0] == pytest.approx(share)


# How the terms make a rank


def block(width_m=0.04):
    mesh = trimesh.creation.box(bounds=[[-0.03, -width_m / 2, 0.0], [0.03, width_m / 2, 0.12]])
    return mesh.subdivide().subdivide()


DOWN = make_T(rotation_about((1, 0, 0), np.pi), (0, 0, 0.1))  # onto the block, jaws along y
LEVEL = make_T(np.column_stack([(0, 0, -1.0), (0, 1.0, 0), (1.0, 0, 0)]), (0.0, 0, 0.06))  # from -x


def quality_at(T, mesh=None, *, at_tip=False, obstacle=None, support_m=0.0, config=None, **seen):
    """Quality of one pose on a block, and its parts."""
    mesh, config = block() if mesh is None else mesh, config or GraspConfig(sway=0.3)
    completion, support = completion_of(mesh, **seen), SupportPlane(UP, support_m)
    surface = surface_of(completion, config, np.random.default_rng(0))
    poses = plan._Poses(T[None], np.array([0.04]), np.array([at_tip]))
    poses, contacts = plan._close_on(poses, surface, config)
    obstacle = surface.points if obstacle is None else obstacle
    quality = plan._quality(poses, contacts, obstacle, completion, support, config)
    return float(quality[0])


def worth_of(load):
    """A weight that is held three times over is worth little more than one held twice."""
    return 1.3 * load / (load + 0.3)


def test_the_quality_of_a_grasp_is_the_product_of_what_was_said_of_it():
    """Square, seen, roomy, from straight above, through the middle of the pads: only the load is less than whole."""
    far = np.array([[0.0, 0.0, -1.0]])
    reach = 0.024
    levers = (0.5 * 0.04 + reach, 2 * 0.5 * np.hypot(0.020, reach) / np.sqrt(12), 0.5 * 0.04 + 0.020)
    known = load_of(DOWN, levers, sway=0.3, centre=(0, 0, 0.06))
    assert known < 0.95
    assert quality_at(DOWN, obstacle=far) == pytest.approx(worth_of(known), rel=0.03)


def test_the_load_is_weighed_about_the_centre_of_mass_not_of_the_surface():
    """A heavy head on a thin fin: the area's centre is on the fin, the mass's in the head."""
    head = trimesh.creation.box(bounds=[[-0.03, -0.02, 0.0], [0.03, 0.02, 0.12]])
    fin = trimesh.creation.box(bounds=[[0.029, -0.001, 0.0], [0.2, 0.001, 0.12]])
    mesh = trimesh.boolean.union([head, fin]).subdivide()
    assert mesh.center_mass[0] < 0.02 < 0.06 < mesh.centroid[0] + 0.03
    far = np.array([[0.0, 0.0, -1.0]])
    opened = mesh.copy()
    opened.update_faces(np.arange(len(opened.faces)) != 5)
    for shape, centre in ((mesh, mesh.center_mass), (opened, opened.centroid)):
        surface = surface_of(completion_of(shape), GraspConfig(), np.random.default_rng(0))
        touched = surface.points, surface.normals, surface.certainty
        contacts = find_contacts(DOWN[None], np.array([0.06]), *touched, gripper=GRIPPER, friction=0.5)
        known = load_of(DOWN, contacts.levers_m[0], sway=0.3, centre=centre)
        assert quality_at(DOWN, shape, obstacle=far) == pytest.approx(worth_of(known), rel=1e-3)


def test_squareness_falls_from_one_to_nothing_at_the_edge_of_the_cone():
    config = GraspConfig(sway=0.0)  # a weight straight below is the whole load, whatever the patches are
    turned = {angle: make_T(rotation_about(UP, angle) @ DOWN[:3, :3], DOWN[:3, 3]) for angle in (0.2, 0.44, 0.48)}
    far = np.array([[0.0, 0.0, -1.0]])
    cone = 1 / np.hypot(1, 0.5)
    share = (np.cos(0.2) - cone) / (1 - cone)
    assert quality_at(DOWN, obstacle=far, config=config) == pytest.approx(1.0)
    assert quality_at(turned[0.2], obstacle=far, config=config) == pytest.approx(share, rel=1e-3)
    assert 0 < quality_at(turned[0.44], obstacle=far, config=config) < 0.2
    assert quality_at(turned[0.48], obstacle=far, config=config) == 0  # atan 0.5 is 0.4636


@pytest.mark.parametrize(("gap_m", "share"), [(0.001, 0.0), (0.0016, 0.6), (0.004, 0.75), (0.008, 1.0), (0.02, 1.0)])
def test_clearance_is_worth_from_one_half_to_one(gap_m, share):
    """A point beside the left finger, so far from it."""
    outer = 0.05 / 2 + 0.014 + gap_m  # an opening of 60 mm after closing on 40, less 10
    beside = np.array([[0.0, outer + 0.005, 0.1]])
    far = np.array([[0.0, 0.0, -1.0]])
    assert quality_at(DOWN, obstacle=beside) == pytest.approx(share * quality_at(DOWN, obstacle=far), rel=1e-4)


def test_what_comes_too_near_the_support_is_worth_nothing():
    """The pads end 12 mm below the gripper's origin, which is at 100 mm."""
    assert quality_at(DOWN, support_m=0.1 - 0.012 - 0.0041) > 0
    assert quality_at(DOWN, support_m=0.1 - 0.012 - 0.0039) == 0


def test_guessed_surface_is_priced_by_the_share_of_the_contact_that_it_has():
    mesh, sigma_m = block(), 0.007
    guessed = np.exp(-sigma_m / GraspConfig().doubt_length_m)
    seen = np.asarray(mesh.vertices)[:, 1] > 0.01
    guess_left, guess_right = ~(np.asarray(mesh.vertices)[:, 1] > 0.01), ~(np.asarray(mesh.vertices)[:, 1] < -0.01)
    whole = quality_at(DOWN, mesh)
    assert seen.any()
    assert quality_at(DOWN, mesh, observed=~guess_left, sigma_m=sigma_m) == pytest.approx(whole * (1 + guessed) / 2)
    assert quality_at(DOWN, mesh, observed=~guess_right, sigma_m=sigma_m) == pytest.approx(whole * (1 + guessed) / 2)
    assert quality_at(DOWN, mesh, observed=False, sigma_m=sigma_m) == pytest.approx(whole * guessed)
    assert quality_at(DOWN, mesh, observed=False, sigma_m=np.nan) == 0


def test_preferences_scale_the_quality_of_what_they_speak_of():
    config = GraspConfig(side_preference=0.45, tip_preference=0.5)
    even = replace(config, side_preference=1.0, tip_preference=1.0)
    far = {"obstacle": np.array([[0.0, 0.0, -1.0]]), "support_m": -1.0}
    sloped = make_T(rotation_about((0, 1, 0), 0.5) @ DOWN[:3, :3], DOWN[:3, 3])
    for T, share in ((DOWN, 1.0), (LEVEL, 0.45), (sloped, 0.45 + 0.55 * np.cos(0.5))):
        whole = quality_at(T, config=even, **far)
        assert quality_at(T, config=config, **far) == pytest.approx(share * whole)
        assert quality_at(T, at_tip=True, config=config, **far) == pytest.approx(0.5 * share * whole)


def test_jaws_that_the_object_hides_cost_their_preference():
    """From behind one jaw, seen over the block's edge or not at all."""
    for eye in ((0.0, 2.0, 0.05), (0.3, 1.0, 0.3), (0.0, 0.1, 2.0)):
        viewpoint, mesh = np.array(eye), block()
        opening = np.array([0.06])
        hidden = hidden_share(DOWN[None], opening, mesh, viewpoint, GRIPPER)[0]
        whole = quality_at(DOWN, mesh)
        assert quality_at(DOWN, mesh, viewpoint=viewpoint) == pytest.approx(whole * (1 - 0.75 * hidden), rel=1e-6)
        trusting = GraspConfig(sway=0.3, hidden_preference=1.0)
        assert quality_at(DOWN, mesh, viewpoint=viewpoint, config=trusting) == pytest.approx(whole)
    assert hidden_share(DOWN[None], opening, block(), np.array([0.0, 2.0, 0.05]), GRIPPER)[0] > 0.2


def test_poses_are_centred_between_the_first_touches_and_drop_what_is_too_wide():
    """The block stands 13 mm off the pose along its closing axis, which looks along the world's -y."""
    moved = block()
    moved.apply_translation((0, 0.013, 0))
    surface = surface_of(completion_of(moved), GraspConfig(), np.random.default_rng(0))
    poses, contacts = plan._close_on(
        plan._Poses(DOWN[None], np.array([0.06]), np.array([True])), surface, GraspConfig()
    )
    np.testing.assert_allclose(poses.T[0, :3, 3], (0, 0.013, 0.1), atol=1e-9)
    assert poses.width[0] == pytest.approx(0.04)
    assert poses.at_tip[0]
    assert len(contacts.low_m) == 1
    wide = surface_of(completion_of(block(0.077)), GraspConfig(), np.random.default_rng(0))
    assert not len(
        plan._close_on(plan._Poses(DOWN[None], np.array([0.07]), np.array([True])), wide, GraspConfig())[1].low_m
    )
    assert plan._opening(np.array([0.04, 0.065]), GraspConfig()) == pytest.approx([0.06, 0.08])


def test_a_grasp_is_a_duplicate_by_its_place_its_closing_axis_and_its_approach_together():
    first = DOWN

    def turned(about, degrees, shift=(0, 0, 0)):
        return make_T(rotation_about(first[:3, about], np.deg2rad(degrees)) @ first[:3, :3], first[:3, 3] + shift)

    others = {
        "nearby": (turned(0, 0, (0.007, 0, 0)), True),
        "farther": (turned(0, 0, (0, 0.009, 0)), False),
        "turned about its approach by 14": (turned(2, 14), True),
        "turned about its approach by 16": (turned(2, 16), False),
        "turned about its closing axis by 24": (turned(1, 24), True),
        "turned about its closing axis by 26": (turned(1, 26), False),
        "jaws swapped": (turned(2, 180), True),
        "from the other side": (turned(1, 180), False),
    }
    for name, (T, is_duplicate) in others.items():
        chosen = plan._distinct(np.stack([T, first]), np.array([1, 0]), 2)
        assert chosen == ([1] if is_duplicate else [1, 0]), name
    assert plan._distinct(np.stack([DOWN, LEVEL]), np.array([1, 0]), 1) == [1]


def test_near_duplicates_of_a_better_grasp_are_left_out():
    grasps = plan_grasps(completion_of(block(), support=SupportPlane(UP, 0.0)), 200)
    assert len(grasps) > 20
    T = np.stack([grasp.T_world_gripper for grasp in grasps])
    near = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2) < 0.008
    closing = np.abs(T[:, :3, 1] @ T[:, :3, 1].T) > np.cos(np.deg2rad(15))
    approach = T[:, :3, 2] @ T[:, :3, 2].T > np.cos(np.deg2rad(25))
    assert not (near & closing & approach & ~np.eye(len(T), dtype=bool)).any()
    kept_by_one_test = (near & closing) | (near & approach) | (closing & approach)
    assert (kept_by_one_test & ~np.eye(len(T), dtype=bool)).any()  # two of the three alone do not make a duplicate


def test_without_a_support_the_object_stands_on_its_lowest_point():
    raised = block()
    raised.apply_translation((0, 0, 0.4))
    for grasp in plan_grasps(completion_of(raised), 16):
        T, opening = grasp.T_world_gripper[None], np.array([grasp.width_m])
        sweep = {"gripper": GRIPPER, "standoff_m": GraspConfig().standoff_m}
        assert height_above(T, opening, SupportPlane(UP, 0.4), **sweep)[0] >= GraspConfig().table_clearance_m - 1e-9
