"""Attempts whose outcome is known, on a cylinder of 60 mm that stands on the table."""

import numpy as np
import pytest
import trimesh

from gfp_grasp.bench.trial import creep_mps
from gfp_grasp.envs import TrialSettings, run_trial
from gfp_grasp.errors import InvalidOption, InvalidScene
from gfp_grasp.grasps import Gripper
from gfp_grasp.scenes import SceneObject, World, build_scene, compile_scene
from gfp_grasp.transforms import make_T
from gfp_grasp.types import REASONS, ConvexPart, Grasp

DOWN = np.column_stack([(1.0, 0, 0), (0, -1.0, 0), (0, 0, -1.0)])
RADIUS_M, HEIGHT_M = 0.03, 0.12


def world_of(mass_kg=0.2, friction=0.7):
    mesh = trimesh.creation.cylinder(RADIUS_M, HEIGHT_M, sections=48)
    mesh.apply_translation((0, 0, HEIGHT_M / 2))
    return World([SceneObject.of_parts((ConvexPart(mesh.vertices, mesh.faces),), mass_kg, friction)])


def from_above(height_m=0.09, x=0.0, width_m=0.075):
    return Grasp(make_T(DOWN, (x, 0, height_m)), width_m)


def outcome_of(world, grasp, settings=None, **knobs):
    return run_trial(world, grasp, settings, **knobs)


@pytest.fixture(scope="module")
def world():
    return world_of()


def test_a_square_grasp_is_held(world):
    outcome = outcome_of(world, from_above())
    assert outcome.success
    assert outcome.reason == "held"
    assert outcome.lift_m == pytest.approx(0.2, abs=0.01)
    assert outcome.slip_m < 0.005
    assert outcome.falls_free


def test_what_the_table_catches_before_it_has_dropped_does_not_fall_free(world):
    outcome = outcome_of(world, from_above(), TrialSettings(drop_m=0.3))
    assert outcome.success
    assert not outcome.falls_free


def test_what_slipped_before_does_not_fall_free():
    assert not outcome_of(world_of(mass_kg=8.0, friction=0.4), from_above()).falls_free


def test_a_grasp_too_deep_collides_with_the_palm(world):
    assert outcome_of(world, from_above(height_m=0.05)).reason == "collided_on_approach"


def test_a_finger_through_the_object_is_a_collision(world):
    assert outcome_of(world, from_above(width_m=0.05)).reason == "collided_on_approach"


def test_a_grasp_into_the_table_is_a_collision(world):
    assert outcome_of(world, from_above(height_m=0.005, x=0.15)).reason == "collided_on_approach"


def test_a_grasp_beside_the_object_has_no_contact(world):
    assert outcome_of(world, from_above(x=0.15)).reason == "no_contact"


def test_jaws_do_not_open_wider_than_their_stroke(world):
    assert outcome_of(world, from_above(width_m=0.09)).reason == "unreachable_width"


def test_what_is_too_heavy_slips_on_lift():
    assert outcome_of(world_of(mass_kg=8.0, friction=0.4), from_above()).reason == "slipped_on_lift"


def test_a_hard_shake_shakes_it_loose():
    settings = TrialSettings(shake_m=0.08, shake_hz=5.0)
    assert outcome_of(world_of(mass_kg=0.8, friction=0.4), from_above(), settings).reason == "slipped_on_shake"


def test_a_state_that_is_not_finite_is_unstable_and_never_nan(world):
    def spoil(data):
        data.qvel[:] = np.nan

    outcome = outcome_of(world, from_above(), on_step=spoil)
    assert outcome.reason == "unstable"
    assert np.isfinite([outcome.lift_m, outcome.slip_m]).all()


def test_the_same_attempt_ends_the_same_to_the_last_bit(world):
    assert outcome_of(world, from_above()) == outcome_of(world, from_above())


def test_a_held_object_creeps_less_than_a_fiftieth_of_a_millimetre_a_second(world):
    creep = creep_mps(world, from_above(), TrialSettings())
    assert creep is not None
    assert 0 < creep < 2e-5


def test_what_is_not_held_has_no_creep():
    assert creep_mps(world_of(mass_kg=8.0, friction=0.4), from_above(), TrialSettings()) is None


def test_an_object_that_cannot_stand_floats_until_it_is_gripped():
    mesh = trimesh.creation.cylinder(RADIUS_M, HEIGHT_M, sections=48)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.3, (0, 1, 0)))
    mesh.apply_translation((0, 0, 0.08))
    leaning = World([SceneObject.of_parts((ConvexPart(mesh.vertices, mesh.faces),), 0.2, 0.7)])
    grasp = from_above(height_m=0.11)
    assert not outcome_of(leaning, grasp).success
    assert outcome_of(leaning, grasp, floats=True).success


def test_an_outcome_carries_its_settings(world):
    settings = TrialSettings(lift_m=0.1)
    outcome = outcome_of(world, from_above(), settings)
    assert outcome.settings["lift_m"] == 0.1
    assert outcome.lift_m == pytest.approx(0.1, abs=0.01)
    assert outcome.reason in REASONS


def test_a_scene_without_the_object_is_refused(world):
    with pytest.raises(InvalidScene, match="no body teapot"):
        run_trial(world, from_above(), target="teapot")


@pytest.mark.parametrize(
    "knob", [{"lift_m": 0.0}, {"grip_n": -1.0}, {"slip_m": float("nan")}, {"hold_s": float("inf")}]
)
def test_nonsense_settings_are_refused(knob):
    with pytest.raises(InvalidOption, match=next(iter(knob))):
        TrialSettings(**knob)


def test_the_planner_and_the_simulator_have_the_same_gripper():
    model = compile_scene(build_scene([], gripper=True))
    root = model.body_rootid[model.geom_bodyid]
    ids = [i for i in range(model.ngeom) if root[i] == model.body("gripper").id]
    simulated = sorted(tuple(np.round([*_in_gripper(model, i), *model.geom_size[i]], 6)) for i in ids)
    gripper = Gripper()
    boxes = gripper.solids(np.zeros(1))[0]
    planned = sorted(tuple(np.round([*(box.sum(axis=0) / 2), *(np.ptp(box, axis=0) / 2)], 6)) for box in boxes)
    np.testing.assert_allclose(simulated, planned, atol=1e-6)
    assert gripper.stroke_m == model.actuator("grip").ctrlrange[1]


def _in_gripper(model, geom):
    """Centre of a geom in the gripper's frame with the jaws closed: joints are at zero in the model's bodies."""
    body = model.geom_bodyid[geom]
    return model.geom_pos[geom] + (0 if model.body(body).name == "gripper" else model.body_pos[body])
