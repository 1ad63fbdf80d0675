"""The environment on episodes that are known: its defaults, its infos, what it asks of camera, detector and task."""

from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pytest
from bodies import box_part, l_shape

from gfp_grasp.camera import SensorModel, intrinsics
from gfp_grasp.completers import Oracle
from gfp_grasp.envs import EnvConfig, Randomisation, episode
from gfp_grasp.envs.episode import draw_episode
from gfp_grasp.errors import AssetMissing, FitDiverged, InvalidOption
from gfp_grasp.scenes import TARGET
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import CollisionMesh, DepthImage, TrueObject

POSE = make_T(rotation_about((0, 0, 1), 0.4), (0.01, -0.02, 0.003))
PART = box_part([0, 0, 0], [0.1, 0.06, 0.02])
TRUTH = TrueObject("ell", "mug", l_shape(), CollisionMesh((PART,), (0.1, 0.2, 0.3), "cuts", 7.0, {"a": 1}), 0.2, 0.5)


def test_the_defaults_of_the_environment():
    assert asdict(EnvConfig()) == {
        **{"objects": "all", "gps": "", "completer": "gfpnet", "detector": "tabletop", "world": "true"},
        **{"split": "test", "limit": 0, "clutter": 0, "num_points": 2048, "image_width": 320, "image_height": 240},
        **{"fov_deg": 35.0, "distance_m": 0.6, "elevation_min_deg": 20.0, "elevation_max_deg": 60.0},
        **{"sensor": "gaussian", "noise_m": 0.001, "mass_spread": 0.25, "friction_min": 0.4, "friction_max": 1.0},
        **{"grip_min_n": 25.0, "grip_max_n": 35.0, "spread_m": 0.05, "margin_trials": 0, "render_mode": None},
    }


def test_sensors_have_their_names():
    sensors = {"ideal": SensorModel(), "realsense": SensorModel.realsense(), "kinect": SensorModel.kinect()}
    for name, sensor in sensors.items():
        assert EnvConfig(sensor=name).sensor_model == sensor
    assert EnvConfig(noise_m=0.004).sensor_model == SensorModel.gaussian(0.004)


@pytest.mark.parametrize(
    "options",
    [
        {"fov_deg": 180.0},
        {"fov_deg": 0.0},
        {"elevation_min_deg": -90.0},
        {"elevation_max_deg": 90.0},
        {"elevation_min_deg": 61.0},
        {"mass_spread": 1.0},
        {"friction_min": 0.0},
        {"friction_min": 1.1},
        {"grip_min_n": 0.0},
        {"grip_max_n": 24.0},
        {"distance_m": 0.0},
        {"num_points": 0},
        {"image_width": 0},
        {"image_height": 0},
        {"spread_m": -0.01},
        {"noise_m": -0.01},
        {"clutter": -1},
        {"margin_trials": -1},
        {"limit": -1},
    ],
)
def test_options_at_the_end_of_their_range_are_refused(options):
    with pytest.raises(InvalidOption, match=next(iter(options)).split("_")[0]):
        EnvConfig(**options)


def test_options_just_within_their_range_are_taken():
    config = EnvConfig(
        fov_deg=179.0,
        elevation_min_deg=-89.0,
        elevation_max_deg=-89.0,
        mass_spread=0.0,
        friction_min=0.1,
        friction_max=0.1,
        grip_min_n=1.0,
        grip_max_n=1.0,
        num_points=1,
        image_width=1,
        image_height=1,
        spread_m=0.0,
        noise_m=0.0,
    )
    assert config.elevation_min_deg == config.elevation_max_deg


class World:
    """A scene in which the object is found where POSE says; what was done to it."""

    def __init__(self) -> None:
        self.model, self.data, self.asked = "model", "data", []

    def set_mass_and_friction(self, *which):
        self.asked.append(("mass", which))

    def settle(self, T):
        self.asked.append(("settle", T[TARGET].round(9).tolist(), list(T)))

    def pose(self, name):
        assert name == TARGET
        return POSE

    def geoms(self, name):
        assert name == TARGET
        return np.array([False, True, True, False])


class Found:
    """A detection by its mask."""

    def __init__(self, mask: np.ndarray) -> None:
        self.mask = mask


GEOM = np.array([[-1, 0, 1, 2], [2, 1, 3, -1]])
CONFIG = EnvConfig(image_width=4, image_height=2, completer="mirror", distance_m=0.7, noise_m=0.002, fov_deg=40.0)
IMAGE = DepthImage(np.full((2, 4), 0.5), intrinsics(4, 2, 40.0), np.eye(4))


@pytest.fixture
def seen(monkeypatch) -> list:
    """What was asked of the camera, which sees GEOM."""
    seen = []

    def viewpoint(rng, **how):
        seen.append(("viewpoint", how))
        return np.eye(4)

    def render(*which, **how):
        seen.append(("render", which, how))
        return np.full((2, 4), 0.5), GEOM

    def sense(image, sensor, rng):
        seen.append(("sensor", sensor))
        return image

    monkeypatch.setattr(episode, "sample_viewpoint", viewpoint)
    monkeypatch.setattr(episode, "render_depth", render)
    monkeypatch.setattr(episode, "apply_sensor", sense)
    return seen


def mask(*columns: int) -> np.ndarray:
    mask = np.zeros((2, 4), bool)
    mask[:, list(columns)] = True
    return mask


class Done(NamedTuple):
    """Stands for a completion."""

    detection: Any
    note: str = ""


def drawn(world=None, complete: Any = Done, detect=None, **how: Any):
    """An episode, in which the second of two detections is that of the object."""
    found = (Found(mask(3)), Found(mask(1, 2)))
    detect = detect or (lambda image, *, up: found if up.tolist() == [0, 0, 1] else ())
    rng = np.random.default_rng(8)
    return draw_episode(TRUTH, world or World(), detect, complete, CONFIG, rng, **how), found  # type: ignore[arg-type]


def test_an_episode_is_drawn_put_down_seen_and_completed(seen):
    world = World()
    made, found = drawn(world)
    rng = np.random.default_rng(8)
    randomisation = Randomisation.draw(TRUTH, CONFIG, rng)
    yaw, place = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), rng.uniform(-0.05, 0.05, 2)
    assert world.asked == [
        ("mass", (TARGET, randomisation.mass_kg, randomisation.friction)),
        ("settle", make_T(yaw, (*place, 5e-4)).round(9).tolist(), [TARGET]),
    ]
    assert (made.truth, made.randomisation, made.failure, made.notes) == (TRUTH, randomisation, "", "")
    assert made.detection is found[1]
    assert made.completion == Done(found[1])
    np.testing.assert_array_equal(made.T_world_object, POSE)
    np.testing.assert_allclose(made.true_mesh().center_mass, (POSE @ [*TRUTH.mesh.center_mass, 1])[:3])
    (_, how), (_, scene, camera), (_, sensor) = seen
    assert (how.pop("elevation_deg"), how.pop("distance_m")) == ((20.0, 60.0), 0.7)
    np.testing.assert_allclose(how.pop("target"), POSE[:3, 3] + [0, 0, 0.4 * 0.02])
    assert (how, scene) == ({}, ("model", "data"))
    np.testing.assert_array_equal(camera.pop("K"), IMAGE.K)
    np.testing.assert_array_equal(camera.pop("T_world_camera"), np.eye(4))
    assert camera == {"width": 4, "height": 2, "backend": "rays"}
    assert sensor == SensorModel.gaussian(0.002)


def test_a_start_that_is_given_is_taken(seen):
    world = World()
    drawn(world, T_start=POSE)
    assert world.asked[1] == ("settle", POSE.round(9).tolist(), [TARGET])


def test_an_error_is_told_with_its_name_and_warnings_are_notes(seen):
    def complains(detection):
        import warnings

        warnings.warn("far away", stacklevel=1)
        warnings.warn("and small", stacklevel=1)
        warnings.warn("old", DeprecationWarning, stacklevel=1)
        raise FitDiverged("nothing fits")

    made, found = drawn(complete=complains)
    assert (made.detection, made.completion) == (found[1], None)
    assert (made.failure, made.notes) == ("FitDiverged: nothing fits", "far away; and small")
    made, found = drawn(complete=lambda detection: Done(detection, "it is of no class"))
    assert (made.failure, made.notes) == ("", "it is of no class")
    made, _ = drawn(detect=lambda image, up: (Found(mask(3)), Found(mask(0) & False)))
    assert made.detection is not None  # one pixel of the object is enough
    made, _ = drawn(detect=lambda image, up: (Found(mask(0) & False),))
    assert (made.detection, made.completion) == (None, None)
    assert made.failure == "NothingDetected: nothing of the object stands out from the table in this view"

    def broken(detection):
        raise AssetMissing("no weights")

    with pytest.raises(AssetMissing):
        drawn(complete=broken)


def test_the_oracle_is_given_the_truth_where_it_lies(seen):
    asked = []

    class Told(Oracle):
        def __call__(self, detection, truth=None, collision=None):
            asked.append((truth, collision))
            return Done("told")  # type: ignore[return-value]

    made, _ = drawn(complete=Told())
    assert made.completion == Done("told")
    (truth, collision) = asked[0]
    np.testing.assert_allclose(truth.vertices, made.true_mesh().vertices)
    np.testing.assert_allclose(collision.parts[0].vertices, PART.vertices @ POSE[:3, :3].T + POSE[:3, 3])
    assert (collision.error_m, collision.made_by, collision.seconds) == ((0.1, 0.2, 0.3), "cuts", 7.0)
    assert collision.notes == {"a": 1}
