"""One object or many out of a depth picture or a cloud: support plane, clusters, category, oriented box."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.detect.boxes import GivenBoxes
from gfp_grasp.detect.clusters import label_picture, label_points
from gfp_grasp.detect.detector import (
    DETECTORS,
    SCAN_DETECTORS,
    DetectConfig,
    Detector,
    detect_objects,
    estimate_sigma,
    get_detector,
    make_detection,
)
from gfp_grasp.detect.merging import upright_box
from gfp_grasp.detect.road import Road, find_road
from gfp_grasp.detect.single import detect_single
from gfp_grasp.detect.stacking import on_each_other
from gfp_grasp.detect.support import find_support, warn_of_a_plane_aside
from gfp_grasp.detect.turned import inside, iou_from_above, suppress
from gfp_grasp.detect.validate import clean_cloud, numbers_of

if TYPE_CHECKING:
    from gfp_grasp.detect.classifier import (
        Calibration,
        Prototypes,
        class_scores,
        classify,
        distance_in,
        mixture,
        score_table,
        scores_in,
        shares_in,
    )
    from gfp_grasp.detect.instances import InstanceNet, Votes, gather_votes, instance_features, level_picture, vote
    from gfp_grasp.detect.pointrcnn import SURE_BOX, detect_traffic, find_boxes, thinned
    from gfp_grasp.detect.proposal import (
        NUM_CHANNELS,
        NUM_POINTS,
        POOL_POINTS,
        PROTOTYPES,
        Look,
        ProposalNet,
        features,
        look,
        look_at_clouds,
        sample_points,
        seen_frame,
        size_of,
        turned_cloud,
        with_surface,
    )
    from gfp_grasp.detect.street_net import (
        CELL_M,
        StreetNet,
        box_loss,
        boxes_of,
        picture_from_above,
        places_in,
        point_features,
        pool,
        refined_boxes,
        refined_loss,
    )

__all__ = [
    "CELL_M",
    "DETECTORS",
    "NUM_CHANNELS",
    "NUM_POINTS",
    "POOL_POINTS",
    "PROTOTYPES",
    "SCAN_DETECTORS",
    "SURE_BOX",
    "Calibration",
    "DetectConfig",
    "Detector",
    "GivenBoxes",
    "InstanceNet",
    "Look",
    "ProposalNet",
    "Prototypes",
    "Road",
    "StreetNet",
    "Votes",
    "box_loss",
    "boxes_of",
    "class_scores",
    "classify",
    "clean_cloud",
    "detect_objects",
    "detect_single",
    "detect_traffic",
    "distance_in",
    "estimate_sigma",
    "features",
    "find_boxes",
    "find_road",
    "find_support",
    "gather_votes",
    "get_detector",
    "inside",
    "instance_features",
    "iou_from_above",
    "label_picture",
    "label_points",
    "level_picture",
    "look",
    "look_at_clouds",
    "make_detection",
    "mixture",
    "numbers_of",
    "on_each_other",
    "picture_from_above",
    "places_in",
    "point_features",
    "pool",
    "refined_boxes",
    "refined_loss",
    "sample_points",
    "score_table",
    "scores_in",
    "seen_frame",
    "shares_in",
    "size_of",
    "suppress",
    "thinned",
    "turned_cloud",
    "upright_box",
    "vote",
    "warn_of_a_plane_aside",
    "with_surface",
]


# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    **dict.fromkeys(
        ("Calibration", "Prototypes", "class_scores", "classify", "mixture", "score_table", "scores_in", "shares_in"),
        "classifier",
    ),
    "distance_in": "classifier",
    **dict.fromkeys(
        (
            "PROTOTYPES", "NUM_CHANNELS", "NUM_POINTS", "POOL_POINTS", "Look", "ProposalNet", "features", "look",
            "look_at_clouds", "sample_points", "seen_frame", "size_of", "turned_cloud", "with_surface",
        ),
        "proposal",
    ),
    **dict.fromkeys(("SURE_BOX", "detect_traffic", "find_boxes", "thinned"), "pointrcnn"),
    **dict.fromkeys(
        (
            "CELL_M", "StreetNet", "box_loss", "boxes_of", "picture_from_above", "places_in", "point_features", "pool",
            "refined_boxes", "refined_loss",
        ),
        "street_net",
    ),
    **dict.fromkeys(
        ("InstanceNet", "Votes", "gather_votes", "instance_features", "level_picture", "vote"), "instances"
    ),
}  # fmt: skip


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.detect.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
