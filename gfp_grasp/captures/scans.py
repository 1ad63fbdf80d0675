"""A list of points that is a whole LiDAR scan: how it is told from the cloud of one object, and how it stands."""

from __future__ import annotations

import warnings

import numpy as np

from gfp_grasp.arguments import checked_direction, checked_place
from gfp_grasp.camera import HDL_64, range_image
from gfp_grasp.detect import find_road
from gfp_grasp.errors import InvalidCloud, InvalidView, NothingDetected, TooFewPoints
from gfp_grasp.transforms import make_T
from gfp_grasp.types import RangeImage, SensorProfile, pixels_of
from gfp_grasp.units import unit_advice

_FEWEST = 30  # returns, as of the cloud of an object
_STRAYS = (1, 99)  # percentiles of the points between which a cloud is measured
_HEIGHT_M = (1.0, 3.0)  # of a sensor above the road, from the roof of a small car to that of a lorry
_ON_ROAD_M = 0.3
_NEAR_M = 25.0  # what is farther says less: a slope that bends away is hidden there
_LEAST_ON, _MOST_BELOW = 0.1, 0.1  # shares of the near points; KITTI's streets have 0.34 to 0.98 and 0.002
_SAMPLE = 20_000  # points that stand for the scan where its road is looked for
_ALONG = np.cos(np.deg2rad(15))  # a given up this near to an axis of the frame is the normal of a sloping road
_LEFT_OUT = 0.1  # share of a scan outside of the rings that is worth a word; KITTI's have 0.06 at most


def is_scan(points: np.ndarray, sensor: SensorProfile) -> bool:
    """Whether points are a whole scan, by one rule: a LiDAR saw them, and they are wider than one object can be.

    Args:
        points: (n, 3) m, any frame; rows that are not finite or zero say nothing.
        sensor: What saw them; a profile with a `step_rad` is that of a LiDAR.
    """
    return sensor.step_rad > 0 and _width_m(_returns(points)) > sensor.largest_m


def scan_of(
    points: np.ndarray, *, viewpoint: np.ndarray | None, up: np.ndarray | None, sensor: SensorProfile
) -> tuple[RangeImage, np.ndarray]:
    """The view of a whole scan that is a list of points, in the frame that the points are in.

    Rows that are not finite, zero as scanners write them where nothing came back, or out of reach are dropped. Where up
    is not given it is the axis of the frame, up or down, below which a road lies 1 to 3 m under the sensor with nearly
    nothing under it; a warning names any other axis than z.

    Args:
        points: (n, 3) m.
        viewpoint: (3,) m, where the sensor stood; None takes the origin.
        up: (3,) normal of the road, within 15 degrees of the sensor's own axis; None looks for it.
        sensor: What saw the points.

    Returns:
        The view, and up (3,).

    Raises:
        TooFewPoints: Fewer than 30 returns within the sensor's reach.
        InvalidCloud: A width that cannot be metres; viewpoint or up is no place or direction.
        InvalidView: No axis has a road under it, and up is not given.
    """
    place, direction = checked_place(viewpoint), checked_direction(up)
    place = np.zeros(3) if place is None else place
    returns = _returns(points)
    _refuse_wrong_unit(_width_m(returns), sensor)
    returns = _within_reach(returns, place, sensor)
    if len(returns) < _FEWEST:
        raise TooFewPoints(
            f"the scan has {len(points)} points, and {len(returns)} that are finite, not zero and within "
            f"{sensor.scene_m:g} m of the sensor at {np.round(place, 3).tolist()}; {_FEWEST} are needed: is the file "
            "whole, and is the viewpoint the sensor's place?"
        )
    z = _upright_axis(returns, place) if direction is None else _axis_along(direction)
    image = range_image(returns, T_world_sensor=_pose(z, place))
    seen = len(pixels_of(returns, image)[0])
    if not seen:
        raise InvalidView(f"no point lies on the rings of the scanner at {place.tolist()}: is the viewpoint its place?")
    if seen < (1 - _LEFT_OUT) * len(returns):
        warnings.warn(
            f"{1 - seen / len(returns):.0%} of the scan lies above or below the rings of an HDL-64, "
            f"{HDL_64.elevation_deg[-1]:g} to {HDL_64.elevation_deg[0]:g} degrees, and is left out",
            stacklevel=3,
        )
    return image, z if direction is None else direction


def _returns(points: np.ndarray) -> np.ndarray:
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


def _within_reach(returns: np.ndarray, place: np.ndarray, sensor: SensorProfile) -> np.ndarray:
    away_m = np.abs(returns - place).max(axis=1)  # no square overflows
    far = away_m > sensor.scene_m
    if 0 < far.sum() < len(far):
        warnings.warn(f"{far.sum()} points are more than {sensor.scene_m:g} m from the sensor; dropped", stacklevel=4)
    return returns[(away_m > 0) & ~far]


def _width_m(returns: np.ndarray) -> float:
    """Extent along the direction in which the points spread most, whatever the axes of their frame."""
    if not len(returns):
        return 0.0
    sample = returns[:: -(-len(returns) // _SAMPLE)]
    middle = np.median(sample, axis=0)
    length = np.abs(sample - middle).max()
    if not 0 < length < np.inf:
        return float(length)
    local = (sample - middle) / length  # no square overflows
    along = local @ np.linalg.eigh(local.T @ local)[1][:, -1]
    return float(length * np.ptp(np.percentile(along, _STRAYS)))


def _refuse_wrong_unit(width_m: float, sensor: SensorProfile) -> None:
    if width_m > sensor.scene_m:
        advice = unit_advice(width_m, least_m=sensor.largest_m, most_m=sensor.scene_m)
        raise InvalidCloud(f"the scan is {width_m:.4g} across and metres are expected: {advice}")


def _axis_along(direction: np.ndarray) -> np.ndarray:
    """The sensor's own axis for a road's normal: the frame's nearest to it, or else the normal itself."""
    nearest = int(np.abs(direction).argmax())
    if abs(direction[nearest]) < _ALONG:
        return direction
    return np.sign(direction[nearest]) * np.eye(3)[nearest]


def _upright_axis(returns: np.ndarray, place: np.ndarray) -> np.ndarray:
    """The axis of the frame, up or down, with most of the scan on a road below it."""
    sample = returns[np.random.default_rng(0).permutation(len(returns))[:_SAMPLE]]
    axes = [sign * axis for axis in np.eye(3)[::-1] for sign in (1.0, -1.0)]  # z first, which wins a tie
    shares = [_share_on_road(sample, place, axis) for axis in axes]
    best = int(np.argmax(shares))
    if shares[best] < _LEAST_ON:
        raise InvalidView(
            f"no axis of the scan's frame has a road {_HEIGHT_M[0]:g} to {_HEIGHT_M[1]:g} m under the sensor at "
            f"{np.round(place, 3).tolist()}: give viewpoint, where the sensor stood, in metres, and up, the road's "
            "normal"
        )
    if best:
        warnings.warn(
            f"the road of the scan lies under the sensor with {_named(axes[best])} up, which is taken for up; the "
            "answer is in the scan's own frame",
            stacklevel=4,
        )
    return axes[best]


def _share_on_road(sample: np.ndarray, place: np.ndarray, up: np.ndarray) -> float:
    """Share of the near points that lie on the road for this up; 0 where what is found can be no road."""
    try:
        road = find_road(sample, up, viewpoint=place)
    except NothingDetected:
        return 0.0
    local = sample - place
    near = np.linalg.norm(local - np.outer(local @ up, up), axis=1) < _NEAR_M
    heights = road.heights(sample[near])
    least_m, most_m = _HEIGHT_M
    if not near.any() or not least_m <= road.heights(place[None])[0] <= most_m:
        return 0.0
    if (heights < -_ON_ROAD_M).mean() > _MOST_BELOW:
        return 0.0
    return float((heights < _ON_ROAD_M).mean())


def _named(axis: np.ndarray) -> str:
    nearest = int(np.abs(axis).argmax())
    return f"{'-' if axis[nearest] < 0 else ''}{'xyz'[nearest]}"


def _pose(z: np.ndarray, place: np.ndarray) -> np.ndarray:
    """T_world_sensor (4, 4): its z along z, its x as near as may be to what habit has forward.

    That is x of a frame whose z is up or down, z of OpenCV's cameras (y down) and -z of OpenGL's (y up).
    """
    upright = int(np.abs(z).argmax())
    forward = np.eye(3)[0] if upright == 2 else -np.sign(z[upright]) * np.eye(3)[2]
    x = forward - (forward @ z) * z
    x /= np.linalg.norm(x)
    return make_T(np.column_stack([x, np.cross(z, x), z]), place)
