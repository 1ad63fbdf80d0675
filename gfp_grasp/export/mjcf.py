"""MJCF: one file for MuJoCo's viewer to open, with floor, light, a free joint and explicit inertia."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gfp_grasp.export.files import Body, Part, to_text, write_meshes, write_xml

_GRAVITY = 9.81  # MuJoCo's own


def write_mjcf(body: Body, path: Path, *, up: np.ndarray, in_files: bool) -> None:
    """Write a body that stands on a floor.

    Args:
        body: What is written.
        path: The .xml file.
        up: (3,) unit normal of the floor, against gravity.
        in_files: Meshes go into files beside the path; else they are embedded.
    """
    root = ElementTree.Element("mujoco", model=body.name)
    ElementTree.SubElement(root, "option", gravity=to_text(-_GRAVITY * up))
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    _add_light_and_floor(world, body, up)
    element = ElementTree.SubElement(world, "body", name=body.name)
    ElementTree.SubElement(element, "freejoint", name=f"{body.name}_free")
    inertia = body.weight.inertia
    ElementTree.SubElement(
        element,
        "inertial",
        pos=to_text(body.weight.centre),
        mass=to_text([body.weight.mass_kg]),
        fullinertia=to_text([inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]),
    )
    if in_files:
        sources = [{"file": file} for file in write_meshes(body, path)]
    else:
        sources = [_embedded(shape) for shape in body.shapes]
    _add_geoms(asset, element, body.name, sources)
    write_xml(root, path)


def _add_light_and_floor(world: ElementTree.Element, body: Body, up: np.ndarray) -> None:
    middle = body.mesh.bounds.mean(axis=0)
    size = float(np.ptp(body.mesh.bounds, axis=0).max())
    above = middle + (5 * size + 1) * up
    ElementTree.SubElement(world, "light", pos=to_text(above), dir=to_text(-up), type="directional")
    # The floor touches the lowest of mesh and parts: what was fitted to noise must not start inside of it.
    lowest = min(float((shape.vertices @ up).min()) for shape in body.shapes)
    ElementTree.SubElement(
        world,
        "geom",
        name="floor",
        type="plane",
        size="0 0 0.05",
        pos=to_text(lowest * up),
        zaxis=to_text(up),
        rgba="0.8 0.8 0.82 1",
    )


def _add_geoms(
    asset: ElementTree.Element, element: ElementTree.Element, name: str, sources: list[dict[str, str]]
) -> None:
    """The mesh, which is seen and collides with nothing, and the parts, which collide and are not seen."""
    visual = f"{name}_visual"
    # inertia="shell": MuJoCo would refuse to look at a mesh that is not closed.
    ElementTree.SubElement(asset, "mesh", {"name": visual, **sources[0], "inertia": "shell"})
    looks = {"contype": "0", "conaffinity": "0", "group": "2", "rgba": "0.55 0.65 0.8 1"}
    ElementTree.SubElement(element, "geom", {"name": visual, "type": "mesh", "mesh": visual, "mass": "0", **looks})
    for index, source in enumerate(sources[1:]):
        hull = f"{name}_hull_{index:03d}"
        ElementTree.SubElement(asset, "mesh", {"name": hull, **source})
        ElementTree.SubElement(element, "geom", name=hull, type="mesh", mesh=hull, group="3", mass="0")


def _embedded(shape: Part) -> dict[str, str]:
    return {"vertex": to_text(shape.vertices), "face": to_text(shape.faces)}
