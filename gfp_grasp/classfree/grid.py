"""What was seen of one object, on a grid of cubic cells around it: the input of the class-free completion.

Letters: x, y, z cells along the axes of the level frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from gfp_grasp.types import LevelView, Silhouette, pixels_of

MOST_CELLS = 56**3
NUM_CHANNELS = 5
MULTIPLE = 8  # of cells along each axis: the network halves them thrice
REACH = 5.0  # cells: distances from a surface are not told apart beyond
_RAMP = 4.0  # cells over which what is said of rays and of the support grows from nothing to one

# What is left round the seen points, in shares of their longest side: of 260 views of all kinds of things one reached
# farther than 0.12 to a side, and none farther than 0.43 behind.
_ASIDE, _BEHIND = 0.12, 0.43
_BELOW = 0.2  # where no support was seen
_HIDDEN = 0.5  # where an occluder stands before it, or the picture ends
_HIDDEN_SHARE = 0.25  # of the places beside the points that nobody could see
_OUTLIERS = 0.005  # share of the points, at either end, that pixels which fly off an edge may be
_LEAST_CELLS = 16
_UNDER = 2.0  # cells below a support that was seen


@dataclass(frozen=True)
class Grid:
    """Cubic cells in the level frame.

    Attributes:
        origin: (3,) m, middle of the first cell.
        cell_m: Length of an edge.
        shape: Cells along x, y and z.
    """

    origin: tuple[float, float, float]
    cell_m: float
    shape: tuple[int, int, int]

    def middles(self) -> np.ndarray:
        """(x * y * z, 3) m, the middles of all cells."""
        axes = [start + self.cell_m * np.arange(num) for start, num in zip(self.origin, self.shape, strict=True)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Places (n, 3) of points (n, 3) m, in cells from the middle of the first."""
        return (points - self.origin) / self.cell_m


def grid_around(view: LevelView) -> Grid:
    """The grid that an object is completed in.

    It holds what was seen, as much room behind as things have there, and room beside where an occluder may hide more.
    Its cells are as fine as their number allows, but no finer than the noise.
    """
    points = view.dense_points
    low, high = np.quantile(points, [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    longest = max(float((high - low).max()), view.sensor.sigma_m)
    margin = np.full((2, 3), _ASIDE * longest)
    margin[0, [0, 2]] = _BEHIND * longest, _BELOW * longest
    if not view.oriented:
        margin[1, 0] = _BEHIND * longest
    if view.silhouette is not None:
        margin = np.where(_hidden_sides(low, high, longest, view.silhouette), _HIDDEN * longest, margin)
    low, high = low - margin[0], high + margin[1]
    if view.floor_seen:
        low[2] = min(view.floor_m, float(points[:, 2].min()))
    extent = high - low
    cell = max(float(extent.prod() / MOST_CELLS) ** (1 / 3), view.sigma_m, float(extent.max()) / 160)
    if view.floor_seen:
        low[2] -= _UNDER * cell
    shape = np.ceil((high - low) / cell / MULTIPLE).astype(int) * MULTIPLE
    shape = np.maximum(shape, _LEAST_CELLS)
    while shape.prod() > MOST_CELLS:  # rounding up has added too many
        cell *= 1.03
        shape = np.maximum(np.ceil((high - low) / cell / MULTIPLE).astype(int) * MULTIPLE, _LEAST_CELLS)
    middle = (low + high) / 2
    origin = middle - cell * (shape - 1) / 2
    if view.floor_seen:
        origin[2] = low[2] + cell / 2
    x, y, z = origin.tolist()
    nx, ny, nz = shape.tolist()
    return Grid((x, y, z), cell, (nx, ny, nz))


def _hidden_sides(low: np.ndarray, high: np.ndarray, longest: float, silhouette: Silhouette) -> np.ndarray:
    """(2, 3) bool, whether a box may go on, where nobody could see it, beyond its lower and its upper end."""
    hidden = np.zeros((2, 3), dtype=bool)
    if not silhouette.certain:
        return hidden
    within = np.linspace(low, high, 6).T
    beyond = np.linspace(0.02, 0.3, 6) * longest
    for end, axis in ((0, 1), (1, 1), (0, 2), (1, 2)):
        axes = list(within)
        axes[axis] = low[axis] - beyond if end == 0 else high[axis] + beyond
        places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
        _, flat, _, range_m = pixels_of(places, silhouette.view)
        free = silhouette.free_range_m.ravel()[flat]
        nearer = (free > 0) & (free < range_m - silhouette.margin_m)
        hidden[end, axis] = nearer.sum() + len(places) - len(flat) > _HIDDEN_SHARE * len(places)
    return hidden


def channels(view: LevelView, grid: Grid) -> np.ndarray:
    """What is known of each cell.

    Args:
        view: The object as it was seen.
        grid: Of `grid_around`.

    Returns:
        (NUM_CHANNELS, x, y, z) float32: how many points lie in it, 0 to 1; how far before what its ray saw it lies
        (four cells are 1); the same beside a silhouette that is guessed from the points; how far behind the
        object's own surface; how far above the support that was seen, -1 to 1. What is unknown is 0.
    """
    answer = np.zeros((NUM_CHANNELS, *grid.shape), dtype=np.float32)
    answer[0] = _density(grid.cells(view.cloud.points), grid.shape)
    if view.silhouette is not None:
        answer[1:4] = _along_rays(view.silhouette, view.cloud.points, grid).reshape(3, *grid.shape)
    if view.floor_seen:
        heights = grid.origin[2] + grid.cell_m * np.arange(grid.shape[2]) - view.floor_m
        answer[4] = np.clip(heights / (_RAMP * grid.cell_m), -1, 1)
    return answer


def _density(cells: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """(x, y, z) from 0 to 1: points shared out among the eight cells around each, against the median of such cells."""
    first = np.floor(cells).astype(np.int64)
    inside = ((first >= 0) & (first < np.array(shape) - 1)).all(axis=1)
    first, share = first[inside], (cells - np.floor(cells))[inside]
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    flat, total = first @ strides, np.zeros(int(np.prod(shape)))
    for corner in np.ndindex(2, 2, 2):
        weight = np.where(corner, share, 1 - share).prod(axis=1)
        total += np.bincount(flat + int(corner @ strides), weight, minlength=len(total))
    found = total[total > 0]
    return (total / (total + (np.median(found) if len(found) else 1.0))).reshape(shape)


def _along_rays(silhouette: Silhouette, points: np.ndarray, grid: Grid) -> np.ndarray:
    """(3, x * y * z) float32 of `channels`: before what was seen, beside a guessed silhouette, behind the object."""
    seen_m = _seen_range(silhouette, points)
    own = ~silhouette.offset_px.any(axis=0)
    index, flat, _, range_m = pixels_of(grid.middles(), silhouette.view)
    seen_m, own = seen_m.ravel()[flat], own.ravel()[flat]
    with np.errstate(invalid="ignore"):
        before = np.clip((seen_m - range_m) / (_RAMP * grid.cell_m), -1, 1)
    before[seen_m <= 0] = 0.0
    guessed = np.isinf(seen_m)
    answer = np.zeros((3, int(np.prod(grid.shape))), dtype=np.float32)
    answer[0, index] = np.where(guessed, 0, np.maximum(before, 0))
    answer[1, index] = guessed
    answer[2, index] = np.where(own, np.maximum(-before, 0), 0)
    return answer


def _seen_range(silhouette: Silhouette, points: np.ndarray) -> np.ndarray:
    """(h, w) m, range of what each pixel saw; 0 where nothing came back, infinity beside a guessed silhouette."""
    own = ~silhouette.offset_px.any(axis=0)
    if silhouette.certain:
        return np.where(own, silhouette.view.free_range_m, silhouette.free_range_m)
    _, flat, _, range_m = pixels_of(points, silhouette.view)
    nearest = np.full(own.size, np.inf)
    np.minimum.at(nearest, flat, range_m)
    nearest = nearest.reshape(own.shape)
    filled = ndimage.distance_transform_edt(np.isinf(nearest), return_distances=False, return_indices=True)
    return np.where(own, nearest[tuple(np.asarray(filled))], silhouette.free_range_m)
