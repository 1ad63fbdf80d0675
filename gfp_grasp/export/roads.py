"""The road under the objects of a scan: one floor below all, and a slab under each object that stands higher."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gfp_grasp.export.formats import Body, Slab
from gfp_grasp.transforms import make_T, rotation_between
from gfp_grasp.types import SupportPlane

_FLUSH_M = 0.0005  # what rises no more than this above the floor needs no slab
_MARGIN_M = 0.1  # of a slab about the outline of its object
_THICK_M = 0.2


def roads_under(
    bodies: Sequence[Body], supports: Sequence[SupportPlane | None], up: np.ndarray
) -> tuple[tuple[Slab, ...], float | None]:
    """The road as a simulator takes it. A road is neither level nor flat, and a simulator's plane is both.

    Args:
        bodies: Objects, each in a frame whose z is its up, as `foot_pose` makes it.
        supports: The plane that touches the road below each; None where it is unknown.
        up: (3,) unit normal of the floor.

    Returns:
        A slab for each object whose road lies above the floor, and the height of the floor along up, m, which touches
        the lowest road; None where no road is known.
    """
    made, heights_m = [], []
    for body, support in zip(bodies, supports, strict=True):
        if support is None:
            continue
        slab = _slab(body, support)
        made.append(slab)
        heights_m.append(_corners_of_top(slab) @ up)
    if not made:
        return (), None
    floor_m = float(min(height.min() for height in heights_m))
    above = [slab for slab, height in zip(made, heights_m, strict=True) if height.max() > floor_m + _FLUSH_M]
    return tuple(above), floor_m


def _slab(body: Body, support: SupportPlane) -> Slab:
    """Road under the outline of an object, whose top is the object's own support."""
    T, normal = body.T_world_body, support.normal
    R = rotation_between(T[:3, 2], normal) @ T[:3, :3]
    outline = np.vstack([shape.vertices for shape in body.shapes])[:, :2]
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle = T[:3, 3] + R[:, :2] @ ((low + high) / 2)
    top = middle - (normal @ middle - support.height_m) * normal
    half = np.array([*((high - low) / 2 + _MARGIN_M), _THICK_M / 2])
    return Slab(f"{body.name}_road", make_T(R, top - half[2] * normal), half)


def _corners_of_top(slab: Slab) -> np.ndarray:
    """(4, 3) m."""
    signs = np.array([(1, 1, 1), (1, -1, 1), (-1, 1, 1), (-1, -1, 1)])
    return slab.T_world_slab[:3, 3] + (signs * slab.half_m) @ slab.T_world_slab[:3, :3].T
