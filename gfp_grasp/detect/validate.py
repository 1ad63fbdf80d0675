"""What may come in as a cloud, and what is refused."""

from __future__ import annotations

import warnings

import numpy as np

from gfp_grasp.errors import InvalidCloud, TooFewPoints

MIN_POINTS = 30  # fewer say nothing about a shape; a mug 2 m away still has about 200
MAX_EXTENT_M = 5.0  # a table top with its surroundings is smaller; a mug in millimetres is not
MAX_OBJECT_M = 1.5  # no single object to be grasped by one hand is larger
# Thickness over length below which a cloud is a plane or a line. Sensor noise alone gives 1e-3 and more, so a real
# view of a flat bottle's broad side passes.
FLATNESS = 1e-4
_SAMPLE = 20_000  # points that stand for the whole cloud where its spread is measured


def clean_cloud(cloud: object, *, min_points: int = MIN_POINTS) -> np.ndarray:
    """Points of anything that holds a cloud, checked.

    Args:
        cloud: (n, 3) array-like in metres, a torch tensor, a trimesh (`.vertices`), an Open3D point cloud or a
            PointCloud of this package (`.points`). Rows that are not finite are dropped and counted in a warning.
        min_points: Finite points that are needed.

    Returns:
        (n, 3) float64 m, finite, in the order they came.

    Raises:
        InvalidCloud: Wrong type or shape, all points on a plane or a line, or extents that cannot be metres.
        TooFewPoints: Empty, or fewer than min_points finite points.
    """
    points = _as_array(cloud)
    finite = np.isfinite(points).all(axis=1)
    num_dropped = len(points) - int(finite.sum())
    if num_dropped:
        points = points[finite]
    if len(points) < min_points:
        raise TooFewPoints(
            f"cloud has {len(points)} finite points ({num_dropped} rows are not finite), {min_points} are needed: "
            "is the object in view?"
        )
    _refuse_wrong_unit(points)
    _refuse_flat(points)
    if num_dropped:
        warnings.warn(f"{num_dropped} of {num_dropped + len(points)} rows are not finite; dropped", stacklevel=2)
    return points


def robust_extents(points: np.ndarray) -> np.ndarray:
    """(3,) extents of (n, 3) points between their 1st and 99th percentile, blind to a few flying pixels."""
    low, high = np.percentile(_sample(points), (1, 99), axis=0)
    return high - low


def _as_array(cloud: object) -> np.ndarray:
    if cloud is None or isinstance(cloud, (str, bytes, dict)):
        raise InvalidCloud(f"cloud is a {type(cloud).__name__}; (n, 3) numbers in metres are expected")
    for attribute in ("points", "vertices"):
        inner = getattr(cloud, attribute, None)
        if inner is not None and not callable(inner):
            cloud = inner
            break
    if hasattr(cloud, "detach"):  # a torch tensor, perhaps on a device or with a gradient
        cloud = cloud.detach().cpu().double().numpy()  # type: ignore[attr-defined]
    try:
        points = np.asarray(cloud)
        if points.dtype.kind not in "fiu":
            points = np.asarray(cloud, dtype=np.float64) if points.dtype.kind == "O" else points
        if points.dtype.kind not in "fiu":
            raise InvalidCloud(f"cloud has dtype {points.dtype}; real numbers in metres are expected")
        points = points.astype(np.float64)
    except (TypeError, ValueError) as error:
        if isinstance(error, InvalidCloud):
            raise
        raise InvalidCloud(f"cloud ({type(cloud).__name__}) is no array of numbers: {error}") from error
    if points.ndim == 1 and points.size == 0:
        raise TooFewPoints("cloud is empty: is the object in view?")
    if points.ndim != 2 or points.shape[1] != 3:
        hint = "; reshape organised points with reshape(-1, 3)" if points.ndim == 3 and points.shape[2] == 3 else ""
        raise InvalidCloud(f"cloud has shape {points.shape}; (n, 3) in metres is expected{hint}")
    return points


def _refuse_wrong_unit(points: np.ndarray) -> None:
    extent = float(robust_extents(points).max())
    if extent > MAX_EXTENT_M:
        raise InvalidCloud(
            f"cloud is {extent:.4g} across and metres are expected: if it is in millimetres, divide it by 1000; "
            "if it is a whole room, crop it to the table"
        )


def _refuse_flat(points: np.ndarray) -> None:
    sample = _sample(points)
    spread = np.linalg.svd(sample - sample.mean(axis=0), compute_uv=False)
    if spread[0] == 0:
        raise InvalidCloud("all points of the cloud are the same point: a surface is expected")
    if spread[1] < FLATNESS * spread[0]:
        raise InvalidCloud("all points of the cloud lie on a line: a view of a surface is expected")
    if spread[2] < FLATNESS * spread[0]:
        raise InvalidCloud("all points of the cloud lie on a plane: an object in the round is expected")


def _sample(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // _SAMPLE)]
