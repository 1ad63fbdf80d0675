"""What an episode starts from: an object at rest, one depth view of it, and its completion."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.camera import apply_sensor, intrinsics, render_depth, sample_viewpoint
from gfp_grasp.complete import Completion
from gfp_grasp.completers import Completer, ToldTruth, needs_class
from gfp_grasp.detect import Detector
from gfp_grasp.envs.config import EnvConfig
from gfp_grasp.errors import AssetMissing, GfpGraspError, NothingDetected
from gfp_grasp.recognition import recognise
from gfp_grasp.scenes import TARGET, World
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import DepthImage, Detection, TrueObject, pixels_of

_UP = np.array([0.0, 0.0, 1.0])
# The camera looks at this share of the object's height.
_LOOK_AT = 0.4
_ABOVE_M = 5e-4  # the object is put down from so high


@dataclass(frozen=True)
class Randomisation:
    """Domain randomisation of one episode: what makes a grasp easy or hard besides the object's place.

    Attributes:
        mass_kg: Mass of the object.
        friction: Sliding friction coefficient of whatever touches it.
        grip_n: Force limit of each jaw.
    """

    mass_kg: float
    friction: float
    grip_n: float

    @classmethod
    def draw(cls, truth: TrueObject, config: EnvConfig, rng: np.random.Generator) -> Randomisation:
        """Draw from the ranges of a config."""
        share, friction, grip = rng.uniform(size=3)
        return cls(
            truth.mass_kg * (1 + config.mass_spread * (2 * share - 1)),
            config.friction_min + friction * (config.friction_max - config.friction_min),
            config.grip_min_n + grip * (config.grip_max_n - config.grip_min_n),
        )


@dataclass(frozen=True, eq=False)
class Episode:
    """One scene as it was drawn, seen and completed.

    Attributes:
        truth: The object.
        randomisation: Mass and friction of the object, and force of the jaws.
        T_world_object: Where it came to rest.
        image: The depth picture, with the sensor's noise.
        detection: What was found in it; None where nothing was.
        completion: The completed object; None where detection or completion failed.
        failure: Name and message of the error that ended detection, completion or its simulation; empty where none did.
        notes: Warnings given on the way.
    """

    truth: TrueObject
    randomisation: Randomisation
    T_world_object: np.ndarray
    image: DepthImage
    detection: Detection | None
    completion: Completion | None
    failure: str = ""
    notes: str = ""

    def true_mesh(self) -> trimesh.Trimesh:
        """The object's mesh where it came to rest."""
        return _at(self.truth, self.T_world_object)


def draw_episode(
    truth: TrueObject,
    world: World,
    detect: Detector,
    complete: Completer,
    config: EnvConfig,
    rng: np.random.Generator,
    *,
    T_start: np.ndarray | None = None,
    completion: Completion | None = None,
) -> Episode:
    """Put the object down at random, look at it from a random side, and complete it.

    Args:
        truth: The object.
        world: Compiled scene with the object, which is left settled.
        detect: The detector.
        complete: The completer.
        config: Camera and placing.
        rng: Draws the domain randomisation, yaw, place, view and noise, in this order.
        T_start: Where to put the object down instead of a random place.
        completion: Used in place of what the completer would give. The picture is then the one that it was made of,
            where that has the size of the config's; else one is taken, as without it.
    """
    drawn = Randomisation.draw(truth, config, rng)
    world.set_mass_and_friction(TARGET, drawn.mass_kg, drawn.friction)
    if T_start is None:
        yaw = rotation_about(_UP, rng.uniform(0, 2 * np.pi))
        T_start = make_T(yaw, [*rng.uniform(-config.spread_m, config.spread_m, 2), _ABOVE_M])
    world.settle({TARGET: T_start})
    T_world_object = world.pose(TARGET)
    if completion is not None:
        view = completion.detection.view
        if not isinstance(view, DepthImage) or view.shape != (config.image_height, config.image_width):
            view, _ = _look(world, truth, config, rng)
        return Episode(truth, drawn, T_world_object, view, completion.detection, completion)
    image, is_target = _look(world, truth, config, rng)
    detection, completed, failure = None, None, ""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            detection = _detection_of(detect(image, up=_UP), image, is_target)
            if needs_class(config.completer):
                detection = recognise(detection, config.library)
            completed = _complete(complete, detection, truth, T_world_object)
        except AssetMissing:  # says nothing of the object: the installation is broken
            raise
        except GfpGraspError as error:
            failure = f"{type(error).__name__}: {error}"
    told = [str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)]
    if completed is not None and completed.note:
        told.append(completed.note)
    return Episode(truth, drawn, T_world_object, image, detection, completed, failure, "; ".join(told))


def _look(
    world: World, truth: TrueObject, config: EnvConfig, rng: np.random.Generator
) -> tuple[DepthImage, np.ndarray]:
    """The depth picture from a random side, and which of its pixels (h, w) show the object."""
    T_world_camera = sample_viewpoint(
        rng,
        elevation_deg=(config.elevation_min_deg, config.elevation_max_deg),
        distance_m=config.distance_m,
        target=world.pose(TARGET)[:3, 3] + (0.0, 0.0, _LOOK_AT * float(truth.mesh.bounds[1, 2])),
    )
    K = intrinsics(config.image_width, config.image_height, config.fov_deg)
    # Rays, not OpenGL, so that one seed gives one picture on every machine.
    depth, geom = render_depth(
        world.model,
        world.data,
        K=K,
        width=config.image_width,
        height=config.image_height,
        T_world_camera=T_world_camera,
        backend="rays",
    )
    image = apply_sensor(DepthImage(depth, K, T_world_camera), config.sensor_model, rng)
    return image, np.append(world.geoms(TARGET), False)[geom]  # the last for -1, where there is nothing


def _detection_of(detections: Sequence[Detection], image: DepthImage, is_target: np.ndarray) -> Detection:
    """The detection with most pixels of the object: what is asked for has been pointed at."""
    shared = [int((_mask_of(detection, image) & is_target).sum()) for detection in detections]
    if not any(shared):
        raise NothingDetected("nothing of the object stands out from the table in this view")
    return detections[int(np.argmax(shared))]


def _mask_of(detection: Detection, image: DepthImage) -> np.ndarray:
    """Pixels (h, w) of a detection, by its mask or else by its points."""
    if detection.mask is not None:
        return detection.mask
    mask = np.zeros(image.depth_m.size, dtype=bool)
    mask[pixels_of(detection.cloud.points, image)[1]] = True
    return mask.reshape(image.shape)


def _complete(complete: Completer, detection: Detection, truth: TrueObject, T_world_object: np.ndarray) -> Completion:
    if isinstance(complete, ToldTruth):
        return complete.placed(detection, truth, T_world_object)
    return complete(detection)


def _at(truth: TrueObject, T_world_object: np.ndarray) -> trimesh.Trimesh:
    mesh = truth.mesh.copy()
    mesh.apply_transform(T_world_object)
    return mesh
