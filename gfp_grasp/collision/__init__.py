"""Convex parts that stand for a mesh: made by CoACD, V-HACD or plane cuts, or a primitive's parts deformed with it.

The way to the parts of a completed shape is `collision_of`, to those of any mesh `decompose`. Importing this package
loads neither engine nor scipy: the child process of an engine imports it too, and starts faster so.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gfp_grasp.collision.choice import collision_of, with_binding
    from gfp_grasp.collision.config import CollisionConfig, DecomposeConfig
    from gfp_grasp.collision.convex import MIN_THICKNESS_M, convex_part, within_bounds
    from gfp_grasp.collision.cutting import cut_parts, quick_parts
    from gfp_grasp.collision.decomposition import decompose, decompose_many, hull, part_levels
    from gfp_grasp.collision.deformed import deform_parts
    from gfp_grasp.collision.engines.guard import close_workers, idle_pids
    from gfp_grasp.collision.fidelity import union_error_m
    from gfp_grasp.collision.parts import parts_from_arrays, parts_to_arrays, within_parts
    from gfp_grasp.collision.store import CACHE_VARIABLE, key_of, read_parts, write_parts

__all__ = [
    "CACHE_VARIABLE",
    "MIN_THICKNESS_M",
    "CollisionConfig",
    "DecomposeConfig",
    "close_workers",
    "collision_of",
    "convex_part",
    "cut_parts",
    "decompose",
    "decompose_many",
    "deform_parts",
    "hull",
    "idle_pids",
    "key_of",
    "part_levels",
    "parts_from_arrays",
    "parts_to_arrays",
    "quick_parts",
    "read_parts",
    "union_error_m",
    "with_binding",
    "within_bounds",
    "within_parts",
    "write_parts",
]

_HOMES = {
    "CACHE_VARIABLE": "store",
    "MIN_THICKNESS_M": "convex",
    "CollisionConfig": "config",
    "DecomposeConfig": "config",
    "close_workers": "engines.guard",
    "collision_of": "choice",
    "convex_part": "convex",
    "cut_parts": "cutting",
    "decompose": "decomposition",
    "decompose_many": "decomposition",
    "deform_parts": "deformed",
    "hull": "decomposition",
    "idle_pids": "engines.guard",
    "key_of": "store",
    "part_levels": "decomposition",
    "parts_from_arrays": "parts",
    "parts_to_arrays": "parts",
    "quick_parts": "cutting",
    "read_parts": "store",
    "union_error_m": "fidelity",
    "with_binding": "choice",
    "within_bounds": "convex",
    "within_parts": "parts",
    "write_parts": "store",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
