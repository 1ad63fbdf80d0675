"""Procedural cups, mugs and bottles: seeded, watertight, metric, upright."""

from gfp_grasp.shapes.shape import FAMILIES, Shape, make_shape
from gfp_grasp.shapes.splits import SPLITS, split_seeds

__all__ = ["FAMILIES", "SPLITS", "Shape", "make_shape", "split_seeds"]
