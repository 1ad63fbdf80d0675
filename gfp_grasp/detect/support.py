"""The plane that objects rest on, by RANSAC."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.clouds import estimate_normals
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import TABLETOP, SensorProfile, SupportPlane

CAMERA_UPS = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))  # gravity is mostly +y there


# Multiples of the sensor's noise:
_INLIER = 4.0  # half the thickness of the plane's slab
_VOXEL = 8 / 3  # grid that evens out the density, so that a plane counts by its area
_OUTLINE = 10 / 3  # what is this far beyond the plane's outline still stands within it

MAX_TILT_DEG = 20.0  # between the plane's normal and a given up
_MIN_SHARE = 0.08  # points of the plane among all
_MIN_SPREAD = 1.2  # area of the plane's outline over that of what stands within it: a table reaches beyond its objects
_MAX_BELOW = 0.04  # points below the plane and within its outline, over those above
# A body may reach so far beyond the outline whose lid the plane is, and what is so far below its rim is near it; in
# square roots of the outline's area.
_RIM, _DROP = 0.2, 0.5
_MOST_SKIRT = 0.5  # such points, over those above the plane and those on it: none on 22 real tables, 0.7 on lids
_MIN_FACING = 0.6  # share of the plane's points whose own surface faces along its normal, within
_FACING_DEG = 25.0
_MIN_FACING_ANYWHERE = 0.9  # where up is unknown: a table has 0.98, a slab of a cup's wall up to 0.82
_FEWEST = 50  # points of a sample in which a plane is looked for
_MIN_ASIDE = 0.35  # share of the points of a plane that is worth a word where it is none that up expects
_ASIDE_SAMPLE, _ASIDE_TRIPLES = 1000, 200
_MAX_PLANES = 3  # that are tried for each direction, biggest first

_SAMPLE = 120_000  # points before, and
_FIT_SAMPLE = 4_000  # points after that evening out: hypotheses need no more
_TRIPLES = 2000  # that are drawn for the planes, of which the steep ones fall away,
_HYPOTHESES = 150  # and this many are tried
_MIN_TRIANGLE = 0.05  # twice its area on the ground, in squares of the noise
_NUM_NORMALS = 300
_NORMAL_NEIGHBOURS = 40  # on the 4 mm grid, a disc of 14 mm radius: wide enough against 3 mm of noise
_CAMERA_TILT_DEG = 50.0  # a camera that looks down at a table by 40 to 90 degrees still has it within this of an axis


def find_support(
    points: np.ndarray,
    up: np.ndarray | None = (0.0, 0.0, 1.0),  # type: ignore[assignment]
    *,
    viewpoint: np.ndarray | None = None,
    sensor: SensorProfile = TABLETOP,
) -> SupportPlane | None:
    """The plane that the objects of a cloud rest on.

    Among the planes that RANSAC finds, the one with most points that lies below what stands within its outline and
    reaches beyond it; so neither the top of a box nor the bottom of a cup nor a flat bottle's side is taken for it.

    Args:
        points: (n, 3) finite, m.
        up: (3,) roughly the plane's normal; None tries the axes of the frame, taken as a camera's (y down).
        viewpoint: (3,) m, where the camera stood; where up is None the plane faces it, and it is taken to be the
            origin unless given.
        sensor: Its noise is the unit of all tolerances.

    Returns:
        The plane, its normal towards up or the camera; None where there is no such plane.
    """
    if len(points) == 0:
        return None
    rng = np.random.default_rng(0)  # the same cloud has the same table
    sample = _even_sample(np.asarray(points, dtype=np.float64), _VOXEL * sensor.sigma_m, rng)
    if len(sample) < _FEWEST:
        return None
    directions = CAMERA_UPS if up is None else (up,)
    eye = np.zeros(3) if viewpoint is None else np.asarray(viewpoint, dtype=np.float64)
    tilt_deg = _CAMERA_TILT_DEG if up is None else MAX_TILT_DEG
    best, best_score = None, 0.0
    for direction in directions:
        for plane in _planes(sample, np.asarray(direction, dtype=np.float64), tilt_deg, sensor.sigma_m):
            if up is None:
                plane = _facing(plane, eye)
            score = _support_score(plane, sample, sensor.sigma_m, _MIN_FACING_ANYWHERE if up is None else _MIN_FACING)
            if score > 0.5:  # more than half of everything lies on it: no other can be bigger
                return plane
            if score > best_score:
                best, best_score = plane, score
    return best


def warn_of_a_plane_aside(
    points: np.ndarray, up: np.ndarray, *, viewpoint: np.ndarray | None = None, sensor: SensorProfile = TABLETOP
) -> None:
    """Warn where a support holds many of the points and is not level: then up may be wrong.

    Args:
        points: (n, 3) finite, m, in the caller's frame, which the message tells the plane in.
        up: (3,) unit, as it was given or assumed.
        viewpoint: (3,) m; None takes the origin, where up turns out to be wrong.
        sensor: Its noise is the unit of all tolerances.
    """
    level, eye = np.cos(np.radians(MAX_TILT_DEG)), np.zeros(3) if viewpoint is None else viewpoint
    rng = np.random.default_rng(0)
    sample = _even_sample(points, _VOXEL * sensor.sigma_m, rng)
    widest, share = _widest(sample, rng, sensor)
    if (
        len(sample) < _FEWEST
        or share < _MIN_ASIDE
        or (abs(widest.normal @ up) > level and (widest.distances(eye) > 0) == (widest.normal @ up > 0))
    ):
        return  # without the search below, which takes thirty times as long
    if _support_score(_facing(_refined(widest, sample, sensor.sigma_m), eye), sample, sensor.sigma_m, 0.0) == 0.0:
        return  # a side of a body: nothing stands on it
    plane = find_support(points, None, viewpoint=viewpoint, sensor=sensor)
    if plane is None or plane.normal @ up > level:
        return
    share = float((np.abs(plane.distances(points)) < _INLIER * sensor.sigma_m).mean())
    if share > _MIN_ASIDE:
        angle_deg = np.degrees(np.arccos(np.clip(plane.normal @ up, -1.0, 1.0)))
        told = ", ".join(f"{value + 0.0:.2f}" for value in plane.normal)
        warnings.warn(
            f"{share:.0%} of the points lie in one plane, whose normal ({told}) is {angle_deg:.0f} degrees from up: if "
            "that is the table, up is wrong; up=None (--up auto) takes that plane, or give its normal as up",
            stacklevel=5,
        )


def widest_plane(points: np.ndarray, *, sensor: SensorProfile = TABLETOP) -> tuple[SupportPlane, float]:
    """The plane of any direction that most of (n, 3) points lie in, roughly, and their share; its sign is chance."""
    rng = np.random.default_rng(0)
    return _widest(_even_sample(points, _VOXEL * sensor.sigma_m, rng), rng, sensor)


def _widest(sample: np.ndarray, rng: np.random.Generator, sensor: SensorProfile) -> tuple[SupportPlane, float]:
    few = sample[rng.permutation(len(sample))[:_ASIDE_SAMPLE]]
    a, b, c = np.moveaxis(few[rng.integers(len(few), size=(_ASIDE_TRIPLES, 3))], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals = np.where(length[:, None] > 1e-12, normals / np.maximum(length, 1e-12)[:, None], (0.0, 0.0, 1.0))
    heights = np.einsum("nx,nx->n", a, normals)
    shares = (np.abs(few @ normals.T - heights) < _INLIER * sensor.sigma_m).mean(axis=0)
    best = int(np.argmax(shares))
    return SupportPlane(normals[best], heights[best]), float(shares[best])


def _refined(plane: SupportPlane, points: np.ndarray, sigma_m: float) -> SupportPlane:
    """The plane by least squares through the points that are near it."""
    on = points[np.abs(plane.distances(points)) < _INLIER * sigma_m]
    middle = on.mean(axis=0)
    normal = np.linalg.svd(on - middle, full_matrices=False)[2][2]
    return SupportPlane(normal, float(normal @ middle))


def _even_sample(points: np.ndarray, voxel_m: float, rng: np.random.Generator) -> np.ndarray:
    if len(points) > _SAMPLE:
        points = points[np.sort(rng.choice(len(points), _SAMPLE, replace=False))]
    cells = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
    extent = cells.max(axis=0) + 1
    _, first = np.unique((cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2], return_index=True)
    return points[np.sort(first)]


def _planes(sample: np.ndarray, up: np.ndarray, tilt_deg: float, sigma_m: float) -> Iterator[SupportPlane]:
    """Planes within tilt_deg of up, biggest first, each refined by least squares on its inliers."""
    R = rotation_between(up, (0.0, 0.0, 1.0))  # heights are regressed on the ground, so up must be z
    rest = sample @ R.T
    max_slope = np.tan(np.radians(tilt_deg))
    min_inliers = max(30, int(_MIN_SHARE * len(sample)))
    for k in range(_MAX_PLANES):
        if len(rest) < min_inliers:
            return
        fitted = rest[np.random.default_rng(k).permutation(len(rest))[:_FIT_SAMPLE]]
        plane = _ransac(fitted, max_slope, sigma_m, np.random.default_rng(k))
        if plane is None:
            return
        inlier = np.abs(_over(plane, rest)) < _INLIER * sigma_m
        if inlier.sum() < min_inliers:
            return
        on = rest[inlier]
        slope_x, slope_y, offset = np.linalg.lstsq(_with_ones(on), on[:, 2], rcond=None)[0]
        normal = np.array([-slope_x, -slope_y, 1.0])
        length = float(np.linalg.norm(normal))
        if np.hypot(slope_x, slope_y) < max_slope:
            yield SupportPlane(R.T @ normal / length, float(offset) / length)
        rest = rest[~inlier]


def _ransac(points: np.ndarray, max_slope: float, sigma_m: float, rng: np.random.Generator) -> np.ndarray | None:
    """The plane z = a x + b y + c (3,) through three of the points that has most of them near; None: all too steep.

    All hypotheses at once: a general RANSAC, which makes one after the other, takes a hundred times as long.
    """
    corners = points[rng.integers(len(points), size=(_TRIPLES, 3))]
    A = np.concatenate([corners[..., :2], np.ones((_TRIPLES, 3, 1))], axis=2)
    # Twice the triangle's area on the ground; of a sliver the plane means nothing.
    sound = np.abs(np.linalg.det(A)) > _MIN_TRIANGLE * sigma_m**2
    planes = np.linalg.solve(A[sound], corners[sound, :, 2:])[..., 0]
    planes = planes[np.hypot(planes[:, 0], planes[:, 1]) < max_slope][:_HYPOTHESES]
    if len(planes) == 0:
        return None
    near = np.abs(points[:, 2] - planes @ _with_ones(points).T) < _INLIER * sigma_m
    return planes[int(np.argmax(near.sum(axis=1)))]


def _over(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Heights (n,) of points over the plane z = a x + b y + c."""
    return points[:, 2] - _with_ones(points) @ plane


def _with_ones(points: np.ndarray) -> np.ndarray:
    return np.column_stack([points[:, :2], np.ones(len(points))])


def _facing(plane: SupportPlane, eye: np.ndarray) -> SupportPlane:
    return plane if plane.distances(eye[None])[0] >= 0 else SupportPlane(-plane.normal, -plane.height_m)


def _support_score(plane: SupportPlane, sample: np.ndarray, sigma_m: float, min_facing: float) -> float:
    """Share of the sample on the plane where it can be the support, else 0."""
    distances = plane.distances(sample)
    ground = sample @ rotation_between(plane.normal, (0.0, 0.0, 1.0))[:2].T
    inlier_m = _INLIER * sigma_m
    on = np.abs(distances) < inlier_m
    outline = _outline(ground[on])
    if outline is None:
        return 0.0
    aside_m = beyond_m(ground, outline.equations)
    inside = aside_m <= _OUTLINE * sigma_m
    above = inside & (distances > 2 * inlier_m)
    below = inside & (distances < -2 * inlier_m)
    num_above = int(above.sum())
    if num_above < 20 or below.sum() > _MAX_BELOW * (num_above + on.sum()):
        return 0.0
    # A lid's pot goes on below its rim, about as far out; the floor about a table is seen beside it, not right below.
    size_m = outline.volume**0.5
    skirt = (aside_m <= _RIM * size_m) & (distances < -2 * inlier_m) & (distances > -_DROP * size_m)
    if skirt.sum() > _MOST_SKIRT * (num_above + on.sum()):
        return 0.0
    # What stands on a table is within its outline, and the table goes on beyond it.
    if num_above < 0.5 * (distances > 2 * inlier_m).sum() and num_above < 0.3 * on.sum():
        return 0.0
    standing = _outline(ground[above])
    if standing is not None and outline.volume < _MIN_SPREAD * standing.volume:
        return 0.0
    if _share_facing_along(plane.normal, sample, on) < min_facing:
        return 0.0
    return float(on.mean())


def _share_facing_along(normal: np.ndarray, sample: np.ndarray, on: np.ndarray) -> float:
    """Share of the plane's points whose own neighbourhood faces along its normal: a slab cut out of a body does not."""
    chosen = np.flatnonzero(on)
    chosen = chosen[:: -(-len(chosen) // _NUM_NORMALS)]
    normals = estimate_normals(sample, sample[chosen], None, num_neighbours=_NORMAL_NEIGHBOURS)
    return float((np.abs(normals @ normal) > np.cos(np.radians(_FACING_DEG))).mean())


def _outline(ground: np.ndarray) -> ConvexHull | None:
    if len(ground) < 10:
        return None
    try:
        return ConvexHull(ground)  # its `volume` is an area in two dimensions
    except QhullError:
        return None


def beyond_m(ground: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """(...,) m, how far points (..., 2) on the ground are beyond an outline of half-planes (k, 3)."""
    return (ground @ outline[:, :2].T + outline[:, 2]).max(axis=-1)
