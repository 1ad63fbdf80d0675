"""Displacements that leave a solid: spread over the mesh, and damped where the surface would fold."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import factorized

from gfp_grasp.meshes import crossing_faces, graph_laplacian, neighbour_average
from gfp_grasp.types import GenericPrimitive

_STIFFNESS = 0.3
_HALVINGS = 5
# A face whose normal turns by more than this has folded over.
_FOLD_COSINE = 0.0


def diffuse(primitive: GenericPrimitive, displacement: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Spread displacements (v, 3) m over the mesh, by their confidence (v,), to vertices that have none.

    Minimises the confident misfit and the bending of the displacement: sum c |d - d0|^2 + s |L d|^2.
    """
    confidence = np.maximum(confidence, 1e-3)
    solve = _diffuser(primitive, confidence.tobytes())
    return np.column_stack([solve(confidence * column) for column in displacement.T])


@lru_cache(maxsize=32)
def _diffuser(primitive: GenericPrimitive, confidence_bytes: bytes) -> Callable[[np.ndarray], np.ndarray]:
    """The factorised system of one primitive and confidence: the default network's is the same for every fit."""
    confidence = np.frombuffer(confidence_bytes)
    L = graph_laplacian(primitive.faces, len(confidence))
    return factorized(sparse.csc_matrix(sparse.diags(confidence) + _STIFFNESS * (L.T @ L)))


def damp_until_solid(vertices: np.ndarray, faces: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, float]:
    """Move vertices as far as the surface neither folds nor crosses itself.

    The displacement is halved around the faces that fold or cross, and everywhere when that does not help.

    Args:
        vertices: (v, 3) m, of a mesh that does not cross itself.
        faces: (f, 3).
        displacement: (v, 3) m.

    Returns:
        (v, 3) m moved vertices, and the smallest share of its displacement that a vertex kept.
    """
    share = np.ones(len(vertices))
    average = _cached_average(faces.tobytes(), len(faces), len(vertices))
    for _ in range(_HALVINGS):
        moved = vertices + share[:, None] * displacement
        bad = _bad_faces(vertices, moved, faces)
        if len(bad) == 0:
            return moved, float(share.min())
        near = np.zeros(len(vertices))
        near[faces[bad].ravel()] = 1.0
        for _ in range(3):  # the damping fades out over three rings: an edge of its own would fold the surface
            near = np.maximum(near, 0.7 * (average @ near))
        share *= 1.0 - 0.5 * np.minimum(near, 1.0)
    for factor in (0.5, 0.25, 0.1, 0.0):
        moved = vertices + factor * share[:, None] * displacement
        if len(_bad_faces(vertices, moved, faces)) == 0:
            return moved, float(factor * share.min())
    return vertices.copy(), 0.0


def _bad_faces(before: np.ndarray, after: np.ndarray, faces: np.ndarray) -> np.ndarray:
    old, new = _cross(before, faces), _cross(after, faces)
    scale = np.linalg.norm(old, axis=1) * np.linalg.norm(new, axis=1) + 1e-30
    folded = np.flatnonzero(np.einsum("fi,fi->f", old, new) / scale < _FOLD_COSINE)
    return np.union1d(folded, crossing_faces(after, faces).ravel()).astype(np.int64)


def _cross(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


@lru_cache(maxsize=32)
def _cached_average(face_bytes: bytes, num_faces: int, num_vertices: int) -> sparse.csr_matrix:
    faces = np.frombuffer(face_bytes, dtype=np.int64).reshape(num_faces, 3)
    return neighbour_average(faces, num_vertices)
