"""Deformation of a fitted primitive onto its observation: GFPNet, the paper's own, and active contours (GFS)."""

from gfp_grasp.deform.gfs import SnakeConfig, evolve
from gfp_grasp.deform.shape import DeformConfig, Deformed, Method, deform
from gfp_grasp.deform.template import TemplatePoints, template_points

__all__ = ["DeformConfig", "Deformed", "Method", "SnakeConfig", "TemplatePoints", "deform", "evolve", "template_points"]
