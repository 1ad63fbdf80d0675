"""The plane in a depth picture that things stand on, in a room with floors, walls and other tables.

Planes are found by RANSAC on points with normals. The support is the one on which most stands in the picture: bodies
that begin at its height, are as small as objects and lie within its outline. Behind a table there may be a floor, and a
wall beside it; neither is chosen for its size. A lid with a knob on it is the top of what stands on the plane below.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.detect.support import MAX_TILT_DEG, beyond_m
from gfp_grasp.transforms import cross, rotation_between
from gfp_grasp.types import DepthImage, SensorProfile, SupportPlane

# Multiples of the sensor's noise:
_SLAB = 4.0  # half the thickness of a plane at the distance at which the sensor has this noise,
_OUTLINE = 10.0  # what is this far beyond the plane's outline still stands within it
_REACH = 100.0  # and so far may reach what stands on it.
_BEGINS = 12.0  # what stands begins lower than this above the slab, for its foot may be hidden;
_FLOATING = 0.02  # what begins higher counts so much less: its foot is behind something, or it hangs
_RISES = 4.0  # what is lower than this above the slab is noise

_NOISE_AT_M = 0.8  # up to here a depth camera has its noise
_STRIDE = 2  # of the pixels that are looked at
_NORMAL_PX = 3  # half a step of the differences that normals are made of
_HYPOTHESES = 400
_REFINED = 6  # of them, the best, are refined
_JUDGED = 3000  # points that a hypothesis is judged by
_FITTED = 15_000  # points that a plane is fitted to,
_ROUNDS = 20  # at most so often
_FACING_DEG = 20.0  # between a plane and the surface of what lies on it
_MOST_PLANES = 6
_LEAST_SHARE = 0.02  # of the points that lie on a plane
_MOST_ROLL = 0.8  # cosine of a plane's normal with the camera's rows from which on it is a wall
_OVERHEAD = -0.2  # cosine of a plane's normal with the camera's up below which it is a ceiling
_STRIP_PX = 5  # half the width of what is too narrow for a table
_LEAST_PIECE = 0.03  # of a plane, a share of its largest piece
_JUMP_PER_M = 0.01  # step in range between neighbouring pixels of one surface, for each metre of range
_LEAST_BODY_PX = 30  # pixels, of those looked at
_MAX_WIDTH = 0.4  # of what stands, in the sensor's largest
_TALLEST = 0.4
_LEAST_ON_TABLE = 0.3  # of an object's pixels


@dataclass(frozen=True, eq=False)
class Table:
    """A plane that things stand on, with its outline.

    Attributes:
        plane: The plane, world frame.
        outline: Half-planes (k, 3) on the ground, normal and offset: x lies within where normal @ x + offset <= 0.
        margin_m: How far beyond the outline a thing still stands on it.
        reach_m: How far beyond it a thing may reach that stands on it.
    """

    plane: SupportPlane
    outline: np.ndarray
    margin_m: float
    reach_m: float

    def beyond_m(self, points: np.ndarray) -> np.ndarray:
        """(...,) how far points (..., 3) m, world, are beyond the outline on the ground; negative within it."""
        return beyond_m(points @ rotation_between(self.plane.normal, (0.0, 0.0, 1.0))[:2].T, self.outline)


@dataclass(frozen=True, eq=False)
class Tables:
    """What was looked at to find the support.

    Attributes:
        best: The plane that most stands on; None where nothing stands on any.
        num_planes: Number of planes that were found.
    """

    best: Table | None
    num_planes: int


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A plane that may be the support.

    Attributes:
        table: The plane with the outline of its large pieces.
        standing: Number of pixels of things that stand on it.
        middle: (3,) m, mean of its own points.
        width_m: Its larger extent on the ground.
    """

    table: Table
    standing: float
    middle: np.ndarray
    width_m: float


def keep_on_table(labels: np.ndarray, on_table: np.ndarray) -> np.ndarray:
    """Labels (h, w) of those objects enough of whose pixels are on the table, renumbered: no walls, no chairs."""
    total = np.bincount(labels.ravel())
    keep = np.bincount(labels[on_table], minlength=len(total)) >= _LEAST_ON_TABLE * total
    keep[0] = False
    return np.where(keep, np.cumsum(keep), 0)[labels]


def noise_growth(range_m: np.ndarray) -> np.ndarray:
    """How many times the sensor's noise a return of some distance has; it grows with the square of the distance."""
    return np.maximum(1.0, (range_m / _NOISE_AT_M) ** 2)


def noise_at(points: np.ndarray, viewpoint: np.ndarray, sensor: SensorProfile) -> float:
    """The sensor's noise at the distance of points (n, 3) m, which may be NaN, from its viewpoint, m."""
    range_m = np.linalg.norm(np.nanmedian(points, axis=0) - viewpoint)
    return sensor.sigma_m * float(noise_growth(np.asarray(range_m)))


def find_table(image: DepthImage, up: np.ndarray | None, *, sensor: SensorProfile) -> Tables:
    """The plane that the objects of a picture stand on.

    Args:
        image: The picture.
        up: (3,) roughly the plane's normal, world frame; None takes any that the camera may look at from above.
        sensor: Its noise and sizes are the units of all thresholds.
    """
    points, normals = _points_and_normals(image)
    known = np.asarray(np.isfinite(points).all(axis=2))
    oriented = known & np.isfinite(normals).all(axis=2)
    if oriented.sum() < 100:
        return Tables(None, 0)
    range_m = np.linalg.norm(points - image.viewpoint, axis=2)
    slab_m = _SLAB * sensor.sigma_m * noise_growth(range_m)
    whole = known & ~_torn(np.where(known, range_m, 0.0), slab_m)
    aside, camera_up = image.T_world_camera[:3, 0], -image.T_world_camera[:3, 1]
    found, free, count = [], oriented.copy(), 0
    for number in range(_MOST_PLANES):
        plane = _largest_plane(points[free], normals[free], slab_m[free], image.viewpoint, up, number)
        if plane is None:
            break
        facing = np.abs(np.where(oriented[..., None], normals, 0.0) @ plane.normal) > np.cos(np.radians(_FACING_DEG))
        close = np.abs(plane.distances(points)) < slab_m
        near = free & facing & close
        if near.sum() < _LEAST_SHARE * oriented.sum():
            break
        count += 1
        free &= ~close  # noise tilts the normals of some of its surface, which is no other plane
        if up is None and (plane.normal @ camera_up < _OVERHEAD or abs(plane.normal @ aside) > _MOST_ROLL):
            continue
        candidate = _what_stands(plane, near, points, whole, slab_m, sensor)
        if candidate is not None and candidate.standing > 0:
            found.append(candidate)
    tables = [one for one in found if not any(_is_top_of_what_stands_on(one, other, sensor) for other in found)]
    best = max(tables, key=lambda one: one.standing, default=None)
    return Tables(None if best is None else best.table, count)


def _is_top_of_what_stands_on(one: _Candidate, other: _Candidate, sensor: SensorProfile) -> bool:
    """Whether a plane is as small as a thing, and as high above a wider one as a thing that stands on that may be."""
    height_m = float(other.table.plane.distances(one.middle))
    return (
        one.width_m < min(_MAX_WIDTH * sensor.largest_m, other.width_m)
        and _RISES * sensor.sigma_m < height_m < _TALLEST * sensor.largest_m
        and float(other.table.beyond_m(one.middle)) <= 0.0
    )


def _points_and_normals(image: DepthImage) -> tuple[np.ndarray, np.ndarray]:
    """Every second point (h, w, 3) m of a picture, and unit normals towards the camera; NaN where there is none."""
    points = image.points()
    k = _NORMAL_PX
    known = np.asarray(np.isfinite(points).all(axis=2))
    sums = np.stack([ndimage.uniform_filter(np.where(known, points[..., i], 0.0), 2 * k - 1) for i in range(3)], axis=2)
    share = ndimage.uniform_filter(known.astype(np.float64), 2 * k - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = np.where((share > 0.6)[..., None], sums / share[..., None], np.nan)
    across, along = np.full_like(points, np.nan), np.full_like(points, np.nan)
    across[:, k:-k] = smooth[:, 2 * k :] - smooth[:, : -2 * k]
    along[k:-k] = smooth[2 * k :] - smooth[: -2 * k]
    normals = cross(across[::_STRIDE, ::_STRIDE], along[::_STRIDE, ::_STRIDE])
    points = points[::_STRIDE, ::_STRIDE]
    with np.errstate(invalid="ignore", divide="ignore"):
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    away = np.einsum("hwi,hwi->hw", normals, points - image.viewpoint) > 0
    return points, np.where(away[..., None], -normals, normals)


def _largest_plane(
    points: np.ndarray,
    normals: np.ndarray,
    slab_m: np.ndarray,
    eye: np.ndarray,
    up: np.ndarray | None,
    seed: int,
) -> SupportPlane | None:
    """The plane towards the eye through one of the points, along its normal, that holds most surface."""
    if len(points) < 50:
        return None
    rng = np.random.default_rng(seed)
    judged = rng.integers(len(points), size=_JUDGED)
    # A far pixel sees more surface than a near one; by its square the floor would always win.
    area = np.linalg.norm(points[judged] - eye, axis=1)
    chosen = rng.integers(len(points), size=8 * _HYPOTHESES)
    if up is not None:
        chosen = chosen[normals[chosen] @ (up / np.linalg.norm(up)) > np.cos(np.radians(MAX_TILT_DEG))]
    chosen = chosen[:_HYPOTHESES]
    if len(chosen) == 0:
        return None
    offsets = np.einsum("ni,ni->n", normals[chosen], points[chosen])
    near = np.abs(points[judged] @ normals[chosen].T - offsets) < slab_m[judged, None]
    near &= normals[judged] @ normals[chosen].T > np.cos(np.radians(_FACING_DEG))
    best, most, (normal, offset) = np.argsort(-(area @ near), kind="stable")[:_REFINED], -1.0, (np.zeros(3), 0.0)
    for k in chosen[best]:
        found = _refined(normals[k], float(normals[k] @ points[k]), points, normals, slab_m, eye)
        held = float(area @ (np.abs(points[judged] @ found[0] - found[1]) < slab_m[judged] / 2))
        if held > most:
            most, (normal, offset) = held, found
    if up is not None and normal @ up / np.linalg.norm(up) < np.cos(np.radians(MAX_TILT_DEG)):
        return None
    return SupportPlane(normal, offset)


def _refined(
    normal: np.ndarray, offset: float, points: np.ndarray, normals: np.ndarray, slab_m: np.ndarray, eye: np.ndarray
) -> tuple[np.ndarray, float]:
    """Unit normal (3,) and offset of the plane by weighted least squares on its own points, until it stays."""
    every = points[:: -(-len(points) // _FITTED)], normals[:: -(-len(points) // _FITTED)]
    slab_m = slab_m[:: -(-len(points) // _FITTED)]
    for _ in range(_ROUNDS):
        # Noise tilts normals and moves points together: a narrow choice of normals would tilt the plane.
        on = (np.abs(every[0] @ normal - offset) < slab_m) & (every[1] @ normal > 0.5)
        if on.sum() < 20:
            break
        weights = 1.0 / slab_m[on] ** 2
        middle = weights @ every[0][on] / weights.sum()
        centred = every[0][on] - middle
        axis = np.linalg.eigh((centred * weights[:, None]).T @ centred)[1][:, 0]
        before, normal = normal, axis if axis @ (eye - middle) > 0 else -axis
        offset = float(normal @ middle)
        if np.abs(before - normal).max() < 1e-5:
            break
    return normal, offset


def _what_stands(
    plane: SupportPlane,
    near: np.ndarray,
    points: np.ndarray,
    known: np.ndarray,
    slab_m: np.ndarray,
    sensor: SensorProfile,
) -> _Candidate | None:
    """The plane with the outline of its large pieces, and what stands on it; None where it is a thin strip alone."""
    R = rotation_between(plane.normal, (0.0, 0.0, 1.0))
    # Objects and their shadows part a table top in the picture; specks elsewhere at its height are none of it.
    pieces, _ = _pieces(np.asarray(ndimage.binary_dilation(near, iterations=4)))
    sizes = np.bincount(pieces[near], weights=slab_m[near])
    ground = points @ R[:2].T
    own = near & np.isin(pieces, np.flatnonzero(sizes >= _LEAST_PIECE * sizes.max()))
    try:
        # A wall or a chair that crosses the plane leaves a thin strip in it.
        hull = ConvexHull(ground[np.asarray(ndimage.binary_opening(own, iterations=_STRIP_PX), dtype=bool)])
    except (QhullError, ValueError):
        return None
    outline = np.unique(hull.equations, axis=0)
    table = Table(plane, outline, _OUTLINE * sensor.sigma_m, _REACH * sensor.sigma_m)
    heights = plane.distances(np.where(known[..., None], points, 0.0))
    above = known & (heights > slab_m) & (heights < _TALLEST * sensor.largest_m)
    standing = _standing_px(table, above, points @ R.T, heights - slab_m, sensor)
    if standing == 0.0:  # the table about an object may be hidden by what stands before it
        table = replace(table, margin_m=table.reach_m)
        standing = _FLOATING * _standing_px(table, above, points @ R.T, heights - slab_m, sensor)
    standing = min(standing, float(own.sum()))  # a support reaches beyond what stands on it
    return _Candidate(table, standing, points[own].mean(axis=0), float(np.ptp(ground[own], axis=0).max()))


def _standing_px(
    table: Table, above: np.ndarray, level: np.ndarray, height_m: np.ndarray, sensor: SensorProfile
) -> float:
    """Number of pixels above a table that are of bodies which may stand on it; of what seems to float, a small share.

    Args:
        table: The plane and its outline.
        above: (h, w) bool, what is above the plane.
        level: (h, w, 3) m, points with z along the normal.
        height_m: (h, w) above the plane's slab.
        sensor: Its noise and sizes are the units of all thresholds.
    """
    above = above.copy()
    above[above] = beyond_m(level[above][:, :2], table.outline) <= table.margin_m
    bodies, _ = _pieces(above)
    standing = 0.0
    for index, window in enumerate(ndimage.find_objects(bodies), start=1):
        body = bodies[window] == index
        if body.sum() < _LEAST_BODY_PX:
            continue
        low, high = np.quantile(height_m[window][body], (0.02, 0.98))
        extent = np.ptp(np.quantile(level[window][body], (0.02, 0.98), axis=0), axis=0).max()
        if high > _RISES * sensor.sigma_m and extent < _MAX_WIDTH * sensor.largest_m:
            standing += float(body.sum()) * (1.0 if low < _BEGINS * sensor.sigma_m else _FLOATING)
    return standing


def _torn(range_m: np.ndarray, slab_m: np.ndarray) -> np.ndarray:
    """(h, w) bool, pixels beside a step in range: what is behind something does not hang together with it."""
    jump_m = slab_m + _STRIDE * _JUMP_PER_M * range_m
    torn = np.zeros(range_m.shape, dtype=bool)
    torn[:, 1:] |= np.abs(np.diff(range_m, axis=1)) > jump_m[:, 1:]
    torn[1:] |= np.abs(np.diff(range_m, axis=0)) > jump_m[1:]
    return torn


def _pieces(chosen: np.ndarray) -> tuple[np.ndarray, int]:
    """Connected pieces (h, w) of chosen pixels, from 1 on, and their number."""
    pieces = np.zeros(chosen.shape, dtype=np.int32)
    ndimage.label(chosen, output=pieces)
    return pieces, int(pieces.max(initial=0))
