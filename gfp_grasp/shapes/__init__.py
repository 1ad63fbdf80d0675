"""Procedural cups, mugs and bottles, and endless kinds of other things: seeded, watertight, metric, upright."""

from gfp_grasp.shapes.assorted import make_assorted
from gfp_grasp.shapes.shape import FAMILIES, SPLITS, Shape, make_shape, split_seeds

__all__ = ["FAMILIES", "SPLITS", "Shape", "make_assorted", "make_shape", "split_seeds"]
