"""Families of what stands and moves in streets; lengths are those of real vehicles and people."""

from gfp_grasp.shapes.family import Family
from gfp_grasp.shapes.traffic.pedestrian import PEDESTRIAN

TRAFFIC_FAMILIES: tuple[Family, ...] = (PEDESTRIAN,)
