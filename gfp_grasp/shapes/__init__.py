"""Procedural members of thirty classes, and endless kinds of other things: seeded, watertight, metric, upright."""

from gfp_grasp.shapes.assorted import foreign_kinds, make_assorted
from gfp_grasp.shapes.family import Family
from gfp_grasp.shapes.mixtures import MIXTURES, make_mixture
from gfp_grasp.shapes.shape import (
    FAMILIES,
    HOUSEHOLD,
    IN_PAPER,
    SPLITS,
    TRAFFIC,
    Shape,
    get_family,
    make_shape,
    split_seeds,
)
from gfp_grasp.shapes.streets import IN_STREETS, STREET_FURNITURE

__all__ = [
    "FAMILIES",
    "HOUSEHOLD",
    "IN_PAPER",
    "IN_STREETS",
    "MIXTURES",
    "SPLITS",
    "STREET_FURNITURE",
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
