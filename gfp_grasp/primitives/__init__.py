"""Generic Primitives: building them from meshes of a class, measuring them, loading the ones that ship."""

from gfp_grasp.primitives.build import BuildConfig, build_primitive, with_parts
from gfp_grasp.primitives.evaluate import PrimitiveReport, fit_full_surface, measure_primitive
from gfp_grasp.primitives.library import PrimitiveLibrary
from gfp_grasp.primitives.mls import project
from gfp_grasp.primitives.pose import bring_into_one_pose
from gfp_grasp.primitives.regions import detect_symmetry
from gfp_grasp.primitives.store import read_primitive, save_primitive

__all__ = [
    "BuildConfig",
    "PrimitiveLibrary",
    "PrimitiveReport",
    "bring_into_one_pose",
    "build_primitive",
    "detect_symmetry",
    "fit_full_surface",
    "measure_primitive",
    "project",
    "read_primitive",
    "save_primitive",
    "with_parts",
]
