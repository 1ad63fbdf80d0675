"""Why no table was found in a picture: what was seen instead, and what to do."""

from __future__ import annotations

import numpy as np

from gfp_grasp.detect.support import MAX_TILT_DEG, widest_plane
from gfp_grasp.detect.validate import robust_extents
from gfp_grasp.errors import NothingDetected
from gfp_grasp.types import DepthImage, SensorProfile

_FEW = 0.3  # share of the pixels where something was seen: with fewer, hardly any has neighbours
_ONE_PLANE = 0.85  # share of the points that makes a plane all that there is
_ALONE = 0.3  # what is seen is no wider than this, in the sensor's largest: objects without their table
_ALONE_TO = "pass its points to complete_to_mesh (in a file: object_points_cam, or a mask)"


def no_table(image: DepthImage, *, num_planes: int, up: np.ndarray | None, sensor: SensorProfile) -> NothingDetected:
    """The error for a picture in which nothing stands on any plane.

    Args:
        image: The picture.
        num_planes: Planes that were looked at.
        up: (3,) as it was given; None where any plane was looked for.
        sensor: What it was taken with.
    """
    seen = image.depth_m > 0
    if not seen.any():
        return NothingDetected("no pixel of the picture came back with a depth: is the sensor covered, or too near?")
    if _filled(seen) < _FEW:
        return NothingDetected(
            f"no support plane can be seen: only {seen.mean():.0%} of the pixels came back with a depth, with holes "
            "between them: fill these, take the median of several pictures, or ask whether the sensor sees glass"
        )
    points = image.points()[seen]
    plane, share = widest_plane(points, sensor=sensor)
    width_m = float(robust_extents(points).max())
    if share > _ONE_PLANE:
        return _one_plane(plane.normal, share, width_m, up)
    if width_m < _ALONE * sensor.largest_m:
        return NothingDetected(
            f"no support plane in the depth picture: what it shows is {width_m:.2f} m across in all, as objects are "
            f"without their table: {_ALONE_TO}, or take the picture from farther away"
        )
    why = "nothing in it is flat enough for one"
    if num_planes:
        why = f"of its {num_planes} planes there is nothing on any that is as small as an object"
    return NothingDetected(
        f"no support plane in the depth picture: {why}; the widest holds {share:.0%} of the points. "
        "Is a table in view, and is `up` its normal in the "
        "world frame (up=None, --up auto, takes any plane that the camera looks down on)? For a single object, "
        f"{_ALONE_TO}"
    )


def _filled(seen: np.ndarray) -> float:
    """Share of the pixels (h, w) that were seen, within the rectangle that holds nearly all of them."""
    (top, left), (bottom, right) = np.quantile(np.argwhere(seen), (0.02, 0.98), axis=0).astype(int)
    return float(seen[top : bottom + 1, left : right + 1].mean())


def _one_plane(normal: np.ndarray, share: float, width_m: float, up: np.ndarray | None) -> NothingDetected:
    seen = f"no support plane with something on it: {share:.0%} of the picture is one plane, {width_m:.2f} m across"
    what, aside = "an empty table, a wall, or the side of an object that fills the picture", ""
    if up is not None:
        tilt_deg = float(np.degrees(np.arccos(np.clip(abs(normal @ up), 0.0, 1.0))))
        level = tilt_deg < MAX_TILT_DEG
        what = "an empty table" if level else "a wall, or the side of an object that fills the picture,"
        aside = f", {tilt_deg:.0f} degrees from level"
    return NothingDetected(
        f"{seen}{aside}, as {what} is: point the camera at the table with the objects on it; if this is the table and "
        f"up is wrong, up=None (--up auto) estimates it; for a single object, {_ALONE_TO}"
    )
