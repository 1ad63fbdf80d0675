"""Objects above a support plane, as connected pieces of surface: in a depth picture, or in bare points.

In a picture, pieces also end at sharp concave creases, where one body stands on, or leans against, another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from sklearn.cluster import DBSCAN

from gfp_grasp.clouds import voxel_grid
from gfp_grasp.detect.continuation import join_behind
from gfp_grasp.detect.merging import merge_pieces
from gfp_grasp.detect.tables import noise_growth
from gfp_grasp.types import TABLETOP, SensorProfile, SupportPlane

ARM = 10.0  # half a chord, in multiples of the noise: well above it, and below the radius of what is to stay whole
_SMOOTH_PX = 5


def concavity(
    points: np.ndarray,
    chosen: np.ndarray,
    depth: np.ndarray,
    eye: np.ndarray,
    focal_px: float,
    *,
    jump: np.ndarray,
    arm_m: float,
) -> np.ndarray:
    """How far the surface dips under chords across each pixel.

    For the ends l, r of a chord of two arms in the picture and its middle m, the concavity is
    ((l + r) / 2 - m) towards the eye, over |l - r|; of four directions the largest counts. Arms a that meet in a
    right angle give 0.5; the inside of a cylinder of radius R gives a / (4 R), 0.1 for a cup.

    Args:
        points: (h, w, 3) m.
        chosen: (h, w) bool, where all three points must lie.
        depth: (h, w) m, distance from the eye; 0 where nothing came back.
        eye: (3,) m.
        focal_px: Focal length.
        jump: (h, w) m; a depth step beyond it breaks a chord.
        arm_m: Half a chord.

    Returns:
        (h, w) float64, 0 where no unbroken chord lies across.
    """
    rays = points - eye
    rays /= np.maximum(depth, 1e-9)[:, :, None]
    # Where nothing came back, the nearest return stands in, so that the edge of a hole is no crease.
    nearest = np.asarray(ndimage.distance_transform_edt(depth == 0, return_distances=False, return_indices=True))
    smooth = eye + rays * ndimage.median_filter(depth[nearest[0], nearest[1]], _SMOOTH_PX)[:, :, None]
    arm_px = max(3, round(focal_px * arm_m / float(np.median(depth[chosen]))))
    largest = np.zeros(chosen.shape)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        k = arm_px if dy * dx == 0 else max(2, round(arm_px / np.sqrt(2)))
        middle, left, right = _windows(chosen.shape, k * dy, k * dx)
        if middle is None:
            continue
        chord = smooth[left] - smooth[right]
        dip = (smooth[left] + smooth[right]) / 2 - smooth[middle]
        value = -np.einsum("hwi,hwi->hw", dip, rays[middle]) / np.maximum(np.linalg.norm(chord, axis=2), 1e-6)
        whole = chosen[middle] & chosen[left] & chosen[right] & ~_broken(depth, jump, dy, dx, k)[middle]
        largest[middle] = np.maximum(largest[middle], np.where(whole, value, 0.0))
    return largest


def _windows(shape: tuple[int, ...], dy: int, dx: int) -> tuple:
    """Slices of the picture's middle, and of the same pixels moved by minus and plus (dy, dx)."""
    h, w = shape
    a, b = abs(dy), abs(dx)
    if h <= 2 * a or w <= 2 * b:
        return None, None, None

    def window(y: int, x: int) -> tuple[slice, slice]:
        return slice(a + y, h - a + y), slice(b + x, w - b + x)

    return window(0, 0), window(-dy, -dx), window(dy, dx)


def _broken(depth: np.ndarray, jump: np.ndarray, dy: int, dx: int, arm_px: int) -> np.ndarray:
    """Whether a chord of two arms along (dy, dx) crosses a depth step."""
    step = np.zeros(depth.shape, dtype=np.uint8)
    middle, left, _ = _windows(depth.shape, dy, dx)
    if middle is not None:
        step[middle] = np.abs(depth[middle] - depth[left]) > jump[middle]
    footprint = np.zeros((2 * arm_px * abs(dy) + 1, 2 * arm_px * abs(dx) + 1), dtype=bool)
    along = np.arange(2 * arm_px + 1)
    footprint[along * abs(dy), (along if dx >= 0 else along[::-1]) * abs(dx)] = True
    return ndimage.maximum_filter(step, footprint=footprint) > 0


# Multiples of the sensor's noise:
_FLOOR = 4.0  # height above the support from which a point belongs to an object
_JUMP = 8 / 3  # depth step between neighbouring pixels that parts surfaces, at the camera
_GAP = 8.0  # bare points farther apart than this are two clusters
VOXEL = 2.0  # grid on which bare points are clustered: below a handle's thickness
_NEAR = 10.0  # pixels of a crease join a piece within this distance

_JUMP_PER_M = 0.01  # that the depth step grows by for each metre of depth
_MAX_CONCAVITY = 0.2  # dip of the surface under a chord, over the chord's length, that parts two bodies: a right angle
# has 0.5, the inside of a cup 0.1 (see concavity)
_MIN_AREA = 3.56  # surface of the smallest object that counts, in squares of the sensor's smallest
_MAX_WIDTH = 0.4  # wider clusters are walls or furniture, not objects; in the sensor's largest
_COARSE = 1.05  # from this noise on, in the sensor's own, an object must rise higher than what belongs to it:
_LEAST_HEIGHT = 6.0  # in multiples of the noise there;
_FILM = 14.0  # what is lower than this
_SOLID = 0.7  # and has less than this share of its pixels in squares of five is noise
_MIN_PIECE_PX = 25  # fewer pixels or voxels are flying ones
_CREASE_PX = 4  # a crease's ends stop short of the silhouette, where chords break
_NEIGHBOURS = 4  # cells within the gap, that an inner point of a surface has


@dataclass(frozen=True, eq=False)
class Surfaces:
    """The part of an organised picture that is above a support, in connected pieces of surface.

    Attributes:
        window: Rows and columns of the picture that all of it lies in; all arrays are of that window.
        points: (h, w, 3) m, zero where nothing came back.
        depth: (h, w) m, distance from the camera; 0 where nothing came back.
        above: (h, w) bool, what is above the support and hangs together.
        pieces: (h, w) int32 pieces between depth steps and sharp concave creases, from 1 on; 0 where there is none.
        area_m2: (h, w) surface that a pixel stands for.
    """

    window: tuple[slice, slice]
    points: np.ndarray
    depth: np.ndarray
    above: np.ndarray
    pieces: np.ndarray
    area_m2: np.ndarray


def cut_picture(
    points: np.ndarray, support: SupportPlane, eye: np.ndarray, focal_px: float, *, sensor: SensorProfile = TABLETOP
) -> Surfaces | None:
    """Pieces of surface above a support; None where nothing is above it.

    Args:
        points: (h, w, 3) m, NaN where nothing came back.
        support: What things stand on, same frame.
        eye: (3,) m, the camera.
        focal_px: Focal length.
        sensor: Its noise and sizes are the units of all thresholds.
    """
    valid = np.asarray(np.isfinite(points).all(axis=2))
    points = np.where(valid[:, :, None], points, 0.0)
    above = valid & (support.distances(points.reshape(-1, 3)).reshape(valid.shape) > _FLOOR * sensor.sigma_m)
    if above.sum() < _MIN_PIECE_PX:
        return None
    rows, columns = (slice(a.min(), a.max() + 1) for a in np.nonzero(above))
    points, above, valid = points[rows, columns], above[rows, columns], valid[rows, columns]
    depth = np.where(valid, np.linalg.norm(points - eye, axis=2), 0.0)
    jump = _JUMP * sensor.sigma_m + _JUMP_PER_M * depth
    above = above & (_connected_pixels(above, depth, jump) > 0)  # flying pixels hang together with nothing
    if not above.any():
        return None
    arm_m = ARM * sensor.sigma_m
    crease = concavity(points, above, depth, eye, focal_px, jump=jump, arm_m=arm_m) > _MAX_CONCAVITY
    crease = above & np.asarray(ndimage.binary_dilation(crease, iterations=_CREASE_PX), dtype=bool)
    pieces = _give_back(_connected_pixels(above & ~crease, depth, jump), above, points, _NEAR * sensor.sigma_m)
    rest = _connected_pixels(above & (pieces == 0), depth, jump)  # wide creases, as round the floor of a cup
    pieces = np.where(rest > 0, rest + pieces.max(), pieces)
    return Surfaces((rows, columns), points, depth, above, pieces, (depth / focal_px) ** 2)


def label_picture(
    points: np.ndarray, support: SupportPlane, eye: np.ndarray, focal_px: float, *, sensor: SensorProfile = TABLETOP
) -> np.ndarray:
    """Objects of an organised picture: the pieces of `cut_picture` that are one object are joined by merge_pieces.

    Args:
        points: (h, w, 3) m, NaN where nothing came back.
        support: What they stand on, same frame.
        eye: (3,) m, the camera.
        focal_px: Focal length.
        sensor: Its noise and sizes are the units of all thresholds.

    Returns:
        (h, w) int32 labels: 0 for background, 1 for the object with most pixels, and so on.
    """
    labels = np.zeros(points.shape[:2], dtype=np.int32)
    cut = cut_picture(points, support, eye, focal_px, sensor=sensor)
    if cut is not None:
        merged = merge_pieces(cut.pieces, cut.points, support, cut.area_m2, sensor=sensor)[cut.pieces]
        coarser = noise_growth(cut.depth)
        merged = join_behind(merged, cut.points, cut.depth, support, sensor=sensor, noise_growth=coarser)
        labels[cut.window] = keep_objects(merged, cut.points, support, cut.area_m2, sensor, coarser=coarser)
    return labels


def label_points(
    points: np.ndarray, support: SupportPlane, *, sensor: SensorProfile = TABLETOP, drop: bool = True
) -> np.ndarray:
    """Objects of bare points: DBSCAN on a grid, then merge_pieces.

    Args:
        points: (n, 3) m.
        support: What they stand on.
        sensor: Its noise and sizes are the units of all thresholds.
        drop: Leave out what is too small or too wide for an object.

    Returns:
        (n,) int32 labels: 0 for the support and for flying points, 1 for the object with most surface, and so on.
    """
    labels = np.zeros(len(points), dtype=np.int32)
    above = np.flatnonzero(support.distances(points) > _FLOOR * sensor.sigma_m)
    if len(above) < _MIN_PIECE_PX:
        return labels
    centres, cell_of = voxel_grid(points[above], VOXEL * sensor.sigma_m)
    pieces = cluster_points(centres, sensor)
    area_m2 = np.full(len(centres), (VOXEL * sensor.sigma_m) ** 2)
    merged = merge_pieces(pieces, centres, support, area_m2, sensor=sensor)[pieces]
    objects = keep_objects(merged, centres, support, area_m2, sensor, drop=drop)
    labels[above] = objects[cell_of]
    return labels


def cluster_points(points: np.ndarray, sensor: SensorProfile, *, least_gap_m: float = 0.0) -> np.ndarray:
    """(n,) int32 clusters of (n, 3) points by DBSCAN, 0 for outliers; the gap grows where the points are sparse."""
    if len(points) < 2:
        return np.zeros(len(points), dtype=np.int32)
    spacing = float(np.median(KDTree(points).query(points[:: -(-len(points) // 2000)], k=2)[0][:, 1]))
    gap_m = max(_GAP * sensor.sigma_m, 3.0 * spacing, least_gap_m)
    # Three cells to the gap: the time grows with the square of how many points lie within it.
    centres, cell_of = voxel_grid(points, gap_m / 3)
    found = DBSCAN(eps=gap_m, min_samples=_NEIGHBOURS).fit(centres).labels_[cell_of]
    return (found + 1).astype(np.int32)


def _connected_pixels(chosen: np.ndarray, depth: np.ndarray, jump: np.ndarray) -> np.ndarray:
    """(h, w) int32 pieces of the chosen pixels, neighbours joined where there is no depth step; 0 elsewhere."""
    index = np.arange(chosen.size).reshape(chosen.shape)
    pairs = []
    for a, b in (((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
                 ((slice(None, -1), slice(None)), (slice(1, None), slice(None)))):  # fmt: skip
        joined = chosen[a] & chosen[b] & (np.abs(depth[a] - depth[b]) < jump[a])
        pairs.append((index[a][joined], index[b][joined]))
    rows, columns = (np.concatenate(side) for side in zip(*pairs, strict=True))
    graph = coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(chosen.size, chosen.size))
    found = connected_components(graph, directed=False)[1].reshape(chosen.shape)
    big = np.bincount(found[chosen], minlength=found.max() + 1) >= _MIN_PIECE_PX
    number = np.where(big, np.cumsum(big), 0)
    return np.where(chosen, number[found], 0).astype(np.int32)


def _give_back(pieces: np.ndarray, above: np.ndarray, points: np.ndarray, near_m: float) -> np.ndarray:
    """Pixels of creases and specks join the nearest piece in the picture, where that is near in space too."""
    if not pieces.any():
        return pieces
    nearest = np.asarray(ndimage.distance_transform_edt(pieces == 0, return_distances=False, return_indices=True))
    there = points[nearest[0], nearest[1]]
    near = np.linalg.norm(points - there, axis=2) < near_m
    return np.where(above & near, pieces[nearest[0], nearest[1]], pieces)


def keep_objects(
    merged: np.ndarray,
    points: np.ndarray,
    support: SupportPlane,
    area_m2: np.ndarray,
    sensor: SensorProfile,
    *,
    coarser: np.ndarray | None = None,
    drop: bool = True,
    sure: Sequence[int] | np.ndarray = (),
) -> np.ndarray:
    """Those labels that may be objects, renumbered by size; shape of `merged`.

    Too small, too wide and too flat ones are dropped; what is too flat grows with the noise there, `coarser` times that
    of the sensor. Those that are `sure` to be things may be flat.
    """
    chosen = merged > 0
    count = int(merged.max(initial=0)) + 1
    area = np.bincount(merged[chosen], area_m2[chosen], minlength=count)
    keep = area >= (_MIN_AREA * sensor.smallest_m**2 if drop else 1e-12)
    for k in np.flatnonzero(keep) if drop else ():
        own = merged == k
        noise_m = sensor.sigma_m * (1.0 if coarser is None else float(np.median(coarser[own])))
        keep[k] = _is_object(own, points, support, noise_m, sensor, flat=k in sure)
    order = np.argsort(-np.bincount(merged[chosen], minlength=count), kind="stable")
    number = np.zeros(len(keep), dtype=np.int32)
    kept = [k for k in order if keep[k]]
    number[kept] = np.arange(1, len(kept) + 1)
    return number[merged]


def _is_object(
    own: np.ndarray,
    points: np.ndarray,
    support: SupportPlane,
    noise_m: float,
    sensor: SensorProfile,
    *,
    flat: bool,
) -> bool:
    """Whether own pixels, or points, are neither as wide as furniture nor, unless they may be flat, a film of noise."""
    mine = points[own]
    low, high = np.percentile(mine, (2, 98), axis=0)
    if float((high - low).max()) > _MAX_WIDTH * sensor.largest_m:
        return False
    if flat:
        return True
    height_m = float(np.percentile(support.distances(mine), 98))
    least_m = _LEAST_HEIGHT * noise_m if noise_m > _COARSE * sensor.sigma_m else _FLOOR * sensor.sigma_m
    if height_m < least_m:
        return False
    if own.ndim < 2 or height_m > _FILM * noise_m:
        return True
    window = tuple(slice(a.min(), a.max() + 1) for a in np.nonzero(own))
    solid = ndimage.binary_opening(np.pad(own[window], 2), np.ones((5, 5)))
    return bool(solid.sum() > _SOLID * own.sum())
