"""What the peers learn from: the same views for all, in the cube of either way, each with the true shape in it.

The truth of a shape, samples of its surface and its signed distances, is made once and kept beside the views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy import ndimage

from gfp_grasp.classfree import Grid
from gfp_grasp.journal import write_arrays
from gfp_grasp.metrics import visible_surface
from gfp_grasp.parallel import pmap
from gfp_grasp.peers import Cube, Seen, cell_middles, cube_of_box, cube_of_seen, seen_in, tidied
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train.by_sensor import class_views
from gfp_grasp.train.distances import distances_and_walls, thickened
from gfp_grasp.train.views import View, seed_of
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import OrientedBox, PointCloud

_SAMPLES = 4096
_UP = np.array([0.0, 0.0, 1.0])
_CELLS = 40  # along the longest side of a shape
_MARGIN = 3  # cells
_THICK = 8.0  # cells: walls are not told apart beyond


@dataclass(frozen=True, eq=False)
class Truth:
    """A true shape, in its own frame.

    Attributes:
        points: (4096, 3) m, samples of the surface that can be seen from outside or through an opening.
        bounds: (2, 3) m.
        grid: Cells around it.
        distance: (x, y, z) float16, signed distances in the grid's cells, negative inside.
        wall: (x, y, z) float16, how thick the shape is where it is nearest, in cells.
    """

    points: np.ndarray
    bounds: np.ndarray
    grid: Grid
    distance: np.ndarray
    wall: np.ndarray

    def box(self, T_world_object: np.ndarray) -> OrientedBox:
        """Its box, along its own axes, where the object stands."""
        return OrientedBox(T_world_object @ make_T(None, self.bounds.mean(axis=0)), np.ptp(self.bounds, axis=0))

    def distances(self, points: np.ndarray, cell_m: float) -> np.ndarray:
        """Signed distances (n,) of points (n, 3) m in cells of a length, walls as thick as a grid of them needs.

        Beyond the truth's own grid they are the mean of the bounds that its faces give.
        """
        cells = self.grid.cells(points)
        inside = np.clip(cells, 0, np.array(self.distance.shape) - 1)
        near = ndimage.map_coordinates(self.distance.astype(np.float32), inside.T, order=1)
        beyond = np.linalg.norm(cells - inside, axis=1)
        outside = (near + beyond + np.hypot(near, beyond)) / 2  # what is nearest lies behind the face
        wall = self.wall[tuple(np.rint(inside).astype(np.int64).T)]
        finer = self.grid.cell_m / cell_m
        return thickened(finer * np.where(beyond > 0, outside, near), finer * wall.astype(np.float32))


def cached_truth(source: ObjectSource, folder: Path) -> Truth:
    """The truth of a shape, made where the cache lacks it."""
    path = folder / source.category / f"{seed_of(source):06d}_{_CELLS}_{_SAMPLES}_walls.npz"
    if not path.is_file():
        mesh = source.load_mesh()
        bounds = np.array(mesh.bounds)
        cell = float(np.ptp(bounds, axis=0).max()) / _CELLS
        x, y, z = (bounds[0] - _MARGIN * cell).tolist()
        nx, ny, nz = (np.ceil(np.ptp(bounds, axis=0) / cell).astype(int) + 2 * _MARGIN + 1).tolist()
        distance, wall = distances_and_walls(mesh, Grid((x, y, z), cell, (nx, ny, nz)))
        points = visible_surface(mesh, _SAMPLES, np.random.default_rng(seed_of(source)))
        write_arrays(
            path,
            points=points.astype(np.float32),
            bounds=bounds,
            origin=np.array([x, y, z]),
            cell_m=np.array(cell),
            distance=distance.astype(np.float16),
            wall=np.minimum(wall, _THICK).astype(np.float16),
        )
    with np.load(path) as stored:
        nx, ny, nz = stored["distance"].shape
        x, y, z = stored["origin"].tolist()
        grid = Grid((x, y, z), float(stored["cell_m"]), (nx, ny, nz))
        return Truth(stored["points"], stored["bounds"], grid, stored["distance"], stored["wall"])


@dataclass(frozen=True, eq=False)
class PeerView:
    """A view in the cube of one way, with its truth.

    Attributes:
        view: What was seen, in the world.
        truth: The true shape.
        cube: Where the peer sees it.
        seen: What was seen, in the cube.
    """

    view: View
    truth: Truth
    cube: Cube
    seen: Seen

    def points(self) -> np.ndarray:
        """(4096, 3), samples of the true surface in sides of the cube."""
        return self.cube.inward(apply_T(self.view.T_world_object, self.truth.points))

    def distances(self, resolution: int) -> np.ndarray:
        """(x, y, z) float32, signed distances of the cube's cells from the true surface, in cells."""
        world = self.cube.outward(cell_middles(resolution))
        own = apply_T(invert_T(self.view.T_world_object), world)
        distance = self.truth.distances(own, self.cube.side_m / resolution)
        return distance.astype(np.float32).reshape(3 * (resolution,))


def peer_views(
    classes: Sequence[str],
    split: str,
    *,
    members: int,
    num_views: int,
    true_box: bool,
    runs: Path,
    workers: int = 1,
) -> list[PeerView]:
    """Views of the first members of classes; views and truths come from the cache where they are in it.

    Args:
        classes: Procedural families.
        split: "train", "val" or "test".
        members: Members of each class.
        num_views: Views of each member.
        true_box: Whether the cube is that around the true box.
        runs: Folder of the caches.
        workers: Processes that render.
    """
    found = []
    for name in classes:
        views = class_views(name, split, limit=members, num_views=num_views, runs=runs, workers=workers)
        sources = {view.source: None for view in views}
        make = partial(cached_truth, folder=runs / "truths")
        truths = dict(zip(sources, pmap(make, list(sources), workers=workers), strict=True))
        found += [in_cube(view, truths[view.source], true_box=true_box) for view in views]
    return found


def in_cube(view: View, truth: Truth, *, true_box: bool) -> PeerView:
    """A view in the cube of one way."""
    cloud = tidied(PointCloud(view.points, view.viewpoint))
    cube = cube_of_box(truth.box(view.T_world_object)) if true_box else cube_of_seen(cloud, _UP)
    return PeerView(view, truth, cube, seen_in(cube, cloud))
