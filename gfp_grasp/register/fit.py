"""One primitive onto one detection: starts, PCRNet, refinement, choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.register.evidence import Evidence, gather_evidence
from gfp_grasp.register.modes import free_space_cost, judge, refine
from gfp_grasp.register.occlusion import cut_off
from gfp_grasp.register.ovality import round_share
from gfp_grasp.register.starts import HYPOTHESIS_COST, starts
from gfp_grasp.register.state import ModesConfig, PoseShape
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive

# A surface is in front of a point when it is this much nearer: noise and the misfit of the modes are less.
_HIDDEN_M = 0.012

_HEAD_STEPS = 2
_HOPELESS = 100.0  # cost by which a start that is behind after the race never comes back; ours
# Cost of free space from which on a cloud without its view is taken to be cut off by something nearer. It is at most
# 3.0 on 204 views of the validation split and of scans where all is seen, at most 6.7 on 48 with 3 mm of noise, and
# above 8 on 45 of 48 where half is hidden (mostly above 20).
_OCCLUSION = 8.0
# Of what is cut off, a share of its surface is out of sight; ours, no measurement: less than a seventh seldom is.
_GOES_ON = 0.15
_ENDING = 30.0
_SIGHTS = 120  # lines of sight that are looked along
_ROUND_M = 0.0003  # ovality of what is round, as made and as its modes show it
_OCCAM = 3.0  # how much less a round body has to explain, negative log odds; ours

_QUICK = ModesConfig(steps=(0.02, 0.015, 0.01, 0.008, 0.006), num_points=150, num_samples=600, num_modes=5)
_MIDDLE = ModesConfig(steps=(0.02, 0.012, 0.008, 0.006, 0.005, 0.004), num_points=250, num_samples=1000)
_THOROUGH = ModesConfig(steps=(0.004, 0.003, 0.003, 0.003))

HYPOTHESES = ("upright", "upside_down", "lying")


@dataclass(frozen=True)
class FitConfig:
    """How a primitive is registered.

    Attributes:
        start: "pcrnet" corrects every start by the network, "box" leaves it as the box of the points gives it.
        hypotheses: How the object may rest on the support.
        quick: Refinement of every start.
        middle: Refinement of the best few.
        thorough: Refinement of those of them that are still near the best after that.
        survivors: Share of the starts that outlive the first two quick steps.
        keep: Starts of which there is a middle refinement.
        behind: A start whose cost is larger than the best's by this after that is given up.
        rival_behind: A primitive whose best start is behind another's by this after the first steps is given up.
        rival_raced_behind: The same after the quick steps.
        roundness: Ask whether the body is as deep as it is wide.
        size: (3,) scale of every start along the primitive's axes, ones for its own; None leaves it to the points.
        refine: Refine the starts; False takes the best of them as it is.
        max_residual_m: A fit whose trimmed residual is larger has diverged.
    """

    start: Literal["pcrnet", "box"] = "box"
    hypotheses: tuple[str, ...] = HYPOTHESES
    quick: ModesConfig = _QUICK
    middle: ModesConfig = _MIDDLE
    thorough: ModesConfig = _THOROUGH
    survivors: float = 0.4
    keep: int = 3
    behind: float = 15.0
    rival_behind: float = 50.0
    rival_raced_behind: float = 25.0
    roundness: bool = True
    size: tuple[float, float, float] | None = None
    refine: bool = True
    max_residual_m: float = 0.05

    def __post_init__(self) -> None:
        if self.start not in ("pcrnet", "box"):
            raise InvalidOption(f"start is {self.start!r}; 'pcrnet' or 'box' is expected")
        unknown = set(self.hypotheses) - set(HYPOTHESES)
        if unknown or not self.hypotheses:
            raise InvalidOption(f"hypotheses are {self.hypotheses}; some of {HYPOTHESES} are expected")
        if not 0 < self.survivors <= 1:
            raise InvalidOption(f"survivors is {self.survivors}; a share in (0, 1] is expected")
        if self.size is not None and not (len(self.size) == 3 and min(self.size) > 0):
            raise InvalidOption(f"size is {self.size}; three positive factors are expected")
        if min(self.behind, self.rival_behind, self.rival_raced_behind) < 0:
            raise InvalidOption("behind, rival_behind and rival_raced_behind must be costs from 0 on")
        if self.keep < 1:
            raise InvalidOption(f"keep is {self.keep}; at least one start must be refined")


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
        candidates: Primitives, each with its negative log odds.
        config: Starts and weights.

    Returns:
        The fit of the least cost and odds together, as `fit_primitive` returns it.

    Raises:
        FitDiverged: None of them reached config.max_residual_m.
    """
    found = _best_of(evidence, candidates, config)
    if config.refine and _is_cut_off(found, evidence, config):
        seen = evidence
        for straight in (True, False):
            evidence = cut_off(seen, straight=straight)
            found = _best_of(evidence, candidates, config)
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


@dataclass(frozen=True, eq=False)
class _Race:
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


def _best_of(evidence: Evidence, candidates: Sequence[tuple[GenericPrimitive, float]], config: FitConfig) -> _Race:
    """Of all primitives the starts are tried; those that are far behind after the first steps, or the race, give up."""
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


def _hopeful(races: list[_Race], behind: float) -> list[_Race]:
    """Those whose cost is not larger than the least by more than that."""
    limit = min(race.cost for race in races) + behind
    return [race for race in races if race.cost <= limit]


def _begun(primitive: GenericPrimitive, odds: float, evidence: Evidence, config: FitConfig) -> _Race:
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
    return _Race(primitive, odds, sorted(states, key=total_cost))


def _raced(race: _Race, evidence: Evidence, config: FitConfig) -> _Race:
    """The better share of the starts refined by the rest of the quick steps; the leaders of them."""
    states, tail = race.states, config.quick.steps[_HEAD_STEPS:]
    if tail:
        go_on = _leaders(states, max(config.keep, round(config.survivors * len(states))))
        quick = replace(config.quick, steps=tail)
        states = sorted(refine(go_on, race.primitive, evidence, quick), key=total_cost)
    leaders = _leaders(states, config.keep)
    blocking = [_blocking_cost(state, race.primitive, evidence, config.thorough) for state in leaders]
    leaders = [replace(state, cost=state.cost + more) for state, more in zip(leaders, blocking, strict=True)]
    return replace(race, states=sorted(leaders, key=total_cost))


def _is_cut_off(race: _Race, evidence: Evidence, config: FitConfig) -> bool:
    """Whether the best fit stands so far beyond the outline of the cloud that something may hide a part of it.

    Only where the outline is guessed: a view knows what hides what.
    """
    if evidence.silhouette is None or evidence.silhouette.certain or not config.thorough.free_space:
        return False
    return free_space_cost(race.best, race.primitive, evidence, config.thorough) > _OCCLUSION


def _finished(race: _Race, evidence: Evidence, config: FitConfig) -> _Race:
    """The leaders refined to the end, and after them those that were given up on the way."""
    primitive, limit = race.primitive, total_cost(race.best) + _HOPELESS
    given_up = [state for state in race.states if total_cost(state) > limit]
    states = refine([s for s in race.states if total_cost(s) <= limit], primitive, evidence, config.middle)
    limit, go_on = np.inf, []
    for state in sorted(states, key=total_cost):
        # What stands in the line of sight half-way does so at the end.
        more = 0.0
        if total_cost(state) <= limit:
            more = _blocking_cost(state, primitive, evidence, config.thorough)
            more += _ending_cost(state, primitive, evidence)
            limit = min(limit, total_cost(state) + more + config.behind)
        go_on.append((state, more))
    given_up += [replace(s, cost=s.cost + more) for s, more in go_on if total_cost(s) + more > limit]
    go_on = [(s, more) for s, more in go_on if total_cost(s) + more <= limit]
    refined = refine([s for s, _ in go_on], primitive, evidence, config.thorough)
    finished = [replace(s, cost=s.cost + more) for s, (_, more) in zip(refined, go_on, strict=True)]
    return replace(race, states=sorted(finished, key=total_cost) + given_up)


def _rounder(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: FitConfig) -> PoseShape:
    """The same fit with a body that is as deep as it is wide, where the points do not speak against that."""
    (round_state,) = refine([state], primitive, evidence, replace(config.thorough, oval_m=_ROUND_M))
    blocking = _blocking_cost(round_state, primitive, evidence, config.thorough)
    round_state = replace(round_state, cost=round_state.cost + blocking)
    share = round_share(primitive, 2 * _ROUND_M)
    return round_state if round_state.cost - np.log(share) - _OCCAM < state.cost - np.log1p(-share) else state


def total_cost(state: PoseShape) -> float:
    """Cost of a state with the odds of its hypothesis."""
    return state.cost + HYPOTHESIS_COST[state.hypothesis]


def _blocking_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig) -> float:
    """Cost of a surface that stands between the viewpoint and what was seen from there.

    Without it a cup's inside fits the inside of the same cup turned over, whose bottom hides it. A point that is
    hidden counts as one that the surface does not explain.
    """
    evidence = evidence.few(_SIGHTS)
    if evidence.viewpoint is None:
        return 0.0
    local = primitive.shape(state.coefficients, np.exp(state.log_scale))
    sight = evidence.points - evidence.viewpoint
    distance, _, _ = cast_rays([(local @ state.R.T + state.t, primitive.faces)], evidence.viewpoint, sight)
    length = np.linalg.norm(sight, axis=1)
    blocked = float((distance * length < length - _HIDDEN_M).mean())
    robust_m, sigma = config.steps[-1], np.hypot(evidence.sigma_m, config.misfit_m)
    return 0.5 * config.effective_points * blocked * float((robust_m / sigma) ** 2)


def _ending_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence) -> float:
    """Cost of a surface that ends where something hides how it goes on."""
    if evidence.cut is None:
        return 0.0
    world = state.world(primitive.shape(state.coefficients, np.ones(3)))
    beyond = float(((world - evidence.viewpoint) @ evidence.cut > 0).mean())
    return _ENDING * max(0.0, 1.0 - beyond / _GOES_ON)


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
    chosen += [s for s in firsts.values() if s.hypothesis not in {c.hypothesis for c in chosen}]
    return chosen
