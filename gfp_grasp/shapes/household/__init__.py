"""Families of things that stand on tables and shelves."""

from gfp_grasp.shapes.household.bottle import BOTTLE
from gfp_grasp.shapes.household.box import BOX
from gfp_grasp.shapes.household.carton import CARTON
from gfp_grasp.shapes.household.cup import CUP
from gfp_grasp.shapes.household.kettle import KETTLE
from gfp_grasp.shapes.household.mug import MUG
from gfp_grasp.shapes.household.pan import PAN
from gfp_grasp.shapes.household.pitcher import PITCHER
from gfp_grasp.shapes.household.pot import POT
from gfp_grasp.shapes.household.spray_bottle import SPRAY_BOTTLE
from gfp_grasp.shapes.household.teapot import TEAPOT

HOUSEHOLD_FAMILIES = (CUP, MUG, BOTTLE, PITCHER, TEAPOT, KETTLE, POT, PAN, CARTON, BOX, SPRAY_BOTTLE)
