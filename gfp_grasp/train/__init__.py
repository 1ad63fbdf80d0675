"""Building primitives and training networks, from procedural families or from any folder of meshes."""

from gfp_grasp.train.primitives import build_from_folder, build_from_shapes, with_spec

__all__ = ["build_from_folder", "build_from_shapes", "with_spec"]
