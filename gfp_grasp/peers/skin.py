"""From what a peer says to a watertight mesh: one way for all that answer with points, one for each kind of grid.

Points and unsigned distances do not tell inside from outside. A skin is laid around them at a small distance, what it
seals off becomes solid, and its vertices are set back to where the points or the zeros are. An open sheet becomes a
thin wall. All is in sides of the cube.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gfp_grasp.errors import NoSurface
from gfp_grasp.meshes import neighbour_average, surface_net, triangle_normals, vertex_normals

_NUM_CELLS = 56  # along the longest side of the points
_NEIGHBOUR = 4  # the distance to this neighbour is the spacing of points
_AWAY = 1.5  # spacings that the skin is away from the points
_SEAL = 2.0  # times as far away it seals off what is inside: points are sparser here and there
_LEAST_CELLS = 1.2  # that the skin is away, or the grid lets it break up
_LEAST = 0.02  # longest side of the points, in sides of the cube, that a skin is laid around
_SET_BACK = 0.9  # share of the way to the points: of a sheet's two sides neither goes through the other
_MEAN_OF = 12  # points that a vertex is set back to
_SMALL_BODY = 0.02  # share of the largest body's volume below which others are dropped
DISTANCE_LEVEL = 1.0  # cells, where the skin around unsigned distances lies


def skin_of_points(points: np.ndarray) -> trimesh.Trimesh:
    """A watertight mesh around points (m, 3) on a surface.

    Raises:
        NoSurface: There is no finite point.
    """
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) <= _MEAN_OF:
        raise NoSurface(f"the network answered with {len(points)} finite points: train it again, or with a lower rate")
    tree = KDTree(points)
    spacing = float(np.median(tree.query(points, k=_NEIGHBOUR + 1)[0][:, -1]))
    low, high = points.min(axis=0), points.max(axis=0)
    cell = max(float((high - low).max()), _LEAST) / _NUM_CELLS
    level = max(_AWAY * spacing, _LEAST_CELLS * cell)
    reach = _SEAL * level + 2 * cell
    origin = low - reach
    shape = np.ceil((high - low + 2 * reach) / cell).astype(int) + 1
    places = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3) * cell + origin
    distance = np.minimum(tree.query(places, distance_upper_bound=reach)[0], reach).reshape(shape)
    mesh = _sealed(distance, origin, cell, level=level, seal=_SEAL * level)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    normals = vertex_normals(vertices, faces)
    near = points[tree.query(vertices, k=_MEAN_OF)[1]].mean(axis=1)
    step = np.clip(np.einsum("vi,vi->v", near - vertices, normals), -level, 0.0)
    step = (step + neighbour_average(faces, len(vertices)) @ step) / 2
    return trimesh.Trimesh(vertices + _SET_BACK * step[:, None] * normals, faces, process=False)


def skin_of_distances(distance: np.ndarray) -> trimesh.Trimesh:
    """A watertight mesh around the zeros of unsigned distances (x, y, z), in cells of a grid that fills the cube.

    Raises:
        NoSurface: No cell is near a surface.
    """
    cell = 1 / len(distance)
    level = cell * DISTANCE_LEVEL
    mesh = _sealed(cell * distance, np.full(3, cell / 2 - 0.5), cell, level=level, seal=level)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    step = _SET_BACK * DISTANCE_LEVEL * cell
    return trimesh.Trimesh(vertices - step * vertex_normals(vertices, faces), faces, process=False)


def surface_of_field(field: np.ndarray) -> trimesh.Trimesh:
    """The watertight surface around where a field (x, y, z), on a grid that fills the cube, is negative.

    Raises:
        NoSurface: It is negative nowhere.
    """
    cell = 1 / len(field)
    return outer_bodies(surface_net(field, origin=np.full(3, cell / 2 - 0.5), cell_m=cell))


def outer_bodies(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The largest body and all that are not very small beside it, the voids within them filled.

    Raises:
        NoSurface: The mesh has no faces.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) == 0:
        raise NoSurface("the network holds all of the space around the points for empty: are they those of one object?")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    num, body = connected_components(coo_array((np.ones(len(edges)), edges.T), shape=2 * (len(vertices),)))
    corners = vertices[faces] - vertices.mean(axis=0)
    doubled = np.einsum("fi,fi->f", corners[:, 0], triangle_normals(corners))
    volume = np.bincount(body[faces[:, 0]], doubled, minlength=num)
    kept = volume >= _SMALL_BODY * volume.max()
    answer = trimesh.Trimesh(vertices, faces[kept[body[faces[:, 0]]]], process=False)
    answer.remove_unreferenced_vertices()
    return answer


def _sealed(distance: np.ndarray, origin: np.ndarray, cell: float, *, level: float, seal: float) -> trimesh.Trimesh:
    """The outer surface at a distance from points or zeros, around what it seals off as well.

    Args:
        distance: (x, y, z), unsigned.
        origin: (3,), place of the first value.
        cell: Distance of two values.
        level: Distance of the surface.
        seal: Distance, no less, at which it is seen what is sealed off.
    """
    distance = np.pad(distance, 1, constant_values=float(max(distance.max(), seal + cell)))
    pieces = np.empty(distance.shape, dtype=np.int32)
    ndimage.label(distance >= seal, output=pieces)
    # What lies between that and the skin belongs to the nearer side.
    nearest = ndimage.distance_transform_edt(pieces == 0, return_distances=False, return_indices=True)
    sealed = (distance >= level) & (pieces[tuple(np.asarray(nearest))] != pieces[0, 0, 0])
    field = np.where(sealed, -np.abs(distance - level) - cell, distance - level)
    return outer_bodies(surface_net(field, origin=origin - cell, cell_m=cell))
