"""Rigid point-to-plane ICP of the mean primitive: the baseline that knows neither scale nor shape."""

from __future__ import annotations

from dataclasses import replace

from gfp_grasp.register.evidence import gather_evidence
from gfp_grasp.register.fit import FitConfig, fit_evidence
from gfp_grasp.register.modes import ModesConfig
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive

_RIGID = ModesConfig(estimate_scale=False, estimate_modes=False, free_space=False)


def icp_primitive(
    detection: Detection, primitive: GenericPrimitive, *, config: FitConfig = FitConfig(start="box", keep=1)
) -> FittedPrimitive:
    """Register the mean primitive at its mean size, with the starts of `fit_primitive`.

    Args:
        detection: One object.
        primitive: Template.
        config: Starts; the refinements are made rigid.

    Raises:
        TooFewPoints: Too few points.
        FitDiverged: Nothing came near the points.
    """
    rigid = replace(
        config,
        quick=replace(_RIGID, steps=config.quick.steps),
        thorough=replace(_RIGID, steps=config.thorough.steps),
        mean_size=True,
    )
    return fit_evidence(gather_evidence(detection), primitive, config=rigid)
