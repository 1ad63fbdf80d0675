"""Generic Primitives: building them from meshes of a class, loading the ones that ship."""

from gfp_grasp.primitives.build import BuildConfig, build_primitive
from gfp_grasp.primitives.store import list_primitives, load_primitive, read_primitive, save_primitive

__all__ = [
    "BuildConfig",
    "build_primitive",
    "list_primitives",
    "load_primitive",
    "read_primitive",
    "save_primitive",
]
