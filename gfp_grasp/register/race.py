"""The search among the starts of some primitives: all take a few light steps, and fewer and fewer go on, with heavier
ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import FitDiverged
from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.modes import judge, refine
from gfp_grasp.register.starts import starts
from gfp_grasp.register.state import ModesConfig, PoseShape
from gfp_grasp.types import GenericPrimitive

# A surface is in front of a point when it is this much nearer: noise and the misfit of the modes are less.
_HIDDEN_M = 0.012

_HEAD_STEPS = 2
_HOPELESS = 100.0  # cost by which a start that is behind after the race never comes back; ours
# Of what is cut off, a share of its surface is out of sight; ours, no measurement: less than a seventh seldom is.
_GOES_ON = 0.15
_ENDING = 30.0
_SIGHTS = 120  # lines of sight that are looked along


@dataclass(frozen=True, eq=False)
class Race:
    """States of one primitive, at some stage of its fit, best first.

    Attributes:
        primitive: Whose states they are.
        odds: Its negative log odds.
        states: As they are.
    """

    primitive: GenericPrimitive
    odds: float
    states: list[PoseShape]

    @property
    def best(self) -> PoseShape:
        """The state of the least cost."""
        return self.states[0]

    @property
    def cost(self) -> float:
        """Of the best state, with the odds of the primitive."""
        return total_cost(self.best) + self.odds


def best_of(evidence: Evidence, candidates: Sequence[tuple[GenericPrimitive, float]], config: FitConfig) -> Race:
    """The primitive that explains the points best, with its states.

    Of all of them every start is tried; those that are far behind after the first steps, or after the race, give up.

    Args:
        evidence: Of one view.
        candidates: At least one primitive, each with its negative log odds.
        config: Starts and weights.

    Raises:
        FitDiverged: None of them reached config.max_residual_m.
    """
    races = [_begun(primitive, odds, evidence, config) for primitive, odds in candidates]
    if config.refine:
        races = [_raced(race, evidence, config) for race in _hopeful(races, config.rival_behind)]
        races = [_finished(race, evidence, config) for race in _hopeful(races, config.rival_raced_behind)]
    fits = [race for race in races if race.best.residual_m <= config.max_residual_m and np.isfinite(race.cost)]
    if not fits:
        nearest = min(races, key=lambda race: race.best.residual_m)
        raise FitDiverged(
            f"{nearest.primitive.category}: the best start misses the points by "
            f"{nearest.best.residual_m * 1000:.1f} mm, {config.max_residual_m * 1000:.0f} mm is allowed: "
            "is it one object, in metres, with the right up?"
        )
    return min(fits, key=lambda race: race.cost)


def _hopeful(races: list[Race], behind: float) -> list[Race]:
    """Those whose cost is not larger than the least by more than that."""
    limit = min(race.cost for race in races) + behind
    return [race for race in races if race.cost <= limit]


def _begun(primitive: GenericPrimitive, odds: float, evidence: Evidence, config: FitConfig) -> Race:
    """Every start refined by the first steps."""
    states = starts(primitive, evidence, config.hypotheses)
    if config.size is not None:
        states = [replace(state, log_scale=np.log(config.size)) for state in states]
    if config.start == "pcrnet":
        from gfp_grasp.register.pcrnet import correct_starts  # torch is loaded where it is needed only

        states = correct_starts(states, primitive, evidence)
    if config.refine:
        states = refine(states, primitive, evidence, replace(config.quick, steps=config.quick.steps[:_HEAD_STEPS]))
    else:
        states = judge(states, primitive, evidence, config.thorough)
    return Race(primitive, odds, sorted(states, key=total_cost))


def _raced(race: Race, evidence: Evidence, config: FitConfig) -> Race:
    """The better share of the starts refined by the rest of the quick steps; the leaders of them."""
    states, tail = race.states, config.quick.steps[_HEAD_STEPS:]
    if tail:
        go_on = _leaders(states, max(config.keep, round(config.survivors * len(states))))
        quick = replace(config.quick, steps=tail)
        states = sorted(refine(go_on, race.primitive, evidence, quick), key=total_cost)
    leaders, limit = [], np.inf
    for state in sorted(_leaders(states, config.keep), key=total_cost):
        if total_cost(state) <= limit:  # the others are given up whatever they hide
            state = replace(state, cost=state.cost + blocking_cost(state, race.primitive, evidence, config.thorough))
            limit = min(limit, total_cost(state) + _HOPELESS)
        leaders.append(state)
    return replace(race, states=sorted(leaders, key=total_cost))


def _finished(race: Race, evidence: Evidence, config: FitConfig) -> Race:
    """The leaders refined to the end, and after them those that were given up on the way."""
    primitive, limit = race.primitive, total_cost(race.best) + _HOPELESS
    given_up = [state for state in race.states if total_cost(state) > limit]
    states = refine([s for s in race.states if total_cost(s) <= limit], primitive, evidence, config.middle)
    limit, go_on = np.inf, []
    for state in sorted(states, key=total_cost):
        # What stands in the line of sight half-way does so at the end.
        more = 0.0
        if total_cost(state) <= limit:
            more = blocking_cost(state, primitive, evidence, config.thorough)
            more += _ending_cost(state, primitive, evidence)
            limit = min(limit, total_cost(state) + more + config.behind)
        go_on.append((state, more))
    given_up += [replace(s, cost=s.cost + more) for s, more in go_on if total_cost(s) + more > limit]
    go_on = [(s, more) for s, more in go_on if total_cost(s) + more <= limit]
    refined = refine([s for s, _ in go_on], primitive, evidence, config.thorough)
    finished = [replace(s, cost=s.cost + more) for s, (_, more) in zip(refined, go_on, strict=True)]
    return replace(race, states=sorted(finished, key=total_cost) + given_up)


def total_cost(state: PoseShape) -> float:
    """Cost of a state with the odds of its hypothesis."""
    return state.cost + state.rest_cost


def blocking_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig) -> float:
    """Cost of a surface that stands between the viewpoint and what was seen from there.

    Without it a cup's inside fits the inside of the same cup turned over, whose bottom hides it. A point that is
    hidden counts as one that the surface does not explain.
    """
    evidence = evidence.few(_SIGHTS)
    if evidence.viewpoint is None:
        return 0.0
    sight = evidence.points - evidence.viewpoint
    distance, _, _ = cast_rays([(_vertices(state, primitive), primitive.faces)], evidence.viewpoint, sight)
    length = np.linalg.norm(sight, axis=1)
    blocked = float((distance * length < length - _HIDDEN_M).mean())
    robust_m, sigma = config.steps[-1], np.hypot(evidence.sigma_m, config.misfit_m)
    return 0.5 * config.effective_points * blocked * float((robust_m / sigma) ** 2)


def _ending_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence) -> float:
    """Cost of a surface that ends where something hides how it goes on."""
    if evidence.cut is None:
        return 0.0
    beyond = float(((_vertices(state, primitive) - evidence.viewpoint) @ evidence.cut > 0).mean())
    return _ENDING * max(0.0, 1.0 - beyond / _GOES_ON)


def _vertices(state: PoseShape, primitive: GenericPrimitive) -> np.ndarray:
    """Vertices (v, 3) m, world, of a primitive in some state."""
    return state.world(primitive.shape(state.coefficients, np.ones(3)))


def _leaders(states: list[PoseShape], keep: int) -> list[PoseShape]:
    """The best few that are not the same place twice, and the best of every hypothesis."""
    firsts = {s.hypothesis: s for s in reversed(states)}
    chosen: list[PoseShape] = []
    for state in states:
        twin = any(
            s.hypothesis == state.hypothesis
            and np.linalg.norm(s.t - state.t) < 0.003
            and np.abs(s.R - state.R).max() < 0.1
            for s in chosen
        )
        if not twin:
            chosen.append(state)
        if len(chosen) == keep:
            break
    return chosen + [s for s in firsts.values() if s.hypothesis not in {c.hypothesis for c in chosen}]
