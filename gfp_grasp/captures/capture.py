"""One recording as the rest of the package takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.camera import project
from gfp_grasp.complete import CompleteConfig, Completion, complete_scene, complete_to_mesh
from gfp_grasp.errors import InvalidCloud
from gfp_grasp.types import DepthImage

# A pixel belongs to the object if its depth is that of an object's point this closely: well above a sensor's rounding.
_SAME_DEPTH_M = 0.006


@dataclass(frozen=True, eq=False)
class Capture:
    """What a camera recorded: a depth picture, points of one object, or both.

    All of it is in one frame, the world's; where the camera's pose is not known that is the camera's own frame.

    Attributes:
        name: Of the file, without its folder.
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
    capture: Capture, *, category: str | None = None, config: CompleteConfig | None = None, seed: int = 0
) -> tuple[Completion, ...]:
    """Complete the one object whose points are known, or else every object of the picture.

    Args:
        capture: The recording.
        category: As complete_to_mesh takes it; a whole picture's objects are classified one by one.
        config: Switches.
        seed: Of every random choice.

    Raises:
        GfpGraspError: As complete_to_mesh and complete_scene raise it.
    """
    if capture.points is None:
        assert capture.view is not None
        return complete_scene(capture.view, up=capture.up, config=config, seed=seed)
    mask = capture.mask
    if mask is None and capture.view is not None:
        mask = mask_of_points(capture.points, capture.view)
    completion = complete_to_mesh(
        capture.points,
        viewpoint=capture.viewpoint,
        up=capture.up,
        support_height=capture.support_height,
        view=capture.view,
        mask=mask,
        category=category,
        config=config,
        seed=seed,
    )
    return (completion,)


def mask_of_points(points: np.ndarray, view: DepthImage) -> np.ndarray:
    """(h, w) bool, the pixels of a view that saw the given points (n, 3) m, world frame."""
    pixels, depth = project(points, view.K, view.T_world_camera)
    height, width = view.depth_m.shape
    inside = np.isfinite(pixels).all(axis=1)
    u, v = np.zeros(len(pixels), dtype=int), np.zeros(len(pixels), dtype=int)
    u[inside], v[inside] = np.round(pixels[inside]).astype(int).T
    inside &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, depth = u[inside], v[inside], depth[inside]
    seen = view.depth_m[v, u]
    same = (seen > 0) & (np.abs(seen - depth) < _SAME_DEPTH_M)
    mask = np.zeros((height, width), dtype=bool)
    mask[v[same], u[same]] = True
    return mask
