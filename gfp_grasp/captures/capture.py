"""One recording as the rest of the package takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.complete import CompleteConfig, Completion, complete_scene, complete_to_mesh
from gfp_grasp.errors import InvalidCloud
from gfp_grasp.types import DepthImage


@dataclass(frozen=True, eq=False)
class Capture:
    """What a camera recorded: a depth picture, points of one object, or both.

    All of it is in one frame, the world's; where the camera's pose is not known that is the camera's own frame.

    Attributes:
        name: Name of the file, without its folder.
        points: (n, 3) m, points of one object, NaN allowed; None where only a picture is known.
        view: The whole depth picture, or None.
        mask: (h, w) bool, the object's pixels in the view, or None.
        viewpoint: (3,) m, where the camera stood, or None.
        up: (3,) normal of the support; None where it must be estimated.
        support_height: Height of the support along up, m, or None.
        truth: The true mesh in place, where somebody knows it: for measuring, never for completing.
    """

    name: str
    points: np.ndarray | None = None
    view: DepthImage | None = None
    mask: np.ndarray | None = None
    viewpoint: np.ndarray | None = None
    up: np.ndarray | None = None
    support_height: float | None = None
    truth: trimesh.Trimesh | None = None

    def __post_init__(self) -> None:
        if self.points is None and self.view is None:
            raise InvalidCloud(f"{self.name} holds neither points of an object nor a depth picture")


def complete_capture(
    capture: Capture,
    *,
    category: str | None = None,
    detector: str = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> tuple[Completion, ...]:
    """Complete the one object whose points are known, or else every object of the picture.

    Args:
        capture: The recording.
        category: As complete_to_mesh takes it; a whole picture's objects are classified one by one.
        detector: Name of the detector for a whole picture, see `gfp_grasp.detect.get_detector`.
        config: Switches.
        seed: Seed of every random choice.

    Raises:
        GfpGraspError: As complete_to_mesh and complete_scene raise it.
    """
    if capture.points is None:
        assert capture.view is not None
        return complete_scene(capture.view, up=capture.up, detector=detector, config=config, seed=seed)
    completion = complete_to_mesh(
        capture.points,
        viewpoint=capture.viewpoint,
        up=capture.up,
        support_height=capture.support_height,
        view=capture.view,
        mask=capture.mask,
        category=category,
        config=config,
        seed=seed,
    )
    return (completion,)
