"""Detectors by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Protocol

import numpy as np

from gfp_grasp.detect.detector import DetectConfig, detect_objects
from gfp_grasp.errors import InvalidOption, NothingDetected, UnknownDetector
from gfp_grasp.plugins import imported_function
from gfp_grasp.types import DepthImage, Detection


class Detector(Protocol):
    """A function from a depth picture to the objects in it, largest first, world frame; they need no class."""

    def __call__(self, image: DepthImage, *, up: np.ndarray | None) -> Sequence[Detection]: ...


# Classes are named when a detection is completed, by the library of the completion.
DETECTORS: Mapping[str, Detector] = {"tabletop": partial(detect_objects, config=DetectConfig(classify=False))}


def get_detector(name: str) -> Detector:
    """A detector by name.

    Args:
        name: `tabletop` (`detect_objects`: what stands on a support plane), or `package.module:function`, a function
            like it. `make_detection` makes a detection of an object's points; its class is named when it is completed.

    Raises:
        UnknownDetector: The name is none of these, or cannot be imported.
    """
    if name in DETECTORS:
        return DETECTORS[name]
    on_offer = ", ".join(DETECTORS)
    function = imported_function(name, what="detector", of="a view", on_offer=on_offer, error=UnknownDetector)
    return _checked(function, name)


def _checked(function: Callable[..., object], name: str) -> Detector:
    def detect(image: DepthImage, *, up: np.ndarray | None) -> Sequence[Detection]:
        answer = function(image, up=up)
        items = tuple(answer) if isinstance(answer, Sequence) else (answer,)
        found = tuple(item for item in items if isinstance(item, Detection))
        if len(found) < len(items):
            came = next(type(item).__name__ for item in items if not isinstance(item, Detection))
            raise InvalidOption(
                f"detector {name!r} returned a {came}; a sequence of gfp_grasp.types.Detection is expected"
            )
        if not found:
            raise NothingDetected(f"detector {name!r} found no object in the picture")
        return found

    return detect
