"""Completion of things of no class: a network that knows cells of space, not classes."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.classfree.grid import NUM_CHANNELS, REACH, Grid, channels, grid_around
from gfp_grasp.classfree.hull import complete_hull, hull_of, refined

if TYPE_CHECKING:
    from gfp_grasp.classfree.complete import complete_classfree, complete_level
    from gfp_grasp.classfree.network import DistanceNet, load_network

__all__ = [
    "NUM_CHANNELS",
    "REACH",
    "DistanceNet",
    "Grid",
    "channels",
    "complete_classfree",
    "complete_hull",
    "complete_level",
    "grid_around",
    "hull_of",
    "load_network",
    "refined",
]

# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    **dict.fromkeys(("complete_classfree", "complete_level"), "complete"),
    **dict.fromkeys(("DistanceNet", "load_network"), "network"),
}


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.classfree.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
