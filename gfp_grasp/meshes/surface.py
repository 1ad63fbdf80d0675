"""Surfaces of triangles: normals, samples, means over the neighbours of each vertex, and faces that cross each other.

Candidates for crossing come from a uniform grid, and Moeller's interval test decides.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from scipy import sparse

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.transforms import cross


def triangle_normals(triangles: np.ndarray) -> np.ndarray:
    """Normals (f, ..., 3) of triangles (f, 3, ..., 3), each twice as long as the area of its triangle."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals of the vertices.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3) int, counter-clockwise seen from outside.

    Returns:
        (v, 3) unit; zero for a vertex that no face of positive area uses.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    # The cross product is twice the area long: the weight comes for free.
    weighted = triangle_normals(corners)
    index = np.asarray(faces).ravel()
    repeated = np.repeat(weighted, 3, axis=0)
    normals = np.stack([np.bincount(index, repeated[:, i], minlength=len(vertices)) for i in range(3)], axis=1)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros(normals.shape), where=lengths > 0)


def enclosed_m3(mesh: trimesh.Trimesh) -> float:
    """Volume within a mesh, m3; 0 where trimesh's `is_volume` is False: it is open, not wound one way, or inside out.

    `is_volume` takes three times as long: it computes the moments of inertia, too.
    """
    if not (len(mesh.faces) and mesh.is_watertight and mesh.is_winding_consistent):
        return 0.0
    triangles = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    triangles = triangles - triangles[0, 0]
    doubled = np.einsum("fi,fi->f", triangles[:, 0], triangle_normals(triangles))
    volume = float(doubled.sum()) / 6
    return volume if 0 < volume < np.inf else 0.0


def sample_surface(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw points uniformly by area.

    Args:
        mesh: Any triangle mesh of positive area.
        count: Points to draw, at least 1.
        rng: Source of randomness.

    Returns:
        Points (count, 3) m, unit normals of their faces (count, 3), and face indices (count,) int.

    Raises:
        InvalidOption: count is below 1.
        InvalidMesh: The mesh has no area.
    """
    if count < 1:
        raise InvalidOption(f"count is {count}; at least one sample must be drawn")
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    edge_a, edge_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normals = cross(edge_a, edge_b)
    doubled_areas = np.linalg.norm(normals, axis=1)
    cumulated = np.cumsum(doubled_areas)
    if len(cumulated) == 0 or not cumulated[-1] > 0:
        raise InvalidMesh(f"a mesh of {len(mesh.faces)} faces has no area: there is nothing to sample")
    index = np.searchsorted(cumulated, rng.random(count) * cumulated[-1], side="right")
    weights = rng.random((count, 2))
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
    points = corners[index, 0] + weights[:, :1] * edge_a[index] + weights[:, 1:] * edge_b[index]
    return points, normals[index] / doubled_areas[index, None], index


def neighbour_average(faces: np.ndarray, num_vertices: int) -> sparse.csr_matrix:
    """(v, v) matrix that takes vertices to the mean of their mesh neighbours; zero for a vertex without any.

    Args:
        faces: (f, 3).
        num_vertices: v.
    """
    rows = faces[:, [0, 1, 2, 1, 2, 0]].ravel()
    columns = faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    adjacency = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(num_vertices, num_vertices))
    adjacency.data[:] = 1.0  # each edge was counted from both of its faces
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
    return sparse.csr_matrix(sparse.diags(1.0 / degree) @ adjacency)


def graph_laplacian(faces: np.ndarray, num_vertices: int) -> sparse.csr_matrix:
    """Random-walk graph Laplacian (v, v): each vertex minus the mean of its mesh neighbours.

    Args:
        faces: (f, 3).
        num_vertices: v.
    """
    return sparse.csr_matrix(sparse.eye(num_vertices) - neighbour_average(faces, num_vertices))


# Overlaps shorter than this share of the mesh's diagonal are touching, not crossing: it is far above the rounding of
# float64 (1e-16) and far below any wall (1e-3).
_TOUCH = 1e-9
# Pairs that are looked at in one go: bounds the memory to some hundred megabytes.
_BATCH = 1_000_000


def crossing_faces(
    vertices: np.ndarray, faces: np.ndarray, *, among: np.ndarray | None = None, pairs: np.ndarray | None = None
) -> np.ndarray:
    """Pairs of faces that pass through each other and share no vertex.

    Faces that only touch, or lie in one plane, do not cross.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3) int.
        among: (f,) bool, of which faces each pair has at least one; None asks for all pairs.
        pairs: (p, 2) int, as `pairs_on_the_way` gives them, the only ones that are asked for; None asks for all.

    Returns:
        (c, 2) int pairs of face indices, the smaller first, in ascending order; empty where nothing crosses.

    Source:
        T. Moeller, A Fast Triangle-Triangle Intersection Test, 1997.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    if len(faces) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    corners = vertices[faces]
    touch = _TOUCH * float(np.linalg.norm(corners.max(axis=(0, 1)) - corners.min(axis=(0, 1))))
    low, high = corners.min(axis=1), corners.max(axis=1)
    batches = _box_overlaps(low, high, faces, among) if pairs is None else [_still_near(pairs, low, high, among)]
    found = [_crossing(batch, corners, touch) for batch in batches]
    crossing = np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)
    return crossing[np.lexsort((crossing[:, 1], crossing[:, 0]))]


def pairs_on_the_way(vertices: np.ndarray, moved: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs of faces that can cross while each vertex goes straight to where it is moved, each as far as it likes.

    To find them once is cheaper than to look for crossing faces anew at each of several steps of the way.

    Args:
        vertices: (v, 3) m.
        moved: (v, 3) m.
        faces: (f, 3) int.

    Returns:
        (p, 2) int, the smaller first; faces that share a vertex are left out.
    """
    corners = np.concatenate([vertices[faces], moved[faces]], axis=1)
    batches = list(_box_overlaps(corners.min(axis=1), corners.max(axis=1), faces, None))
    return np.concatenate(batches) if batches else np.zeros((0, 2), dtype=np.int64)


def _still_near(pairs: np.ndarray, low: np.ndarray, high: np.ndarray, among: np.ndarray | None) -> np.ndarray:
    """The pairs whose boxes, with corners (f, 3) m, overlap, and of which one is among the faces that are asked for."""
    if among is not None:
        pairs = pairs[among[pairs[:, 0]] | among[pairs[:, 1]]]
    for axis in range(3):
        a, b = pairs.T
        pairs = pairs[(low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])]
    return pairs


def _box_overlaps(
    low: np.ndarray, high: np.ndarray, faces: np.ndarray, among: np.ndarray | None
) -> Iterator[np.ndarray]:
    """Batches (b, 2) of pairs whose boxes overlap and that share no vertex, each pair once; see `crossing_faces`."""
    first_cell, last_cell = _grid(low, high)
    face, cell, key = _entries(first_cell, last_cell)
    if among is not None:
        near = np.isin(key, key[among[face]])
        face, cell, key = face[near], cell[near], key[near]
    # Column by column: a test of whole rows takes twice as long.
    low, high, first_cell, cell = (np.ascontiguousarray(array.T) for array in (low, high, first_cell, cell))
    # Within a cell, each entry is paired with those after it.
    partners = np.searchsorted(key, key, side="right") - np.arange(len(key)) - 1
    ends = np.cumsum(partners)
    start = 0
    while start < len(key):
        stop = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _BATCH)))
        left = np.repeat(np.arange(start, min(stop, len(key))), partners[start:stop])
        right = left + 1 + _ramps(partners[start:stop])
        a, b = face[left], face[right]
        for axis in range(3):
            overlaps = (low[axis, a] <= high[axis, b]) & (low[axis, b] <= high[axis, a])
            # Two faces meet in many cells; the first cell of their overlap speaks for the pair.
            is_first = np.maximum(first_cell[axis, a], first_cell[axis, b]) == cell[axis, left]
            keep = np.flatnonzero(overlaps & is_first)
            a, b, left = a[keep], b[keep], left[keep]
        meets = [faces[a, i] == faces[b, j] for i in range(3) for j in range(3)]
        apart = ~np.logical_or.reduce(meets)
        if among is not None:
            apart &= among[a] | among[b]
        yield np.sort(np.stack([a[apart], b[apart]], axis=1), axis=1)
        start = stop


def _entries(first_cell: np.ndarray, last_cell: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each face in each cell that its box meets, sorted by cell: face (e,), cell (e, 3) and the cell's key (e,)."""
    spans = last_cell - first_cell + 1
    counts = spans.prod(axis=1)
    face = np.repeat(np.arange(len(counts)), counts)
    step, span = _ramps(counts), spans[face]
    offset = np.stack([step // (span[:, 1] * span[:, 2]), step // span[:, 2] % span[:, 1], step % span[:, 2]], axis=1)
    cell, shape = first_cell[face] + offset, last_cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    order = np.argsort(key, kind="stable")
    return face[order], cell[order], key[order]


def _grid(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last cell (f, 3) of each box in a grid about as fine as the median box."""
    origin, extent = low.min(axis=0), float((high.max(axis=0) - low.min(axis=0)).max())
    size = max(float(np.median((high - low).max(axis=1))), extent / 200, 1e-12)
    while True:
        first = np.floor((low - origin) / size).astype(np.int64)
        last = np.floor((high - origin) / size).astype(np.int64)
        # Large faces among small ones would fill the grid: a coarser grid then.
        if (last - first + 1).prod(axis=1).sum() <= 24 * len(low) + 1000:
            return first, last
        size *= 1.5


def _ramps(counts: np.ndarray) -> np.ndarray:
    """0 .. c - 1 for each count c, one after the other."""
    starts = np.cumsum(counts) - counts
    return np.arange(int(counts.sum())) - np.repeat(starts, counts)


def _crossing(pairs: np.ndarray, corners: np.ndarray, touch: float) -> np.ndarray:
    """The pairs (b, 2) whose triangles cut a common segment out of the line in which their planes meet."""
    normals, offsets = _planes(corners)
    heights = []
    for mine, other in ((0, 1), (1, 0)):
        a, b = pairs[:, mine], pairs[:, other]
        height = np.einsum("pcx,px->pc", corners[a], normals[b]) - offsets[b, None]
        keep = (height.min(axis=1) < -touch) & (height.max(axis=1) > touch)
        pairs, heights = pairs[keep], [h[keep] for h in heights] + [height[keep]]
    line = cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    length = np.linalg.norm(line, axis=1)
    line = np.divide(line, length[:, None], out=np.zeros_like(line), where=length[:, None] > 0)
    low, high = zip(*(_interval(corners[pairs[:, i]], heights[i], line, touch) for i in (0, 1)), strict=True)
    overlap = np.minimum(high[0], high[1]) - np.maximum(low[0], low[1])
    return pairs[overlap > touch]


def _planes(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (f, 3), zero for a face without area, and offsets (f,) m."""
    normals = triangle_normals(corners)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return normals, np.einsum("fx,fx->f", normals, corners[:, 0])


def _interval(corners: np.ndarray, height: np.ndarray, line: np.ndarray, touch: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends (p,) m, along the line, of the cut of each triangle with the other's plane."""
    height = np.where(np.abs(height) <= touch, 0.0, height)
    along = np.einsum("pcx,px->pc", corners, line)
    low, high = np.full(len(corners), np.inf), np.full(len(corners), -np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        cuts = height[:, i] * height[:, j] <= 0
        drop = np.where(height[:, i] == height[:, j], 1.0, height[:, i] - height[:, j])
        at = along[:, i] + (along[:, j] - along[:, i]) * height[:, i] / drop
        low, high = np.where(cuts, np.minimum(low, at), low), np.where(cuts, np.maximum(high, at), high)
    return low, high
