"""Normals and samples of a triangle surface."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidMesh, InvalidOption


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
    weighted = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    index = np.asarray(faces).ravel()
    repeated = np.repeat(weighted, 3, axis=0)
    normals = np.stack([np.bincount(index, repeated[:, i], minlength=len(vertices)) for i in range(3)], axis=1)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros(normals.shape), where=lengths > 0)


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
    normals = np.cross(edge_a, edge_b)
    doubled_areas = np.linalg.norm(normals, axis=1)
    cumulated = np.cumsum(doubled_areas)
    if len(cumulated) == 0 or not cumulated[-1] > 0:
        raise InvalidMesh(f"a mesh of {len(mesh.faces)} faces has no area: there is nothing to sample")
    index = np.searchsorted(cumulated, rng.random(count) * cumulated[-1], side="right")
    weights = rng.random((count, 2))
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
    points = corners[index, 0] + weights[:, :1] * edge_a[index] + weights[:, 1:] * edge_b[index]
    return points, normals[index] / doubled_areas[index, None], index
