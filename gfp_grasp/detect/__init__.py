"""One object or many out of a depth picture or a cloud: support plane, clusters, category, oriented box."""

from typing import TYPE_CHECKING

from gfp_grasp.detect.box import upright_box
from gfp_grasp.detect.clusters import label_picture, label_points
from gfp_grasp.detect.detector import DetectConfig, detect_objects, estimate_sigma, make_detection
from gfp_grasp.detect.detectors import DETECTORS, Detector, get_detector
from gfp_grasp.detect.single import detect_single
from gfp_grasp.detect.support import find_support
from gfp_grasp.detect.validate import clean_cloud, numbers_of

if TYPE_CHECKING:
    from gfp_grasp.detect.classifier import classify

__all__ = [
    "DETECTORS",
    "DetectConfig",
    "Detector",
    "classify",
    "clean_cloud",
    "detect_objects",
    "detect_single",
    "estimate_sigma",
    "find_support",
    "get_detector",
    "label_picture",
    "label_points",
    "make_detection",
    "numbers_of",
    "upright_box",
]


def __getattr__(name: str) -> object:
    if name == "classify":  # brings torch
        from gfp_grasp.detect.classifier import classify

        return classify
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
