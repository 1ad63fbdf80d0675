"""Convex parts that stand for a mesh: CoACD or V-HACD in a guarded child process, or a template's parts carried along.

Importing this package loads neither engine nor scipy: the guard's child process imports it too, and starts faster so.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gfp_grasp.collision.budget import CollisionConfig
    from gfp_grasp.collision.carry import carry_parts
    from gfp_grasp.collision.choice import collision_of
    from gfp_grasp.collision.config import DecomposeConfig
    from gfp_grasp.collision.decomposition import decompose, hull
    from gfp_grasp.collision.levels import part_levels
    from gfp_grasp.collision.many import decompose_many

__all__ = [
    "CollisionConfig",
    "DecomposeConfig",
    "carry_parts",
    "collision_of",
    "decompose",
    "decompose_many",
    "hull",
    "part_levels",
]

_HOMES = {
    "CollisionConfig": "budget",
    "DecomposeConfig": "config",
    "carry_parts": "carry",
    "collision_of": "choice",
    "decompose": "decomposition",
    "decompose_many": "many",
    "hull": "decomposition",
    "part_levels": "levels",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
