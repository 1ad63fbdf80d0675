"""Which grasps the planner tries, along closing lines of a mesh, and which of them it puts first."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from grasped_bodies import GRIPPER, UP, completion_of, load_of

from gfp_grasp.grasps import GraspConfig, plan, plan_grasps
from gfp_grasp.grasps.clearance import height_above, hidden_share
from gfp_grasp.grasps.contact import find_contacts, surface_of
from gfp_grasp.grasps.plan import cast_closing_lines, poses_about
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import SupportPlane

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
