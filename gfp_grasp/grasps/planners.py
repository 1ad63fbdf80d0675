"""Planners by name."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Protocol, cast

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.plan import Graspable, plan_grasps
from gfp_grasp.grasps.top_down import plan_top_down
from gfp_grasp.types import Grasp


class Planner(Protocol):
    """A function from a completion to at most num grasps, best first, world frame."""

    def __call__(self, completion: Graspable, num: int, *, seed: int) -> Sequence[Grasp]: ...


PLANNERS: dict[str, Planner] = {"antipodal": plan_grasps, "top-down": plan_top_down}


def planner(name: str) -> Planner:
    """A planner by name.

    Args:
        name: `antipodal` (`plan_grasps`), `top-down` (`plan_top_down`), or `package.module:function`, a function like
            these two.

    Raises:
        InvalidOption: It is none of these, or cannot be imported.
    """
    if name in PLANNERS:
        return PLANNERS[name]
    legal = f"{', '.join(PLANNERS)}, or package.module:function"
    module_name, colon, function_name = name.partition(":")
    if not (module_name and colon and function_name):
        raise InvalidOption(f"there is no planner {name!r}: expected {legal}")
    try:
        function = getattr(import_module(module_name), function_name)
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise InvalidOption(f"planner {name!r} cannot be imported ({error}): expected {legal}") from error
    if not callable(function):
        raise InvalidOption(f"planner {name!r} is a {type(function).__name__}, not a function of a completion")
    return cast(Planner, function)
