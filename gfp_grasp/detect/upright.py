"""Which way is up for an object without a table: from what the frame makes likely, and how the object looks then."""

from __future__ import annotations

import warnings

import numpy as np

from gfp_grasp.camera import sensor_frame
from gfp_grasp.clouds import estimate_normals, thin
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import DepthImage, RangeImage, View

UP = np.array([0.0, 0.0, 1.0])

# Angles of a camera above the horizon that are tried where neither up nor a table is known.
_ELEVATIONS_DEG = np.arange(0.0, 80.0, 2.5)
_COARSE_ELEVATIONS_DEG = (30.0, 15.0, 45.0, 0.0, 60.0)  # for the classifier, which is slow
_AT_ORIGIN_M = 0.01  # a viewpoint this near to the origin says that the frame is a camera's
# The axis of something round stands out: elsewhere the normals pass it at more than the distance at the axis over this.
_ROUND = 0.8
_NUM_POINTS, _NUM_NEIGHBOURHOOD = 1500, 4000
_STEEP = 0.3  # least share of a normal that is level: others say nothing of where the axis is
_FARTHEST = 0.1  # distance from the axis, as a share of the object, beyond which a normal counts no more
_NUM_ROUNDS = 8


def guess_up(points: np.ndarray, viewpoint: np.ndarray | None, view: View | None) -> np.ndarray:
    """The likely up (3,) of an object alone; a warning says which, and what the frame was taken for.

    The camera is taken to be level, and its elevation to be the one at which the object is most like a surface of
    revolution, all of whose normals pass through its axis (Pottmann and Randrup, 1998); where none stands out, the
    elevation at which the classifier is surest decides.
    """
    ups, coarse, frame = _possible_ups(points, viewpoint, view)
    up = _axis_of_revolution(points, viewpoint, ups) if len(ups) > len(coarse) else None
    up = _most_familiar(points, viewpoint, coarse) if up is None else up
    told = ", ".join(f"{value + 0.0:.2f}" for value in up)
    warnings.warn(
        f"no support was seen: up is guessed to be ({told}) by what the object looks like, in {frame}; give up if it "
        "is known",
        stacklevel=4,
    )
    return up


def _possible_ups(
    points: np.ndarray, viewpoint: np.ndarray | None, view: View | None
) -> tuple[list[np.ndarray], list[np.ndarray], str]:
    """Ups that the frame makes likely, a few of them for the classifier, and what the frame was taken for.

    They are those of a level camera at all elevations, and z too with a view; the axes of a frame that is no camera's.
    """
    if view is None and viewpoint is not None and np.linalg.norm(viewpoint) > _AT_ORIGIN_M:
        toward = np.asarray(viewpoint) - points.mean(axis=0)
        # Most worlds have z up, and a camera looks at a table from above.
        ups = [UP] if toward @ UP > 0 else [up for up in np.vstack([np.eye(3), -np.eye(3)]) if up @ toward > 0]
        return ups, ups, "a frame of its own, whose origin the viewpoint is not"
    if isinstance(view, RangeImage):
        return [view.T_world_sensor[:3, 2]], [view.T_world_sensor[:3, 2]], "the sensor's frame"
    if isinstance(view, DepthImage):
        R, name = view.T_world_camera[:3, :3], "the frame of the view's camera"
    else:
        frame = sensor_frame(points)
        R = np.eye(3) if frame is None else frame.R_frame_opencv
        name = "a frame that may be OpenCV's, y down and z forward" if frame is None else frame.name
    more = [] if view is None else [UP]
    return [*_level_ups(R, _ELEVATIONS_DEG), *more], [*_level_ups(R, _COARSE_ELEVATIONS_DEG), *more], name


def _level_ups(R: np.ndarray, elevations_deg: np.ndarray | tuple[float, ...]) -> list[np.ndarray]:
    """Up of a level camera that looks down by each of these angles; R (3, 3) turns its OpenCV frame into the world."""
    return [R @ np.array([0.0, -np.cos(e), -np.sin(e)]) for e in np.radians(elevations_deg)]


def _axis_of_revolution(points: np.ndarray, viewpoint: np.ndarray | None, ups: list[np.ndarray]) -> np.ndarray | None:
    """The up about which the points are most like a surface of revolution; None where it does not stand out."""
    neighbourhood = thin(points, _NUM_NEIGHBOURHOOD)
    chosen = thin(neighbourhood, _NUM_POINTS)
    normals = estimate_normals(neighbourhood, chosen, viewpoint)
    passing = np.array([_distance_from_axis(chosen, normals, up) for up in ups])
    best = int(np.argmin(passing))
    return ups[best] if passing[best] < _ROUND * np.median(passing) else None


def _distance_from_axis(points: np.ndarray, normals: np.ndarray, up: np.ndarray) -> float:
    """Mean distance at which the lines along the normals pass the best axis along up, as seen from above, m."""
    R = rotation_between(up, (0.0, 0.0, 1.0))[:2]
    ground, level = points @ R.T, normals @ R.T
    length = np.linalg.norm(level, axis=1)
    says = length > _STEEP
    if says.sum() < 10:
        return np.inf
    ground, level = ground[says], level[says] / length[says, None]
    across = np.stack([-level[:, 1], level[:, 0]], axis=1)
    offset = np.einsum("ni,ni->n", across, ground)
    most_m = _FARTHEST * float(np.ptp(points, axis=0).max())
    weight = np.ones(len(across))
    for _ in range(_NUM_ROUNDS):  # least absolute distances, so that a handle does not pull the axis
        axis = np.linalg.lstsq(across * weight[:, None], offset * weight, rcond=None)[0]
        distance = np.abs(across @ axis - offset)
        weight = 1 / np.sqrt(np.maximum(distance, 0.05 * most_m))
    return float(np.minimum(distance, most_m).mean())  # pyright: ignore[reportPossiblyUnboundVariable]


def _most_familiar(points: np.ndarray, viewpoint: np.ndarray | None, ups: list[np.ndarray]) -> np.ndarray:
    from gfp_grasp.detect.classifier import classify  # torch, only where it is asked for

    return max(ups, key=lambda up: max(classify(points, up, viewpoint=viewpoint).values()))
