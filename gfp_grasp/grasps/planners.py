"""Planners by name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Protocol, cast

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.plan import plan_grasps
from gfp_grasp.grasps.surface import Graspable
from gfp_grasp.grasps.top_down import plan_top_down
from gfp_grasp.plugins import imported_function
from gfp_grasp.types import Grasp


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
