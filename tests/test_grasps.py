"""The planner on shapes whose good grasps are known."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps import Box, GraspConfig, Gripper, get_planner, plan_grasps, plan_top_down
from gfp_grasp.grasps.clearance import clearance_around, height_above, hidden_share
from gfp_grasp.grasps.contact import find_contacts, load_ratio
from gfp_grasp.meshes import load_mesh, sample_surface
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import Detection, OrientedBox, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Completed:
    """What the planner needs of a completion."""

    mesh: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    observed: np.ndarray
    sigma_m: np.ndarray
    detection: Detection


def completion_of(mesh, *, observed=True, sigma_m=0.0, support=None, up=UP):
    """A completion around a mesh."""
    points = np.asarray(mesh.vertices)
    box = OrientedBox(np.eye(4), np.ptp(points, axis=0))
    detection = Detection(PointCloud(points), up, support, "cup", {"cup": 1.0}, box)
    seen = np.broadcast_to(observed, (len(points),))
    parts = (mesh.convex_hull,) if mesh.is_convex else ()
    return Completed(mesh, parts, seen, np.full(len(points), sigma_m), detection)


def cylinder(radius_m=0.03, height_m=0.12):
    mesh = trimesh.creation.cylinder(radius_m, height_m, sections=64)
    mesh.apply_translation((0, 0, height_m / 2))
    return mesh


def cup(radius_m=0.05, wall_m=0.003, height_m=0.1):
    profile = [
        (0, 0),
        (radius_m, 0),
        (radius_m, height_m),
        (radius_m - wall_m, height_m),
        (radius_m - wall_m, wall_m),
        (0, wall_m),
    ]
    return trimesh.creation.revolve(profile, sections=64)


def test_a_cylinder_is_pinched_across_its_axis():
    grasps = plan_grasps(completion_of(cylinder()), num=8)
    assert len(grasps) == 8
    for grasp in grasps:
        T = grasp.T_world_gripper
        assert abs(T[2, 1]) < 0.2  # the closing axis is level
        assert abs(np.cross(T[:3, 3], T[:3, 1])[2]) < 0.006  # and crosses the cylinder's
        assert 0.060 < grasp.width_m <= 0.080


def test_jaws_behind_the_object_are_hidden_and_those_beside_it_are_not():
    mesh, viewpoint = cylinder(), np.array([0.6, 0.0, 0.06])
    R = np.column_stack([(0.0, 1.0, 0), (1.0, 0, 0), (0, 0, -1.0)])  # straight down, jaws along x
    beside = np.column_stack([(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)])  # along y
    T = np.stack([make_T(R, (0, 0, 0.08)), make_T(beside, (0, 0, 0.08)), make_T(beside, (0.2, 0, 0.08))])
    hidden = hidden_share(T, np.full(3, 0.07), mesh, viewpoint, Gripper())
    assert 0.25 < hidden[0] <= 0.5  # one jaw of two, but for what looks out above
    assert hidden[1] < 0.1
    assert hidden[2] == 0


def test_no_pose_has_no_share_and_what_is_too_wide_has_no_grasp_from_where_it_was_seen():
    wide = cylinder(radius_m=0.09)
    assert hidden_share(np.empty((0, 4, 4)), np.empty(0), wide, np.ones(3), Gripper()).shape == (0,)
    completion = completion_of(wide)
    cloud = PointCloud(np.asarray(wide.vertices), np.array([0.6, 0, 0.4]))
    seen = replace(completion, detection=replace(completion.detection, cloud=cloud))
    assert plan_grasps(seen) == ()


def test_the_deeper_a_jaw_is_in_an_unseen_hollow_the_more_of_it_is_hidden():
    R = np.column_stack([(0.0, 1.0, 0), (1.0, 0, 0), (0, 0, -1.0)])
    poses = np.stack([make_T(R, (0, 0, height)) for height in (0.04, 0.06, 0.20)])
    deep, less, above = hidden_share(poses, np.full(3, 0.04), cup(), np.array([0.3, 0, 0.6]), Gripper())
    assert deep > less > above == 0


def test_a_cup_too_wide_for_the_jaws_is_pinched_by_its_wall():
    grasps = plan_grasps(completion_of(cup()), num=8)
    assert len(grasps) == 8
    for grasp in grasps:
        assert grasp.width_m == pytest.approx(0.003 + 0.020, abs=0.002)
        assert grasp.T_world_gripper[2, 3] > 0.05  # as deep as the fingers are long
        assert grasp.T_world_gripper[2, 2] < -0.8  # from above


def test_from_above_a_block_is_taken_across_its_narrow_side():
    block = trimesh.creation.box(bounds=[[-0.06, -0.02, 0], [0.06, 0.02, 0.1]]).subdivide().subdivide()
    support = SupportPlane(UP, 0.0)
    best, *others = plan_top_down(completion_of(block, support=support), 4)
    np.testing.assert_allclose(best.T_world_gripper[:3, 2], -UP, atol=1e-9)
    assert abs(best.T_world_gripper[1, 1]) > 0.999
    assert best.width_m == pytest.approx(0.06, abs=2e-3)
    assert best.T_world_gripper[2, 3] == pytest.approx(0.08, abs=1e-3)
    assert all(other.quality < best.quality for other in others)


def test_from_above_the_gripper_comes_over_the_middle_of_what_was_seen_in_any_frame():
    """A block off the origin, turned, on a slanted support: seen to 40 mm of its narrow side."""
    T = make_T(rotation_about((1, 2, 0.5), 0.6), (0.3, -0.2, 0.1))
    block = trimesh.creation.box(bounds=[[0.01, 0.05, 0], [0.13, 0.09, 0.1]])
    block = block.subdivide().subdivide().apply_transform(T)
    support = SupportPlane(T[:3, 2], float(T[:3, 2] @ T[:3, 3]))
    best = plan_top_down(completion_of(block, support=support, up=T[:3, 2]), 1)[0]
    found = np.linalg.inv(T) @ best.T_world_gripper
    np.testing.assert_allclose(found[:3, 3], (0.07, 0.07, 0.08), atol=1e-3)
    np.testing.assert_allclose(np.abs(found[:3, 1]), (0, 1, 0), atol=1e-6)
    np.testing.assert_allclose(found[:3, 2], (0, 0, -1), atol=1e-9)
    assert best.quality == pytest.approx(1 - 0.04 / 0.08, abs=0.01)


def test_from_above_nothing_is_taken_that_is_wider_than_the_jaws_and_no_pad_meets_the_table():
    assert plan_top_down(completion_of(cup())) == ()
    low = cylinder(height_m=0.01)
    for grasp in plan_top_down(completion_of(low, support=SupportPlane(UP, 0.0))):
        T, opening = grasp.T_world_gripper[None], np.array([grasp.width_m])
        config = GraspConfig()
        sweep = {"gripper": config.gripper, "standoff_m": config.standoff_m}
        assert height_above(T, opening, SupportPlane(UP, 0.0), **sweep)[0] > 0.003


def test_planners_go_by_name():
    assert get_planner("antipodal") is plan_grasps
    assert get_planner("top-down") is plan_top_down
    assert get_planner("gfp_grasp.grasps.planners:plan_top_down") is plan_top_down


@pytest.mark.parametrize("plan", [plan_grasps, plan_top_down])
def test_a_plan_of_less_than_one_grasp_is_refused(plan):
    with pytest.raises(InvalidOption, match="num is 0"):
        plan(completion_of(cylinder()), 0)


def test_grasps_are_rigid_and_ranked():
    grasps = plan_grasps(completion_of(cylinder()), num=16)
    qualities = [grasp.quality for grasp in grasps]
    assert qualities == sorted(qualities, reverse=True)
    assert all(0 < quality <= 1 for quality in qualities)
    for grasp in grasps:
        R = grasp.T_world_gripper[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_grasps_and_another_seed_does_not():
    first, again, other = (plan_grasps(completion_of(cup()), seed=seed) for seed in (3, 3, 4))
    assert all(np.array_equal(a.T_world_gripper, b.T_world_gripper) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].T_world_gripper, other[0].T_world_gripper)


@pytest.mark.parametrize(
    "mesh", [cylinder(), cup(), trimesh.creation.box((0.05, 0.06, 0.1))], ids=["cylinder", "cup", "box"]
)
def test_no_grasp_touches_object_or_support_on_its_way_in(mesh):
    mesh = mesh.copy()
    mesh.apply_translation((0, 0, -mesh.bounds[0, 2]))
    config = GraspConfig()
    fresh = sample_surface(mesh, 20_000, np.random.default_rng(99))[0]
    support = SupportPlane(UP, 0.0)
    for grasp in plan_grasps(completion_of(mesh, support=support)):
        pose, opening = grasp.T_world_gripper[None], np.array([grasp.width_m])
        sweep = {"gripper": config.gripper, "standoff_m": config.standoff_m}
        assert clearance_around(pose, opening, fresh, **sweep)[0] > -0.001
        assert height_above(pose, opening, support, **sweep)[0] >= config.table_clearance_m


def test_no_grasp_comes_from_below_a_slanted_support():
    R = rotation_about((1, 0, 0), 0.4)
    mesh = cylinder()
    mesh.apply_transform(make_T(R, (0.1, 0.2, 0.3)))
    up = R @ UP
    grasps = plan_grasps(completion_of(mesh, support=SupportPlane(up, float(up @ (0.1, 0.2, 0.3))), up=up))
    assert grasps
    assert all(grasp.T_world_gripper[:3, 2] @ up <= 0.1 + 1e-9 for grasp in grasps)


def test_an_object_wider_than_the_stroke_has_no_grasp():
    assert plan_grasps(completion_of(trimesh.creation.icosphere(radius=0.06))) == ()


@pytest.mark.parametrize(
    "mesh",
    [
        trimesh.Trimesh([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]], [[0, 1, 2]], process=False),
        trimesh.Trimesh([[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0], [0, 0, 0.05]], [[0, 1, 2], [0, 3, 1]], process=False),
        trimesh.creation.box((0.05, 0.05, 1e-5)),
    ],
    ids=["one face", "two faces", "a sheet"],
)
def test_hostile_meshes_have_no_grasp_and_do_no_harm(mesh):
    assert plan_grasps(completion_of(mesh)) == ()


def test_guessed_surface_lowers_quality():
    seen = plan_grasps(completion_of(cylinder()))[0]
    guessed = plan_grasps(completion_of(cylinder(), observed=False, sigma_m=0.01))[0]
    assert guessed.quality == pytest.approx(seen.quality * np.exp(-1), rel=0.05)


@pytest.mark.parametrize(
    "knob", [{"friction": 0.0}, {"num_rays": -1}, {"min_jaw_clearance_m": 0.05}, {"max_climb": 2.0}]
)
def test_a_nonsense_config_is_refused(knob):
    with pytest.raises(InvalidOption, match=next(iter(knob))):
        GraspConfig(**knob)


def test_contacts_of_a_box_are_its_faces():
    mesh = trimesh.creation.box((0.03, 0.04, 0.05))
    points, normals, _ = sample_surface(mesh, 5000, np.random.default_rng(0))
    poses = np.eye(4)[None]
    contacts = find_contacts(
        poses, np.array([0.06]), points, normals, np.full(5000, 0.5), gripper=Gripper(), friction=0.5
    )
    assert contacts.low_m[0] == pytest.approx(-0.02, abs=1e-6)
    assert contacts.high_m[0] == pytest.approx(0.02, abs=1e-6)
    assert contacts.squareness[0] == pytest.approx(1.0)
    assert contacts.certainty[0] == pytest.approx(0.5)
    # A pad of 20 by 24 mm on a flat face twists on a radius of sqrt(20^2 + 24^2) / sqrt(12) mm.
    about_y = 2 * 0.5 * np.hypot(0.020, 0.024) / np.sqrt(12)
    # Turns about x and z are resisted by friction over 40 mm and by the length and the width of the pad.
    about_x, about_z = 0.5 * 0.04 + 0.024, 0.5 * 0.04 + 0.020
    np.testing.assert_allclose(contacts.levers_m[0], np.diag([about_x, about_y, about_z]), rtol=0.05, atol=2.5e-3)


def test_room_is_the_gap_to_the_nearest_box_and_moves_with_the_gripper():
    gripper = Gripper()
    point = np.array([[0.0, 0.0, 0.0]])  # midway between the pads
    T = make_T(rotation_about((1, 2, 3), 1.0), (0.3, -0.2, 0.5))
    room = clearance_around(T[None], np.array([0.06]), apply_T(T, point), gripper=gripper, standoff_m=0.1)
    assert room[0] == pytest.approx(0.03, abs=1e-6)
    inside = apply_T(T, np.array([[0.0, 0.034, 0.0]]))  # behind a pad 6 mm thick
    assert clearance_around(T[None], np.array([0.06]), inside, gripper=gripper, standoff_m=0.1)[0] < 0


def test_a_jaw_in_one_box_has_the_room_of_its_boxes():
    rng = np.random.default_rng(0)
    gripper, opening, T = Gripper(), np.linspace(0.01, 0.08, 8), np.tile(np.eye(4), (8, 1, 1))
    boxes = gripper.solids(opening)
    assert gripper.swept(opening, 0.1).shape[1] < boxes.shape[1]
    boxes[:, :, 0, 2] -= 0.1
    for point in rng.uniform(-0.2, 0.2, (200, 3)):
        gap = np.maximum(boxes[:, :, 0] - point, point - boxes[:, :, 1]).max(axis=2).min(axis=1)
        room = clearance_around(T, opening, point[None], gripper=gripper, standoff_m=0.1)
        np.testing.assert_allclose(room, gap, atol=1e-7)


def test_a_grasp_at_the_centre_of_mass_carries_most_and_one_beside_it_less():
    down = np.column_stack([(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)])
    T = np.stack([make_T(down, place) for place in ((0, 0, 0), (0.05, 0, 0), (0.1, 0, 0), (0, 0, 0.1))])
    levers = np.tile(0.02 * np.eye(3), (4, 1, 1))
    share = load_ratio(T, levers, np.zeros(3), np.array([0.0, 0, 1]), friction=0.5, sway=0.3)
    assert share[0] == pytest.approx(1 / np.hypot(1, 0.3), rel=1e-3)
    assert share[0] > share[1] > share[2] > 0
    # Hung 10 cm below the jaws, only the sway has a lever: 2 mu 0.3 * 0.1 m / 0.02 m.
    assert share[3] == pytest.approx(1 / np.sqrt(1 + 0.3**2 + 1.5**2))
    level = load_ratio(T, levers, np.zeros(3), np.array([0.0, 0, 1]), friction=0.5, sway=0.0)
    assert level[3] == pytest.approx(1.0)
    assert level[1] == pytest.approx(1 / np.hypot(1, 0.05 / 0.02))


def test_each_lever_resists_the_turn_about_its_own_axis():
    """Jaws from above, closing along the world's -y: a weight beside them along x turns them about the closing axis."""
    down = np.column_stack([(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)])
    up = np.array([0.0, 0, 1])

    def share(levers, place=(0, 0, 0)):
        T = make_T(down, place)[None]
        return load_ratio(T, np.diag(levers)[None], np.zeros(3), up, friction=0.5, sway=0.0)[0]

    along_x, along_y = (share((0.01, 0.02, 0.04), place) for place in ((0.05, 0, 0), (0, 0.05, 0)))
    assert along_x == pytest.approx(1 / np.hypot(1, 0.05 / 0.02))
    assert along_y == pytest.approx(1 / np.hypot(1, 0.05 / 0.01))
    assert np.isnan(share((np.nan, np.nan, np.nan)))


def test_the_widest_object_leaves_two_millimetres_to_either_jaw():
    assert GraspConfig().max_width_m == pytest.approx(0.076)
    assert GraspConfig(min_jaw_clearance_m=0.005).max_width_m == pytest.approx(0.070)


@pytest.mark.parametrize("knob", [{"sway": -0.1}, {"side_preference": 3.0}, {"sway": float("inf")}])
def test_a_share_that_is_none_is_refused(knob):
    with pytest.raises(InvalidOption, match=next(iter(knob))):
        GraspConfig(**knob)


def test_a_part_without_area_and_a_sigma_that_is_not_known_do_not_end_planning():
    known = completion_of(cylinder())
    flat = trimesh.Trimesh([(0, 0, 0), (0.01, 0, 0), (0.02, 0, 0)], [(0, 1, 2)], process=False)
    assert len(plan_grasps(replace(known, parts=(*known.parts, flat)), 4)) == 4
    unknown = np.full(len(known.mesh.vertices), np.nan)
    assert len(plan_grasps(replace(known, sigma_m=unknown), 4)) == 4


def test_jaws_that_reach_beyond_the_body_stay_two_boxes():
    for gripper, opening, place in (
        (Gripper(stroke_m=0.2), 0.16, (0, 0.083, -0.13)),
        (Gripper(body=(Box((0, 0, -0.085), (0.03, 0.02, 0.03)),)), 0.06, (0, 0.033, -0.13)),
    ):
        room = clearance_around(
            np.eye(4)[None], np.array([opening]), np.array([place]), gripper=gripper, standoff_m=0.1
        )
        assert room[0] == pytest.approx(0.003, abs=1e-6)


def test_nothing_between_the_pads_is_no_contact():
    nowhere = find_contacts(
        np.eye(4)[None],
        np.array([0.06]),
        np.full((1, 3), 9.0),
        np.eye(3)[:1],
        np.ones(1),
        gripper=Gripper(),
        friction=0.5,
    )
    nobody = find_contacts(
        np.empty((0, 4, 4)), np.empty(0), np.zeros((1, 3)), np.eye(3)[:1], np.ones(1), gripper=Gripper(), friction=0.5
    )
    assert np.isnan(nowhere.low_m).all()
    assert nowhere.levers_m.shape == (1, 3, 3)
    assert len(nobody.low_m) == 0


@pytest.mark.parametrize("knob", [0.0, 0.08])
def test_the_boxes_of_both_jaws_mirror_each_other(knob):
    gripper = Gripper()
    boxes = gripper.solids(np.array([knob]))[0]
    num = len(gripper.jaw)
    np.testing.assert_allclose(boxes[:num, 0, 1], -boxes[num : 2 * num, 1, 1])
    np.testing.assert_allclose(boxes[:num, :, [0, 2]], boxes[num : 2 * num][:, :, [0, 2]])
    assert boxes[:num, 0, 1].min() == pytest.approx(knob / 2)


@pytest.mark.parametrize("name", ["bottle__fuze_bottle", "cup__gso_red_cup", "mug__ycb_025_mug", "cup__plastic_glass"])
def test_real_scans_can_be_grasped(name):
    mesh = load_mesh(real_data.folder() / "meshes" / f"{name}.ply")
    assert len(plan_grasps(completion_of(mesh), num=4)) == 4
