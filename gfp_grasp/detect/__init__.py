"""One object or many out of a depth picture or a cloud: support plane, clusters, category, oriented box."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.detect.clusters import label_picture, label_points
from gfp_grasp.detect.detector import (
    DETECTORS,
    DetectConfig,
    Detector,
    detect_objects,
    estimate_sigma,
    get_detector,
    make_detection,
)
from gfp_grasp.detect.merging import upright_box
from gfp_grasp.detect.single import detect_single
from gfp_grasp.detect.stacking import on_each_other
from gfp_grasp.detect.support import find_support, warn_of_a_plane_aside
from gfp_grasp.detect.validate import clean_cloud, numbers_of

if TYPE_CHECKING:
    from gfp_grasp.detect.classifier import (
        FLOOR_M,
        NUM_CHANNELS,
        NUM_POINTS,
        POOL_POINTS,
        Calibration,
        EmbeddingNet,
        Prototypes,
        class_scores,
        classify,
        embed,
        embed_clouds,
        features,
        mixture,
        sample_points,
        score_table,
        upright_points,
        with_surface,
    )
    from gfp_grasp.detect.instances import InstanceNet, Votes, gather_votes, instance_features, level_picture, vote

__all__ = [
    "DETECTORS",
    "FLOOR_M",
    "NUM_CHANNELS",
    "NUM_POINTS",
    "POOL_POINTS",
    "Calibration",
    "DetectConfig",
    "Detector",
    "EmbeddingNet",
    "InstanceNet",
    "Prototypes",
    "Votes",
    "class_scores",
    "classify",
    "clean_cloud",
    "detect_objects",
    "detect_single",
    "embed",
    "embed_clouds",
    "estimate_sigma",
    "features",
    "find_support",
    "gather_votes",
    "get_detector",
    "instance_features",
    "label_picture",
    "label_points",
    "level_picture",
    "make_detection",
    "mixture",
    "numbers_of",
    "on_each_other",
    "sample_points",
    "score_table",
    "upright_box",
    "upright_points",
    "vote",
    "warn_of_a_plane_aside",
    "with_surface",
]


# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    **dict.fromkeys(
        (
            "FLOOR_M", "NUM_CHANNELS", "NUM_POINTS", "POOL_POINTS", "Calibration", "EmbeddingNet", "Prototypes",
            "class_scores", "classify", "embed", "embed_clouds", "features", "mixture", "sample_points", "score_table",
            "upright_points", "with_surface",
        ),
        "classifier",
    ),
    **dict.fromkeys(
        ("InstanceNet", "Votes", "gather_votes", "instance_features", "level_picture", "vote"), "instances"
    ),
}  # fmt: skip


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.detect.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
