"""Families of things that stand on tables and shelves."""

from gfp_grasp.shapes.household.bottle import BOTTLE
from gfp_grasp.shapes.household.cup import CUP
from gfp_grasp.shapes.household.mug import MUG

HOUSEHOLD_FAMILIES = (CUP, MUG, BOTTLE)
