"""Families of what stands and moves in streets; lengths are those of real vehicles and people."""

from gfp_grasp.shapes.family import Family
from gfp_grasp.shapes.traffic.bicycle import BICYCLE
from gfp_grasp.shapes.traffic.bus import BUS
from gfp_grasp.shapes.traffic.car import CAR
from gfp_grasp.shapes.traffic.cyclist import CYCLIST
from gfp_grasp.shapes.traffic.motorcycle import MOTORCYCLE
from gfp_grasp.shapes.traffic.pedestrian import PEDESTRIAN
from gfp_grasp.shapes.traffic.traffic_cone import TRAFFIC_CONE
from gfp_grasp.shapes.traffic.traffic_sign import TRAFFIC_SIGN
from gfp_grasp.shapes.traffic.truck import TRUCK
from gfp_grasp.shapes.traffic.van import VAN

TRAFFIC_FAMILIES: tuple[Family, ...] = (
    CAR,
    VAN,
    TRUCK,
    BUS,
    PEDESTRIAN,
    CYCLIST,
    MOTORCYCLE,
    BICYCLE,
    TRAFFIC_CONE,
    TRAFFIC_SIGN,
)
