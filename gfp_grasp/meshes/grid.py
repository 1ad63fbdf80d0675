"""The last resort of a repair: a new surface at a small distance around the old one, from a grid."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.meshes.surface import crossing_faces, sample_surface, triangle_normals, vertex_normals

NUM_CELLS = 96
# Half of the wall that a sheet gets, in cells: below about 0.9 the grid lets it break up.
_HALF_WALL = 0.9
# What thinning may move the surface, in cells, in the order in which it is tried: nearly always the first will do. In
# soups of triangles none does; at 0.05, half of the faces stay, which only the coarse grid can afford.
_THINNING = (0.2, 0.3, 0.4, 0.1)
_THINNING_COARSE = (*_THINNING, 0.05, 0.0)
_FEW = 8  # crossings that another share may be without; more never were gone
# Kuhn's six tetrahedra of a cube around its diagonal 0-7; corner i is (i & 1, i >> 1 & 1, i >> 2).
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])


def remeshed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Watertight surface around a mesh in any state.

    A sheet becomes a wall about two cells thick, a cell being 1/96 of the longest side; what is sealed off from the
    outside becomes solid, and there the surface is set back to where it was. Where thinning fails, as with soups of
    triangles, the cells are twice as large: half a million faces would be of no use to anyone.
    """
    fine = _from_grid(mesh, NUM_CELLS, _THINNING)
    if fine is not None:
        return fine
    coarse = _from_grid(mesh, NUM_CELLS // 2, _THINNING_COARSE)
    assert coarse is not None  # no thinning at all is the last that is tried
    return coarse


def _from_grid(mesh: trimesh.Trimesh, num_cells: int, thinning: Sequence[float]) -> trimesh.Trimesh | None:
    """None where no thinning keeps the faces from crossing."""
    cell = float(mesh.extents.max()) / num_cells
    half_wall = _HALF_WALL * cell
    origin = mesh.bounds[0] - 4 * cell
    shape = np.ceil((mesh.extents + 8 * cell) / cell).astype(int) + 1
    distance = _distances(mesh, origin, cell, shape, reach=3 * cell)
    clear = distance > half_wall
    pieces = np.empty(clear.shape, dtype=np.int32)
    ndimage.label(clear, output=pieces)
    sealed = clear & (pieces != pieces[0, 0, 0])
    vertices, faces = _level(np.where(sealed, -half_wall, distance - half_wall))
    solid = _thinned(origin + cell * vertices, faces, cell, thinning)
    return None if solid is None else _set_back(solid, sealed, origin, cell, half_wall)


def _distances(
    mesh: trimesh.Trimesh, origin: np.ndarray, cell: float, shape: np.ndarray, *, reach: float
) -> np.ndarray:
    """Distance (x, y, z) m of the grid's points from the surface, at most `reach`."""
    count = int(np.clip(12 * mesh.area / cell**2, 20_000, 600_000))
    samples, _, _ = sample_surface(mesh, count, np.random.default_rng(0))
    samples = np.concatenate([samples, np.asarray(mesh.vertices)[np.unique(mesh.faces)]])
    near = np.zeros(tuple(shape), dtype=bool)
    near[tuple(np.round((samples - origin) / cell).astype(int).T)] = True
    near = np.asarray(ndimage.binary_dilation(near, iterations=4), dtype=bool)
    distance = np.full(tuple(shape), reach)
    found, _ = KDTree(samples).query(np.argwhere(near) * cell + origin, distance_upper_bound=reach)
    distance[near] = np.minimum(found, reach)
    return distance


def _level(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Zero level of a field, negative inside, by marching tetrahedra: vertices in cells, faces outward."""
    inside = field < 0
    corner = np.stack([np.arange(8) & 1, np.arange(8) >> 1 & 1, np.arange(8) >> 2], axis=1)
    x, y, z = inside.shape
    blocks = [inside[i : x - 1 + i, j : y - 1 + j, k : z - 1 + k] for i, j, k in corner]
    mixed = np.argwhere(np.any(blocks, axis=0) & ~np.all(blocks, axis=0))
    strides = np.array([y * z, z, 1])
    point = (mixed @ strides)[:, None] + (corner @ strides)[None]
    tetrahedra = point[:, _TETRAHEDRA].reshape(-1, 4)
    state = inside.ravel()[tetrahedra]
    # Inner corners first; then one, two or three of them give a triangle, a quad or a triangle.
    tetrahedra = np.take_along_axis(tetrahedra, np.argsort(~state, axis=1, kind="stable"), axis=1)
    number = np.count_nonzero(state, axis=1)
    one, two, three = tetrahedra[number == 1], tetrahedra[number == 2], tetrahedra[number == 3]
    triangles = np.concatenate(
        [
            one[:, [[0, 1], [0, 2], [0, 3]]],
            three[:, [[0, 3], [1, 3], [2, 3]]],
            two[:, [[0, 2], [0, 3], [1, 3]]],
            two[:, [[0, 2], [1, 3], [1, 2]]],
        ]
    )
    ends = triangles.reshape(-1, 2)
    key, index = np.unique(ends[:, 0] * field.size + ends[:, 1], return_inverse=True)
    edges, faces = np.stack(np.divmod(key, field.size), axis=1), index.reshape(-1, 3)
    value, place = field.ravel()[edges], np.stack(np.unravel_index(edges, field.shape), axis=2)
    # Away from the corners, so that no triangle loses its area.
    share = np.clip(value[:, 0] / (value[:, 0] - value[:, 1]), 0.05, 0.95)[:, None]
    vertices = place[:, 0] * (1 - share) + place[:, 1] * share
    outward = (place[:, 1] - place[:, 0])[faces].sum(axis=1)
    corners = vertices[faces]
    turned = np.einsum("fx,fx->f", triangle_normals(corners), outward) < 0
    faces[turned] = faces[turned][:, ::-1]
    return vertices, faces


def _set_back(
    solid: trimesh.Trimesh, sealed: np.ndarray, origin: np.ndarray, cell: float, depth: float
) -> trimesh.Trimesh:
    """Move the surface inward by `depth` where something solid lies behind it; not where it would then cross itself."""
    normals = vertex_normals(solid.vertices, solid.faces)
    behind = (solid.vertices - 3.5 * depth * normals - origin) / cell
    full = ndimage.map_coordinates(sealed.astype(np.float64), behind.T, order=1)
    moved = solid.vertices - (depth * np.clip(full, 0, 1))[:, None] * normals
    candidate = trimesh.Trimesh(moved, solid.faces, process=False)
    return candidate if len(crossing_faces(moved, solid.faces)) == 0 else solid


def _thinned(vertices: np.ndarray, faces: np.ndarray, cell: float, thinning: Sequence[float]) -> trimesh.Trimesh | None:
    """Far fewer faces; each vertex moves by a fraction of a cell, and the mesh stays a volume without crossings."""
    dense = manifold3d.Manifold(manifold3d.Mesh64(np.ascontiguousarray(vertices), faces.astype(np.uint64, order="C")))
    for share in thinning:
        if share == 0.0:
            return trimesh.Trimesh(vertices, faces, process=False)
        raw = dense.simplify(share * cell).to_mesh64()
        thin = np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts).astype(np.int64)
        num_crossing = len(crossing_faces(*thin))
        if len(thin[1]) and num_crossing == 0:
            return trimesh.Trimesh(*thin, process=False)
        if num_crossing > _FEW and thinning[-1] > 0.0:
            return None
    return None
