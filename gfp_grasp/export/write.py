"""Completed objects as files, by suffix."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.collision import MIN_THICKNESS_M, convex_part
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export.formats import Body, Part, Slab, mass_properties, replacing, write_mjcf, write_urdf
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_between

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
    contact: bool = True,
) -> Path:
    """Write an object in the form that the suffix names.

    `.obj`, `.ply`, `.stl` and `.glb` hold the mesh. `.xml` is MJCF in one file: the mesh to look at, every convex part
    as a mesh of its own to collide with, explicit inertia, a free joint, floor and light, for MuJoCo's viewer to open.
    Its body stands in the middle of the object's foot with z along up, so that its position is the object's. `.urdf`
    names mesh files in the folder `<stem>_meshes` beside it, visual.obj and hull_000.obj onward, by relative paths: the
    two can be moved together; its link has the frame of the mesh. The same object gives the same names and bytes. Each
    file is replaced as a whole: a program that has the old one open goes on reading the old one.

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
        contact: Parts in .xml carry contact parameters with which things stand still and marbles stay in cups at
            MuJoCo's default options; False leaves all parameters to the scene.

    Returns:
        The path that was written.

    Raises:
        InvalidOption: Unknown suffix, illegal name, density, thickness, colors, up or assets.
        InvalidMesh: No parts where they are needed, one that MuJoCo would not take, or mass from a volume that is none.
    """
    path = Path(path)
    in_parts, up = needs_parts(path), _unit(up)
    _check_name(name)
    _check_assets(assets)
    mesh = _colored(mesh, colors)
    path.parent.mkdir(parents=True, exist_ok=True)
    if not in_parts:
        with replacing(path) as new:
            mesh.export(new, file_type=path.suffix.lower()[1:])
        return path
    in_urdf = path.suffix.lower() == ".urdf"
    body = make_body(
        mesh,
        parts,
        name=name,
        density=density,
        shell_thickness_m=shell_thickness_m,
        T_world_body=None if in_urdf else foot_pose(mesh, parts, up),
    )
    if in_urdf:
        write_urdf([body], path)
    else:
        write_mjcf([body], path, up=up, in_files=assets == "files", contact=contact)
    return path


def export_bodies(
    bodies: Sequence[Body],
    path: str | Path,
    *,
    up: ArrayLike = (0.0, 0.0, 1.0),
    floor_m: float | None = None,
    slabs: Sequence[Slab] = (),
    assets: Literal["embedded", "files"] = "embedded",
    contact: bool = True,
) -> Path:
    """Write several objects into one file: a scene.

    `.xml` is MJCF with one floor and a free body for each object. `.urdf` has a link for each, on a floating joint of a
    link "world", turned so that z is up, as its readers take for granted. `.glb` has a node for each; `.obj`, `.ply`
    and `.stl` hold all meshes as one.

    Args:
        bodies: At least one; no two of the same name.
        path: The file; folders are made, files replaced.
        up: (3,) normal of the floor, for .xml and .urdf.
        floor_m: Height of the floor along up, for .xml; None takes that of the lowest point.
        slabs: Further ground above the floor, for .xml.
        assets: As in `export_completion`.
        contact: As in `export_completion`.

    Raises:
        InvalidOption: Unknown suffix, two bodies of one name, no body, illegal up or assets.
    """
    path = Path(path)
    in_parts, up = needs_parts(path), _unit(up)
    _check_assets(assets)
    names = [body.name for body in bodies]
    if not names or len(set(names)) < len(names):
        raise InvalidOption(f"the bodies are {names}; at least one is expected, and each with a name of its own")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix.lower() == ".urdf":
        turned = [_turned(body, rotation_between(up, (0.0, 0.0, 1.0))) for body in bodies]
        write_urdf(turned, path, in_world=True)
    elif in_parts:
        write_mjcf(bodies, path, up=up, floor_m=floor_m, slabs=slabs, in_files=assets == "files", contact=contact)
    else:
        shown = trimesh.Scene()
        for body in bodies:
            shown.add_geometry(body.mesh, node_name=body.name, geom_name=body.name, transform=body.T_world_body)
        together = shown if path.suffix.lower() == ".glb" else shown.to_mesh()
        with replacing(path) as new:
            together.export(new, file_type=path.suffix.lower()[1:])
    return path


def make_body(
    mesh: trimesh.Trimesh,
    parts: Sequence[Part],
    *,
    name: str,
    density: float = 1000.0,
    shell_thickness_m: float | None = None,
    T_world_body: np.ndarray | None = None,
) -> Body:
    """What is written of an object, in a frame of its own.

    Args:
        mesh: World frame, m; watertight unless shell_thickness_m is given.
        parts: Its convex parts, world frame; at least one.
        name: Name of the body, as in `export_completion`.
        density: As there.
        shell_thickness_m: As there.
        T_world_body: (4, 4) the frame; None takes the world's.

    Raises:
        InvalidOption: Illegal name, density or thickness.
        InvalidMesh: No parts, one that MuJoCo would not take, or mass from a volume that is none.
    """
    _check_name(name)
    _check_parts(parts)
    T = np.eye(4) if T_world_body is None else T_world_body
    T_body_world = invert_T(T)
    own = _moved(mesh, T_body_world)
    weight = mass_properties(own, density=density, shell_thickness_m=shell_thickness_m)
    return Body(name, own, [_moved(part, T_body_world) for part in parts], weight, T)


def foot_pose(mesh: trimesh.Trimesh, parts: Sequence[Part], up: np.ndarray) -> np.ndarray:
    """(4, 4) pose of the frame of an object that stands: in the middle of its outline, at its lowest point, z up."""
    R = rotation_between((0.0, 0.0, 1.0), up)
    level = np.vstack([shape.vertices for shape in (mesh, *parts)]) @ R
    low, high = level.min(axis=0), level.max(axis=0)
    return make_T(R, R @ np.append((low[:2] + high[:2]) / 2, low[2]))


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


def _check_name(name: str) -> None:
    if not name or name != legal_name(name):
        raise InvalidOption(f"name is {name!r}; letters, digits and _ . - are legal, world is not: use legal_name")


def _check_assets(assets: str) -> None:
    if assets not in ("embedded", "files"):
        raise InvalidOption(f"assets is {assets!r}; 'embedded' or 'files' is expected")


def _moved(shape: Part, T: np.ndarray) -> trimesh.Trimesh:
    if isinstance(shape, trimesh.Trimesh):
        return shape.copy().apply_transform(T)
    return trimesh.Trimesh(apply_T(T, shape.vertices), np.array(shape.faces), process=False)


def _turned(body: Body, R: np.ndarray) -> Body:
    return replace(body, T_world_body=make_T(R, np.zeros(3)) @ body.T_world_body)


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


def _check_parts(parts: Sequence[Part]) -> None:
    if not parts:
        raise InvalidMesh("no convex parts came, which .xml and .urdf need: pass those of decompose or the completion")
    for number, part in enumerate(parts):
        points = np.asarray(part.vertices)
        if not np.isfinite(points).all() or convex_part(points) is None:
            least = f"{1000 * MIN_THICKNESS_M:g} mm"
            raise InvalidMesh(
                f"part {number} of {len(parts)} is not finite, thinner than {least} or next to nothing, which MuJoCo "
                "does not compile: leave it out"
            )
