"""Parts of true objects, kept in memory and where `collision.store` keeps those of `decompose`."""

import hashlib
from collections.abc import Callable

import numpy as np
import trimesh

from gfp_grasp.collision import key_of, read_parts, write_parts
from gfp_grasp.types import CollisionMesh

_KEPT = 256  # at 0.2 MB
_memory: dict[str, CollisionMesh] = {}


def mesh_sha256(mesh: trimesh.Trimesh) -> str:
    """Hash of the vertices as little-endian float32 and the faces as int32: a mesh read twice has one hash anywhere."""
    digest = hashlib.sha256(np.asarray(mesh.vertices, dtype="<f4").tobytes())
    digest.update(np.asarray(mesh.faces, dtype="<i4").tobytes())
    return digest.hexdigest()


def decompose_cached(
    mesh: trimesh.Trimesh, decompose: Callable[[trimesh.Trimesh], CollisionMesh], *, maker: str
) -> CollisionMesh:
    """What decompose(mesh) gives, computed once a mesh.

    Args:
        mesh: Passed on to `decompose`.
        decompose: The work.
        maker: Says what `decompose` is and with which options; results of different makers are kept apart.
    """
    key = key_of(f"{maker}/{mesh_sha256(mesh)}")
    if key not in _memory:
        found = read_parts(key)
        if found is None:
            found = decompose(mesh)
            write_parts(key, found)
        if len(_memory) >= _KEPT:
            _memory.pop(next(iter(_memory)))
        _memory[key] = found
    return _memory[key]
