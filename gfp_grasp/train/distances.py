"""Exact signed distances of a solid on a grid, its thin walls thick enough for the grid to show them."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.camera import cast_rays
from gfp_grasp.classfree import Grid
from gfp_grasp.meshes import sample_surface, triangle_normals

THINNEST = 1.3  # cells: a wall of less would slip between the middles of cells
_SAMPLES = 30_000
_NEAREST = 3  # samples whose triangles are asked for the distance
_BESIDE = 1e-4  # cells: columns pass vertices and edges, and do not hit them


def signed_distances(mesh: trimesh.Trimesh, grid: Grid, *, reach: float) -> np.ndarray:
    """Distances of the middles of a grid's cells from a solid's surface, in cells, thin walls `thickened`.

    Args:
        mesh: Watertight, outward, without bodies that reach into each other; in the grid's frame.
        grid: The cells.
        reach: Distances are cut off there, cells.

    Returns:
        (x, y, z) float32, negative inside, from -reach to reach.
    """
    return np.clip(thickened(*distances_and_walls(mesh, grid)), -reach, reach).astype(np.float32)


def thickened(distance: np.ndarray, wall: np.ndarray) -> np.ndarray:
    """Signed distances (...) in cells, both sides of a wall (...) thinner than THINNEST cells moved apart to that."""
    return distance - np.maximum(THINNEST - wall, 0) / 2


def distances_and_walls(mesh: trimesh.Trimesh, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances (x, y, z) from a solid, and the thickness (x, y, z) of its wall where it is nearest, in cells.

    Args:
        mesh: Watertight, outward, without bodies that reach into each other; in the grid's frame.
        grid: The cells.
    """
    vertices = grid.cells(np.asarray(mesh.vertices))
    faces = np.asarray(mesh.faces)
    inside = _inside(vertices[faces], grid.shape)
    solid = trimesh.Trimesh(vertices, faces, process=False)
    samples, normals, faces_of = sample_surface(solid, _SAMPLES, np.random.default_rng(0))
    distance, near = _to_surface(samples, vertices[faces][faces_of], grid.shape)
    return np.where(inside, -distance, distance), _thickness(solid, samples, normals)[near]


def _to_surface(
    samples: np.ndarray, triangles: np.ndarray, shape: tuple[int, int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Distance (x, y, z) of cells' middles from a surface, in cells, and the sample that is nearest to each.

    Near the surface it is exact; farther off it is that from the sample nearest to the next place near the surface.

    Args:
        samples: (n, 3) on the surface, in cells.
        triangles: (n, 3, 3) that they lie on.
        shape: Of the grid.
    """
    close = np.zeros(shape, dtype=bool)
    index = np.rint(samples).astype(np.int64)
    index = index[((index >= 0) & (index < np.array(shape))).all(axis=1)]
    close[tuple(index.T)] = True
    close = np.asarray(ndimage.binary_dilation(close, structure=np.ones((3, 3, 3))), dtype=bool)
    places = np.argwhere(close).astype(np.float64)
    few = KDTree(samples).query(places, k=_NEAREST)[1]
    feet = trimesh.triangles.closest_point(triangles[few.ravel()], np.repeat(places, _NEAREST, axis=0))
    exact = np.linalg.norm(feet.reshape(-1, _NEAREST, 3) - places[:, None], axis=2)
    best = exact.argmin(axis=1)[:, None]
    near = np.zeros(shape, dtype=np.int64)
    near[close] = np.take_along_axis(few, best, axis=1)[:, 0]
    towards = ndimage.distance_transform_edt(~close, return_distances=False, return_indices=True)
    near = near[tuple(np.asarray(towards))]
    distance = np.linalg.norm(np.moveaxis(np.indices(shape), 0, -1) - samples[near], axis=-1)
    distance[close] = np.take_along_axis(exact, best, axis=1)[:, 0]
    return distance, near


def _inside(triangles: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """(x, y, z) bool, whether cells' middles are within triangles (f, 3, 3) in cells: faces above each, with sign."""
    turned = triangle_normals(triangles)[:, 2]
    used = turned != 0
    a, b, c = triangles[used].transpose(1, 0, 2)
    turned = turned[used]
    flat = np.stack([a[:, :2], b[:, :2], c[:, :2]], axis=1) + _BESIDE * np.array([1.0, np.sqrt(0.5)])
    first = np.maximum(np.ceil(flat.min(axis=1)), 0).astype(np.int64)
    last = np.minimum(np.floor(flat.max(axis=1)), np.array(shape[:2]) - 1).astype(np.int64)
    spans = np.maximum(last - first + 1, 0)
    counts = spans.prod(axis=1)
    face = np.repeat(np.arange(len(counts)), counts)
    step = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = first[face] + np.stack([step // spans[face, 1], step % spans[face, 1]], axis=1)
    weights = []
    for i, j in ((1, 2), (2, 0)):  # barycentric, of the first and the second corner
        edge, off = flat[face, j] - flat[face, i], column - flat[face, i]
        weights.append((edge[:, 0] * off[:, 1] - edge[:, 1] * off[:, 0]) / turned[face])
    u, v = weights
    hit = (u >= 0) & (v >= 0) & (u + v <= 1)
    u, v, face, column = u[hit], v[hit], face[hit], column[hit]
    height = u * a[face, 2] + v * b[face, 2] + (1 - u - v) * c[face, 2]
    below = np.clip(np.ceil(height), 0, shape[2]).astype(np.int64)  # cells 0 .. below - 1 lie under the face
    steps = np.zeros((shape[0], shape[1], shape[2] + 1))
    np.add.at(steps, (column[:, 0], column[:, 1], below), np.sign(turned[face]))
    return np.cumsum(steps[:, :, ::-1], axis=2)[:, :, ::-1][:, :, 1:] > 0.5


def _thickness(solid: trimesh.Trimesh, samples: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(n,) how far samples on a surface are from what lies behind them, along their normals."""
    start = samples - 1e-3 * normals
    distance, _, _ = cast_rays([(np.asarray(solid.vertices), np.asarray(solid.faces))], start, -normals)
    return distance
