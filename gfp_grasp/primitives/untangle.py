"""Undoing small folds of a mesh: vertices near them move towards the middle of their neighbours, the rest stays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gfp_grasp.meshes import crossing_faces, neighbour_average, vertex_normals

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
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    around = vertex_normals(vertices, faces)[faces].sum(axis=1)
    lengths = np.linalg.norm(normals, axis=1) * np.linalg.norm(around, axis=1)
    return (normals * around).sum(axis=1) < _LEAN * lengths


def _grown(bad: np.ndarray, faces: np.ndarray, count: int, rings: int) -> np.ndarray:
    chosen = np.zeros(count, dtype=bool)
    chosen[faces[bad]] = True
    for _ in range(rings - 1):
        chosen[faces[chosen[faces].any(axis=1)]] = True
    return chosen
