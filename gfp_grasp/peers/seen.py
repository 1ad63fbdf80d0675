"""What was seen of an object, in the cube of a peer: points, the cells that they lie in, and cells known to be empty.

Letters: n points, x, y, z cells along the cube's axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy import ndimage

from gfp_grasp.clouds import thin
from gfp_grasp.peers.cube import Cube
from gfp_grasp.transforms import apply_T, invert_T, look_at
from gfp_grasp.types import PointCloud

_MARGIN = 1.0  # cells before a return that are not called empty
_CLOSING = 2  # pixels of a guessed silhouette that holes are closed by
_LEAST_DEPTH = 1e-3


@dataclass(frozen=True, eq=False)
class Seen:
    """What was seen, in sides of the cube.

    Attributes:
        points: (n, 3).
        viewpoint: (3,) or None.
    """

    points: np.ndarray
    viewpoint: np.ndarray | None

    def mirrored(self) -> Seen:
        """The same in the mirror y = 0."""
        flip = np.array([1.0, -1.0, 1.0])
        return Seen(self.points * flip, None if self.viewpoint is None else self.viewpoint * flip)


def seen_in(cube: Cube, cloud: PointCloud) -> Seen:
    """A cloud in a cube."""
    viewpoint = None if cloud.viewpoint is None else cube.inward(cloud.viewpoint[None])[0]
    return Seen(cube.inward(cloud.points), viewpoint)


def fixed_number(points: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) float32 of points (n, 3), spread evenly; where there are fewer, they repeat."""
    chosen = thin(points, count)
    if len(chosen) > count:
        chosen = chosen[np.linspace(0, len(chosen) - 1, count).round().astype(int)]
    return np.resize(chosen, (count, 3)).astype(np.float32)


@cache
def cell_middles(resolution: int) -> np.ndarray:
    """(resolution ** 3, 3) float64, read-only, the middles of all cells in sides of the cube."""
    axis = (np.arange(resolution) + 0.5) / resolution - 0.5
    middles = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    middles.setflags(write=False)
    return middles


def occupied_cells(points: np.ndarray, resolution: int) -> np.ndarray:
    """(x, y, z) bool, cells that points (n, 3) lie in; those outside the cube are left out."""
    cells = np.zeros(3 * (resolution,), dtype=bool)
    index = np.floor((points + 0.5) * resolution).astype(np.int64)
    index = index[((index >= 0) & (index < resolution)).all(axis=1)]
    cells[tuple(index.T)] = True
    return cells


def distance_to_points(points: np.ndarray, resolution: int, *, reach: float) -> np.ndarray:
    """(x, y, z) float32, distances of cells' middles from the points (n, 3), in cells, at most `reach`.

    It is that to the mean of the points in the nearest cell that holds any.
    """
    scaled = (points + 0.5) * resolution
    index = np.floor(scaled).astype(np.int64)
    inside = ((index >= 0) & (index < resolution)).all(axis=1)
    flat = index[inside] @ np.array([resolution**2, resolution, 1])
    count = np.bincount(flat, minlength=resolution**3)
    if not inside.any():
        return np.full(3 * (resolution,), reach, dtype=np.float32)
    sums = np.stack([np.bincount(flat, scaled[inside, axis], resolution**3) for axis in range(3)], axis=1)
    means = sums / np.maximum(count, 1)[:, None]
    empty = (count == 0).reshape(3 * (resolution,))
    towards = np.asarray(ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True))
    nearest = towards.reshape(3, -1).T @ np.array([resolution**2, resolution, 1])
    away = (cell_middles(resolution) + 0.5) * resolution - means[nearest]
    distance = np.minimum(np.linalg.norm(away, axis=1), reach)
    return distance.reshape(3 * (resolution,)).astype(np.float32)


def empty_cells(seen: Seen, resolution: int) -> np.ndarray:
    """(x, y, z) bool, cells that are known to be empty: those before the points.

    A picture with pixels as wide as a cell is made of the points, and small holes in it are closed. Beside the points
    nothing is known, as an occluder may stand there; nor is anything without a viewpoint.
    """
    shape = 3 * (resolution,)
    if seen.viewpoint is None or np.linalg.norm(seen.viewpoint) < _LEAST_DEPTH:
        return np.zeros(shape, dtype=bool)
    T_camera = invert_T(look_at(seen.viewpoint, np.zeros(3)))
    focal, size = float(np.linalg.norm(seen.viewpoint)) * resolution, 3 * resolution
    of_points, points_m = _pixels(apply_T(T_camera, seen.points), focal, size)
    of_cells, cells_m = _pixels(apply_T(T_camera, cell_middles(resolution)), focal, size)
    nearest = np.full(size * size + 1, np.inf)  # the last is for what is not in the picture
    np.minimum.at(nearest, of_points, points_m)
    nearest = nearest[:-1].reshape(size, size)
    own = ndimage.binary_closing(np.isfinite(nearest), structure=np.ones((3, 3)), iterations=_CLOSING)
    if not own.any():
        return np.zeros(shape, dtype=bool)
    filled = ndimage.distance_transform_edt(np.isinf(nearest), return_distances=False, return_indices=True)
    surface = np.where(own, nearest[tuple(np.asarray(filled))], -np.inf)
    before = cells_m < np.append(surface, -np.inf)[of_cells] - _MARGIN / resolution
    return before.reshape(shape)


def _pixels(points: np.ndarray, focal: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (n,) of a square picture and depth (n,) of points in the camera's frame; size ** 2 for those outside."""
    depth = points[:, 2]
    at = np.floor(points[:, :2] / np.maximum(depth, _LEAST_DEPTH)[:, None] * focal + size / 2)
    inside = (depth > _LEAST_DEPTH) & ((at >= 0) & (at < size)).all(axis=1)
    at = np.where(inside[:, None], at, 0).astype(np.int64)
    return np.where(inside, at[:, 1] * size + at[:, 0], size * size), depth
