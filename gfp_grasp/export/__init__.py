"""Completed objects and scenes as files: meshes, MJCF in one file, URDF with a mesh for each part."""

from gfp_grasp.export.formats import CONTACT_PRIORITY, CONTACT_SOLREF, Body, MassProperties, Slab, mass_properties
from gfp_grasp.export.roads import roads_under
from gfp_grasp.export.write import (
    SUFFIXES,
    export_bodies,
    export_completion,
    foot_pose,
    legal_name,
    make_body,
    needs_parts,
)

__all__ = [
    "CONTACT_PRIORITY",
    "CONTACT_SOLREF",
    "SUFFIXES",
    "Body",
    "MassProperties",
    "Slab",
    "export_bodies",
    "export_completion",
    "foot_pose",
    "legal_name",
    "make_body",
    "mass_properties",
    "needs_parts",
    "roads_under",
]
