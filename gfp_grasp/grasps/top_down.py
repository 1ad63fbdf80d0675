"""The heuristic that many robots run: straight down onto the middle of what was seen, jaws across its narrow side."""

from __future__ import annotations

import numpy as np

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.surface import Graspable
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import Grasp

_DEPTH_M = 0.02  # below the top, where the support allows it
_YAWS_DEG = (0.0, 20.0, -20.0, 45.0, -45.0, 70.0, -70.0, 90.0)


def plan_top_down(
    completion: Graspable, num: int = 16, *, seed: int = 0, config: GraspConfig | None = None
) -> tuple[Grasp, ...]:
    """Vertical grasps over the middle of the observed points; the completed shape is not looked at.

    Args:
        completion: World frame; only its detection is used.
        num: Grasps wanted, at most.
        seed: Unused; every planner has it.
        config: Gripper, clearances and the height above the table.

    Returns:
        Up to num grasps, those across the narrowest width first; none where the jaws take no width.

    Raises:
        InvalidOption: num is not positive.
    """
    del seed
    if num < 1:
        raise InvalidOption(f"num is {num}; a positive number of grasps is expected")
    config = config or GraspConfig()
    detection = completion.detection
    points, up = np.asarray(detection.cloud.points), detection.up / np.linalg.norm(detection.up)
    if len(points) < 3:
        return ()
    across = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    across /= np.linalg.norm(across)
    flat = np.column_stack([across, np.cross(up, across)])
    _, axes = np.linalg.eigh(np.cov((points @ flat).T))
    narrow = flat @ axes[:, 0]
    heights = points @ up
    floor = detection.support.height_m if detection.support is not None else float(heights.min())
    reach_m = config.gripper.pad.low_high[1, 2] + config.table_clearance_m
    height = max(float(heights.max()) - _DEPTH_M, floor + reach_m)
    found = []
    for yaw in np.deg2rad(_YAWS_DEG):
        closing = rotation_about(up, yaw) @ narrow
        side = np.cross(closing, -up)
        low, high = np.quantile(points @ closing, (0.01, 0.99))
        ahead = np.quantile(points @ side, (0.01, 0.99)).mean()
        width = float(high - low)
        if width > config.max_width_m:
            continue
        origin = closing * (low + high) / 2 + side * ahead + up * height
        opening = min(width + 2 * config.jaw_clearance_m, config.gripper.stroke_m)
        R = np.column_stack([side, closing, -up])
        found.append(Grasp(make_T(R, origin), opening, 1.0 - width / config.gripper.stroke_m))
    return tuple(sorted(found, key=lambda grasp: -grasp.quality)[:num])
