"""Procedural members of thirty classes, and endless kinds of other things: seeded, watertight, metric, upright."""

from gfp_grasp.shapes.assorted import foreign_kinds, make_assorted
from gfp_grasp.shapes.family import Family
from gfp_grasp.shapes.mixtures import MIXTURES, make_mixture
from gfp_grasp.shapes.shape import FAMILIES, HOUSEHOLD, SPLITS, TRAFFIC, Shape, get_family, make_shape, split_seeds

__all__ = [
    "FAMILIES",
    "HOUSEHOLD",
    "MIXTURES",
    "SPLITS",
    "TRAFFIC",
    "Family",
    "Shape",
    "foreign_kinds",
    "get_family",
    "make_assorted",
    "make_mixture",
    "make_shape",
    "split_seeds",
]
