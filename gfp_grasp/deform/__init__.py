"""Deformation of a fitted primitive onto its observation: GFPNet, the paper's own, and active contours (GFS)."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.deform.gfs import SnakeConfig, evolve
from gfp_grasp.deform.patches import MISFIT_SHARE, NUM_TEMPLATE, Patches, make_patches
from gfp_grasp.deform.shape import DeformConfig, Deformed, Method, deform, diffuse
from gfp_grasp.deform.standing import stand_on, stood
from gfp_grasp.deform.template import (
    NUM_PATCHES,
    NUM_SOURCE,
    TemplatePoints,
    patch_layout,
    patch_unit_m,
    template_points,
)

if TYPE_CHECKING:
    from gfp_grasp.deform.gfpnet import (
        BELIEF,
        Levers,
        PaperNet,
        PatchAnswer,
        PatchNet,
        Variant,
        fit_features,
        make_levers,
        make_network,
        solve_change,
    )
    from gfp_grasp.deform.weights import WEIGHTS, read_network

__all__ = [
    "BELIEF",
    "MISFIT_SHARE",
    "NUM_PATCHES",
    "NUM_SOURCE",
    "NUM_TEMPLATE",
    "WEIGHTS",
    "DeformConfig",
    "Deformed",
    "Levers",
    "Method",
    "PaperNet",
    "PatchAnswer",
    "PatchNet",
    "Patches",
    "SnakeConfig",
    "TemplatePoints",
    "Variant",
    "deform",
    "diffuse",
    "evolve",
    "fit_features",
    "make_levers",
    "make_network",
    "make_patches",
    "patch_layout",
    "patch_unit_m",
    "read_network",
    "solve_change",
    "stand_on",
    "stood",
    "template_points",
]

# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    **dict.fromkeys(
        (
            "BELIEF",
            "Levers",
            "PaperNet",
            "PatchAnswer",
            "PatchNet",
            "Variant",
            "fit_features",
            "make_levers",
            "make_network",
            "solve_change",
        ),
        "gfpnet",
    ),
    **dict.fromkeys(("WEIGHTS", "read_network"), "weights"),
}


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.deform.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
