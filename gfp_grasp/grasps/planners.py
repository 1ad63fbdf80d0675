"""Planners by name, and the heuristic that many robots run.

The heuristic goes straight down onto the middle of what was seen, its jaws across the narrow side.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol, cast

import numpy as np

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.contact import Graspable
from gfp_grasp.grasps.plan import plan_grasps
from gfp_grasp.plugins import imported_function
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


class Planner(Protocol):
    """A function from a completion to at most num grasps, best first, world frame."""

    def __call__(self, completion: Graspable, num: int, *, seed: int) -> Sequence[Grasp]: ...


# For this planner a guessed surface is as good as one that was seen, and what is hidden is free.
_TRUSTING = GraspConfig(doubt_length_m=float("inf"), hidden_preference=1.0)
PLANNERS: dict[str, Planner] = {
    "antipodal": plan_grasps,
    "trusting": partial(plan_grasps, config=_TRUSTING),
    "top-down": plan_top_down,
}


def get_planner(name: str) -> Planner:
    """A planner by name.

    Args:
        name: `antipodal` (`plan_grasps`), `trusting` (the same, with no price on what was not seen), `top-down`
            (`plan_top_down`), or `package.module:function`, a function like these.

    Raises:
        InvalidOption: It is none of these, or cannot be imported.
    """
    if name in PLANNERS:
        return PLANNERS[name]
    on_offer = ", ".join(PLANNERS)
    function = imported_function(name, what="planner", of="a completion", on_offer=on_offer, error=InvalidOption)
    return cast(Planner, function)
