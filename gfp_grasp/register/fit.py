"""The likeliest of some primitives onto one detection: starts, PCRNet, refinement, choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.evidence import Evidence, gather_evidence
from gfp_grasp.register.modes import free_space_cost, refine
from gfp_grasp.register.occlusion import cut_off
from gfp_grasp.register.ovality import round_share
from gfp_grasp.register.race import Race, best_of, blocking_cost, total_cost
from gfp_grasp.register.state import PoseShape
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive

# Cost of free space from which on a cloud without its view is taken to be cut off by something nearer. It is at most
# 3.0 on 204 views of the validation split and of scans where all is seen, at most 6.7 on 48 with 3 mm of noise, and
# above 8 on 45 of 48 where half is hidden (mostly above 20).
_OCCLUSION = 8.0
_ROUND_M = 0.0003  # ovality of what is round, as made and as its modes show it
_OCCAM = 3.0  # how much less a round body has to explain, negative log odds; ours


def fit_primitive(
    detection: Detection, primitive: GenericPrimitive, *, config: FitConfig = FitConfig()
) -> FittedPrimitive:
    """Fit pose, scale and shape modes of one primitive to a partial cloud.

    Args:
        detection: One object, world frame.
        primitive: Template in its own frame, z up.
        config: Starts and weights.

    Returns:
        The fit with the smallest cost over all starts and hypotheses; `margin` is the cost of the best start of
        another hypothesis over it.

    Raises:
        TooFewPoints: Too few points to fit anything.
        FitDiverged: No start reached config.max_residual_m.
    """
    evidence = gather_evidence(detection)
    return fit_evidence(evidence, primitive, config=config)


def fit_evidence(
    evidence: Evidence, primitive: GenericPrimitive, *, config: FitConfig = FitConfig()
) -> FittedPrimitive:
    """As `fit_primitive`, from evidence gathered before."""
    return fit_best(evidence, [(primitive, 0.0)], config=config)


def fit_best(
    evidence: Evidence,
    candidates: Sequence[tuple[GenericPrimitive, float]],
    *,
    config: FitConfig = FitConfig(),
) -> FittedPrimitive:
    """Fit the one of several primitives that explains the points best.

    Args:
        evidence: Of one view.
        candidates: At least one primitive, each with its negative log odds.
        config: Starts and weights.

    Returns:
        The fit of the least cost and odds together, as `fit_primitive` returns it.

    Raises:
        FitDiverged: None of them reached config.max_residual_m.
    """
    found = best_of(evidence, candidates, config)
    if config.refine and _is_cut_off(found, evidence, config):
        seen = evidence
        for straight in (True, False):
            evidence = cut_off(seen, straight=straight)
            found = best_of(evidence, candidates, config)
            if not _is_cut_off(found, evidence, config):
                break
    best, primitive = found.best, found.primitive
    if config.roundness and config.refine:
        best = _rounder(best, primitive, evidence, config)
    others = [total_cost(state) for state in found.states if state.hypothesis != best.hypothesis]
    margin = min(others) / max(total_cost(best), 1e-9) if others else float("inf")
    return FittedPrimitive(
        primitive=primitive,
        T_world_object=make_T(best.R, best.t),
        scale=np.exp(best.log_scale),
        coefficients=best.coefficients,
        residual_m=best.residual_m,
        hypothesis=best.hypothesis,
        margin=max(margin, 1.0),
        cost=total_cost(best),
    )


def _is_cut_off(race: Race, evidence: Evidence, config: FitConfig) -> bool:
    """Whether the best fit stands so far beyond the outline of the cloud that something may hide a part of it.

    Only where the outline is guessed: a view knows what hides what.
    """
    if evidence.silhouette is None or evidence.silhouette.certain or not config.thorough.free_space:
        return False
    return free_space_cost(race.best, race.primitive, evidence, config.thorough) > _OCCLUSION


def _rounder(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: FitConfig) -> PoseShape:
    """The same fit with a body that is as deep as it is wide, where the points do not speak against that."""
    (round_state,) = refine([state], primitive, evidence, replace(config.thorough, oval_m=_ROUND_M))
    blocking = blocking_cost(round_state, primitive, evidence, config.thorough)
    round_state = replace(round_state, cost=round_state.cost + blocking)
    share = round_share(primitive, 2 * _ROUND_M)
    return round_state if round_state.cost - np.log(share) - _OCCAM < state.cost - np.log1p(-share) else state
