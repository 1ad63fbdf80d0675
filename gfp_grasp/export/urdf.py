"""URDF: one link, a mesh to look at and a mesh for each convex part, in files beside it."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from gfp_grasp.export.files import Body, to_text, write_meshes, write_xml


def write_urdf(body: Body, path: Path) -> None:
    """Write a robot of one link. URDF knows neither gravity nor embedded meshes."""
    names = write_meshes(body, path)
    root = ElementTree.Element("robot", name=body.name)
    # MuJoCo's reader else looks for the files without their folder and drops the visual; other readers ignore this.
    extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(extension, "compiler", strippath="false", discardvisual="false")
    link = ElementTree.SubElement(root, "link", name=body.name)
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=to_text(body.weight.centre), rpy="0 0 0")
    ElementTree.SubElement(inertial, "mass", value=to_text([body.weight.mass_kg]))
    inertia = body.weight.inertia
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": to_text([inertia[i, j]]) for i in range(3) for j in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)
    for file in names:
        stem = Path(file).stem
        element = ElementTree.SubElement(link, "visual" if stem == "visual" else "collision", name=stem)
        ElementTree.SubElement(element, "origin", xyz="0 0 0", rpy="0 0 0")
        geometry = ElementTree.SubElement(element, "geometry")
        ElementTree.SubElement(geometry, "mesh", filename=file)
    write_xml(root, path)
