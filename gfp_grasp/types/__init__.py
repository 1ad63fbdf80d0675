"""One frozen type for each stage of the data's way, from depth picture to grasp outcome.

World is z up, metres; camera frames are OpenCV's (x right, y down, z forward). Arrays are checked once, here, and are
read-only afterwards.
"""

from gfp_grasp.types.category import (
    DATASETS,
    KEEP_RULES,
    RESTS,
    UNKNOWN,
    CategorySpec,
    OptionalPart,
    default_density,
)
from gfp_grasp.types.observation import (
    Detection,
    LevelView,
    OrientedBox,
    PointCloud,
    Proposal,
    Silhouette,
    SupportPlane,
)
from gfp_grasp.types.primitive import (
    BODY_REGIONS,
    INSIDE,
    OUTSIDE,
    ConvexPart,
    FittedPrimitive,
    GenericPrimitive,
    PartBinding,
    Symmetry,
    Variant,
    default_spec,
)
from gfp_grasp.types.result import (
    REASONS,
    CollisionMesh,
    CompletedShape,
    Grasp,
    Outcome,
    TrueObject,
)
from gfp_grasp.types.sensors import LIDAR, SENSORS, TABLETOP, SensorProfile, get_sensor
from gfp_grasp.types.views import DepthImage, RangeImage, View, pixels_of

__all__ = [
    "BODY_REGIONS",
    "DATASETS",
    "INSIDE",
    "KEEP_RULES",
    "LIDAR",
    "OUTSIDE",
    "REASONS",
    "RESTS",
    "SENSORS",
    "TABLETOP",
    "UNKNOWN",
    "CategorySpec",
    "CollisionMesh",
    "CompletedShape",
    "ConvexPart",
    "DepthImage",
    "Detection",
    "FittedPrimitive",
    "GenericPrimitive",
    "Grasp",
    "LevelView",
    "OptionalPart",
    "OrientedBox",
    "Outcome",
    "PartBinding",
    "PointCloud",
    "Proposal",
    "RangeImage",
    "SensorProfile",
    "Silhouette",
    "SupportPlane",
    "Symmetry",
    "TrueObject",
    "Variant",
    "View",
    "default_density",
    "default_spec",
    "get_sensor",
    "pixels_of",
]
