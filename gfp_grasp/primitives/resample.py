"""The fewest vertices that still carry a mean and its modes: half-edge collapse under quadrics of many shapes."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import crossing_faces, triangle_normals, vertex_normals
from gfp_grasp.primitives.remesh import _rings
from gfp_grasp.primitives.surface import Surface

# A collapse may turn a face by up to 72 degrees in any of the shapes, and make no needle, or none that is thinner.
_MAX_TURN, _MIN_HEIGHT = 0.3, 0.12
# Weight of a kept vertex's own place against the dense vertices around it, when it is moved to fit them.
_ANCHOR = 0.2
# Candidates of a closest point where the largest distance is asked for, which one missed face would spoil.
_MANY = 40
_FEW = 100  # points about which every face may be asked


@dataclass(frozen=True)
class ResampleConfig:
    """How far vertices are thinned out.

    Attributes:
        max_error_m: Largest distance between the thinned and the dense mean that is allowed for any size.
        max_error: The same as a share of the mean's diagonal; the larger one counts.
        mode_error: How many times as far each of the other shapes may be off, at the 99th percentile.
        max_edge: Longest edge, as a share of the mean's diagonal: modes need vertices also where the mean is flat.
    """

    max_error_m: float = 0.0005
    max_error: float = 0.0016
    mode_error: float = 2.0
    max_edge: float = 0.09

    def __post_init__(self) -> None:
        if not (min(self.max_error_m, self.max_error, self.mode_error) > 0 and 0 < self.max_edge < 1):
            raise InvalidOption(f"{self}: errors above zero and 0 < max_edge < 1 are expected")


def resample(
    shapes: np.ndarray, faces: np.ndarray, rng: np.random.Generator, *, config: ResampleConfig = ResampleConfig()
) -> tuple[np.ndarray, np.ndarray, float]:
    """Thin out a mesh that takes many shapes.

    Edges collapse onto one of their ends, so each remaining vertex is one of the old ones; the cost is the quadric
    error (Garland and Heckbert, SIGGRAPH 1997) summed over shapes. Chords cut corners, so the remaining vertices are
    then moved, by one linear map for the mean and all modes, to where the thin mesh interpolates the dense one best.

    Args:
        shapes: (m, v, 3) m; the first is the mean, the others what its modes make of it.
        faces: (f, 3), closed.
        rng: Draws the samples that measure the error.
        config: How far.

    Returns:
        Map (w, v) from dense to thinned vertices, for the mean and for every mode; faces (g, 3); and the largest
        distance of the thinned from the dense mean in metres.
    """
    diagonal = float(np.linalg.norm(np.ptp(shapes[0], axis=0)))
    allowed_m = max(config.max_error_m, config.max_error * diagonal)
    history = _collapse_all(shapes, faces, config.max_edge * diagonal)
    low, high = 0, len(history)  # low collapses are fine, more than high are not
    while high - low > len(history) // 100:
        count = (low + high + 1) // 2
        carry, thin = _carrier(shapes[0], faces, *_after(history, count, faces, len(shapes[0])), allowed_m)
        if _fits(shapes, faces, carry, thin, rng, allowed_m, config.mode_error):
            low = count
        else:
            high = count - 1
    while low > 0:
        carry, thin = _carrier(shapes[0], faces, *_after(history, low, faces, len(shapes[0])), allowed_m)
        error = _farthest_m(shapes[0], faces, carry @ shapes[0], thin, rng, allowed_m)
        # Measured on other samples than in the search: what is reported has to hold as well.
        if error <= allowed_m:
            return carry, thin, error
        low = max(0, low - max(1, len(history) // 100))
    return np.eye(len(shapes[0])), faces, 0.0  # every vertex is needed, where it is


def _collapse_all(shapes: np.ndarray, faces: np.ndarray, limit: float) -> list[tuple[int, int]]:
    """Every collapse (gone, onto) that is legal, cheapest first."""
    points = shapes.transpose(1, 0, 2)  # (v, m, 3)
    homogeneous = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=2)
    quadrics = _quadrics(points, faces)
    rings, around = _rings(faces, len(points))
    faces = faces.copy()
    stamp = np.zeros(len(points), dtype=int)
    heap: list[tuple[float, int, int, int, int]] = []

    def push(pairs: np.ndarray) -> None:
        both = quadrics[pairs[:, 0]] + quadrics[pairs[:, 1]]
        end = homogeneous[pairs[:, 1]]
        cost = np.einsum("emi,emij,emj->e", end, both, end)
        # Between equals the shorter edge goes first, or flat parts would be cut into needles.
        length = np.linalg.norm(points[pairs[:, 0], 0] - points[pairs[:, 1], 0], axis=1)
        cost = cost / len(shapes) + 1e-5 * length**2
        for (i, j), c in zip(pairs.tolist(), cost.tolist(), strict=True):
            heapq.heappush(heap, (c, i, j, int(stamp[i]), int(stamp[j])))

    push(np.array([(i, j) for i, ring in enumerate(rings) for j in ring]))
    history: list[tuple[int, int]] = []
    while heap:
        _, i, j, stamp_i, stamp_j = heapq.heappop(heap)
        if stamp[i] != stamp_i or stamp[j] != stamp_j or len(rings[i] & rings[j]) != 2:
            continue
        if not _legal(points, faces, around[i] - around[j], i, j, rings[i], limit):
            continue
        history.append((i, j))
        gone = around[i] & around[j]
        for face in around[i] - gone:
            faces[face][faces[face] == i] = j
            around[j].add(face)
        for face in gone:
            for vertex in faces[face]:
                around[vertex].discard(face)
        for neighbour in rings[i]:
            rings[neighbour].discard(i)
            if neighbour != j:
                rings[neighbour].add(j)
                rings[j].add(neighbour)
        quadrics[j] += quadrics[i]
        stamp[i] += 1
        stamp[j] += 1
        ring = np.fromiter(rings[j], dtype=int)
        own = np.full(len(ring), j)
        push(np.concatenate([np.stack([ring, own], 1), np.stack([own, ring], 1)]))
    return history


def _quadrics(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Plane quadrics (v, m, 4, 4) in m^2, weighted by the root of the area: by area, thin rims would count nothing."""
    corners = points[faces]
    cross = triangle_normals(corners)
    area = np.linalg.norm(cross, axis=2, keepdims=True)
    normal = cross / np.maximum(area, 1e-300)
    plane = np.concatenate([normal, -(normal * corners[:, 0]).sum(axis=2, keepdims=True)], axis=2)
    each = np.einsum("fmi,fmj->fmij", plane, plane) * np.sqrt(area / area.mean())[..., None]
    quadrics = np.zeros((len(points), points.shape[1], 4, 4))
    for corner in range(3):
        np.add.at(quadrics, faces[:, corner], each)
    return quadrics


def _legal(points, faces, index: set[int], i: int, j: int, ring: set[int], limit: float) -> bool:
    """Whether the faces that survive keep their side in each shape, and their edges stay short."""
    others = np.fromiter(ring, dtype=int)
    if (np.linalg.norm(points[others, 0] - points[j, 0], axis=1) > limit).any():
        return False
    old = faces[np.fromiter(index, dtype=int)]
    new = np.where(old == i, j, old)
    before, after = points[old], points[new]
    normal = triangle_normals(before)
    cross = triangle_normals(after)
    area = np.linalg.norm(cross, axis=2)
    flatness, old_flatness = _flatness(after[:, :, 0]), _flatness(before[:, :, 0])
    if ((flatness < _MIN_HEIGHT) & (flatness < old_flatness)).any():
        return False
    return bool(((cross * normal).sum(axis=2) > _MAX_TURN * area * np.linalg.norm(normal, axis=2)).all())


def _flatness(corners: np.ndarray) -> np.ndarray:
    """(n,) height over the longest side of triangles (n, 3, 3)."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return np.linalg.norm(triangle_normals(corners), axis=1) / np.maximum(longest, 1e-300) ** 2


def _after(history: list[tuple[int, int]], count: int, faces: np.ndarray, num: int) -> tuple[np.ndarray, np.ndarray]:
    """Kept vertices and faces once the first `count` collapses are done."""
    onto = np.arange(num)
    for i, j in reversed(history[:count]):
        onto[i] = onto[j]
    faces = onto[faces]
    alive = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    kept, inverse = np.unique(faces[alive], return_inverse=True)
    return kept, inverse.reshape(-1, 3)


def _carrier(
    dense: np.ndarray, faces: np.ndarray, kept: np.ndarray, thin: np.ndarray, allowed_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares map (w, v) that takes dense vertices to thin ones, so that thin triangles run through the dense.

    A vertex that it would take farther away than allowed_m stays: around it, in a sharp corner, points were matched to
    another sheet.
    """
    triangles = dense[kept][thin]
    normals = vertex_normals(dense, faces)
    thin_normals = triangle_normals(triangles)
    thin_normals /= np.maximum(np.linalg.norm(thin_normals, axis=1, keepdims=True), 1e-300)
    face, weight = _nearest_faces(dense, normals, triangles, thin_normals)
    rows = np.repeat(np.arange(len(dense)), 3)
    interpolate = sparse.csr_matrix((weight.ravel(), (rows, thin[face].ravel())), (len(dense), len(kept)))
    pick = sparse.csr_matrix((np.ones(len(kept)), (np.arange(len(kept)), kept)), (len(kept), len(dense)))
    # Each kept vertex pulls on itself as well: it is seldom far off.
    gram = (interpolate.T @ interpolate + _ANCHOR * sparse.identity(len(kept))).tocsc()
    carry = splu(gram).solve((interpolate.T + _ANCHOR * pick).toarray())
    stray = np.linalg.norm(carry @ dense - dense[kept], axis=1) > allowed_m
    carry[stray] = pick[stray].toarray()
    return carry, thin


def _nearest_faces(points, normals, triangles, face_normals) -> tuple[np.ndarray, np.ndarray]:
    """The face (n,) on the same sheet that is nearest to each point, and the barycentric weights (n, 3) of its foot."""
    tree = KDTree(triangles.mean(axis=1))
    index = np.asarray(tree.query(points, k=min(24, len(triangles)))[1])
    flat = np.repeat(points, index.shape[1], axis=0)
    feet = trimesh.triangles.closest_point(triangles[index.ravel()], flat).reshape(*index.shape, 3)
    distance = np.linalg.norm(feet - points[:, None], axis=2)
    distance[(face_normals[index] * normals[:, None]).sum(axis=2) < 0] += 1.0  # metres: never preferred
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    face = index[rows, best]
    return face, np.clip(trimesh.triangles.points_to_barycentric(triangles[face], feet[rows, best]), 0, 1)


def _fits(shapes, faces, carry, thin, rng: np.random.Generator, allowed_m: float, mode_error: float) -> bool:
    mean = carry @ shapes[0]
    if _farthest_m(shapes[0], faces, mean, thin, rng, allowed_m) > allowed_m:
        return False
    if len(crossing_faces(mean, thin)) or not trimesh.Trimesh(mean, thin, process=False).is_volume:
        return False
    return all(
        np.percentile(_distances(shape, faces, carry @ shape, thin, rng), 99) <= mode_error * allowed_m
        for shape in shapes[1:]
    )


def _farthest_m(
    dense: np.ndarray, faces: np.ndarray, points: np.ndarray, thin: np.ndarray, rng, allowed_m: float
) -> float:
    """Largest distance m from the dense mesh to the thinned surface.

    Samples miss needles, as the middle of a disc has them: the few points that seem too far are asked about every face.
    """
    found = _distances(dense, faces, points, thin, rng, _MANY)
    far = np.flatnonzero(found > allowed_m)
    if 0 < len(far) <= _FEW:
        asked = np.concatenate([dense, dense[faces].mean(axis=1)])[far]
        every = np.tile(points[thin], (len(far), 1, 1))
        feet = trimesh.triangles.closest_point(every, np.repeat(asked, len(thin), axis=0)).reshape(len(far), -1, 3)
        found[far] = np.linalg.norm(feet - asked[:, None], axis=2).min(axis=1)
    return float(found.max())


def _distances(dense: np.ndarray, faces: np.ndarray, points: np.ndarray, thin: np.ndarray, rng, num_candidates=8):
    """Distances (v + f,) m from the dense vertices and face centres to the thinned surface."""
    from_points = np.concatenate([dense, dense[faces].mean(axis=1)])
    surface = Surface(trimesh.Trimesh(points, thin, process=False), rng, count=12000)
    return np.linalg.norm(surface.closest(from_points, num_candidates=num_candidates)[0] - from_points, axis=1)
