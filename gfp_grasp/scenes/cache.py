"""Convex decompositions, kept in memory and in the user's cache folder: CoACD takes seconds to a minute a mesh."""

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.types import CollisionMesh, ConvexPart

CACHE_VARIABLE = "GFP_GRASP_CACHE"  # a folder, or "off" for memory only
_FORMAT = "1"  # raise it when decompose() starts to give other parts for the same mesh
_memory: dict[str, CollisionMesh] = {}


def mesh_sha256(mesh: trimesh.Trimesh) -> str:
    """Of the vertices as little-endian float32 and the faces as int32: a mesh read twice has one hash anywhere."""
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
    key = hashlib.sha256(f"{_FORMAT}/{maker}/{mesh_sha256(mesh)}".encode()).hexdigest()[:32]
    if key not in _memory:
        folder = _folder()
        found = _read(folder / f"{key}.npz") if folder else None
        if found is None:
            found = decompose(mesh)
            if folder:
                _write(folder / f"{key}.npz", found)
        _memory[key] = found
    return _memory[key]


def _folder() -> Path | None:
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen == "off":
        return None
    if chosen:
        return Path(chosen)
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "gfp_grasp" / "parts"


def _read(path: Path) -> CollisionMesh | None:
    """None for a file that is absent, torn or of another make: it is then computed afresh."""
    try:
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            parts = tuple(ConvexPart(file[f"v{i}"], file[f"f{i}"]) for i in range(meta["parts"]))
        if not parts:
            return None
        return CollisionMesh(parts, tuple(meta["error_m"]), meta["made_by"], meta["seconds"], meta["notes"])
    except (OSError, ValueError, KeyError, EOFError):
        return None


def _write(path: Path, collision: CollisionMesh) -> None:
    """In one move, so that workers never read half a file; a full or read-only disk only costs the cache."""
    arrays: dict[str, np.ndarray] = {}
    for number, part in enumerate(collision.parts):
        arrays[f"v{number}"], arrays[f"f{number}"] = part.vertices, part.faces
    meta = {
        "parts": len(collision.parts),
        "error_m": [float(error) for error in collision.error_m],
        "made_by": collision.made_by,
        "seconds": float(collision.seconds),
        "notes": json.loads(json.dumps(dict(collision.notes), default=str)),
    }
    arrays["meta"] = np.array(json.dumps(meta))
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]
        os.replace(temporary, path)
    except OSError:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)
