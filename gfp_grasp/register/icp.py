"""Registrations that know neither scale nor shape, as baselines: ICP and the paper's PCRNet."""

from __future__ import annotations

from dataclasses import replace

from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.state import ModesConfig

_RIGID = ModesConfig(estimate_scale=False, estimate_modes=False, free_space=False)


def icp_config(*, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FitConfig:
    """Rigid point-to-plane ICP of the mean primitive, from the starts of the default fit.

    Args:
        size: (3,) scale of the primitive along its axes; ones are its own size.
    """
    config = FitConfig(roundness=False, size=size, keep=1)
    return replace(
        config,
        quick=replace(_RIGID, steps=config.quick.steps),
        middle=replace(_RIGID, steps=config.middle.steps),
        thorough=replace(_RIGID, steps=config.thorough.steps),
    )


def pcrnet_config(*, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FitConfig:
    """PCRNet's five iterations on the mean primitive and nothing after them (GFPNet sec. III-A).

    Args:
        size: (3,) scale of the primitive along its axes; ones are its own size.
    """
    return FitConfig(start="pcrnet", roundness=False, size=size, refine=False, thorough=_RIGID)
