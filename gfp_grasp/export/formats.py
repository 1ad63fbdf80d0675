"""MJCF and URDF of completed objects, and the mass, centre and inertia of solids and of shells that both state.

MJCF is one file for MuJoCo's viewer to open, with floor, light, a free joint and explicit inertia. URDF is one link, a
mesh to look at and a mesh for each convex part, in files beside it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.meshes import triangle_normals
from gfp_grasp.transforms import apply_T, quat_wxyz
from gfp_grasp.types import ConvexPart

_DENSITIES = (0.1, 30_000.0)  # kg/m3: from the lightest aerogel to beyond osmium


@dataclass(frozen=True, eq=False)
class MassProperties:
    """How a rigid body moves under forces, in the frame of its mesh.

    Attributes:
        mass_kg: Mass.
        centre: (3,) m, centre of mass.
        inertia: (3, 3) kg m2, about the centre of mass.
    """

    mass_kg: float
    centre: np.ndarray
    inertia: np.ndarray


def mass_properties(
    mesh: trimesh.Trimesh, *, density: float = 1000.0, shell_thickness_m: float | None = None
) -> MassProperties:
    """Mass, centre and inertia of a solid, or of a shell of even thickness.

    Args:
        mesh: Metres; watertight and outward unless it is a shell.
        density: kg/m3, 0.1 to 30 000.
        shell_thickness_m: Thickness of the shell, spread over the whole surface; None for a solid.

    Raises:
        InvalidOption: No material has this density, or the thickness is not a finite positive number.
        InvalidMesh: A solid is asked for and the mesh encloses no volume.
    """
    if not _DENSITIES[0] <= density <= _DENSITIES[1]:
        raise InvalidOption(f"density is {density!r}; kg/m3 are expected, 0.1 to 30000 (water has 1000)")
    if shell_thickness_m is not None:
        if not np.isfinite(shell_thickness_m) or shell_thickness_m <= 0:
            raise InvalidOption(f"shell_thickness_m is {shell_thickness_m!r}; a finite positive number is expected")
        return _shell_properties(np.asarray(mesh.triangles), density * shell_thickness_m)
    if not mesh.is_volume:
        raise InvalidMesh("mesh is not watertight and outward, so that it has no volume: give shell_thickness_m")
    solid = mesh.copy()
    solid.density = density
    found = solid.mass_properties
    return MassProperties(float(found.mass), np.array(found.center_mass), np.array(found.inertia))


def _shell_properties(triangles: np.ndarray, density_kg_m2: float) -> MassProperties:
    """Properties of triangles (f, 3, 3) m with a mass on their surface."""
    # The midpoints of the edges, weighted alike, integrate quadratics over a triangle exactly.
    across = triangle_normals(triangles)
    mass = np.repeat(np.linalg.norm(across, axis=1) / 2 * density_kg_m2 / 3, 3)
    points = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 3)
    centre = mass @ points / mass.sum()
    arms = points - centre
    second = np.einsum("n,ni,nj->ij", mass, arms, arms)
    return MassProperties(float(mass.sum()), centre, np.trace(second) * np.eye(3) - second)


Part = ConvexPart | trimesh.Trimesh


@dataclass(frozen=True, eq=False)
class Body:
    """What is written of one object, in its own frame.

    Attributes:
        name: Name of the body, and the start of its geoms' names.
        mesh: What is looked at.
        parts: Convex parts, what collides.
        weight: Mass, centre and inertia.
        T_world_body: (4, 4) where its frame is.
    """

    name: str
    mesh: trimesh.Trimesh
    parts: Sequence[Part]
    weight: MassProperties
    T_world_body: np.ndarray = field(default_factory=lambda: np.eye(4))

    @property
    def shapes(self) -> tuple[Part, ...]:
        """The mesh, then the parts."""
        return (self.mesh, *self.parts)


@dataclass(frozen=True, eq=False)
class Slab:
    """A box of road.

    Attributes:
        name: Name of its geom.
        T_world_slab: (4, 4) of its middle, z normal to its top.
        half_m: (3,) half of its sides.
    """

    name: str
    T_world_slab: np.ndarray
    half_m: np.ndarray


def write_meshes(bodies: Sequence[Body], path: Path) -> list[list[str]]:
    """Write mesh and parts of each body into the folder `<stem>_meshes` beside a path.

    Returns:
        The names of each body's files relative to the path's folder; in those of several, the body's name comes first.
    """
    folder = path.parent / f"{path.stem}_meshes"
    folder.mkdir(exist_ok=True)
    names = []
    for body in bodies:
        prefix = f"{body.name}_" if len(bodies) > 1 else ""
        stems = [f"{prefix}visual", *(f"{prefix}hull_{i:03d}" for i in range(len(body.parts)))]
        names.append([f"{folder.name}/{stem}.obj" for stem in stems])
        for stem, shape in zip(stems, body.shapes, strict=True):
            solid = trimesh.Trimesh(np.array(shape.vertices), np.array(shape.faces), process=False)
            with replacing(folder / f"{stem}.obj") as new:
                solid.export(new, file_type="obj", include_normals=False, header=None)
    written = {name for body in names for name in body}
    for file in folder.glob("*.obj"):  # an earlier export may have had more of them
        if re.fullmatch(r"(.+_)?(visual|hull_\d{3,})\.obj", file.name) and f"{folder.name}/{file.name}" not in written:
            file.unlink()
    return names


def write_xml(root: ElementTree.Element, path: Path) -> None:
    """Write an indented tree; the file is replaced as a whole."""
    ElementTree.indent(root)
    with replacing(path) as new:
        ElementTree.ElementTree(root).write(new, encoding="utf-8", xml_declaration=True)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to; its file takes the place of the one at `path` once it is complete."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        yield new
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)


def to_text(numbers: object) -> str:
    """Numbers of any shape in a row, to nine digits."""
    return " ".join(f"{number:.9g}" for number in np.asarray(numbers).ravel())


_GROUND_RGBA = "0.8 0.8 0.82 1"
_GRAVITY = 9.81  # MuJoCo's own
# Stiffer than MuJoCo's 20 ms, down to which a default marble sinks through the bottom of a cup, and as stiff as its
# default step of 2 ms allows; the higher priority makes it hold against whatever the other geom has.
CONTACT_SOLREF = (0.004, 1.0)
CONTACT_PRIORITY = 1


def write_mjcf(
    bodies: Sequence[Body],
    path: Path,
    *,
    up: np.ndarray,
    in_files: bool,
    contact: bool,
    floor_m: float | None = None,
    slabs: Sequence[Slab] = (),
) -> None:
    """Write bodies that stand on one floor, or on slabs above it.

    Args:
        bodies: What is written, at least one.
        path: The .xml file; its stem names the model of several bodies.
        up: (3,) unit normal of the floor, against gravity.
        in_files: Meshes go into files beside the path; else they are embedded.
        contact: Parts carry contact parameters of their own.
        floor_m: Height of the floor along up; None lets it touch the lowest of meshes and parts, so that what was
            fitted to noise does not start inside of it.
        slabs: Boxes of ground that do not move.
    """
    root = ElementTree.Element("mujoco", model=bodies[0].name if len(bodies) == 1 else path.stem)
    ElementTree.SubElement(root, "option", gravity=to_text(-_GRAVITY * up))
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    _add_light_and_floor(world, bodies, up, floor_m)
    for slab in slabs:
        T = slab.T_world_slab
        place = {"pos": to_text(T[:3, 3]), "quat": to_text(quat_wxyz(T[:3, :3])), "size": to_text(slab.half_m)}
        ElementTree.SubElement(world, "geom", {"name": slab.name, "type": "box", **place, "rgba": _GROUND_RGBA})
    files = write_meshes(bodies, path) if in_files else [None] * len(bodies)
    for body, names in zip(bodies, files, strict=True):
        sources = [_embedded(shape) for shape in body.shapes] if names is None else [{"file": file} for file in names]
        _add_body(asset, world, body, sources, contact=contact)
    write_xml(root, path)


def _add_body(
    asset: ElementTree.Element,
    world: ElementTree.Element,
    body: Body,
    sources: Sequence[Mapping[str, str]],
    *,
    contact: bool,
) -> None:
    """Add a body with its free joint, inertia, mesh and parts; sources say where the shapes have their vertices."""
    place = {"pos": to_text(body.T_world_body[:3, 3]), "quat": to_text(quat_wxyz(body.T_world_body[:3, :3]))}
    element = ElementTree.SubElement(world, "body", {"name": body.name, **place})
    ElementTree.SubElement(element, "freejoint", name=f"{body.name}_free")
    inertia = body.weight.inertia
    ElementTree.SubElement(
        element,
        "inertial",
        pos=to_text(body.weight.centre),
        mass=to_text([body.weight.mass_kg]),
        fullinertia=to_text([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
    )
    visual = f"{body.name}_visual"
    # inertia="shell": MuJoCo would refuse to look at a mesh that is not closed.
    ElementTree.SubElement(asset, "mesh", {"name": visual, **sources[0], "inertia": "shell"})
    looks = {"contype": "0", "conaffinity": "0", "group": "2", "rgba": "0.55 0.65 0.8 1"}
    ElementTree.SubElement(element, "geom", {"name": visual, "type": "mesh", "mesh": visual, "mass": "0", **looks})
    for index, source in enumerate(sources[1:]):
        hull = f"{body.name}_hull_{index:03d}"
        ElementTree.SubElement(asset, "mesh", {"name": hull, **source})
        geom = {"name": hull, "type": "mesh", "mesh": hull, "group": "3", "mass": "0"}
        if contact:
            geom |= {"solref": to_text(CONTACT_SOLREF), "priority": str(CONTACT_PRIORITY)}
        ElementTree.SubElement(element, "geom", geom)


def _add_light_and_floor(
    world: ElementTree.Element, bodies: Sequence[Body], up: np.ndarray, floor_m: float | None
) -> None:
    shapes = [apply_T(body.T_world_body, shape.vertices) for body in bodies for shape in body.shapes]
    corners = np.array([[points.min(axis=0), points.max(axis=0)] for points in shapes]).reshape(-1, 3)
    middle, size = (corners.min(axis=0) + corners.max(axis=0)) / 2, float(np.ptp(corners, axis=0).max())
    above = middle + (5 * size + 1) * up
    ElementTree.SubElement(world, "light", pos=to_text(above), dir=to_text(-up), type="directional")
    height_m = min(float((points @ up).min()) for points in shapes) if floor_m is None else floor_m
    ElementTree.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 0.05",
        pos=to_text(height_m * up),
        zaxis=to_text(up),
        rgba=_GROUND_RGBA,
    )


def _embedded(shape: Part) -> dict[str, str]:
    return {"vertex": to_text(shape.vertices), "face": to_text(shape.faces)}


def write_urdf(bodies: Sequence[Body], path: Path, *, in_world: bool = False) -> None:
    """Write a robot with a link for each object. URDF knows neither gravity nor embedded meshes.

    Args:
        bodies: What is written, at least one; only one where they are not in the world.
        path: The .urdf file; its stem names the robot of several objects.
        in_world: There is a link "world", and each object has its place on a floating joint of it.
    """
    root = ElementTree.Element("robot", name=bodies[0].name if len(bodies) == 1 else path.stem)
    # MuJoCo's reader else looks for the files without their folder and drops the visual; other readers ignore this.
    extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(extension, "compiler", strippath="false", discardvisual="false")
    if in_world:
        ElementTree.SubElement(root, "link", name="world")
    for body, files in zip(bodies, write_meshes(bodies, path), strict=True):
        _add_link(root, body, files)
        if in_world:
            joint = ElementTree.SubElement(root, "joint", name=f"{body.name}_free", type="floating")
            ElementTree.SubElement(joint, "parent", link="world")
            ElementTree.SubElement(joint, "child", link=body.name)
            rpy = Rotation.from_matrix(body.T_world_body[:3, :3]).as_euler("xyz")
            ElementTree.SubElement(joint, "origin", xyz=to_text(body.T_world_body[:3, 3]), rpy=to_text(rpy))
    write_xml(root, path)


def _add_link(root: ElementTree.Element, body: Body, files: Sequence[str]) -> None:
    link = ElementTree.SubElement(root, "link", name=body.name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=to_text(body.weight.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=to_text([body.weight.mass_kg]))
    inertia = body.weight.inertia
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": to_text([inertia[i, j]]) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)
    for index, file in enumerate(files):
        element = ElementTree.SubElement(link, "collision" if index else "visual", name=Path(file).stem)
        ElementTree.SubElement(element, "origin", xyz="0 0 0", rpy="0 0 0")
        geometry = ElementTree.SubElement(element, "geometry")
        ElementTree.SubElement(geometry, "mesh", filename=file)
