"""Making a closed solid of an open or multi-piece mesh.

The last resort is a new surface at a small distance around the old one, from a grid.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import manifold3d
import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes.load import check_mesh
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


# Vertices nearer than this share of the diagonal are one.
_SAME = 1e-6
# A hole larger than this share of its piece's area is an opening, such as the mouth of a cup, and stays one.
_LARGEST_HOLE = 0.06
# A repair that moves the surface further than this share of the diagonal has lost a part of it.
_LOST = 0.02
_NUM_CHECKS = 8_000
_NUM_NEAR = 8
_NUM_EXACT = 250
_NUM_PATCHINGS = 8


def make_solid(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float]:
    """Make a watertight volume without crossing faces out of any mesh.

    Tried in turn, the first that succeeds is taken: joining and orienting; filling holes and uniting the pieces;
    cutting out where the surface crosses itself and filling that; remeshing, in which a sheet becomes a thin wall and
    what is sealed becomes solid.

    Args:
        mesh: Triangles in any state that `check_mesh` lets pass.

    Returns:
        The solid, and the largest distance m from the given surface, where it is outermost or open to the outside,
        to the solid's surface; 0 where nothing but joining and orienting was needed.

    Raises:
        InvalidMesh: Not a usable mesh, or nothing of any volume came of it.
    """
    joined = _joined(check_mesh(mesh))
    nothing = InvalidMesh(
        f"no solid could be made of the mesh of {len(mesh.faces)} faces: is it more than stray triangles?"
    )
    if len(joined.faces) == 0:  # all of them needles that joining has closed
        raise nothing
    if _is_solid(joined):
        return joined, 0.0
    repairs: tuple[Callable[[trimesh.Trimesh], trimesh.Trimesh | None], ...] = (_united, _patched, remeshed)
    for repair in repairs:
        solid = repair(joined)
        if solid is None or not _is_solid(solid):
            continue
        error = _error_m(
            joined, solid, depth=2 * float(joined.extents.max()) / NUM_CELLS if repair is remeshed else 0.0
        )
        if repair is remeshed or error <= _LOST * float(np.linalg.norm(joined.extents)):
            return solid, error
    raise nothing


def _is_solid(mesh: trimesh.Trimesh) -> bool:
    return bool(mesh.is_volume) and len(crossing_faces(mesh.vertices, mesh.faces)) == 0


def _joined(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy with vertices joined, faces oriented alike, and those without area or told twice left out."""
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces)
    used = vertices[faces.ravel()]
    tolerance = _SAME * float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))
    if not mesh.is_watertight:
        near = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
        representative = np.arange(len(vertices))
        # Pairs in descending order, so that each vertex ends at the lowest of its neighbours.
        near = near[np.argsort(-near[:, 0])]
        representative[near[:, 1]] = near[:, 0]
        faces = representative[representative[faces]]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    joined = trimesh.Trimesh(vertices, faces[np.sort(first)], process=False)
    joined.remove_unreferenced_vertices()
    if not joined.is_winding_consistent:
        trimesh.repair.fix_winding(joined)
    if joined.is_watertight and joined.is_winding_consistent and joined.volume < 0:
        joined.invert()
    return joined


def _united(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """Union of the pieces, each with its small holes filled; None where a piece stays open."""
    solids = []
    for piece in mesh.split(only_watertight=False):
        closed = _filled(piece)
        if closed is None:
            return None
        vertices = np.array(closed.vertices, dtype=np.float64, order="C")
        solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, np.array(closed.faces, dtype=np.uint64, order="C")))
        if solid.status() != manifold3d.Error.NoError:
            return None
        solids.append(solid)
    raw = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).to_mesh64()
    faces = np.asarray(raw.tri_verts).astype(np.int64)
    if len(faces) == 0:
        return None
    return trimesh.Trimesh(np.asarray(raw.vert_properties)[:, :3], faces, process=False)


def _patched(mesh: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """The mesh with its crossing faces, and ever more around them, replaced by fans; None where crossings stay."""
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    for _ in range(_NUM_PATCHINGS):
        crossing = np.unique(crossing_faces(vertices, faces))
        if len(crossing) == 0 or len(crossing) > _LARGEST_HOLE * len(faces):
            return None
        touched = np.isin(faces, faces[crossing]).any(axis=1)
        closed = _filled(trimesh.Trimesh(vertices, faces[~touched], process=False))
        if closed is None:
            return None
        vertices, faces = np.array(closed.vertices), np.array(closed.faces)
        if _is_solid(closed):
            closed.remove_unreferenced_vertices()
            return closed
    return None


def _filled(piece: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """The piece with a fan over each of its small holes, facing outward; None where it stays open, or is empty."""
    if len(piece.faces) == 0 or not piece.is_winding_consistent:
        return None
    vertices, faces = np.array(piece.vertices), np.array(piece.faces)
    for loop in _loops(faces):
        middle = vertices[loop].mean(axis=0)
        spokes = vertices[loop] - middle
        area = np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, axis=0)), axis=1).sum() / 2
        if area > _LARGEST_HOLE * piece.area:
            return None
        fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(vertices))], axis=1)
        vertices, faces = np.concatenate([vertices, middle[None]]), np.concatenate([faces, fan])
    closed = trimesh.Trimesh(vertices, faces, process=False)
    if not closed.is_watertight:
        return None
    if closed.volume < 0:
        closed.invert()
    return closed


def _loops(faces: np.ndarray) -> list[np.ndarray]:
    """Border loops, each in the direction of its faces' edges; where borders touch in a vertex, they part there."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key, back = edges[:, 0] * (faces.max() + 1) + edges[:, 1], edges[:, 1] * (faces.max() + 1) + edges[:, 0]
    following: dict[int, list[int]] = {}
    for start, end in edges[~np.isin(key, back)].tolist():
        following.setdefault(start, []).append(end)
    loops = []
    for start in following:
        path = [start]
        while following.get(path[-1]):
            here = following[path[-1]].pop()
            if here in path:
                loops.append(np.array(path[path.index(here) :]))
                del path[path.index(here) + 1 :]
            else:
                path.append(here)
    return loops


def _error_m(given: trimesh.Trimesh, solid: trimesh.Trimesh, *, depth: float) -> float:
    """Largest distance m of the given surface to the solid's; what lies deeper inside than `depth` was meant to go."""
    rng = np.random.default_rng(0)
    points = sample_surface(given, _NUM_CHECKS, rng)[0]
    dense, _, face = sample_surface(solid, 20 * _NUM_CHECKS, rng)
    dense, face = np.concatenate([dense, solid.triangles_center]), np.append(face, np.arange(len(solid.faces)))
    nearest = face[np.asarray(KDTree(dense).query(points, k=_NUM_NEAR)[1])]
    feet = trimesh.triangles.closest_point(solid.triangles[nearest.ravel()], np.repeat(points, _NUM_NEAR, axis=0))
    distance = np.linalg.norm(feet.reshape(-1, _NUM_NEAR, 3) - points[:, None], axis=2).min(axis=1)
    kept = (distance <= depth) | ~solid.contains(points)
    points, distance = points[kept], distance[kept]
    # These are upper bounds, which rest on the faces that the samples found: the worst are looked at again, exactly,
    # until none that is left could be worse.
    order, largest = np.argsort(-distance), 0.0
    for start in range(0, len(order), _NUM_EXACT):
        chunk = order[start : start + _NUM_EXACT]
        if distance[chunk[0]] <= largest:
            break
        largest = max(largest, float(trimesh.proximity.closest_point(solid, points[chunk])[1].max()))
    return largest
