"""The library call: a partial cloud in, a watertight mesh and its convex parts out, in the same frame, in metres."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.answers import Clock, CompleteConfig, answer
from gfp_grasp.arguments import checked_direction, checked_height, checked_place, checked_pose
from gfp_grasp.clouds import order_points
from gfp_grasp.completion import CompletedScene, Completion
from gfp_grasp.detect import (
    DetectConfig,
    Detector,
    clean_cloud,
    detect_single,
    get_detector,
    on_each_other,
    warn_of_a_plane_aside,
)
from gfp_grasp.errors import FitDiverged, InvalidOption, InvalidView, UnknownCategory
from gfp_grasp.level import level_frame, make_level_view, move_detection
from gfp_grasp.parallel import one_thread
from gfp_grasp.plugins import DEFAULT_DETECTOR, DEFAULT_SCAN_DETECTOR
from gfp_grasp.recognition import SURE_SCORE, class_is_given, likeliest, recognise, sureness
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import (
    UNKNOWN,
    DepthImage,
    Detection,
    RangeImage,
    SensorProfile,
    View,
    get_sensor,
)


@one_thread()
def complete_to_mesh(
    cloud: object,
    *,
    viewpoint: ArrayLike | None = None,
    up: ArrayLike | None = (0.0, 0.0, 1.0),
    support_height: float | None = None,
    view: View | None = None,
    mask: np.ndarray | None = None,
    category: str | None = None,
    sensor: str | SensorProfile = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> Completion:
    """Complete one object that was seen from one side.

    Args:
        cloud: (n, 3) array-like, m; also a trimesh or Open3D point cloud, or a torch tensor. Non-finite rows are
            dropped and counted in a warning, copies of a point count once.
        viewpoint: (3,) m, where the camera stood, same frame. Without it normals have no sign and nothing is known of
            free space, and the answer is less sure.
        up: (3,) normal of the support; None estimates it, from the plane under the object or else from the axes of
            the camera, and `completion.detection.up` reports the choice.
        support_height: Height of the support along up, m; None estimates it.
        view: All that the sensor saw, for the space that it saw to be free.
        mask: (h, w) bool, the object's pixels in the view.
        category: A class with a primitive; None lets the classifier and the fits choose.
        sensor: "tabletop" (a depth camera), "lidar", or a profile of your own: which noise and which sizes to expect.
        config: Switches.
        seed: Sets every random choice; the same seed gives the same answer, whatever the order of the points.

    Returns:
        The completion, in the frame of the cloud, m.

    Raises:
        InvalidCloud: Not an (n, 3) cloud in metres, or degenerate; viewpoint or up is no place or direction.
        TooFewPoints: Too few finite points.
        NothingDetected: Nothing stands above the support.
        InvalidView: View, mask and cloud do not fit each other.
        InvalidOption: Height, sensor, seed or config of the wrong type.
        UnknownCategory: No primitive of that class; the message lists those on offer.
        FitDiverged: No primitive could be fitted.
    """
    _check_options(config, seed)
    _check_category(category, config)
    if view is not None and not isinstance(view, (DepthImage, RangeImage)):
        raise InvalidView(f"view is a {type(view).__name__}; a gfp_grasp.types.DepthImage or RangeImage is expected")
    place, direction = checked_place(viewpoint), checked_direction(up)
    if place is None and view is not None:
        place = view.viewpoint
    height, profile = checked_height(support_height), get_sensor(sensor)
    start = time.perf_counter()
    points = order_points(clean_cloud(cloud, sensor=profile), seed=seed)
    detection, T_world_found = _detect(points, place, direction, height, view, mask, category, profile)
    seconds = time.perf_counter() - start
    return _complete(detection, T_world_found, config or CompleteConfig(), seed, timings_s={"detect": seconds})


@one_thread()
def complete_scene(
    image: DepthImage | RangeImage,
    *,
    up: ArrayLike | None = (0.0, 0.0, 1.0),
    detector: str | Detector | None = None,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> CompletedScene:
    """Complete every object of a depth picture or of a LiDAR's scan, largest first.

    Args:
        image: Depth, m, with intrinsics and pose; or a LiDAR's scan.
        up: (3,) normal of the support in the world frame; None estimates it.
        detector: Name of a detector, see `gfp_grasp.detect.get_detector`, or a function like `detect_objects`; None
            takes "votes" for a picture and "pointrcnn" for a scan. `gfp_grasp.detect.GivenBoxes` is one for a scan.
        config: Switches.
        seed: Sets every random choice.

    Returns:
        One completion an object, and what makes a scene of them; an object that no primitive fits is left out with a
        warning.

    Raises:
        NothingDetected: No object stands out from the support.
        FitDiverged: No primitive fits any object.
        InvalidView: Neither of these, a scan for a detector of pictures or the other way round, or a camera so far
            from the origin that its pose cannot be in metres.
        UnknownDetector: No detector of that name.
        InvalidOption: The detector returned something else than detections.
    """
    _check_options(config, seed)
    if not isinstance(image, (DepthImage, RangeImage)):
        raise InvalidView(f"image is a {type(image).__name__}; a gfp_grasp.types.DepthImage or RangeImage is expected")
    if isinstance(image, DepthImage):
        checked_pose(image.T_world_camera)
    detector = detector or (DEFAULT_SCAN_DETECTOR if isinstance(image, RangeImage) else DEFAULT_DETECTOR)
    done, failure = [], None
    for detection in on_each_other(get_detector(detector)(image, up=checked_direction(up))):
        try:
            done.append(complete_detection(detection, config=config, seed=seed))
        except FitDiverged as error:
            warnings.warn(f"an object was left out: {error}", stacklevel=3)
            failure = error
    if failure is not None and not done:
        raise FitDiverged(f"no object of the picture could be completed; the last: {failure}")
    return CompletedScene.of(done, image)


@one_thread()
def complete_detection(detection: Detection, *, config: CompleteConfig | None = None, seed: int = 0) -> Completion:
    """Complete a detected object: registration of the likely classes, choice, deformation.

    Args:
        detection: One object, world frame.
        config: Switches.
        seed: Sets every random choice.

    Raises:
        TooFewPoints: Too few points.
        FitDiverged: No primitive could be fitted.
    """
    return _complete(detection, np.eye(4), config or CompleteConfig(), seed, timings_s={})


def _detect(
    points: np.ndarray,
    viewpoint: np.ndarray | None,
    up: np.ndarray | None,
    support_height: float | None,
    view: View | None,
    mask: np.ndarray | None,
    category: str | None,
    sensor: SensorProfile,
) -> tuple[Detection, np.ndarray]:
    """The object of the points, and T_world_found (4, 4) of the frame that it was found in.

    Where up is known that frame is level, and grids do not depend on the caller's axes.
    """
    config = DetectConfig(sensor=sensor, classify=False)
    if up is None:
        found = detect_single(
            points,
            viewpoint=viewpoint,
            up=None,
            support_height=support_height,
            view=view,
            mask=mask,
            category=category,
            config=config,
        )
        return found, np.eye(4)
    if view is None and support_height is None:
        warn_of_a_plane_aside(points, up, viewpoint=viewpoint, sensor=sensor)
    T_world_level = level_frame(points, up, viewpoint)
    T_level_world = invert_T(T_world_level)
    found = detect_single(
        order_points(apply_T(T_level_world, points)),
        viewpoint=None if viewpoint is None else apply_T(T_level_world, viewpoint),
        support_height=None if support_height is None else support_height - float(up @ T_world_level[:3, 3]),
        view=None if view is None else view.moved(T_level_world),
        mask=mask,
        category=category,
        config=config,
    )
    return found, T_world_level


def _complete(
    detection: Detection,
    T_world_found: np.ndarray,
    config: CompleteConfig,
    seed: int,
    *,
    timings_s: dict[str, float],
) -> Completion:
    """Complete a detection that was found in some frame; the completion and its detection are in the world's."""
    clock = Clock(timings_s)
    detection = recognise(detection, config.library)
    clock.lap("detect")
    # Everything below runs in a frame tied to the object and the viewer, so that the answer moves with its input.
    view = make_level_view(detection, seed=seed)
    clock.lap("level")
    shape = answer(view, detection, config, clock)
    if shape.fit is not None and sureness(detection.scores, config.library) < SURE_SCORE:
        told = ", ".join(f"{name} {score:.2f}" for name, score in likeliest(detection.scores, 3))
        warnings.warn(f"no known class is likely ({told}); the best is completed all the same", stacklevel=4)
    if shape.fit is None and not class_is_given(detection):
        detection = replace(detection, category=UNKNOWN)
    shape = shape.moved(T_world_found @ view.T_world_level)
    return Completion(
        replace(shape, timings_s=clock.laps),
        move_detection(detection, T_world_found),
        collision_config=config.collision,
    )


def _check_category(category: str | None, config: CompleteConfig | None) -> None:
    known = (config or CompleteConfig()).library.categories
    if category is not None and category not in known:
        raise UnknownCategory(
            f"there is no primitive of {category!r}; there are {', '.join(known)}. A class of your own: gfp-grasp gps "
            "build, then CompleteConfig(library=PrimitiveLibrary.with_shipped(FOLDER))"
        )


def _check_options(config: object, seed: object) -> None:
    if config is not None and not isinstance(config, CompleteConfig):
        raise InvalidOption(f"config is a {type(config).__name__}; a CompleteConfig is expected")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InvalidOption(f"seed is {seed!r}; a whole number from 0 on is expected")


__all__ = ["CompleteConfig", "Completion", "complete_detection", "complete_scene", "complete_to_mesh"]
