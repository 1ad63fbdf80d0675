"""Reading a mesh file, and refusing what is not a mesh."""

from __future__ import annotations

import io
import re
import struct
import tokenize
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from trimesh.exchange.load import mesh_formats
from trimesh.resolvers import Resolver
from trimesh.units import unit_conversion

from gfp_grasp.errors import InvalidMesh, UnreadableFile
from gfp_grasp.meshes.bodies import closed_bodies

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
LARGEST_BYTES = 1 << 30
_WITH_UNIT = ("3mf", "dae", "zae")
# What to do with a file that the installed packages do not read.
_WAYS = {
    ".dae": "pip install 'gfp-grasp[formats]' and it is read, or export it as .glb",
    ".zae": "pip install 'gfp-grasp[formats]' and it is read, or export it as .glb",
    ".3mf": "pip install 'gfp-grasp[formats]' and it is read, or export it as .stl",
    **dict.fromkeys((".step", ".stp", ".iges", ".igs"), "it holds CAD surfaces: export triangles, as .stl or .glb"),
    **dict.fromkeys((".fbx", ".blend", ".usd", ".usdz"), "export it from its program as .glb or .obj"),
}
# What trimesh's readers are seen to raise on broken files; anything else would be our own mistake.
READER_ERRORS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    ImportError,  # trimesh guesses the encoding of stray bytes with a package that need not be there
    LookupError,
    MemoryError,
    NameError,
    OSError,
    RuntimeError,
    SyntaxError,  # numpy reads the header of an array as a piece of Python,
    tokenize.TokenError,  # and then once more, word by word
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)


def load_mesh(path: str | Path, *, suffixes: Sequence[str] = SUFFIXES, scale: float = 1.0) -> trimesh.Trimesh:
    """Read one triangle mesh; the pieces of a scene are merged into one, vertices that coincide are joined.

    Closed bodies that touch stay apart. Lengths become metres where the format states their unit (3MF, DAE; glTF is in
    metres), else they are taken for metres. Nothing outside the file is opened, but for the buffers of a .gltf in its
    own folder: materials, textures and other links are left alone.

    Args:
        path: OBJ, STL, PLY, GLB or OFF file, or another that every_suffix lists.
        suffixes: Suffixes that are accepted; see every_suffix for more.
        scale: What all lengths are multiplied by then.

    Raises:
        UnreadableFile: The file is absent, has another suffix, or is not what its suffix says.
        InvalidMesh: The file can be read, but holds no usable triangles.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in suffixes:
        way = _WAYS.get(suffix)
        hint = f": {way}" if way else ""
        raise UnreadableFile(f"{path.name}: suffix {path.suffix!r} is not among {', '.join(suffixes)}{hint}")
    content = read_content(path)
    try:
        mesh = _parse(content, suffix[1:], _Beside(path.parent), scale)
    except UnreadableFile as error:
        raise UnreadableFile(f"{path.name}: {error}") from error
    except READER_ERRORS as error:
        reason = f"{type(error).__name__}: {str(error)[:200]}"
        raise UnreadableFile(f"{path.name} is not a readable {path.suffix[1:].upper()} mesh ({reason})") from error
    try:
        return check_mesh(mesh)
    except InvalidMesh as error:
        raise InvalidMesh(f"{path.name}: {error}") from error


def every_suffix() -> tuple[str, ...]:
    """Suffixes of all mesh files that the installed trimesh reads; some need packages that trimesh does not install."""
    names = set(mesh_formats()) - {"stl_ascii", "xyz"}  # no suffix, and points without faces
    return tuple(sorted({f".{name}" for name in names} | set(SUFFIXES)))


def read_content(path: Path) -> bytes:
    """All bytes of a file.

    Raises:
        UnreadableFile: Not there, empty, or larger than LARGEST_BYTES.
    """
    try:
        size = path.stat().st_size
        content = path.read_bytes() if 0 < size <= LARGEST_BYTES else b""
    except (OSError, ValueError) as error:  # a ValueError of a path with a null character
        raise UnreadableFile(f"{path} cannot be read: {getattr(error, 'strerror', error)}") from error
    if not content:
        raise UnreadableFile(f"{path.name} has {size} bytes; 1 to {LARGEST_BYTES} are read")
    return content


def check_mesh(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the mesh if it is a usable triangle mesh; it need not be closed.

    Raises:
        InvalidMesh: Not a mesh, empty, not finite, badly indexed, or of no extent or area.
    """
    if not isinstance(mesh, trimesh.Trimesh):
        raise InvalidMesh(f"{type(mesh).__name__} came; a trimesh.Trimesh is expected")
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(vertices) < 3 or len(faces) < 1:
        raise InvalidMesh(f"mesh has {len(vertices)} vertices and {len(faces)} faces; at least one triangle is needed")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InvalidMesh(f"face indices run from {faces.min()} to {faces.max()}; 0 to {len(vertices) - 1} are legal")
    used = vertices[faces]
    if not np.isfinite(used).all():
        raise InvalidMesh("mesh has vertices that are not finite: repair or re-export it")
    extents = used.max(axis=(0, 1)) - used.min(axis=(0, 1))
    if extents.max() > 1e6:
        raise InvalidMesh(f"mesh spans {extents.max():.3g} m: are its units metres, and are there stray vertices?")
    flat = np.linalg.matrix_rank(used.reshape(-1, 3) - used.reshape(-1, 3).mean(axis=0), tol=1e-9 * extents.max()) < 3
    if extents.max() <= 0 or flat:
        raise InvalidMesh(
            f"mesh is flat: its extents are {np.round(extents, 9).tolist()} m and its points lie in a plane"
        )
    return mesh


class _Beside(Resolver):
    """Files that a .gltf names: those in its own folder and the folders in that, and no others."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def get(self, key: str) -> bytes:
        path = (self._folder / unquote(key)).resolve()
        if not path.is_relative_to(self._folder):
            raise UnreadableFile(f"it names {key!r}, and only files in its own folder are opened")
        return read_content(path)

    def write(self, name: str, data: object) -> None:
        raise NotImplementedError

    def namespaced(self, namespace: str) -> _Beside:
        return _Beside(self._folder / namespace)

    def keys(self) -> list[str]:
        return []


def _parse(content: bytes, suffix: str, beside: _Beside, scale: float) -> trimesh.Trimesh:
    if suffix == "off":
        # Part of ModelNet's files write the counts behind the magic word, on one line.
        content = re.sub(rb"^(\s*C?OFF)(?=\d)", rb"\1\n", content, count=1)
    options: dict[str, Any] = {"skip_materials": True} if suffix in ("obj", "gltf", "glb") else {}
    if suffix == "gltf":
        options["resolver"] = beside
    loaded = trimesh.load_scene(io.BytesIO(content), file_type=suffix, process=False, **options)
    for unit in {piece.units for piece in loaded.geometry.values()} - {None} if suffix in _WITH_UNIT else ():
        scale *= unit_conversion(unit, "meters")
    mesh = loaded.to_mesh()
    mesh = trimesh.Trimesh(np.array(mesh.vertices) * scale, np.array(mesh.faces), process=False, validate=False)
    sound = len(mesh.faces) and mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices)
    if sound and np.isfinite(mesh.vertices).all():  # anything else is for check_mesh to refuse
        mesh.merge_vertices()
        # Bodies that touch must not become one surface by that.
        bodies = None if mesh.is_watertight else closed_bodies(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        mesh = mesh if bodies is None else bodies
    return mesh
