"""Places, directions and heights that a caller gives, checked."""

from __future__ import annotations

import numpy as np

from gfp_grasp.detect import numbers_of
from gfp_grasp.errors import InvalidCloud, InvalidOption, InvalidView
from gfp_grasp.units import unit_advice

_FARTHEST_M = 1e12  # from any origin: beyond it metres have no decimals and squares overflow
_FARTHEST_CAMERA_M = 100.0  # from its world's origin; in millimetres, one over a table is at 300 and more


def _checked_vector(value: object, name: str) -> np.ndarray | None:
    if value is None:
        return None
    vector = numbers_of(value, name)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        came = vector.tolist() if vector.size < 9 else f"an array of shape {vector.shape}"
        raise InvalidCloud(f"{name} is {came}; three finite numbers are expected")
    return vector


def checked_place(viewpoint: object) -> np.ndarray | None:
    vector = _checked_vector(viewpoint, "viewpoint")
    if vector is not None and np.abs(vector).max() > _FARTHEST_M:
        raise InvalidCloud(f"viewpoint is {vector.tolist()}: metres in the frame of the cloud are expected")
    return vector


def checked_direction(up: object) -> np.ndarray | None:
    vector = _checked_vector(up, "up")
    if vector is None:
        return None
    longest = np.abs(vector).max()
    if longest < 1e-9:
        raise InvalidCloud("up has no length: give the direction that is up, e.g. (0, 0, 1), or None to estimate it")
    vector = vector / longest  # first, so that no square overflows
    return vector / np.linalg.norm(vector)


def checked_height(value: object) -> float | None:
    if value is None:
        return None
    try:
        height = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidOption(f"support_height is {value!r}; a number in metres is expected") from error
    if not np.isfinite(height):
        raise InvalidOption(f"support_height is {height}; a finite number in metres, or None, is expected")
    return height


def checked_pose(T_world_camera: np.ndarray) -> np.ndarray:
    """The pose (4, 4) of a depth camera, if it can be in metres."""
    away_m = float(np.linalg.norm(T_world_camera[:3, 3]))
    if away_m > _FARTHEST_CAMERA_M:
        advice = unit_advice(away_m, least_m=0.1, most_m=20.0)
        raise InvalidView(
            f"T_world_camera puts the camera {away_m:.4g} m from the world's origin, and metres are expected, at most "
            f"{_FARTHEST_CAMERA_M:g}: {advice}; if the world is a map, move its origin near to the table"
        )
    return T_world_camera
