"""The likeliest of some primitives for one detection: search, occlusion, roundness, optional parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.errors import FitDiverged
from gfp_grasp.level import make_level_view
from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.length import hidden_end, settle_length
from gfp_grasp.register.occlusion import behind_occluder, blocking_cost, cut_off
from gfp_grasp.register.pruning import Search, search_starts, total_cost
from gfp_grasp.register.refine import evaluate_free_space, refine
from gfp_grasp.register.state import PoseShape, surface_samples
from gfp_grasp.register.terms import circular_share
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive, LevelView

# A part is believed when this many of the thinned points lie on it and stand off the rest by more than noise: within
# and beyond these shares of the primitive's size.
_PART_POINTS = 6
_OFF_REST = 0.051
_ON_PART = 0.081


def part_is_seen(fit: FittedPrimitive, part: str, evidence: LevelView) -> bool:
    """Whether points support an optional part of the fit: they lie near it, and away from the rest of the body."""
    samples, size_m = surface_samples(fit.primitive), fit.primitive.size_m
    local = samples.local(fit.coefficients) * fit.scale
    world = local @ fit.T_world_object[:3, :3].T + fit.T_world_object[:3, 3]
    on_part = fit.primitive.on_region(part)[fit.primitive.faces[samples.face]].all(axis=1)
    if not on_part.any() or on_part.all():
        return False
    to_part = KDTree(world[on_part]).query(evidence.points)[0]
    to_rest = KDTree(world[~on_part]).query(evidence.points)[0]
    return int(((to_part < _ON_PART * size_m) & (to_rest > _OFF_REST * size_m)).sum()) >= _PART_POINTS


# Cost of free space from which on a straight edge of the cloud may be that of something nearer, and from which on any
# edge may be. Of unhidden things of the validation split it is at most 2.6, or 6.7 with 3 mm of noise; of 30 bottles of
# which half is hidden it is at least 2.1, mostly above 9.
_SUSPECT, _FOOT_SUSPECT = 2.0, 1.0
_OCCLUSION = 8.0
# Negative log odds of something that hides a part, and the share of a poor fit's cost that may be chance; ours.
_OCCLUDED_COST, _OCCLUDED_SHARE = 5.0, 0.13
_MEASURED_BY = 5  # likeliest primitives, by whose size the lengths of all are measured
_ROUND = 0.0031  # ellipticity of a round body, as made and as its modes show it, a share of the unit
_ROUND_LOG_PRIOR = 3.0  # log odds of a round body beside its share of the members; ours


def fit_primitive(
    detection: Detection, primitive: GenericPrimitive, *, config: FitConfig = FitConfig()
) -> FittedPrimitive:
    """Fit pose, scale and shape modes of one primitive to a partial cloud, as `fit_best` does, in the world frame.

    Raises:
        TooFewPoints: Too few points to fit anything.
        FitDiverged: No start reached config.max_residual.
    """
    view = make_level_view(detection)
    fit = fit_best(view, [(primitive, 0.0)], config=config)
    return replace(fit, T_world_object=view.T_world_level @ fit.T_world_object)


def fit_best(
    evidence: LevelView,
    candidates: Sequence[tuple[GenericPrimitive, float]],
    *,
    config: FitConfig = FitConfig(),
) -> FittedPrimitive:
    """Fit the primitive, among one or several, that explains the points best.

    Args:
        evidence: One object, in its level frame.
        candidates: At least one primitive, each with its negative log prior.
        config: Starts and weights.

    Returns:
        The fit with the smallest cost over all primitives, starts and hypotheses; `margin` is the cost of the best
        start of another hypothesis over it. It is in the level frame.

    Raises:
        FitDiverged: No primitive reached config.max_residual.
    """
    # One unit for all of them: costs of primitives can be compared only where they take the same misfit for likely.
    likeliest = sorted(candidates, key=lambda candidate: candidate[1])[:_MEASURED_BY]
    config = config.with_unit(float(np.median([primitive.size_m for primitive, _ in likeliest])))
    if config.occlusion and evidence.silhouette is not None and evidence.silhouette.certain:
        evidence = behind_occluder(evidence)
    found = search_starts(evidence, candidates, config)
    if config.occlusion and config.refine:
        found, evidence = _behind_something(found, evidence, candidates, config)
    best, primitive = found.best, found.primitive
    if config.roundness and config.refine:
        best = try_circular(best, primitive, evidence, config)
    spread_m = None
    end = hidden_end(best, primitive, evidence) if config.refine and config.thorough.estimate_scale else 0
    if end:
        best, spread_m = settle_length(best, primitive, evidence, config, end=end)
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
        spread_m=spread_m,
    )


def _behind_something(
    found: Search, seen: LevelView, candidates: Sequence[tuple[GenericPrimitive, float]], config: FitConfig
) -> tuple[Search, LevelView]:
    """The search anew, where something may hide a part of the object, and what it takes for evidence then.

    This is asked only where the silhouette is guessed: a view knows what hides what. An occluder is believed where the
    object that it hides a part of is the likelier one.
    """
    evidence = seen
    for edge, least in (("clear", _FOOT_SUSPECT), ("faint", _OCCLUSION), (None, _OCCLUSION)):
        beyond = _beyond_silhouette(found, evidence, config)
        if beyond <= least:
            break
        cut = cut_off(seen, edge=edge)
        if edge and (cut.cut is None or (beyond <= _SUSPECT and np.isfinite(cut.floor_sigma_m[1]))):
            continue
        try:
            other = search_starts(cut, candidates, config)
        except FitDiverged:
            continue
        if other.cost + max(_OCCLUDED_COST, _OCCLUDED_SHARE * found.cost) < found.cost:
            found, evidence = other, cut
    return found, evidence


def _beyond_silhouette(found: Search, evidence: LevelView, config: FitConfig) -> float:
    """Cost of free space of the best fit where the silhouette is guessed; 0 otherwise."""
    if evidence.silhouette is None or evidence.silhouette.certain or not config.thorough.free_space:
        return 0.0
    return evaluate_free_space(found.best, found.primitive, evidence, config.thorough)


def try_circular(state: PoseShape, primitive: GenericPrimitive, evidence: LevelView, config: FitConfig) -> PoseShape:
    """The same fit with a body that is as deep as it is wide, where the points do not speak against that."""
    (circular,) = refine([state], primitive, evidence, replace(config.thorough, ellipticity=_ROUND))
    blocking = blocking_cost(circular, primitive, evidence, config.thorough)
    circular = replace(circular, cost=circular.cost + blocking)
    share = circular_share(primitive, 2 * _ROUND * config.thorough.unit_of(primitive))
    return circular if circular.cost - np.log(share) - _ROUND_LOG_PRIOR < state.cost - np.log1p(-share) else state
