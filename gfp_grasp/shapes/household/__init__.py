"""Families of things that stand on tables and shelves."""

from gfp_grasp.shapes.household.bottle import BOTTLE
from gfp_grasp.shapes.household.bowl import BOWL
from gfp_grasp.shapes.household.box import BOX
from gfp_grasp.shapes.household.can import CAN
from gfp_grasp.shapes.household.carton import CARTON
from gfp_grasp.shapes.household.cup import CUP
from gfp_grasp.shapes.household.flask import FLASK
from gfp_grasp.shapes.household.glass import GLASS
from gfp_grasp.shapes.household.jar import JAR
from gfp_grasp.shapes.household.kettle import KETTLE
from gfp_grasp.shapes.household.mug import MUG
from gfp_grasp.shapes.household.pan import PAN
from gfp_grasp.shapes.household.pitcher import PITCHER
from gfp_grasp.shapes.household.plate import PLATE
from gfp_grasp.shapes.household.pot import POT
from gfp_grasp.shapes.household.spray_bottle import SPRAY_BOTTLE
from gfp_grasp.shapes.household.teapot import TEAPOT
from gfp_grasp.shapes.household.tube import TUBE
from gfp_grasp.shapes.household.vase import VASE
from gfp_grasp.shapes.household.wine_glass import WINE_GLASS

HOUSEHOLD_FAMILIES = (
    CUP, MUG, BOTTLE, GLASS, WINE_GLASS, BOWL, PLATE, CAN, JAR, VASE, PITCHER, TEAPOT, POT, PAN, CARTON, BOX,
    SPRAY_BOTTLE, TUBE, FLASK, KETTLE,
)  # fmt: skip
