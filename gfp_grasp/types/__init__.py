"""One frozen type for each stage of the data's way, from depth picture to grasp outcome.

World is z up, metres; camera frames are OpenCV's (x right, y down, z forward). Arrays are checked once, here, and are
read-only afterwards.
"""

from gfp_grasp.types.grasping import (
    REASONS,
    Grasp,
    Outcome,
    TrueObject,
)
from gfp_grasp.types.observation import (
    DepthImage,
    Detection,
    OrientedBox,
    PointCloud,
    SupportPlane,
)
from gfp_grasp.types.primitive import (
    HANDLE,
    INSIDE,
    OUTSIDE,
    REGION_NAMES,
    ConvexPart,
    FittedPrimitive,
    GenericPrimitive,
    Symmetry,
)
from gfp_grasp.types.result import (
    CollisionMesh,
    CompletedShape,
)

__all__ = [
    "HANDLE",
    "INSIDE",
    "OUTSIDE",
    "REASONS",
    "REGION_NAMES",
    "CollisionMesh",
    "CompletedShape",
    "ConvexPart",
    "DepthImage",
    "Detection",
    "FittedPrimitive",
    "GenericPrimitive",
    "Grasp",
    "OrientedBox",
    "Outcome",
    "PointCloud",
    "SupportPlane",
    "Symmetry",
    "TrueObject",
]
