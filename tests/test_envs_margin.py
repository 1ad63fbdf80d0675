"""The least friction at which a grasp holds: the halving by itself, and a trial of a block whose friction is known."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gfp_grasp.collision import collision_of
from gfp_grasp.envs import FRICTIONS, EnvConfig, GraspTask, TrialSettings, least_friction, octaves, run_trial
from gfp_grasp.scenes import TARGET, SceneObject, World
from gfp_grasp.transforms import make_T
from gfp_grasp.types import CompletedShape, Grasp, Outcome

DOWN = np.diag([1.0, -1.0, -1.0])


def outcome(held: bool, reason: str = "slipped_on_lift") -> Outcome:
    return Outcome(held, "held" if held else reason, 0.0, 0.0)


@pytest.mark.parametrize("needed", [0.06, 0.31, 0.9, 1.4])
def test_five_halvings_end_within_a_ninth_above_what_is_needed(needed):
    asked = []

    def attempt(friction: float) -> Outcome:
        asked.append(friction)
        return outcome(friction >= needed)

    found = least_friction(attempt, outcome(True), num_trials=5)
    assert len(asked) == 5
    assert asked[0] == pytest.approx(np.sqrt(0.05 * 1.6))
    assert needed <= found <= needed * 2 ** (5 / 32) * (1 + 1e-9)


def test_what_no_friction_mends_is_not_tried_and_what_never_holds_needs_infinitely_much():
    asked = []

    def attempt(friction: float) -> Outcome:
        asked.append(friction)
        return outcome(False)

    for reason in ("collided_on_approach", "no_contact", "unreachable_width", "no_grasp_found"):
        assert least_friction(attempt, outcome(False, reason), num_trials=5) == np.inf
    assert asked == []
    assert least_friction(attempt, outcome(False), num_trials=3) == np.inf
    assert len(asked) == 3


def test_octaves_count_the_doublings_below_the_highest_friction():
    assert FRICTIONS == (0.05, 1.6)
    assert octaves(0.2) == pytest.approx(3.0)
    assert octaves(1.6) == octaves(np.inf) == octaves(None) == 0.0


def test_a_heavier_block_needs_more_friction_in_proportion_and_the_scene_is_left_as_the_first_trial_ended():
    """Pads of 30 N hold a block of weight m g at its middle by 2 mu N; shaking takes a little more."""
    block = trimesh.creation.box((0.06, 0.04, 0.1)).apply_translation((0.0, 0.0, 0.05))
    parts = collision_of(CompletedShape(block, np.ones(8, bool), np.zeros(8))).parts
    grasp = Grasp(make_T(DOWN, (0.0, 0.0, 0.05)), 0.06)
    needed = {}
    for mass_kg in (0.5, 1.5):
        task = GraspTask(EnvConfig(objects="cup", limit=1, completer="oracle"))
        task.draw(np.random.default_rng(0), number=0)
        world = World([SceneObject.of_parts(parts, mass_kg, 0.8)])
        world.settle()
        task._true_world = world
        task._episode = _with_mass(task.episode, mass_kg)
        alone = run_trial(world, grasp, TrialSettings(grip_n=30.0))
        at_end = world.pose(TARGET)
        told = task.run_trial(grasp, margin_trials=5)
        np.testing.assert_allclose(world.pose(TARGET), at_end, atol=1e-5)
        assert (alone.success, told.success, told.lift_m) == (True, True, pytest.approx(alone.lift_m))
        assert world.model.geom_friction[world.geoms(TARGET), 0] == pytest.approx(0.8)
        needed[mass_kg] = told.least_friction
    held_n = {mass_kg: 2 * mu * 30.0 for mass_kg, mu in needed.items()}
    for mass_kg, force_n in held_n.items():
        assert 1.0 < force_n / (9.81 * mass_kg) < 1.5


def _with_mass(episode, mass_kg: float):
    drawn = replace(episode.randomisation, mass_kg=mass_kg, friction=0.8, grip_n=30.0)
    return replace(episode, randomisation=drawn)
