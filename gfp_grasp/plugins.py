"""Functions of the user's own, by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from gfp_grasp.errors import GfpGraspError

DEFAULT_DETECTOR = "votes"  # finds the objects of a picture where nothing is said,
DEFAULT_SCAN_DETECTOR = "pointrcnn"  # and those of a LiDAR's scan


def imported_function(
    name: str, *, what: str, of: str, on_offer: str, error: type[GfpGraspError]
) -> Callable[..., Any]:
    """The function that `package.module:function` names.

    Args:
        name: "package.module:function".
        what: What the function is meant to be, for messages.
        of: What it is a function of, for messages.
        on_offer: Names that need no import, for messages.
        error: Type of the error that is raised where there is no such function; its message lists what is legal.
    """
    module_name, colon, function_name = name.partition(":")
    legal = f"{on_offer}, or package.module:function"
    if not (module_name and colon and function_name):
        raise error(f"there is no {what} {name!r}: expected {legal}")
    try:
        function = getattr(import_module(module_name), function_name)
    except (ImportError, AttributeError, TypeError, ValueError) as reason:
        raise error(f"{what} {name!r} cannot be imported ({reason}): expected {legal}") from reason
    if not callable(function):
        raise error(f"{what} {name!r} is a {type(function).__name__}, not a function of {of}")
    return function
