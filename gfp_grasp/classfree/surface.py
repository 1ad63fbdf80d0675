"""From signed distances on a grid to a surface: its bodies, their way to the points that were seen, its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
import trimesh
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gfp_grasp.classfree.grid import Grid
from gfp_grasp.errors import NoSurface
from gfp_grasp.meshes import neighbour_average, surface_net, triangle_normals, vertex_normals
from gfp_grasp.types import LevelView

_SUPPORTED = 0.01  # share of the points that a body other than the largest has to explain
_NEIGHBOURS = 8
_NEAR = 2.5  # cells: a surface that is farther from a point does not stand for it
_SAME_WAY = 0.5  # cosine between the normals of a point and of the surface that it belongs to
_EVENINGS = 2  # of the way to the points, over the surface
_FARTHEST = 0.65  # cells that a vertex is moved by
_TURNED = 0.7  # cosine between the normals of a face before and after: beyond, the surface would fold
_HALVINGS = 4
# A valley of the distances is a wall if they rise on either side by more than this within so many cells; for each cell
# that they rise beyond, it is sunk by so much. On 112 things of the test split this takes an eighth off the Chamfer
# distance, a fifth to a quarter on mugs, bowls and pots, and leaves solid things as they are.
_WALL_REACH, _WALL_RISE, _WALL_SINKS = 3, 0.2, 0.7
_LAPLACE = np.sqrt(2.0)  # standard deviation of a Laplace distribution whose scale is one


@dataclass(frozen=True, eq=False)
class Surface:
    """A watertight surface in the level frame.

    Attributes:
        vertices: (v, 3) m.
        faces: (f, 3), outward.
        sigma_m: (v,) standard deviation of its position along the normal.
    """

    vertices: np.ndarray
    faces: np.ndarray
    sigma_m: np.ndarray


def surface_from(distance: np.ndarray, log_scale: np.ndarray, grid: Grid, view: LevelView) -> Surface:
    """The surface where signed distances are zero, drawn to the points as far as these are surer.

    Args:
        distance: (x, y, z) signed distances in cells, negative inside.
        log_scale: (x, y, z) logarithms of the scales, in cells, of the Laplace distributions about them.
        grid: The cells.
        view: What was seen.

    Raises:
        NoSurface: Nothing is inside.
    """
    net = surface_net(with_thin_walls(distance), origin=np.array(grid.origin), cell_m=grid.cell_m)
    mesh = _bodies(net, view.dense_points)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    scale = np.exp(ndimage.map_coordinates(log_scale, grid.cells(vertices).T, order=1, mode="nearest"))
    sigma_m = _LAPLACE * grid.cell_m * scale
    moved, sigma_m = _drawn_to_points(vertices, faces, sigma_m, view, grid.cell_m)
    return Surface(moved, faces, sigma_m)


def with_thin_walls(distance: np.ndarray) -> np.ndarray:
    """Signed distances (x, y, z) in cells in which walls that nobody saw are closed.

    Where the network does not know which of several cells a thin wall runs through, each of them is more likely empty
    than not, and the wall has a hole. Its distances have a valley there all the same, which is sunk below zero.
    """
    valley = np.zeros_like(distance)
    for axis in range(3):
        own = np.moveaxis(distance, axis, 0)
        padded = np.pad(own, [(_WALL_REACH, _WALL_REACH), (0, 0), (0, 0)], mode="edge")
        around = [padded[i : i + len(own)] for i in range(2 * _WALL_REACH + 1)]
        rise = np.minimum(around[0], around[-1]) - own
        empty = reduce(np.minimum, around) > 0  # beside a wall that is there, nothing is to be sunk
        np.maximum(np.moveaxis(valley, axis, 0), np.where(empty, rise, 0.0), out=np.moveaxis(valley, axis, 0))
    return distance - _WALL_SINKS * np.maximum(valley - _WALL_RISE, 0.0)


def _bodies(net: trimesh.Trimesh, points: np.ndarray) -> trimesh.Trimesh:
    """The largest body and those that explain points; what is sealed within them is filled."""
    faces = np.asarray(net.faces)
    if len(faces) == 0:
        raise NoSurface("the network holds all of the space around the points for empty: are they those of one object?")
    vertices = np.asarray(net.vertices)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    num, body = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=2 * (len(vertices),)))
    if num == 1:
        return net
    corners = vertices[faces] - vertices.mean(axis=0)
    doubled = np.einsum("fi,fi->f", corners[:, 0], triangle_normals(corners))
    volume = np.bincount(body[faces[:, 0]], doubled, minlength=num)
    outer = np.flatnonzero(volume > 0)
    of_outer = np.flatnonzero(volume[body] > 0)
    nearest = body[of_outer[KDTree(vertices[of_outer]).query(points)[1]]]
    explains = np.bincount(nearest, minlength=num) >= _SUPPORTED * len(points)
    kept = (explains & (volume > 0)) | (np.arange(num) == outer[volume[outer].argmax()])
    mesh = trimesh.Trimesh(vertices, faces[kept[body[faces[:, 0]]]], process=False)
    mesh.remove_unreferenced_vertices()
    return mesh


def _drawn_to_points(
    vertices: np.ndarray, faces: np.ndarray, sigma_m: np.ndarray, view: LevelView, cell_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices moved along their normals to the points around them, and what is left of their sigmas.

    The points near a vertex, on its side of a wall, are so many measurements of its position; its own is another one.
    """
    points, point_normals = view.dense_points, view.dense_normals
    tree = KDTree(points)
    spacing = float(np.median(tree.query(points, k=min(2, len(points)))[0][:, -1]))
    width, near_m = max(1.5 * spacing, cell_m), _NEAR * cell_m
    normals = vertex_normals(vertices, faces)
    distance, near = tree.query(vertices, k=min(_NEIGHBOURS, len(points)), distance_upper_bound=near_m + width)
    distance, near = distance.reshape(len(vertices), -1), near.reshape(len(vertices), -1)
    found = np.isfinite(distance)
    near = np.where(found, near, 0)
    ahead = np.einsum("vki,vi->vk", points[near] - vertices[:, None], normals)
    aside = np.maximum(np.where(found, distance, 0.0) ** 2 - ahead**2, 0.0)
    cosine = np.einsum("vki,vi->vk", point_normals[near], normals)
    same = (cosine if view.oriented else np.abs(cosine)) > _SAME_WAY
    weight = np.where(found & same & (np.abs(ahead) < near_m), np.exp(-aside / (2 * width**2)), 0.0)
    count = weight.sum(axis=1)
    mean = (weight * ahead).sum(axis=1) / np.maximum(count, 1e-9)
    gain = count * sigma_m**2 / (count * sigma_m**2 + view.sigma_m**2)
    farthest_m = _FARTHEST * cell_m
    average, step = neighbour_average(faces, len(vertices)), np.clip(gain * mean, -farthest_m, farthest_m)
    for _ in range(_EVENINGS):
        step = (step + average @ step) / 2
    return _unfolded(vertices, faces, step[:, None] * normals), sigma_m * np.sqrt(1 - gain)


def _unfolded(vertices: np.ndarray, faces: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Vertices (v, 3) moved as far as no face turns by much."""
    share, before = np.ones(len(vertices)), triangle_normals(vertices[faces])
    for _ in range(_HALVINGS):
        after = triangle_normals((vertices + share[:, None] * displacement)[faces])
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        turned = np.einsum("fi,fi->f", before, after) < _TURNED * lengths
        if not turned.any():
            break
        share[np.unique(faces[turned])] *= 0.5
    return vertices + share[:, None] * displacement
