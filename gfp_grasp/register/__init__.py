"""Registration of a primitive onto one view: starts, then pose, scale and modes by robust least squares."""

from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.evaluate import part_is_seen
from gfp_grasp.register.evidence import Evidence, gather_evidence
from gfp_grasp.register.fit import fit_best, fit_evidence, fit_primitive
from gfp_grasp.register.icp import icp_config, pcrnet_config
from gfp_grasp.register.state import ModesConfig

__all__ = [
    "Evidence",
    "FitConfig",
    "ModesConfig",
    "fit_best",
    "fit_evidence",
    "fit_primitive",
    "gather_evidence",
    "icp_config",
    "part_is_seen",
    "pcrnet_config",
]
