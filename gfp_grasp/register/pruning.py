"""Multi-start search with pruning: every start takes a few light steps; fewer and fewer go on, with heavier ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.errors import FitDiverged
from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.occlusion import blocking_cost, truncation_cost
from gfp_grasp.register.refine import evaluate_states, refine
from gfp_grasp.register.starts import make_starts, proposed_starts
from gfp_grasp.register.state import PoseShape
from gfp_grasp.types import GenericPrimitive, LevelView

_HEAD_STEPS = 2  # quick steps that every start takes
_RIVAL_SHARE = 0.25  # of the least cost by which a rival may exceed it where that is more than the margin; ours
_ABANDON_MARGIN = 100.0  # a start that is behind by this cost after the quick steps never comes back; ours
# Starts of one hypothesis are the same place where they differ by less than this in translation (a share of the
# primitive's size) and in every entry of R.
_SAME_PLACE = 0.031
_SAME_ROTATION = 0.1


@dataclass(frozen=True, eq=False)
class Search:
    """The search for the best state of one primitive, at some stage.

    Attributes:
        primitive: The primitive that is fitted.
        prior_cost: Its negative log prior.
        states: Its states, best first.
    """

    primitive: GenericPrimitive
    prior_cost: float
    states: list[PoseShape]

    @property
    def best(self) -> PoseShape:
        """The state of the least cost."""
        return self.states[0]

    @property
    def cost(self) -> float:
        """Cost of the best state with the priors of hypothesis and primitive."""
        return total_cost(self.best) + self.prior_cost


def search_starts(
    evidence: LevelView, candidates: Sequence[tuple[GenericPrimitive, float]], config: FitConfig
) -> Search:
    """Find the primitive that explains the points best, with its states.

    Every start of every primitive is tried; a primitive that is far behind another after the first steps, or after all
    quick steps, is pruned.

    Args:
        evidence: Points, normals, floor and silhouette of one object.
        candidates: At least one primitive, each with its negative log prior.
        config: Starts, steps and margins.

    Raises:
        FitDiverged: None of them reached config.max_residual.
    """
    searches = [_tried(primitive, prior_cost, evidence, config) for primitive, prior_cost in candidates]
    if config.refine:
        searches = [_pruned(search, evidence, config) for search in within_margin(searches, config.rival_margin)]
        searches = [
            _finished(search, evidence, config) for search in within_margin(searches, config.rival_margin_quick)
        ]
    allowed_m = {s: config.max_residual * config.thorough.unit_of(s.primitive) for s in searches}
    fits = [s for s in searches if s.best.residual_m <= allowed_m[s] and np.isfinite(s.cost)]
    if not fits:
        nearest = min(searches, key=lambda search: search.best.residual_m)
        raise FitDiverged(
            f"{nearest.primitive.category}: the best start misses the points by "
            f"{nearest.best.residual_m * 1000:.1f} mm, {allowed_m[nearest] * 1000:.0f} mm is allowed: "
            "is it one object, in metres, with the right up?"
        )
    return min(fits, key=lambda search: search.cost)


def within_margin(searches: list[Search], margin: float) -> list[Search]:
    """The searches whose cost exceeds the least by no more than a margin, or a share of it: poor starts say little."""
    least = min(search.cost for search in searches)
    limit = least + max(margin, _RIVAL_SHARE * least)
    return [search for search in searches if search.cost <= limit]


def total_cost(state: PoseShape) -> float:
    """Cost of a state with the negative log prior of its hypothesis."""
    return state.cost + state.rest_cost


def distinct_leaders(states: list[PoseShape], count: int, size_m: float) -> list[PoseShape]:
    """The best few states, of which no two are the same place, and the best one of every hypothesis.

    Args:
        states: Best first.
        count: How many; those that are added for their hypothesis come besides.
        size_m: Size of the primitive.
    """
    firsts = {s.hypothesis: s for s in reversed(states)}
    chosen: list[PoseShape] = []
    for state in states:
        if not any(_is_same_place(s, state, _SAME_PLACE * size_m) for s in chosen):
            chosen.append(state)
        if len(chosen) == count:
            break
    return chosen + [s for s in firsts.values() if s.hypothesis not in {c.hypothesis for c in chosen}]


def _is_same_place(a: PoseShape, b: PoseShape, near_m: float) -> bool:
    return bool(
        a.hypothesis == b.hypothesis and np.linalg.norm(a.t - b.t) < near_m and np.abs(a.R - b.R).max() < _SAME_ROTATION
    )


def _tried(primitive: GenericPrimitive, prior_cost: float, evidence: LevelView, config: FitConfig) -> Search:
    """Every start, refined by the first steps."""
    begin = proposed_starts if config.start == "proposal" else make_starts
    states = begin(primitive, evidence, config.hypotheses)
    if config.size is not None:
        states = [replace(state, log_scale=np.log(config.size)) for state in states]
    if config.start == "pcrnet":
        from gfp_grasp.register.pcrnet import correct_starts  # torch is loaded where it is needed only

        states = correct_starts(states, primitive, evidence)
    if config.refine:
        states = refine(states, primitive, evidence, replace(config.quick, steps=config.quick.steps[:_HEAD_STEPS]))
    else:
        states = evaluate_states(states, primitive, evidence, config.thorough)
    return Search(primitive, prior_cost, sorted(states, key=total_cost))


def _pruned(search: Search, evidence: LevelView, config: FitConfig) -> Search:
    """The leaders among the better share of the starts, after the rest of the quick steps."""
    states, tail, size_m = search.states, config.quick.steps[_HEAD_STEPS:], search.primitive.size_m
    if tail:
        kept = distinct_leaders(states, max(config.num_kept, round(config.kept_share * len(states))), size_m)
        quick = replace(config.quick, steps=tail)
        states = sorted(refine(kept, search.primitive, evidence, quick), key=total_cost)
    leaders, limit = [], np.inf
    for state in sorted(distinct_leaders(states, config.num_kept, size_m), key=total_cost):
        if total_cost(state) <= limit:  # the others are abandoned, whatever they hide
            state = replace(state, cost=state.cost + blocking_cost(state, search.primitive, evidence, config.thorough))
            limit = min(limit, total_cost(state) + _ABANDON_MARGIN)
        leaders.append(state)
    return replace(search, states=sorted(leaders, key=total_cost))


def _finished(search: Search, evidence: LevelView, config: FitConfig) -> Search:
    """The leaders refined to the end, and after them those that were pruned on the way."""
    primitive, limit = search.primitive, total_cost(search.best) + _ABANDON_MARGIN
    pruned = [state for state in search.states if total_cost(state) > limit]
    states = refine([s for s in search.states if total_cost(s) <= limit], primitive, evidence, config.middle)
    limit, kept = np.inf, []
    for state in sorted(states, key=total_cost):
        # A surface that stands in the line of sight after the middle steps does so at the end.
        more = 0.0
        if total_cost(state) <= limit:
            more = blocking_cost(state, primitive, evidence, config.thorough)
            more += truncation_cost(state, primitive, evidence)
            limit = min(limit, total_cost(state) + more + config.prune_margin)
        kept.append((state, more))
    pruned += [replace(s, cost=s.cost + more) for s, more in kept if total_cost(s) + more > limit]
    kept = [(s, more) for s, more in kept if total_cost(s) + more <= limit]
    refined = refine([s for s, _ in kept], primitive, evidence, config.thorough)
    finished = [replace(s, cost=s.cost + more) for s, (_, more) in zip(refined, kept, strict=True)]
    return replace(search, states=sorted(finished, key=total_cost) + pruned)
