"""Booleans of closed solids, cleaned so that what comes out is a volume without exactly coplanar pieces."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh

# Convex decomposition aborts on some unions with exactly coplanar faces; this much jitter cures it, and a union is not
# known to a micrometre anyway.
_JITTER_M = 1e-6


def unite(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Union of closed meshes, jittered by a micrometre."""
    whole = manifold3d.Manifold.batch_boolean([_solid(mesh) for mesh in meshes], manifold3d.OpType.Add)
    mesh = _mesh(whole.simplify(1e-5))
    jitter = np.random.default_rng(len(mesh.vertices)).uniform(-_JITTER_M, _JITTER_M, mesh.vertices.shape)
    return trimesh.Trimesh(mesh.vertices + jitter, mesh.faces, process=False)


def subtract(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> trimesh.Trimesh:
    """What of a closed mesh is outside of another."""
    return _mesh(_solid(mesh) - _solid(other))


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
