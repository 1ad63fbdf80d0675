"""What an episode draws: mass, friction, grip, place and camera; and what is detected, rendered and observed of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from grasp_tasks import TINY, leaning_box, task_of, written_objects

from gfp_grasp.envs import EnvConfig, Episode, Randomisation
from gfp_grasp.envs import episode as episode_module
from gfp_grasp.envs.spaces import observation_space, observe
from gfp_grasp.errors import InvalidOption, NothingDetected, UnknownDetector
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import CollisionMesh, ConvexPart, DepthImage, Detection, OrientedBox, PointCloud, TrueObject


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return written_objects(tmp_path_factory.mktemp("objects"))


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


def test_vehicles_are_no_objects_of_a_table():
    task = task_of("traffic", limit=1)
    with pytest.raises(InvalidOption, match="'car-3' of it is nothing that a table holds: take household families"):
        task.draw(np.random.default_rng(0))


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
