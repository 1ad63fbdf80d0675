"""A cache of convex parts on disk, each under the hash of all that they depend on: an engine takes up to minutes.

The environment variable GFP_GRASP_CACHE names the folder ("off" for no cache); without it, the folder lies in that of
the user's caches. It holds at most LARGEST_BYTES, and the parts that were read longest ago are removed first. Several
processes may share it: a file is written under another name and then moved into its place. A file that is torn, foreign
or gone counts as absent.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import tempfile
import time
import warnings
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import trimesh

from gfp_grasp import __version__
from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.parts import parts_from_arrays, parts_to_arrays
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.types import CollisionMesh

CACHE_VARIABLE = "GFP_GRASP_CACHE"  # a folder, or "off"
LARGEST_BYTES = 256 * 2**20  # some 20 000 decompositions of 40 parts
_FORMAT = "4"  # raise it when the files change, or when the same call gives other parts
_WHEELS = {"coacd": "coacd", "vhacd": "vhacdx"}
# Nothing else in the folder is ours to remove.
_OURS = re.compile(r"[0-9a-f]{64}\.npz|[0-9a-f]{64}-\w+\.tmp")
_ABANDONED_S = 3600.0  # a file that is being written is done long before
_BROKEN = (
    ArithmeticError,
    AttributeError,
    BadZipFile,
    EOFError,
    InvalidMesh,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    zlib.error,
)
_warned: set[str] = set()


def decomposition_key(mesh: trimesh.Trimesh, config: DecomposeConfig) -> str:
    """Hash of vertices, faces, the options, the engine and its version: 64 hexadecimal digits.

    The time limit is none of them: parts that a lack of time made coarser are not kept.
    """
    options = {name: value for name, value in asdict(config).items() if name not in ("cache", "time_limit_s")}
    try:
        wheel = version(_WHEELS[config.engine])
    except PackageNotFoundError:  # built by hand, without metadata
        wheel = ""
    head = [_FORMAT, __version__, wheel, options, len(mesh.vertices), len(mesh.faces)]
    digest = hashlib.sha256(json.dumps(head, sort_keys=True).encode())
    digest.update(np.asarray(mesh.vertices, dtype="<f8").tobytes())
    digest.update(np.asarray(mesh.faces, dtype="<i8").tobytes())
    return digest.hexdigest()


def key_of(text: str) -> str:
    """Key for parts of another maker, from a text that says what they depend on: 64 hexadecimal digits."""
    return hashlib.sha256(f"{_FORMAT}/{text}".encode()).hexdigest()


def read_parts(key: str) -> CollisionMesh | None:
    """The parts under a key; None where the cache has none, or none that can be used."""
    folder = cache_folder()
    if folder is None:
        return None
    path = folder / f"{key}.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            found = _unpacked(key, file)
    except _BROKEN:
        return None
    with suppress(OSError):
        os.utime(path)  # it was read now: others are removed first
    return found


def write_parts(key: str, collision: CollisionMesh) -> None:
    """Keep parts under a key. Where the folder cannot be written, a warning is given, once for each folder."""
    folder = cache_folder()
    if folder is None:
        return
    temporary = None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=folder, prefix=f"{key}-", suffix=".tmp")
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(file, **_packed(key, collision))  # pyright: ignore[reportArgumentType]
        os.replace(temporary, folder / f"{key}.npz")
        temporary = None
        _make_room(folder)
    except OSError as error:
        if str(folder) not in _warned:
            _warned.add(str(folder))
            warnings.warn(
                f"convex parts cannot be kept in {folder} ({error.strerror or error}) and are computed each time: name "
                f"a folder that is yours in {CACHE_VARIABLE}, or turn this off with {CACHE_VARIABLE}=off",
                RuntimeWarning,
                stacklevel=3,
            )
    finally:
        if temporary is not None:  # KeyboardInterrupt, too
            with suppress(OSError):
                os.unlink(temporary)


def cache_folder() -> Path | None:
    """Folder of the cache; None where it is turned off or the user's home folder is unknown."""
    chosen = os.environ.get(CACHE_VARIABLE, "")
    if chosen.lower() == "off":
        return None
    try:
        if chosen:
            return Path(chosen).expanduser()
        if sys.platform == "win32":
            root = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        elif sys.platform == "darwin":
            root = Path.home() / "Library" / "Caches"
        else:
            root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        return None
    return Path(root) / "gfp_grasp" / "parts"


def _packed(key: str, collision: CollisionMesh) -> dict[str, np.ndarray]:
    meta = {
        "key": key,
        "error_m": [float(error) for error in collision.error_m],
        "made_by": collision.made_by,
        "seconds": float(collision.seconds),
        "notes": {name: _plain(value) for name, value in collision.notes.items()},
    }
    return {**parts_to_arrays(collision.parts), "meta": np.array(json.dumps(meta, default=str))}


def _plain(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, bool | int | float | str | tuple | list | None) else str(value)


def _unpacked(key: str, file: Mapping[str, np.ndarray]) -> CollisionMesh | None:
    """The parts in a file; None where the file belongs to another key or holds no parts."""
    meta = json.loads(str(file["meta"]))
    if meta["key"] != key:
        return None
    parts = parts_from_arrays(file)
    if not parts:
        return None
    mean, high, largest = map(float, meta["error_m"])
    notes = {name: tuple(value) if isinstance(value, list) else value for name, value in meta["notes"].items()}
    return CollisionMesh(parts, (mean, high, largest), meta["made_by"], float(meta["seconds"]), notes)


def _make_room(folder: Path) -> None:
    """Remove the files that were read longest ago, and those that a killed process left half written."""
    kept, now = [], time.time()
    for entry in os.scandir(folder):
        if not _OURS.fullmatch(entry.name):
            continue
        with suppress(OSError):  # another process may have been first
            status = entry.stat()
            if entry.name.endswith(".npz"):
                kept.append((status.st_mtime, status.st_size, entry.path))
            elif now - status.st_mtime > _ABANDONED_S:
                os.unlink(entry.path)
    excess = sum(size for _, size, _ in kept) - LARGEST_BYTES
    for _, size, path in sorted(kept):
        if excess <= 0:
            return
        with suppress(OSError):
            os.unlink(path)
        excess -= size
