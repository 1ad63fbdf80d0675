"""Completed objects as files, by suffix."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.collision import MIN_THICKNESS_M, convex_part
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export.formats import Body, Part, mass_properties, replacing, write_mjcf, write_urdf

_IN_PARTS = (".xml", ".urdf")
SUFFIXES = (".obj", ".ply", ".stl", ".glb", *_IN_PARTS)
_STRANGE = r"[^A-Za-z0-9_.-]+"


def export_completion(
    mesh: trimesh.Trimesh,
    parts: Sequence[Part],
    path: str | Path,
    *,
    name: str = "object",
    density: float = 1000.0,
    shell_thickness_m: float | None = None,
    colors: np.ndarray | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
    assets: Literal["embedded", "files"] = "embedded",
) -> Path:
    """Write an object in the form that the suffix names.

    `.obj`, `.ply`, `.stl` and `.glb` hold the mesh. `.xml` is MJCF in one file: the mesh to look at, every convex part
    as a mesh of its own to collide with, explicit inertia, a free joint, floor and light, for MuJoCo's viewer to open.
    `.urdf` names mesh files in the folder `<stem>_meshes` beside it, visual.obj and hull_000.obj onward, by relative
    paths: the two can be moved together. The same object gives the same names and bytes. Each file is replaced as a
    whole: a program that has the old one open goes on reading the old one.

    Args:
        mesh: Metres; watertight unless shell_thickness_m is given or only the mesh is written.
        parts: Its convex parts in the same frame; only .xml and .urdf need them.
        path: The file; folders are made, files replaced.
        name: Name of the body: letters, digits and _ . - only, and not "world"; legal_name makes one of any text.
        density: Density of the material, kg/m3, 0.1 to 30 000.
        shell_thickness_m: Take the mass from the surface times this thickness instead of the volume. What is hollow
            and has a closed mesh needs it; a vessel whose mesh has an inside does not.
        colors: (v, 3) or (v, 4) uint8 of the vertices, kept by .ply, .glb and .obj.
        up: (3,) normal of the floor, against gravity, in the mesh's frame; for .xml.
        assets: Whether .xml embeds its meshes or has them in files beside it, as .urdf always does.

    Returns:
        The path that was written.

    Raises:
        InvalidOption: Unknown suffix, illegal name, density, thickness, colors, up or assets.
        InvalidMesh: No parts where they are needed, one that MuJoCo would not take, or mass from a volume that is none.
    """
    path = Path(path)
    in_parts, up = needs_parts(path), _unit(up)
    if not name or name != legal_name(name):
        raise InvalidOption(f"name is {name!r}; letters, digits and _ . - are legal, world is not: use legal_name")
    if assets not in ("embedded", "files"):
        raise InvalidOption(f"assets is {assets!r}; 'embedded' or 'files' is expected")
    mesh = _colored(mesh, colors)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not in_parts:
        with replacing(path) as new:
            mesh.export(new, file_type=path.suffix.lower()[1:])
        return path
    _check_parts(parts, path.suffix)
    body = Body(name, mesh, parts, mass_properties(mesh, density=density, shell_thickness_m=shell_thickness_m))
    if path.suffix.lower() == ".urdf":
        write_urdf(body, path)
    else:
        write_mjcf(body, path, up=up, in_files=assets == "files")
    return path


def legal_name(text: str) -> str:
    """A name for export_completion from any text: whatever is no letter of ASCII, digit or _ . - becomes _."""
    name = re.sub(_STRANGE, "_", text) or "object"
    return "world_" if name == "world" else name  # MuJoCo's own body


def needs_parts(path: str | Path) -> bool:
    """Whether the format that the suffix names holds convex parts.

    Raises:
        InvalidOption: Unknown suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidOption(f"{Path(path).name!r} ends in {suffix or 'no suffix'}; legal are {', '.join(SUFFIXES)}")
    return suffix in _IN_PARTS


def _unit(up: ArrayLike) -> np.ndarray:
    direction = np.asarray(up, dtype=np.float64)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InvalidOption(f"up is {up!r}; three finite numbers, not all zero, are expected")
    return direction / np.linalg.norm(direction)


def _colored(mesh: trimesh.Trimesh, colors: np.ndarray | None) -> trimesh.Trimesh:
    if colors is None:
        return mesh
    colors = np.asarray(colors)
    if colors.dtype != np.uint8 or colors.shape not in ((len(mesh.vertices), 3), (len(mesh.vertices), 4)):
        raise InvalidOption(
            f"colors are {colors.dtype} of shape {colors.shape}; uint8 ({len(mesh.vertices)}, 3 or 4) is expected"
        )
    return trimesh.Trimesh(np.array(mesh.vertices), np.array(mesh.faces), vertex_colors=colors, process=False)


def _check_parts(parts: Sequence[Part], suffix: str) -> None:
    if not parts:
        raise InvalidMesh(f"no convex parts came; {suffix} needs them: pass those of decompose or of the completion")
    for number, part in enumerate(parts):
        points = np.asarray(part.vertices)
        if not np.isfinite(points).all() or convex_part(points) is None:
            least = f"{1000 * MIN_THICKNESS_M:g} mm"
            raise InvalidMesh(
                f"part {number} of {len(parts)} is not finite, thinner than {least} or next to nothing, which MuJoCo "
                "does not compile: leave it out"
            )
