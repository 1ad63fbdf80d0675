"""Deformation of a fitted primitive onto its observation: GFPNet, the paper's own, and active contours (GFS)."""

from gfp_grasp.deform.gfs import SnakeConfig, evolve
from gfp_grasp.deform.layout import NUM_PATCHES, NUM_SOURCE, patch_layout, patch_unit_m
from gfp_grasp.deform.patches import MISFIT_SHARE, NUM_TEMPLATE, Patches, make_patches
from gfp_grasp.deform.shape import DeformConfig, Deformed, Method, deform
from gfp_grasp.deform.template import TemplatePoints, template_points

__all__ = [
    "MISFIT_SHARE",
    "NUM_PATCHES",
    "NUM_SOURCE",
    "NUM_TEMPLATE",
    "DeformConfig",
    "Deformed",
    "Method",
    "Patches",
    "SnakeConfig",
    "TemplatePoints",
    "deform",
    "evolve",
    "make_patches",
    "patch_layout",
    "patch_unit_m",
    "template_points",
]
