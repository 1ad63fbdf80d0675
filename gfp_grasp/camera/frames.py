"""Which way a sensor looks in the frame of its points: there are several habits, and most can be told apart.

Sources: OpenCV, "Camera calibration and 3D reconstruction"; OpenGL, and PLY files that RealSense's viewer exports; ROS,
REP 103 for the body of a sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

_ALL = 0.01  # share of points that may be strays on the wrong side


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """How the axes of a frame lie whose origin is a sensor.

    Attributes:
        name: For messages.
        R_frame_opencv: (3, 3) turns OpenCV's camera frame (x right, y down, z forward) into this one.
    """

    name: str
    R_frame_opencv: np.ndarray


OPENCV = SensorFrame("OpenCV's camera frame, y down and z forward", np.eye(3))
OPENGL = SensorFrame("OpenGL's camera frame, y up and z backward, as RealSense exports PLY", np.diag([1.0, -1.0, -1.0]))
ROS_BODY = SensorFrame(
    "a ROS sensor's body frame, x forward and z up", np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
)


def sensor_frame(points: ArrayLike) -> SensorFrame | None:
    """The frame in which a sensor at the origin saw these points, told by the axis that they lie along.

    Args:
        points: (..., 3) m; NaN and zeros are passed over.

    Returns:
        The frame; None where the points lie around the origin or along an axis along which no habit looks.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1) & points.any(axis=1)]
    if len(points) == 0:
        return None
    low, high = np.quantile(points, (_ALL, 1 - _ALL), axis=0)
    axis = int(np.argmax(np.abs(np.median(points, axis=0))))
    sides = {(2, 1): OPENCV, (2, -1): OPENGL, (0, 1): ROS_BODY}
    side = 1 if low[axis] > 0 else -1 if high[axis] < 0 else 0
    return sides.get((axis, side))
