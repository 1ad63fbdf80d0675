"""One frozen type for each stage of the data's way, from depth picture to grasp outcome.

World is z up, metres; camera frames are OpenCV's (x right, y down, z forward). Arrays are checked once, here, and are
read-only afterwards.
"""

from gfp_grasp.types.category import (
    DATASETS,
    KEEP_RULES,
    RESTS,
    CategorySpec,
    OptionalPart,
)
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
    BODY_REGIONS,
    INSIDE,
    OUTSIDE,
    ConvexPart,
    FittedPrimitive,
    GenericPrimitive,
    Symmetry,
    Variant,
    default_spec,
)
from gfp_grasp.types.result import (
    CollisionMesh,
    CompletedShape,
)

__all__ = [
    "BODY_REGIONS",
    "DATASETS",
    "INSIDE",
    "KEEP_RULES",
    "OUTSIDE",
    "REASONS",
    "RESTS",
    "CategorySpec",
    "CollisionMesh",
    "CompletedShape",
    "ConvexPart",
    "DepthImage",
    "Detection",
    "FittedPrimitive",
    "GenericPrimitive",
    "Grasp",
    "OptionalPart",
    "OrientedBox",
    "Outcome",
    "PointCloud",
    "SupportPlane",
    "Symmetry",
    "TrueObject",
    "Variant",
    "default_spec",
]
