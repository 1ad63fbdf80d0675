"""What the pads of a gripper touch on faces known by hand, how sure that is, and what the grasp carries."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from grasped_bodies import GRIPPER, UP, completion_of, load_of

from gfp_grasp.grasps import GraspConfig, clearance, contact, plan
from gfp_grasp.grasps.clearance import clearance_around
from gfp_grasp.grasps.contact import Contacts, find_contacts, surface_of
from gfp_grasp.meshes import sample_surface
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import Grasp, SupportPlane

TILTED = make_T(rotation_about((1, -2, 0.5), 0.8), (0.3, -0.1, 0.2))


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


# What a grasp carries


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
