"""What may come in as a cloud, and what is refused."""

from __future__ import annotations

import warnings

import numpy as np

from gfp_grasp.clouds import distinct_points
from gfp_grasp.errors import InvalidCloud, TooFewPoints
from gfp_grasp.types import TABLETOP, SensorProfile
from gfp_grasp.units import unit_advice

MIN_POINTS = 30  # fewer say nothing about a shape; a mug 2 m away still has about 200
# Thickness over length below which a cloud is a plane or a line. Sensor noise alone gives 1e-3 and more, so a real
# view of a flat bottle's broad side passes.
FLATNESS = 1e-4
# What numpy, torch and foreign objects are seen to raise where no array can be made of them.
_CONVERSION_ERRORS = (ArithmeticError, AttributeError, LookupError, MemoryError, RuntimeError, TypeError, ValueError)
_SAMPLE = 20_000  # points that stand for the whole cloud where its spread is measured


def clean_cloud(cloud: object, *, min_points: int = MIN_POINTS, sensor: SensorProfile = TABLETOP) -> np.ndarray:
    """Points of anything that holds a cloud, checked.

    Args:
        cloud: (n, 3) array-like in metres, also masked or structured with fields x, y and z; a torch tensor, a trimesh
            (`.vertices`), an Open3D point cloud or a PointCloud of this package (`.points`). Rows that are not finite,
            and points farther away from nearly all others than a scene is wide (5 m for a depth camera), are dropped
            and counted in a warning.
        min_points: Different finite points that are needed.
        sensor: Which extents can be metres.

    Returns:
        (n, 3) float64 m, finite, in the order they came; where most are copies of others, these are left out.

    Raises:
        InvalidCloud: Wrong type or shape, all points on a plane or a line, or extents that cannot be metres.
        TooFewPoints: Empty, or fewer than min_points different finite points.
    """
    points = _as_points(cloud)
    num_rows = len(points)
    finite = np.isfinite(points).all(axis=1)
    num_dropped = num_rows - int(finite.sum())
    if num_dropped:
        points = points[finite]
    points = _without_many_copies(points)
    if len(points) < min_points:
        _refuse_few(points, num_rows, num_dropped, min_points)
    _refuse_wrong_unit(points, sensor)
    points, num_strays = _without_strays(points, sensor.scene_m)
    _refuse_flat(points)
    if num_dropped:
        warnings.warn(f"{num_dropped} of {num_rows} rows are not finite; dropped", stacklevel=2)
    if num_strays:
        warnings.warn(
            f"{num_strays} points are more than {sensor.scene_m:.0f} m from the others; dropped", stacklevel=2
        )
    return points


def numbers_of(value: object, name: str) -> np.ndarray:
    """Real numbers of an array, a tensor or nested sequences as float64; what is masked or None is NaN.

    Raises:
        InvalidCloud: No real numbers.
    """
    try:
        if hasattr(value, "detach"):  # a torch tensor, perhaps sparse, on a device or with a gradient
            tensor = value.detach().to_dense().cpu()  # type: ignore[attr-defined]
            value = (tensor.double() if tensor.is_floating_point() else tensor).numpy()
        array = np.ma.asarray(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
        if array.dtype.names and {"x", "y", "z"} <= set(array.dtype.names):
            array = np.stack([array[axis] for axis in "xyz"], axis=-1)
        if array.dtype.kind not in "fiuO":
            raise InvalidCloud(f"{name} has dtype {array.dtype}; real numbers in metres are expected")
        array = array.astype(np.float64)
        return array.filled(np.nan) if isinstance(array, np.ma.MaskedArray) else array
    except InvalidCloud:
        raise
    except _CONVERSION_ERRORS as error:
        raise InvalidCloud(f"{name} ({type(value).__name__}) is no array of numbers: {error}") from error


def robust_extents(points: np.ndarray) -> np.ndarray:
    """(3,) extents of (n, 3) points between their 1st and 99th percentile, blind to a few flying pixels."""
    low, high = _robust_bounds(points)
    return high - low


def _robust_bounds(points: np.ndarray) -> np.ndarray:
    return np.percentile(_sample(points), (1, 99), axis=0)


def _as_points(cloud: object) -> np.ndarray:
    if cloud is None or isinstance(cloud, (str, bytes, dict)):
        raise InvalidCloud(f"cloud is a {type(cloud).__name__}; (n, 3) numbers in metres are expected")
    points = numbers_of(_held_by(cloud), "cloud")
    if points.ndim == 1 and points.size == 0:
        raise TooFewPoints("cloud is empty: is the object in view?")
    if points.ndim != 2 or points.shape[1] != 3:
        hint = "; reshape organised points with reshape(-1, 3)" if points.ndim == 3 and points.shape[2] == 3 else ""
        raise InvalidCloud(f"cloud has shape {points.shape}; (n, 3) in metres is expected{hint}")
    return points


def _held_by(cloud: object) -> object:
    for attribute in ("points", "vertices"):
        inner = getattr(cloud, attribute, None)
        if inner is not None and not callable(inner):
            return inner
    positions = getattr(getattr(cloud, "point", None), "positions", None)  # Open3D's tensor point cloud
    return cloud if positions is None else positions.cpu().numpy()


def _without_many_copies(points: np.ndarray) -> np.ndarray:
    """The points, or where most of a sample are copies, each of them once: shares and spreads are then its own."""
    sample = _sample(points)
    return distinct_points(points) if len(distinct_points(sample)) < 0.5 * len(sample) else points


def _refuse_few(points: np.ndarray, num_rows: int, num_dropped: int, min_points: int) -> None:
    num_finite = num_rows - num_dropped
    if num_finite < min_points:
        raise TooFewPoints(
            f"cloud has {num_finite} finite points ({num_dropped} rows are not finite), {min_points} are needed: "
            "is the object in view?"
        )
    if len(points) == 1:
        raise InvalidCloud("all points of the cloud are the same point: a surface is expected")
    raise TooFewPoints(
        f"cloud has {num_finite} finite points but only {len(points)} different ones, {min_points} are needed: "
        "is the object in view?"
    )


def _refuse_wrong_unit(points: np.ndarray, sensor: SensorProfile) -> None:
    extent = float(robust_extents(points).max())
    if extent > sensor.scene_m:
        raise InvalidCloud(
            f"cloud is {extent:.4g} across and metres are expected: {_advice(extent, sensor)}; if it is a whole room, "
            'crop it to the table; if a LiDAR saw it, say so (sensor="lidar")'
        )
    if extent < sensor.smallest_m:
        raise InvalidCloud(
            f"cloud is {extent:.4g} across and metres are expected, at least {sensor.smallest_m} from a {sensor.name} "
            f"sensor: if it was normalised or is in another unit, scale it back ({_advice(extent, sensor)})"
        )


def _advice(extent: float, sensor: SensorProfile) -> str:
    return unit_advice(extent, least_m=2 * sensor.smallest_m, most_m=sensor.largest_m)


def _without_strays(points: np.ndarray, farther_m: float) -> tuple[np.ndarray, int]:
    low, high = _robust_bounds(points)
    low, high = low - farther_m, high + farther_m
    if (points.min(axis=0) >= low).all() and (points.max(axis=0) <= high).all():
        return points, 0
    near = ((points >= low) & (points <= high)).all(axis=1)
    return points[near], len(points) - int(near.sum())


def _refuse_flat(points: np.ndarray) -> None:
    sample = _sample(points)
    spread = np.linalg.svd(sample - sample.mean(axis=0), compute_uv=False)
    if spread[1] < FLATNESS * spread[0]:
        raise InvalidCloud("all points of the cloud lie on a line: a view of a surface is expected")
    if spread[2] < FLATNESS * spread[0]:
        raise InvalidCloud("all points of the cloud lie on a plane: an object in the round is expected")


def _sample(points: np.ndarray) -> np.ndarray:
    if len(points) <= _SAMPLE:
        return points
    return points[np.random.default_rng(0).integers(len(points), size=_SAMPLE)]  # a stride can fall in with repeats
