"""The steps of a trial one by one, with poses and bodies that are not symmetric."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from gfp_grasp.envs import TrialSettings, run_trial, trial
from gfp_grasp.scenes import TARGET, Handles, SceneObject, World, gripper_pose
from gfp_grasp.transforms import invert_T, make_T, rotation_about
from gfp_grasp.types import ConvexPart, Grasp

DOWN = np.column_stack([(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)])
YAWED = rotation_about((0, 0, 1), 0.6) @ DOWN
QUICK = TrialSettings(approach_s=0.2, lift_s=0.3, hold_s=0.1, shake_cycles=1, turn_hz=2.0)


def part_of(mesh):
    return ConvexPart(mesh.vertices, mesh.faces)


def cylinder(radius_m=0.03, height_m=0.12, *, at=(0, 0)):
    mesh = trimesh.creation.cylinder(radius_m, height_m, sections=48)
    mesh.apply_translation((*at, height_m / 2))
    return mesh


@pytest.fixture(scope="module")
def world():
    return World([SceneObject.of_parts((part_of(cylinder()),), 0.2, 0.7)])


@pytest.fixture(scope="module")
def recorded(world):
    """A trial with a yawed gripper: what the gripper did, command by command."""
    grasp, rows = Grasp(make_T(YAWED, (0, 0, 0.09)), 0.075), []

    def record(data):
        T, opening = gripper_pose(world.model, data)
        rows.append((T, opening, world.pose(TARGET), float(data.ctrl[0]), data.time))

    outcome = run_trial(world, grasp, QUICK, on_step=record)
    assert outcome.reason == "held"
    T, opening, target, command, time = (np.array(column) for column in zip(*rows, strict=True))
    s = QUICK
    durations = [s.approach_s, s.close_s, s.lift_s, s.hold_s]
    for _ in range(2):
        durations += [s.shake_cycles / s.shake_hz, 1 / s.turn_hz]
    ends = np.cumsum([round(d / s.control_s) for d in [*durations, s.release_s]])
    names = ("approach", "close", "lift", "hold", "shake_x", "turn_x", "shake_y", "turn_y", "release")
    phases = {name: slice(begin, end) for name, begin, end in zip(names, [0, *ends], ends, strict=False)}
    return SimpleNamespace(
        grasp=grasp, T=T, opening=opening, target=target, command=command, time=time, outcome=outcome, num=ends[-1],
        **phases,
    )  # fmt: skip


def test_a_trial_takes_the_time_that_its_settings_say(recorded):
    assert len(recorded.T) == recorded.num
    np.testing.assert_allclose(np.diff(recorded.time), QUICK.control_s, atol=1e-9)


def test_the_gripper_comes_straight_along_its_own_z_and_gently(world):
    """From the side and from above, tilted in both: the path is on a line, with half of it at half the time."""
    for R in (rotation_about((1, 2, 0.5), 0.4) @ DOWN, rotation_about((0, 1, 0), 1.4)):
        at, positions = np.array([0.2, -0.1, 0.3]), []

        def record(data, positions=positions):
            positions.append(gripper_pose(world.model, data)[0][:3, 3])

        settings = TrialSettings(approach_s=1.0)
        assert run_trial(world, Grasp(make_T(R, at), 0.06), settings, on_step=record).reason == "no_contact"
        path = (np.array(positions)[:100] - at) @ R
        assert np.abs(path[:, :2]).max() < 1e-3
        assert path[0, 2] == pytest.approx(-settings.standoff_m, abs=1e-3)
        assert path[49, 2] == pytest.approx(-settings.standoff_m / 2, abs=3e-3)
        assert path[24, 2] < -0.085
        assert path[99, 2] == pytest.approx(0.0, abs=1e-3)
        assert (np.diff(path[:, 2]) > -1e-6).all()


def test_the_jaws_close_at_their_ramp_and_then_press(recorded):
    closing = recorded.command[recorded.close]
    steps = QUICK.grip_ramp_mps * QUICK.control_s * np.arange(len(closing))  # each is told after it has been seen
    np.testing.assert_allclose(closing, np.maximum(0.075 - steps, -0.02), atol=1e-12)
    assert recorded.opening[recorded.approach] == pytest.approx(0.075, abs=1e-3)
    assert recorded.opening[recorded.hold] == pytest.approx(0.06, abs=1e-3)


def test_the_lift_goes_straight_up_by_its_height_and_rests_there(recorded):
    moved = recorded.T[:, :3, 3] - recorded.grasp.T_world_gripper[:3, 3]
    lift = moved[recorded.lift]
    assert np.abs(lift[:, :2]).max() < 1e-3
    assert lift[len(lift) // 2 - 1, 2] == pytest.approx(QUICK.lift_m / 2, abs=0.02)  # it lags behind
    np.testing.assert_allclose(moved[recorded.hold][-1], (0, 0, QUICK.lift_m), atol=1e-3)
    assert recorded.outcome.lift_m == pytest.approx(QUICK.lift_m, abs=2e-3)


def test_the_shake_swings_along_the_world_s_axes_one_after_the_other(recorded):
    moved = recorded.T[:, :3, 3] - recorded.grasp.T_world_gripper[:3, 3] - (0, 0, QUICK.lift_m)
    for phase, axis in ((recorded.shake_x, 0), (recorded.shake_y, 1)):
        along, across = moved[phase][:, axis], np.delete(moved[phase], axis, axis=1)
        assert along.max() == pytest.approx(QUICK.shake_m, rel=0.15)
        assert along.min() == pytest.approx(-QUICK.shake_m, rel=0.15)
        assert np.argmax(along) < np.argmin(along)
        assert np.abs(across).max() < 2e-3


def test_turns_are_about_the_world_s_axes_however_the_gripper_is_yawed(recorded):
    R_grasp = recorded.grasp.T_world_gripper[:3, :3]
    for phase, axis in ((recorded.turn_x, 0), (recorded.turn_y, 1)):
        turned = Rotation.from_matrix(recorded.T[phase][:, :3, :3] @ R_grasp.T).as_rotvec(degrees=True)
        along, across = turned[:, axis], np.delete(turned, axis, axis=1)
        assert along.max() == pytest.approx(QUICK.turn_deg, rel=0.1)
        assert along.min() == pytest.approx(-QUICK.turn_deg, rel=0.1)
        assert np.argmax(along) < np.argmin(along)
        assert np.abs(across).max() < 1.0
        held_at = recorded.T[phase][:, :3, 3] - recorded.grasp.T_world_gripper[:3, 3]
        np.testing.assert_allclose(held_at, np.tile((0, 0, QUICK.lift_m), (len(held_at), 1)), atol=3e-3)


def test_more_cycles_shake_for_longer_and_turn_no_more(world):
    marks = []

    def record(data):
        marks.append(gripper_pose(world.model, data)[0][0, 3])

    settings = TrialSettings(approach_s=0.2, lift_s=0.3, hold_s=0.1, shake_cycles=3, turn_hz=2.0)
    outcome = run_trial(world, Grasp(make_T(DOWN, (0, 0, 0.09)), 0.075), settings, on_step=record)
    assert outcome.reason == "held"
    start = round((0.2 + 0.8 + 0.3 + 0.1) / 0.01)
    x = np.array(marks)[start : start + 150]
    crossings = np.flatnonzero((x[:-1] > 0) != (x[1:] > 0))
    assert len(crossings) in (5, 6, 7)
    assert len(marks) == start + 2 * (150 + 50) + 30


def test_the_jaws_open_as_wide_as_they_go_to_release(recorded):
    assert recorded.command[recorded.release] == pytest.approx(0.08)
    fall = recorded.target[recorded.release][:, 2, 3]
    assert fall[0] - fall[-1] > 0.19  # the table catches it
    assert recorded.outcome.falls_free


def test_lift_is_what_the_object_gained_not_the_gripper(world):
    outcome = run_trial(world, Grasp(make_T(DOWN, (0.2, 0, 0.09)), 0.06), QUICK)
    assert outcome.reason == "no_contact"
    assert abs(outcome.lift_m) < 1e-4


def test_a_trial_starts_from_the_world_s_own_state_whatever_was_before(world):
    grasp = Grasp(make_T(YAWED, (0, 0, 0.09)), 0.075)
    first = run_trial(world, grasp, QUICK)
    world.data.qpos[:] = 0.3
    world.data.ctrl[:] = 0.01
    assert run_trial(world, grasp, QUICK) == first


def test_a_lift_that_is_no_number_is_told_as_none(world):
    one = trial_on(world)
    put(world, make_T(one.T_target_start[:3, :3], one.T_target_start[:3, 3] + (0, 0, 0.07)))
    assert one.lift_m() == pytest.approx(0.07)
    world.data.xpos[world.model.body(TARGET).id] = np.nan
    assert one.lift_m() == 0.0
    world.restore()


# Judgements


def trial_on(world, *, at=(0, 0, 0.09), settings=QUICK, R=YAWED):
    """A trial whose jaws are where they close, with the object noted as it is held."""
    world.restore()
    grasp = Grasp(make_T(R, at), 0.07)
    one = trial._Trial(Handles.of(world, TARGET), grasp, settings, None, mujoco.mj_step)
    one.handles.place(grasp.T_world_gripper, 0.0598)  # both pads press by 0.1 mm
    one.T_gripper_held = invert_T(one.handles.T_world_gripper) @ one.handles.T_world_target
    one.held_point = invert_T(one.T_gripper_held)[:3, 3]
    return one


def put(world, T_world_object):
    joint = world.model.joint(f"{TARGET}_free").qposadr[0]
    world.data.qpos[joint : joint + 3] = T_world_object[:3, 3]
    world.data.qpos[joint + 3 : joint + 7] = Rotation.from_matrix(T_world_object[:3, :3]).as_quat(scalar_first=True)
    mujoco.mj_forward(world.model, world.data)


def test_the_largest_slip_is_told_not_the_last(world):
    one = trial_on(world)
    start = one.handles.T_world_target
    for shift_m, largest_m in ((0.002, 0.002), (0.006, 0.006), (0.001, 0.006), (0.0, 0.006)):
        put(world, make_T(start[:3, :3], start[:3, 3] + shift_m * YAWED[:, 0]))
        assert one._slipped("slipped") is None
        assert one.largest_slip_m == pytest.approx(largest_m, abs=1e-6)


@pytest.mark.parametrize(("shift_m", "reason"), [(0.0099, None), (0.0101, "slipped")])
def test_slip_beyond_its_limit_is_a_reason(world, shift_m, reason):
    one = trial_on(world)
    start = one.handles.T_world_target
    put(world, make_T(start[:3, :3], start[:3, 3] + (0, 0, -shift_m)))
    assert one._slipped("slipped") == reason


@pytest.mark.parametrize(("turn_deg", "reason"), [(9.9, None), (-9.9, None), (10.1, "slipped"), (-10.1, "slipped")])
def test_turning_about_the_grip_is_no_slip_of_its_point_but_has_a_limit_of_its_own(world, turn_deg, reason):
    one = trial_on(world, at=(0, 0, 0.07))
    start, grip = one.handles.T_world_target, one.handles.T_world_gripper[:3, 3]
    R = rotation_about(YAWED[:, 1], np.deg2rad(turn_deg))  # about the closing axis
    put(world, make_T(R @ start[:3, :3], grip + R @ (start[:3, 3] - grip)))
    assert one._slipped("slipped") == reason
    assert one.largest_slip_m < 1e-6


def test_an_object_that_both_pads_have_lost_has_slipped_wherever_it_is(world):
    one = trial_on(world)
    assert one._slipped("lost") is None
    one.handles.place(one.grasp.T_world_gripper, 0.07)  # off by 5 mm on either side
    assert one._slipped("lost") == "lost"


def test_a_trial_in_which_the_pads_let_go_has_slipped_on_lift(world, monkeypatch):
    touches = iter([2])
    monkeypatch.setattr(Handles, "touching_pads", lambda self: next(touches, 0))
    assert run_trial(world, Grasp(make_T(YAWED, (0, 0, 0.09)), 0.075), QUICK).reason == "slipped_on_lift"


def test_one_pad_on_the_object_is_no_contact():
    """A post that does not yield stands beside the middle of the jaws: one of them stops at it."""
    post = SceneObject(TARGET, (part_of(cylinder(0.008)),), None, make_T(t=(0, 0.02, 0)), 0.2, 0.7, fixed=True)
    world, seen = World([post]), []
    handles = Handles.of(world, TARGET)
    outcome = run_trial(
        world, Grasp(make_T(DOWN, (0, 0, 0.09)), 0.075), QUICK, on_step=lambda _: seen.append(handles.touching_pads())
    )
    assert outcome.reason == "no_contact"
    assert seen[-1] == 1
    assert set(seen) == {0, 1}


def test_pads_are_counted_once_each_and_fingers_and_palm_not_at_all(world):
    one = trial_on(world)
    assert one.handles.touching_pads() == 2
    T = one.grasp.T_world_gripper
    one.handles.place(make_T(T[:3, :3], T[:3, 3] + 0.002 * T[:3, 1]), 0.0598)
    assert one.handles.touching_pads() == 1
    below = make_T(T[:3, :3], (0, 0, 0.06))  # pads beside the foot, the palm on the lid: 5 mm deep
    one.handles.place(below, 0.08)
    assert one.handles.touching_pads() == 0
    assert one.handles.largest_force_n() > 1.0


def test_forces_between_other_things_are_not_the_gripper_s():
    heavy = World([SceneObject.of_parts((part_of(cylinder()),), 20.0, 0.7)])
    heavy.settle()
    handles = Handles.of(heavy, TARGET)
    assert heavy.data.ncon > 0
    assert handles.largest_force_n() == 0.0
    handles.place(make_T(DOWN, (0.2, 0, 0.0119)), 0.05)  # pads 0.1 mm in the table
    assert handles.largest_force_n() > 1.0


@pytest.mark.parametrize(("force_n", "collides"), [(0.99, False), (1.01, True)])
def test_a_touch_on_the_way_in_counts_from_its_force_on(world, monkeypatch, force_n, collides):
    monkeypatch.setattr(Handles, "largest_force_n", lambda self: force_n)
    outcome = run_trial(world, Grasp(make_T(YAWED, (0, 0, 0.09)), 0.075), QUICK)
    assert (outcome.reason == "collided_on_approach") == collides


@pytest.mark.parametrize(("push_m", "collides"), [(0.0028, False), (0.0032, True)])
def test_a_push_on_the_way_in_counts_from_its_length_on(world, push_m, collides):
    pushed = []

    def push(_):
        if not pushed:
            at = world.pose(TARGET)
            put(world, make_T(at[:3, :3], at[:3, 3] - push_m * YAWED[:, 0]))
        pushed.append(True)

    outcome = run_trial(world, Grasp(make_T(YAWED, (0, 0, 0.09)), 0.075), QUICK, on_step=push)
    assert (outcome.reason == "collided_on_approach") == collides
    assert (len(pushed) == 1) == collides


@pytest.mark.parametrize(("speed", "is_unstable"), [(19.0, False), (21.0, True), (-21.0, True)])
def test_a_speed_that_no_object_reaches_is_unstable(world, speed, is_unstable):
    one = trial_on(world)
    joint = world.model.joint(f"{TARGET}_free").dofadr[0]
    world.data.qvel[joint + 1] = speed
    mujoco.mj_forward(world.model, world.data)
    assert one.handles.is_unstable(20.0) == is_unstable


def test_a_warning_of_the_solver_is_unstable(world):
    one = trial_on(world)
    assert not one.handles.is_unstable(20.0)
    for kind in (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_CNSTRFULL):
        world.data.warning[int(kind)].number = 1
        assert one.handles.is_unstable(20.0)
        world.data.warning[int(kind)].number = 0
    world.data.qpos[0] = np.inf
    assert one.handles.is_unstable(20.0)


@pytest.mark.parametrize("width_m", [0.0801, 0.075])
def test_the_object_has_its_weight_back_after_a_trial_in_which_it_floated(world, width_m):
    outcome = run_trial(world, Grasp(make_T(DOWN, (0.2, 0, 0.09)), width_m), QUICK, floats=True)
    assert outcome.reason == ("unreachable_width" if width_m > 0.08 else "no_contact")
    assert world.model.body_gravcomp[world.model.body(TARGET).id] == 0.0


def test_a_floating_object_has_no_weight_until_the_jaws_have_closed():
    """It hangs in the air beside the jaws; with its weight it falls at once."""
    ball = trimesh.creation.icosphere(radius=0.03)
    ball.apply_translation((0.2, 0, 0.3))
    world, heights = World([SceneObject.of_parts((part_of(ball),), 0.2, 0.7)]), []
    grasp = Grasp(make_T(DOWN, (0, 0, 0.3)), 0.07)
    run_trial(world, grasp, QUICK, floats=True, on_step=lambda _: heights.append(world.pose(TARGET)[2, 3]))
    np.testing.assert_allclose(heights, 0.3, atol=1e-6)
    heights.clear()
    fallen = run_trial(world, grasp, QUICK, on_step=lambda _: heights.append(world.pose(TARGET)[2, 3]))
    assert heights[-1] < 0.3 - QUICK.push_m
    assert fallen.reason == "collided_on_approach"


def test_each_jaw_presses_with_the_grip_of_the_settings(world):
    for grip_n in (12.0, 25.0):
        seen = []
        run_trial(
            world,
            Grasp(make_T(DOWN, (0, 0, 0.09)), 0.075),
            TrialSettings(grip_n=grip_n, approach_s=0.2, lift_s=0.3, shake_cycles=1),
            on_step=lambda data, seen=seen: seen.append(float(data.actuator_force[0])),
        )
        assert min(seen) == pytest.approx(-grip_n)


def test_a_trial_is_stepped_by_whatever_it_is_told(world):
    calls = []

    def stepper(model, data):
        calls.append(model.opt.timestep)
        mujoco.mj_step(model, data)

    run_trial(world, Grasp(make_T(DOWN, (0.2, 0, 0.09)), 0.06), QUICK, stepper=stepper)
    assert len(calls) == round((QUICK.approach_s + QUICK.close_s) / world.model.opt.timestep)


def test_another_object_than_the_target_may_be_grasped_by_its_name():
    parts = tuple(SceneObject.of_parts((part_of(cylinder(at=at)),), 0.2, 0.7, name=name)
                  for name, at in (("near", (0, 0)), ("far", (0.2, 0))))  # fmt: skip
    world = World(parts)
    world.settle()
    grasp = Grasp(make_T(DOWN, (0.2, 0, 0.09)), 0.075)
    assert run_trial(world, grasp, QUICK, target="far").reason == "held"
    assert run_trial(world, grasp, QUICK, target="near").reason == "no_contact"


def test_courses_start_and_end_gently_and_swing_both_ways():
    t = np.linspace(0, 1, 201)
    smooth = trial._smooth(t)
    assert (smooth[0], smooth[100], smooth[-1]) == pytest.approx((0, 0.5, 1))
    np.testing.assert_allclose(smooth + smooth[::-1], 1.0)
    assert np.gradient(smooth, t).max() == pytest.approx(1.875, rel=1e-3)  # minimum jerk, Flash and Hogan 1985
    swing = trial._swing(t, 2)
    assert abs(swing[[0, 1, -2, -1]]).max() < 1e-3
    assert swing[25] == pytest.approx(1.0)  # the peak of the first cycle, where the fade has ended
    assert swing[75] == pytest.approx(-1.0)
    np.testing.assert_allclose(swing[100:], -swing[:101][::-1], atol=1e-12)


def test_what_floated_is_lifted_with_its_weight():
    """Two jaws of 30 N hold 24 N at a friction of 0.4: its weight of 34 N is too much, its inertia is not."""
    heavy = World([SceneObject.of_parts((part_of(cylinder()),), 3.5, 0.4)])
    grasp, shares = Grasp(make_T(DOWN, (0, 0, 0.09)), 0.075), []
    for floats, share in ((True, 1.0), (False, 0.0)):
        shares.clear()
        outcome = run_trial(
            heavy,
            grasp,
            floats=floats,
            on_step=lambda _: shares.append(heavy.model.body_gravcomp[heavy.model.body(TARGET).id]),
        )
        assert outcome.reason == "slipped_on_lift"
        assert set(shares[:140]) == {share}  # while the gripper comes and the jaws close
        assert set(shares[140:]) == {0.0}
