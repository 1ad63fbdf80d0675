"""What MJCF and URDF share: the body that is written, its mesh files, and files that are replaced as a whole."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh

from gfp_grasp.export.mass import MassProperties
from gfp_grasp.types import ConvexPart

Part = ConvexPart | trimesh.Trimesh


@dataclass(frozen=True, eq=False)
class Body:
    """What is written of one object.

    Attributes:
        name: Name of the body, and the start of its geoms' names.
        mesh: What is looked at.
        parts: Convex parts, what collides.
        weight: Mass, centre and inertia.
    """

    name: str
    mesh: trimesh.Trimesh
    parts: Sequence[Part]
    weight: MassProperties

    @property
    def shapes(self) -> tuple[Part, ...]:
        """The mesh, then the parts."""
        return (self.mesh, *self.parts)


def write_meshes(body: Body, path: Path) -> list[str]:
    """Write the mesh and each part into the folder `<stem>_meshes` beside a path; return their names relative to it."""
    folder = path.parent / f"{path.stem}_meshes"
    folder.mkdir(exist_ok=True)
    names = []
    stems = ["visual", *(f"hull_{i:03d}" for i in range(len(body.parts)))]
    for stem, shape in zip(stems, body.shapes, strict=True):
        solid = trimesh.Trimesh(np.array(shape.vertices), np.array(shape.faces), process=False)
        with replacing(folder / f"{stem}.obj") as new:
            solid.export(new, file_type="obj", include_normals=False, header=None)
        names.append(f"{folder.name}/{stem}.obj")
    for hull in folder.glob("hull_*.obj"):  # an earlier export may have had more of them
        if re.fullmatch(r"hull_\d{3,}\.obj", hull.name) and f"{folder.name}/{hull.name}" not in names:
            hull.unlink()
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
