"""Registration of a primitive onto one view: starts, then pose, scale and modes by robust least squares."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.register.config import STARTS, FitConfig, RefineConfig, icp_config, pcrnet_config, size_of_extents
from gfp_grasp.register.fit import fit_best, fit_primitive, part_is_seen
from gfp_grasp.register.occlusion import is_cut_off
from gfp_grasp.register.starts import make_starts
from gfp_grasp.register.state import PoseShape

if TYPE_CHECKING:
    from gfp_grasp.register.pcrnet import PCRNet, mlp, network_input, pcrnet_weights, rotation_of

__all__ = [
    "STARTS",
    "FitConfig",
    "PCRNet",
    "PoseShape",
    "RefineConfig",
    "fit_best",
    "fit_primitive",
    "icp_config",
    "is_cut_off",
    "make_starts",
    "mlp",
    "network_input",
    "part_is_seen",
    "pcrnet_config",
    "pcrnet_weights",
    "rotation_of",
    "size_of_extents",
]


def __getattr__(name: str) -> object:
    if name in ("PCRNet", "mlp", "network_input", "pcrnet_weights", "rotation_of"):  # these bring torch
        return getattr(import_module("gfp_grasp.register.pcrnet"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
