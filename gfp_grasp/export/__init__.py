"""Completed objects as files: meshes, MJCF in one file, URDF with a mesh for each part."""

from gfp_grasp.export.formats import MassProperties, mass_properties
from gfp_grasp.export.write import SUFFIXES, export_completion, legal_name, needs_parts

__all__ = ["SUFFIXES", "MassProperties", "export_completion", "legal_name", "mass_properties", "needs_parts"]
