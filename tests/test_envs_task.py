"""Episodes and trials without gymnasium's interface: what is drawn, seen, observed, and shared with the environment."""

import inspect
import pydoc
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from gfp_grasp.envs import ActionCode, EnvConfig, Episode, GfpGraspEnv, GraspTask, Randomisation, TrialSettings, shade
from gfp_grasp.envs import episode as episode_module
from gfp_grasp.envs.spaces import observation_space, observe
from gfp_grasp.errors import InvalidGrasp, InvalidOption, InvalidScene, NothingDetected, UnknownDetector
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.scenes import TARGET, SceneObject, World
from gfp_grasp.transforms import apply_T, look_at, make_T
from gfp_grasp.types import (
    CollisionMesh,
    ConvexPart,
    DepthImage,
    Detection,
    Grasp,
    OrientedBox,
    PointCloud,
    TrueObject,
)

SMALL: dict[str, Any] = {"completer": "mirror", "num_points": 64, "image_width": 120, "image_height": 90}
TINY: dict[str, Any] = {"image_width": 8, "image_height": 6}  # nothing is detected, but all else is drawn
# Level, at mid-height, at the middle of the table.
LEVEL = Grasp(make_T(np.column_stack([(0, 0, -1.0), (0, 1.0, 0), (1.0, 0, 0)]), (0, 0, 0.07)), 0.078)


def leaning_box():
    """A box that is not about its own axis, so that yaw and place show."""
    mesh = trimesh.creation.box((0.05, 0.03, 0.14))
    mesh.apply_translation((0.012, 0.004, 0.07))
    return mesh


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("objects")
    for name, radius_m in (("slim", 0.025), ("wide", 0.034)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"bottle__{name}.ply")
    leaning_box().export(path / "box__crooked.ply")
    return str(path)


def task_of(folder, **options):
    return GraspTask(EnvConfig(objects=folder, **{**SMALL, **options}))


class Given:
    """A generator that draws the same share every time."""

    def __init__(self, share):
        self.share = share

    def uniform(self, size):
        return np.full(size, self.share)


@pytest.mark.parametrize(("share", "mass_kg", "friction", "grip_n"), [(0, 0.16, 0.4, 25), (1, 0.24, 1.0, 35)])
def test_domain_randomisation_spans_its_ranges_to_their_ends(share, mass_kg, friction, grip_n):
    mesh = leaning_box()
    part = ConvexPart(mesh.vertices, mesh.faces)
    truth = TrueObject("x", "", mesh, CollisionMesh((part,), (0, 0, 0), "hull", 0.0), 0.2, 0.7)
    drawn = Randomisation.draw(truth, EnvConfig(mass_spread=0.2), Given(share))  # pyright: ignore[reportArgumentType]
    assert (drawn.mass_kg, drawn.friction, drawn.grip_n) == pytest.approx((mass_kg, friction, grip_n))


def test_mass_friction_and_grip_are_drawn_apart():
    task_rng = np.random.default_rng(0)
    mesh = leaning_box()
    part = ConvexPart(mesh.vertices, mesh.faces)
    truth = TrueObject("x", "", mesh, CollisionMesh((part,), (0, 0, 0), "hull", 0.0), 0.2, 0.7)
    drawn = [Randomisation.draw(truth, EnvConfig(), task_rng) for _ in range(300)]
    values = np.array([(one.mass_kg, one.friction, one.grip_n) for one in drawn])
    assert np.abs(np.corrcoef(values.T) - np.eye(3)).max() < 0.2


def test_the_task_draws_what_the_environment_does(folder):
    env, task = GfpGraspEnv(objects=folder, **SMALL), task_of(folder)
    for seed in (3, 4):
        env.reset(seed=seed)
        mine = task.draw(np.random.default_rng(seed))
        assert task.episode is mine
        theirs = env.episode
        assert mine.truth.name == theirs.truth.name
        np.testing.assert_array_equal(mine.image.depth_m, theirs.image.depth_m)
        np.testing.assert_array_equal(mine.T_world_object, theirs.T_world_object)
        assert mine.randomisation == theirs.randomisation
        assert mine.completion is not None
        action = ActionCode().encode(plan_grasps(mine.completion, 1)[0])
        outcome, info = task.run_trial(ActionCode().decode(action)), env.step(action)[4]
        assert (outcome.reason, outcome.slip_m) == (info["reason"], info["slip_m"])
        assert outcome.settings["grip_n"] == mine.randomisation.grip_n


def test_objects_stand_anywhere_within_the_spread_turned_at_will(folder):
    task = task_of(folder, spread_m=0.05, completer="own_completers:gives_up", **TINY)
    at, yaws = [], []
    for seed in range(40):
        T = task.draw(np.random.default_rng(seed), number=0).T_world_object
        at.append(T[:2, 3])
        yaws.append(np.arctan2(T[1, 0], T[0, 0]))
    at = np.array(at)
    assert np.abs(at).max() <= 0.0501
    assert (at.max(axis=0) > 0.035).all()
    assert (at.min(axis=0) < -0.035).all()
    assert abs(np.corrcoef(at.T)[0, 1]) < 0.5
    assert np.histogram(yaws, 4, (-np.pi, np.pi))[0].min() >= 3


def test_the_camera_looks_at_the_object_from_its_distance_and_elevation(folder):
    task = task_of(
        folder,
        distance_m=0.7,
        elevation_min_deg=25.0,
        elevation_max_deg=40.0,
        completer="own_completers:gives_up",
        **TINY,
    )
    elevations = []
    for seed in range(15):
        episode = task.draw(np.random.default_rng(seed), number=0)
        T = episode.image.T_world_camera
        target = episode.T_world_object[:3, 3] + (0, 0, 0.4 * 0.14)
        line = target - T[:3, 3]
        assert np.linalg.norm(line) == pytest.approx(0.7, abs=1e-6)
        np.testing.assert_allclose(line / 0.7, T[:3, 2], atol=1e-6)
        elevations.append(np.rad2deg(np.arcsin(-line[2] / 0.7)))
    assert 25 <= min(elevations) < 30
    assert 35 < max(elevations) <= 40


def test_the_detection_with_most_pixels_of_the_object_is_the_object(folder):
    episode = task_of(folder).draw(np.random.default_rng(0))
    detection = episode.detection
    assert detection is not None
    is_target = np.zeros((4, 4), dtype=bool)
    is_target[:2] = True
    masks = []
    for rows, columns in ((slice(1, 4), slice(0, 1)), (slice(0, 2), slice(1, 3)), (slice(3, 4), slice(0, 4))):
        mask = np.zeros((4, 4), dtype=bool)
        mask[rows, columns] = True
        masks.append(mask)
    view = DepthImage(np.ones((4, 4), dtype=np.float32), np.diag([50.0, 50.0, 1.0]), np.eye(4))
    detections = tuple(replace(detection, mask=mask, view=view) for mask in masks)
    assert episode_module._detection_of(detections, view, is_target) is detections[1]
    blind = (replace(detection, mask=None, view=None), detections[2])
    with pytest.raises(NothingDetected):
        episode_module._detection_of(blind, view, is_target)


def test_a_detector_of_the_user_s_own_sees_for_the_task(folder):
    task = task_of(folder, detector="own_completers:all_above_the_table", sensor="ideal")
    episode = task.draw(np.random.default_rng(3))
    assert episode.failure == ""
    assert episode.detection is not None
    assert episode.detection.mask is None
    assert np.asarray(episode.detection.cloud.points)[:, 2].max() > 0.1
    with pytest.raises(UnknownDetector, match="tabletop"):
        task_of(folder, detector="magic")


def test_the_mask_of_the_object_is_what_the_rays_hit_of_it_and_nothing_beyond(folder):
    task = task_of(folder, sensor="ideal", distance_m=0.9, elevation_min_deg=5.0, elevation_max_deg=8.0)
    episode = task.draw(np.random.default_rng(1))
    world = task.world()
    assert world is not None
    rng = np.random.default_rng(2)
    image, is_target = episode_module._look(world, episode.truth, task.config, rng)
    seen = is_target & (image.depth_m > 0)
    assert seen.any()
    assert (image.depth_m == 0).any()
    assert not is_target[image.depth_m == 0].any()
    rays = np.linalg.inv(image.K) @ np.stack([*np.nonzero(seen)[::-1], np.ones(seen.sum())]).astype(float)
    points = apply_T(image.T_world_camera, (rays * image.depth_m[seen]).T)
    low, high = episode.true_mesh().bounds
    assert (points > low - 2e-3).all()
    assert (points < high + 2e-3).all()
    table = ~is_target & (image.depth_m > 0)
    rays = np.linalg.inv(image.K) @ np.stack([*np.nonzero(table)[::-1], np.ones(table.sum())]).astype(float)
    heights = apply_T(image.T_world_camera, (rays * image.depth_m[table]).T)[:, 2]
    assert heights.max() < 2e-3


def test_a_given_completion_brings_its_own_picture_and_no_view_is_rendered(folder, monkeypatch):
    task = task_of(folder)
    first = task.draw(np.random.default_rng(5))

    def never(*_, **__):
        raise AssertionError("a view was rendered for nothing")

    other = task_of(folder, world="completed")
    with monkeypatch.context() as patch:
        patch.setattr(episode_module, "render_depth", never)
        again = other.draw(np.random.default_rng(5), completion=first.completion)
    assert again.completion is first.completion
    assert first.completion is not None
    assert again.detection is first.completion.detection
    np.testing.assert_array_equal(again.T_world_object, first.T_world_object)
    np.testing.assert_array_equal(again.image.depth_m, first.image.depth_m)
    larger = task_of(folder, image_width=160)  # the picture would not fit into its observations
    assert larger.draw(np.random.default_rng(5), completion=first.completion).image.depth_m.shape == (90, 160)


def test_both_worlds_of_an_episode_take_the_same_grasp(folder):
    task = task_of(folder, spread_m=0.0)
    task.draw(np.random.default_rng(1), number=1)
    true, completed = (task.run_trial(LEVEL, world=world) for world in ("true", "completed"))
    assert (true.reason, completed.reason) == ("held", "held")
    assert true != completed
    assert task.run_trial(LEVEL) == true
    parts, whole = task.world("completed"), task.world()
    assert parts is not None
    assert whole is not None
    assert parts is task.world("completed")  # compiled once
    assert parts is not whole
    assert task.episode is not None
    drawn = task.episode.randomisation
    for world in (parts, whole):
        assert world.model.body(TARGET).mass[0] == pytest.approx(drawn.mass_kg)
        assert set(world.model.geom_friction[world.geoms(TARGET), 0]) == {drawn.friction}
    task.draw(np.random.default_rng(2), number=1)
    assert task.world("completed") is not parts


def test_a_completed_world_stands_among_the_same_clutter(folder):
    task = task_of(folder, clutter=2)
    task.draw(np.random.default_rng(0))
    true, completed = task.world(), task.world("completed")
    assert true is not None
    assert completed is not None
    assert true.names == completed.names == (TARGET, "clutter_0", "clutter_1")
    for name in true.names[1:]:
        np.testing.assert_array_equal(true.pose(name), completed.pose(name))
    assert all(thing.fixed for thing in true.objects[1:])
    assert not true.objects[0].fixed


def test_the_widest_of_the_clutter_are_taken_out_where_all_find_no_place(tmp_path):
    for name, radius_m in (("plain", 0.03), ("slim", 0.02), ("wide", 0.43)):
        mesh = trimesh.creation.cylinder(radius_m, 0.1, sections=24)
        mesh.apply_translation((0, 0, 0.05))
        mesh.export(tmp_path / f"can__{name}.ply")
    task = task_of(str(tmp_path), clutter=3)
    names = set()
    for seed in range(6):
        task.draw(np.random.default_rng(seed), number=0)
        world = task.world()
        assert world is not None
        widest = max(float(np.ptp(part.vertices[:, 0])) for thing in world.objects for part in thing.parts)
        assert widest == pytest.approx(0.06)  # what is 0.86 m wide leaves no place for any other
        names.add(world.names)
    assert names == {(TARGET, "clutter_0"), (TARGET, *(f"clutter_{i}" for i in range(3)))}


def test_vehicles_are_no_objects_of_a_table():
    task = task_of("traffic", limit=1)
    with pytest.raises(InvalidOption, match="'car-3' of it is nothing that a table holds: take household families"):
        task.draw(np.random.default_rng(0))


def test_no_completion_or_none_that_can_be_simulated_is_no_grasp(folder, monkeypatch):
    task = task_of(folder, completer="own_completers:gives_up", **TINY)
    assert task.world() is None
    assert task.run_trial(LEVEL).reason == "no_grasp_found"
    task.draw(np.random.default_rng(0))
    assert task.world("completed") is None
    assert task.run_trial(LEVEL, world="completed").reason == "no_grasp_found"
    assert task.run_trial(LEVEL).reason != "no_grasp_found"

    def refuse(*_, **__):
        raise InvalidScene("a sliver")

    task = task_of(folder)
    task.draw(np.random.default_rng(0))
    monkeypatch.setattr(SceneObject, "of_parts", refuse)
    with pytest.raises(InvalidScene):
        task.world("completed")
    assert task.run_trial(LEVEL, world="completed").reason == "no_grasp_found"


def test_a_task_has_settings_of_its_own_but_for_the_grip(folder):
    task = GraspTask(EnvConfig(objects=folder, **SMALL), settings=TrialSettings(lift_m=0.1, grip_n=3.0))
    assert task.trial_settings.grip_n == 3.0
    episode = task.draw(np.random.default_rng(0))
    assert task.trial_settings == TrialSettings(lift_m=0.1, grip_n=episode.randomisation.grip_n)


def test_scenes_of_so_many_objects_are_kept_those_used_last(folder):
    task = GraspTask(EnvConfig(objects=folder, **SMALL), num_kept=2)
    for number in (0, 1, 0, 2):
        task.draw(np.random.default_rng(0), number=number)
    assert list(task._true_worlds) == [0, 2]
    with pytest.raises(InvalidOption, match="there is no object 3; there are 0 to 2"):
        task.draw(np.random.default_rng(0), number=3)
    task.close()
    assert task.episode is task.world() is None
    assert not task._true_worlds


def episode_with(points, completion=None):
    box = OrientedBox(np.eye(4), np.ones(3))
    detection = Detection(PointCloud(points), np.array([0, 0, 1.0]), None, "", {}, box)
    K = np.array([[50.0, 0, 2], [0, 50, 1.5], [0, 0, 1]])
    depth = np.array([[0, 1, 20, 3]] * 3, dtype=np.float32)
    return Episode(None, None, np.eye(4), DepthImage(depth, K, np.eye(4)), detection, completion)  # pyright: ignore[reportArgumentType]


def test_observations_are_padded_thinned_and_clipped():
    config = EnvConfig(num_points=5, image_width=4, image_height=3)
    rng = np.random.default_rng(0)
    few = np.array([(0.1, 0.2, 0.3), (3.0, -3.0, 0.0), (0.0, 0.1, 0.2)])
    seen = observe(episode_with(few), config, rng)
    np.testing.assert_array_equal(seen["observed_mask"], [1, 1, 1, 0, 0])
    np.testing.assert_allclose(seen["observed"][:3], np.clip(few, -2, 2), atol=1e-7)
    assert not seen["observed"][3:].any()
    assert not seen["completed"].any()
    np.testing.assert_array_equal(seen["depth"][0], [0, 1, 10, 3])
    many = np.random.default_rng(1).uniform(-0.5, 0.5, (40, 3))
    chosen = set()
    for _ in range(5):
        thinned = observe(episode_with(many), config, rng)["observed"]
        rows = [int(np.flatnonzero((np.abs(many - row) < 1e-6).all(axis=1))[0]) for row in thinned]
        assert len(set(rows)) == 5
        assert rows == sorted(rows)
        chosen |= set(rows)
    assert len(chosen) > 10  # other points each time
    far = trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((3.0, 0.0, -2.5))
    completed = observe(episode_with(few, SimpleNamespace(mesh=far)), config, rng)["completed"]
    np.testing.assert_array_equal(completed[:, 0], np.full(5, 2.0))
    np.testing.assert_array_equal(completed[:, 2], np.full(5, -2.0))
    assert np.abs(completed[:, 1]).max() <= 0.05
    assert observation_space(config).contains(seen)


def test_a_picture_is_brighter_where_the_lamp_shines_and_sky_where_nothing_is():
    ball = trimesh.creation.icosphere(3, radius=0.1)
    part = ConvexPart(ball.vertices, ball.faces)
    world = World([SceneObject("ball", (part,), None, make_T(t=(0, 0, 0.3)), 0.2, 0.5, fixed=True)])
    camera = look_at((0.0, -0.6, 0.3), (0.0, 0.0, 0.3))
    picture = shade(world.model, world.data, width=80, height=60, T_world_camera=camera, fov_deg=40.0)
    assert picture.shape == (60, 80, 3)
    top, left, middle, foot = picture[18, 40], picture[30, 26], picture[30, 40], picture[41, 40]
    assert tuple(picture[0, 0]) == (int(255 * 0.92), int(255 * 0.94), int(255 * 0.97))
    assert top.sum() > middle.sum() > foot.sum()  # the lamp is above, to the front right
    assert picture[30, 54].sum() > left.sum()
    full, dark = 255 * np.array([0x4F, 0x7C, 0xAC]) / 255, 0.45 * np.array([0x4F, 0x7C, 0xAC])
    assert (picture[15:45, 25:55].max(axis=(0, 1)) <= 255).all()
    np.testing.assert_allclose(foot, dark, atol=3)
    ball_pixels = picture[20:40, 30:50].reshape(-1, 3).astype(float)
    assert (ball_pixels <= full + 1).all()
    assert ball_pixels.max() > 0.9 * full.max()


# Grasps as actions


def test_an_action_is_placed_within_the_workspace_axis_by_axis():
    code = ActionCode(centre_m=(0.1, -0.2, 0.3), half_m=(0.2, 0.3, 0.4), max_width_m=0.1)
    grasp = code.decode(np.array([0.5, -0.5, 0.25, 1, 0, 0, 0, 1, 0, 0.5]))
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 3], (0.2, -0.35, 0.4))
    assert grasp.width_m == pytest.approx(0.075)
    np.testing.assert_allclose(
        grasp.T_world_gripper[:3, :3], np.column_stack([(0, 0, -1), (0, 1, 0), (1, 0, 0)]), atol=1e-12
    )
    assert code.decode(np.array([0.0] * 9 + [-1.0])).width_m == 0.0


def test_short_directions_are_taken_as_given_down_to_a_ten_thousandth():
    code = ActionCode()
    for length, taken in ((0.05, True), (1.1e-4, True), (0.9e-4, False)):
        action = np.zeros(10)
        action[3], action[8] = length, length
        T = code.decode(action).T_world_gripper
        np.testing.assert_allclose(T[:3, 2], (1, 0, 0) if taken else (0, 0, -1), atol=1e-12)
        np.testing.assert_allclose(T[:3, 1], (0, 0, 1) if taken else (0, -1, 0), atol=1e-12)


def test_a_closing_axis_is_made_square_to_the_approach_and_not_the_other_way():
    action = np.zeros(10)
    action[3:6], action[6:9] = (0.6, 0.0, -0.8), (0.5, 0.5, 0.0)
    T = ActionCode().decode(action).T_world_gripper
    np.testing.assert_allclose(T[:3, 2], (0.6, 0, -0.8))
    square = np.array([0.5, 0.5, 0]) - 0.3 * np.array([0.6, 0, -0.8])
    np.testing.assert_allclose(T[:3, 1], square / np.linalg.norm(square))
    action[6:9] = 0.3 * action[3:6]  # along the approach: any axis square to it
    T = ActionCode().decode(action).T_world_gripper
    np.testing.assert_allclose(T[:3, 2], (0.6, 0, -0.8))
    assert T[:3, 1] @ T[:3, 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("pose", [np.eye(3), np.full((4, 4), np.nan), "down", None])
def test_a_grasp_without_a_pose_is_refused_as_a_grasp(pose):
    with pytest.raises(InvalidGrasp, match="T_world_gripper"):
        Grasp(pose, 0.05)


@pytest.mark.parametrize("width_m", [-1e-6, np.inf, np.nan, "wide", None, (0.01, 0.02)])
def test_a_grasp_without_a_width_is_refused_as_a_grasp(width_m):
    with pytest.raises(InvalidGrasp, match="width_m"):
        Grasp(np.eye(4), width_m)
    assert Grasp(np.eye(4), 0).width_m == 0.0


def test_the_constructor_shows_its_options_with_types_and_defaults():
    shown = inspect.signature(GfpGraspEnv).parameters
    assert list(shown) == [option.name for option in fields(EnvConfig)]
    assert shown["clutter"].default == 0
    assert shown["clutter"].annotation == "int"
    assert all(option.kind is inspect.Parameter.KEYWORD_ONLY for option in shown.values())
    assert "clutter: 'int' = 0" in pydoc.plain(pydoc.render_doc(GfpGraspEnv))
