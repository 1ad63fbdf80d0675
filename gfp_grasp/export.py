"""Completed objects as files: meshes, MJCF in one file, URDF with a mesh a hull."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.collision import MIN_THICKNESS_M, convex_part
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.types import ConvexPart

_GRAVITY = 9.81  # MuJoCo's own
_MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb")
_DENSITIES = (0.1, 30_000.0)  # kg/m3: from the lightest aerogel to beyond osmium
_STRANGE = r"[^A-Za-z0-9_.-]+"
SUFFIXES = (*_MESH_SUFFIXES, ".xml", ".urdf")

Part = ConvexPart | trimesh.Trimesh
_Writer = Callable[[trimesh.Trimesh, Sequence[Part], Path, str, "MassProperties", np.ndarray, bool], None]


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass in kg, centre of mass (3,) m, and inertia (3, 3) kg m2 about that centre, all in the mesh's frame."""

    mass_kg: float
    centre: np.ndarray
    inertia: np.ndarray


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
    `.urdf` names mesh files in the folder `<stem>_meshes` beside it: visual.obj and hull_000.obj onward, by paths that
    hold wherever the two are moved together. The same object gives the same names and bytes. Each file is replaced as a
    whole, so that who has the old one open goes on reading the old one.

    Args:
        mesh: Metres; watertight unless shell_thickness_m is given or only the mesh is written.
        parts: Its convex parts in the same frame; only .xml and .urdf need them.
        path: Where to; folders are made, files replaced.
        name: Of the object, from letters, digits and _ . - only, and not "world"; legal_name makes one of any text.
        density: kg/m3 of the material, 0.1 to 30 000.
        shell_thickness_m: Take the mass from the surface times this thickness instead of the volume. Cups whose mesh
            has an inside need none; closed bottles that are hollow do.
        colors: (v, 3) or (v, 4) uint8 of the vertices, kept by .ply, .glb and .obj.
        up: (3,) normal of the floor and the way that gravity does not pull, in the mesh's frame; for .xml.
        assets: Where .xml has its meshes: in itself, or in files beside it as .urdf always does.

    Returns:
        The path.

    Raises:
        InvalidOption: Unknown suffix, illegal name, density, thickness, colors, up or assets.
        InvalidMesh: No parts where they are needed, one that MuJoCo would not take, or mass from a volume that is none.
    """
    path = Path(path)
    writer = _writer(path)
    direction = _direction(up)
    if not name or name != legal_name(name):
        raise InvalidOption(f"name is {name!r}; letters, digits and _ . - are legal, world is not: use legal_name")
    if assets not in ("embedded", "files"):
        raise InvalidOption(f"assets is {assets!r}; 'embedded' or 'files' is expected")
    mesh = _colored(mesh, colors)
    path.parent.mkdir(parents=True, exist_ok=True)
    if writer is None:
        with _replacing(path) as new:
            mesh.export(new, file_type=path.suffix.lower()[1:])
        return path
    if not parts:
        raise InvalidMesh(
            f"no convex parts came; {path.suffix} needs them: pass those of decompose or of the completion"
        )
    _check_parts(parts)
    weight = mass_properties(mesh, density=density, shell_thickness_m=shell_thickness_m)
    writer(mesh, parts, path, name, weight, direction, assets == "files")
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
    return _writer(Path(path)) is not None


def mass_properties(
    mesh: trimesh.Trimesh, *, density: float = 1000.0, shell_thickness_m: float | None = None
) -> MassProperties:
    """Mass, centre and inertia of a solid, or of a shell of even thickness.

    Args:
        mesh: Metres; watertight and outward unless it is a shell.
        density: kg/m3, 0.1 to 30 000.
        shell_thickness_m: Thickness of the shell, spread over the whole surface; None for a solid.

    Raises:
        InvalidOption: density is that of no material, or the thickness not a finite positive number.
        InvalidMesh: A solid is asked for and the mesh encloses no volume.
    """
    if not _DENSITIES[0] <= density <= _DENSITIES[1]:
        raise InvalidOption(f"density is {density!r}; kg/m3 are expected, 0.1 to 30000 (water has 1000)")
    if shell_thickness_m is not None:
        if not np.isfinite(shell_thickness_m) or shell_thickness_m <= 0:
            raise InvalidOption(f"shell_thickness_m is {shell_thickness_m!r}; a finite positive number is expected")
        return _of_shell(np.asarray(mesh.triangles), density * shell_thickness_m)
    if not mesh.is_volume:
        raise InvalidMesh("mesh is not watertight and outward, so that it has no volume: give shell_thickness_m")
    solid = mesh.copy()
    solid.density = density
    found = solid.mass_properties
    return MassProperties(float(found.mass), np.array(found.center_mass), np.array(found.inertia))


def _writer(path: Path) -> _Writer | None:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidOption(f"{path.name!r} ends in {suffix or 'no suffix'}; legal are {', '.join(SUFFIXES)}")
    return {".xml": _write_mjcf, ".urdf": _write_urdf}.get(suffix)


def _direction(up: ArrayLike) -> np.ndarray:
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
    for number, part in enumerate(parts):
        points = np.asarray(part.vertices)
        if not np.isfinite(points).all() or convex_part(points) is None:
            least = f"{1000 * MIN_THICKNESS_M:g} mm"
            raise InvalidMesh(
                f"part {number} of {len(parts)} is not finite, thinner than {least} or next to nothing, which MuJoCo "
                "does not compile: leave it out"
            )


def _of_shell(triangles: np.ndarray, density_kg_m2: float) -> MassProperties:
    # The midpoints of the edges, weighted alike, integrate quadratics over a triangle exactly.
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    mass = np.repeat(np.linalg.norm(across, axis=1) / 2 * density_kg_m2 / 3, 3)
    points = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 3)
    centre = mass @ points / mass.sum()
    arms = points - centre
    second = np.einsum("n,ni,nj->ij", mass, arms, arms)
    return MassProperties(float(mass.sum()), centre, np.trace(second) * np.eye(3) - second)


def _write_mjcf(
    mesh: trimesh.Trimesh,
    parts: Sequence[Part],
    path: Path,
    name: str,
    weight: MassProperties,
    up: np.ndarray,
    in_files: bool,
) -> None:
    root = ElementTree.Element("mujoco", model=name)
    ElementTree.SubElement(root, "option", gravity=_text(-_GRAVITY * up))
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    lowest = min(float((shape.vertices @ up).min()) for shape in (mesh, *parts))
    middle = mesh.bounds.mean(axis=0)
    size = float(np.ptp(mesh.bounds, axis=0).max())
    ElementTree.SubElement(world, "light", pos=_text(middle + (5 * size + 1) * up), dir=_text(-up), type="directional")
    # An infinite plane, just below: what was fitted to noise must not start inside of it.
    ElementTree.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 0.05",
        pos=_text(lowest * up),
        zaxis=_text(up),
        rgba="0.8 0.8 0.82 1",
    )
    body = ElementTree.SubElement(world, "body", name=name)
    ElementTree.SubElement(body, "freejoint", name=f"{name}_free")
    inertia = weight.inertia
    ElementTree.SubElement(
        body,
        "inertial",
        pos=_text(weight.centre),
        mass=_text([weight.mass_kg]),
        fullinertia=_text([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
    )
    # inertia="shell": MuJoCo would refuse to look at a mesh that is not closed.
    visual = f"{name}_visual"
    files = _write_meshes(mesh, parts, path) if in_files else None
    sources = [_embedded(shape) for shape in (mesh, *parts)] if files is None else [{"file": file} for file in files]
    ElementTree.SubElement(asset, "mesh", {"name": visual, **sources[0], "inertia": "shell"})
    looks = {"contype": "0", "conaffinity": "0", "group": "2", "rgba": "0.55 0.65 0.8 1"}
    ElementTree.SubElement(body, "geom", {"name": visual, "type": "mesh", "mesh": visual, "mass": "0", **looks})
    for index, source in enumerate(sources[1:]):
        hull = f"{name}_hull_{index:03d}"
        ElementTree.SubElement(asset, "mesh", {"name": hull, **source})
        ElementTree.SubElement(body, "geom", name=hull, type="mesh", mesh=hull, group="3", mass="0")
    _write_xml(root, path)


def _embedded(shape: Part) -> dict[str, str]:
    return {"vertex": _text(shape.vertices), "face": _text(shape.faces)}


def _write_meshes(mesh: trimesh.Trimesh, parts: Sequence[Part], path: Path) -> list[str]:
    """Files of the mesh and each part in a folder beside a path; their names, relative to it."""
    folder = path.parent / f"{path.stem}_meshes"
    folder.mkdir(exist_ok=True)
    names = []
    for stem, shape in (("visual", mesh), *((f"hull_{i:03d}", part) for i, part in enumerate(parts))):
        solid = trimesh.Trimesh(np.array(shape.vertices), np.array(shape.faces), process=False)
        with _replacing(folder / f"{stem}.obj") as new:
            solid.export(new, file_type="obj", include_normals=False, header=None)
        names.append(f"{folder.name}/{stem}.obj")
    for hull in folder.glob("hull_*.obj"):  # an earlier export may have had more of them
        if re.fullmatch(r"hull_\d{3,}\.obj", hull.name) and f"{folder.name}/{hull.name}" not in names:
            hull.unlink()
    return names


def _write_urdf(
    mesh: trimesh.Trimesh,
    parts: Sequence[Part],
    path: Path,
    name: str,
    weight: MassProperties,
    up: np.ndarray,
    in_files: bool,
) -> None:
    del up, in_files  # URDF has no gravity, and meshes in files only
    names = _write_meshes(mesh, parts, path)
    root = ElementTree.Element("robot", name=name)
    # For MuJoCo's reader, which else looks for the files without their folder and drops the visual; others ignore it.
    extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(extension, "compiler", strippath="false", discardvisual="false")
    link = ElementTree.SubElement(root, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=_text(weight.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=_text([weight.mass_kg]))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": _text([weight.inertia[i, j]]) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)
    for file in names:
        stem = Path(file).stem
        element = ElementTree.SubElement(link, "visual" if stem == "visual" else "collision", name=stem)
        ElementTree.SubElement(element, "origin", xyz="0 0 0", rpy="0 0 0")
        geometry = ElementTree.SubElement(element, "geometry")
        ElementTree.SubElement(geometry, "mesh", filename=file)
    _write_xml(root, path)


def _write_xml(root: ElementTree.Element, path: Path) -> None:
    ElementTree.indent(root)
    with _replacing(path) as new:
        ElementTree.ElementTree(root).write(new, encoding="utf-8", xml_declaration=True)


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    """A path to write to, whose file takes the place of another one once it is complete."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield new
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def _text(numbers: object) -> str:
    return " ".join(f"{number:.9g}" for number in np.asarray(numbers).ravel())
