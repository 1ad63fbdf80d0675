"""Closest points on a mesh whose normals agree, the nearest-neighbour rule of this room; and undoing small folds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.meshes import crossing_faces, neighbour_average, sample_surface, triangle_normals, vertex_normals


class Surface:
    """Samples of a mesh with normals, and exact closest points on its faces.

    Attributes:
        points: (n, 3) m, uniform over the area.
        normals: (n, 3) unit, of the faces.
        face_index: (n,) face of each sample.
    """

    def __init__(self, mesh: trimesh.Trimesh, rng: np.random.Generator, *, count: int = 8000) -> None:
        self.points, self.normals, self.face_index = sample_surface(mesh, count, rng)
        self._triangles = np.asarray(mesh.triangles)
        self._face_normals = _face_normals(self._triangles)
        # Faces too small to be hit by a sample are found by their centres.
        self._candidates = np.vstack([self.points, self._triangles.mean(axis=1)])
        self._candidate_normals = np.vstack([self.normals, self._face_normals])
        self._candidate_faces = np.concatenate([self.face_index, np.arange(len(self._triangles))])
        self._trees: dict[tuple[bool, float], KDTree] = {}

    def nearest(self, points: np.ndarray, normals: np.ndarray, *, normal_weight_m: float) -> np.ndarray:
        """Index (n,) of the sample nearest in position and normal; a right angle costs 1.4 normal_weight_m."""
        features = np.hstack([points, normals * normal_weight_m])
        return np.asarray(self._tree(normal_weight_m, exact=False).query(features)[1])

    def closest(
        self,
        points: np.ndarray,
        normals: np.ndarray | None = None,
        *,
        normal_weight_m: float = 0.0,
        num_candidates: int = 6,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Exact closest points on the faces near each point.

        Args:
            points: (n, 3) m.
            normals: (n, 3) unit: candidates are sought in position and normal; None for position only.
            normal_weight_m: Weight of the normals in that search.
            num_candidates: How many samples are looked at: their faces are tried exactly.

        Returns:
            Closest points (n, 3) m, and the unit normals (n, 3) of their faces.
        """
        if normals is None:
            index = self._tree(0.0, exact=True).query(points, k=num_candidates)[1]
        else:
            features = np.hstack([points, normals * normal_weight_m])
            index = self._tree(normal_weight_m, exact=True).query(features, k=num_candidates)[1]
        faces = self._candidate_faces[index]
        flat = np.repeat(points, num_candidates, axis=0)
        candidates = trimesh.triangles.closest_point(self._triangles[faces.ravel()], flat).reshape(*faces.shape, 3)
        best = np.linalg.norm(candidates - points[:, None], axis=2).argmin(axis=1)
        rows = np.arange(len(points))
        return candidates[rows, best], self._face_normals[faces[rows, best]]

    def _tree(self, normal_weight_m: float, *, exact: bool) -> KDTree:
        key = (exact, normal_weight_m)
        if key not in self._trees:
            points, normals = (self._candidates, self._candidate_normals) if exact else (self.points, self.normals)
            features = np.hstack([points, normals * normal_weight_m]) if normal_weight_m > 0 else points
            self._trees[key] = KDTree(features)
        return self._trees[key]


def surface_distance_m(a: trimesh.Trimesh, b: trimesh.Trimesh, *, seed: int = 0, count: int = 6000) -> float:
    """Mean distance between two surfaces: from samples of each to the other, the two means averaged."""
    rng = np.random.default_rng(seed)
    on_a, on_b = Surface(a, rng, count=count), Surface(b, rng, count=count)
    return 0.5 * (_mean_distance(on_a, on_b) + _mean_distance(on_b, on_a))


def _mean_distance(source: Surface, target: Surface) -> float:
    return float(np.linalg.norm(target.closest(source.points)[0] - source.points, axis=1).mean())


def _face_normals(triangles: np.ndarray) -> np.ndarray:
    normals = triangle_normals(triangles)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


# A face that leans more than 75 degrees away from the surface around it is folded, or about to be.
_LEAN = 0.25


def untangle(vertices: np.ndarray, faces: np.ndarray, *, iterations: int = 60) -> np.ndarray:
    """Smooth a closed mesh where, and only where, its faces cross or fold over.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3).
        iterations: Steps at most; every tenth step the region grows by one ring.

    Returns:
        (v, 3) m, without crossings where that could be reached.
    """
    average = neighbour_average(faces, len(vertices))
    vertices = vertices.copy()
    for step in range(iterations):
        bad = folded_faces(vertices, faces)
        bad[np.unique(crossing_faces(vertices, faces))] = True
        if not bad.any():
            break
        chosen = _grown(bad, faces, len(vertices), 1 + step // 10)
        vertices[chosen] += 0.5 * (average @ vertices - vertices)[chosen]
    return vertices


def relax_folds(
    vertices: np.ndarray,
    faces: np.ndarray,
    project: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    iterations: int = 8,
) -> np.ndarray:
    """Slide vertices of folded faces along a surface until the faces lie flat on it.

    Args:
        vertices: (v, 3) m, on the surface.
        faces: (f, 3).
        project: Takes points (n, 3) and normals (n, 3) back to the surface.
        iterations: At most.
    """
    average = neighbour_average(faces, len(vertices))
    vertices = vertices.copy()
    for step in range(iterations):
        bad = folded_faces(vertices, faces)
        if not bad.any():
            break
        chosen = _grown(bad, faces, len(vertices), 1 + step // 3)
        moved = vertices + 0.6 * np.where(chosen[:, None], average @ vertices - vertices, 0.0)
        vertices[chosen] = project(moved[chosen], vertex_normals(moved, faces)[chosen])
    return vertices


def folded_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(f,) bool: faces that lean far away from the mean normal of the vertices around them."""
    corners = vertices[faces]
    normals = triangle_normals(corners)
    around = vertex_normals(vertices, faces)[faces].sum(axis=1)
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(around, axis=1)
    return (normals * around).sum(axis=1) < _LEAN * lengths


def _grown(bad: np.ndarray, faces: np.ndarray, count: int, rings: int) -> np.ndarray:
    chosen = np.zeros(count, dtype=bool)
    chosen[faces[bad]] = True
    for _ in range(rings - 1):
        chosen[faces[chosen[faces].any(axis=1)]] = True
    return chosen
