"""Data sets of meshes on disk, as sources of objects: ModelNet40, ShapeNet, and plain folders."""

from gfp_grasp.datasets.layouts import LAYOUTS, layout_of, read_dataset

__all__ = ["LAYOUTS", "layout_of", "read_dataset"]
