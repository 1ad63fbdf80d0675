"""Booleans of closed solids, cleaned so that what comes out is a volume without exactly coplanar pieces."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh

# Convex decomposition aborts on some unions with exactly coplanar faces; this much jitter cures it, and a union is not
# known to a micrometre anyway.
_JITTER_M = 1e-6
# Edges that a union leaves shorter than this are collapsed.
_SLIVER_M = 1e-5


def unite(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Union of closed meshes, jittered by at most a micrometre."""
    whole = manifold3d.Manifold.batch_boolean([_solid(mesh) for mesh in meshes], manifold3d.OpType.Add)
    mesh = _mesh(whole.simplify(_SLIVER_M))
    room = np.minimum(_JITTER_M, 0.05 * _smallest_altitudes(mesh.vertices, mesh.faces))
    turn = np.random.default_rng(len(mesh.vertices)).uniform(-1, 1, mesh.vertices.shape)
    return trimesh.Trimesh(mesh.vertices + room[:, None] * turn, mesh.faces, process=False)


def subtract(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> trimesh.Trimesh:
    """What of a closed mesh is outside of another."""
    return _mesh(_solid(mesh) - _solid(other))


def _smallest_altitudes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Smallest altitude (v,) m of the faces around each vertex: moved by less, no sliver turns over."""
    corners = vertices[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    smallest = np.full(len(vertices), np.inf)
    np.minimum.at(smallest, faces.ravel(), np.repeat(doubled / edges.max(axis=1), 3))
    return smallest


def _solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    vertices, faces = (
        np.array(mesh.vertices, dtype=np.float64, order="C"),
        np.array(mesh.faces, dtype=np.uint64, order="C"),
    )
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))


def _mesh(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    raw = solid.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts).astype(np.int64), process=False
    )
