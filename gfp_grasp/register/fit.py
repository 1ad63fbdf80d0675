"""One primitive onto one detection: starts, PCRNet, refinement, choice."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.register.evidence import Evidence, gather_evidence
from gfp_grasp.register.modes import ModesConfig, PoseShape, refine
from gfp_grasp.register.starts import HYPOTHESIS_COST, starts
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive

# A surface is in front of a point when it is this much nearer: noise and the misfit of the modes are less.
_HIDDEN_M = 0.012

_HEAD_STEPS = 2

HYPOTHESES = ("upright", "upside_down", "lying")


@dataclass(frozen=True)
class FitConfig:
    """How a primitive is registered.

    Attributes:
        start: "pcrnet" corrects every start by the network, "box" leaves it as the box of the points gives it.
        hypotheses: How the object may rest on the support.
        quick: Refinement of every start.
        thorough: Refinement of the best few.
        survivors: Share of the starts that outlive the first two quick steps.
        keep: Starts that are refined thoroughly.
        mean_size: Every start has the mean size, not the size of the points.
        max_residual_m: A fit whose trimmed residual is larger has diverged.
    """

    start: Literal["pcrnet", "box"] = "box"
    hypotheses: tuple[str, ...] = HYPOTHESES
    quick: ModesConfig = field(default_factory=lambda: ModesConfig(steps=(0.02, 0.015, 0.01, 0.008, 0.006)))
    thorough: ModesConfig = field(default_factory=ModesConfig)
    survivors: float = 0.4
    keep: int = 3
    mean_size: bool = False
    max_residual_m: float = 0.05

    def __post_init__(self) -> None:
        if self.start not in ("pcrnet", "box"):
            raise InvalidOption(f"start is {self.start!r}; 'pcrnet' or 'box' is expected")
        unknown = set(self.hypotheses) - set(HYPOTHESES)
        if unknown or not self.hypotheses:
            raise InvalidOption(f"hypotheses are {self.hypotheses}; some of {HYPOTHESES} are expected")
        if not 0 < self.survivors <= 1:
            raise InvalidOption(f"survivors is {self.survivors}; a share in (0, 1] is expected")
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
    """As `fit_primitive`, from evidence gathered before (one gathering serves several primitives)."""
    states = starts(primitive, evidence, config.hypotheses)
    if config.mean_size:
        states = [replace(state, log_scale=np.zeros(3)) for state in states]
    if config.start == "pcrnet":
        from gfp_grasp.register.pcrnet import correct_starts  # torch is loaded where it is needed only

        states = correct_starts(states, primitive, evidence)
    states = _race(states, primitive, evidence, config)
    leaders = _leaders(states, config.keep)
    refined = [refine(s, primitive, evidence, config.thorough) for s in leaders]
    refined = [replace(s, cost=s.cost + _blocking_cost(s, primitive, evidence, config)) for s in refined]
    refined.sort(key=total_cost)
    best = refined[0]
    if not np.isfinite(best.cost) or best.residual_m > config.max_residual_m:
        raise FitDiverged(
            f"{primitive.category}: the best start misses the points by {best.residual_m * 1000:.1f} mm, "
            f"{config.max_residual_m * 1000:.0f} mm is allowed: is it one object, in metres, with the right up?"
        )
    others = [total_cost(s) for s in (*refined, *states) if s.hypothesis != best.hypothesis]
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


def _race(
    states: list[PoseShape], primitive: GenericPrimitive, evidence: Evidence, config: FitConfig
) -> list[PoseShape]:
    """Every start refined by two steps, the better share of them by the rest; best first."""
    steps = config.quick.steps
    head, tail = replace(config.quick, steps=steps[:_HEAD_STEPS]), steps[_HEAD_STEPS:]
    states = sorted((refine(s, primitive, evidence, head) for s in states), key=total_cost)
    if tail:
        go_on = _leaders(states, max(config.keep, round(config.survivors * len(states))))
        states = sorted((refine(s, primitive, evidence, replace(head, steps=tail)) for s in go_on), key=total_cost)
    return states


def total_cost(state: PoseShape) -> float:
    """Cost of a state with the odds of its hypothesis."""
    return state.cost + HYPOTHESIS_COST[state.hypothesis]


def _blocking_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: FitConfig) -> float:
    """Cost of a surface that stands between the viewpoint and what was seen from there.

    Without it a cup's inside fits the inside of the same cup turned over, whose bottom hides it. A point that is
    hidden counts as one that the surface does not explain.
    """
    if evidence.viewpoint is None:
        return 0.0
    local = primitive.shape(state.coefficients, np.exp(state.log_scale))
    triangles = (local @ state.R.T + state.t)[primitive.faces]
    sight = evidence.points - evidence.viewpoint
    distance, _, _ = cast_rays([triangles], evidence.viewpoint, sight)
    length = np.linalg.norm(sight, axis=1)
    blocked = float((distance * length < length - _HIDDEN_M).mean())
    robust_m, sigma = config.thorough.steps[-1], np.hypot(evidence.sigma_m, config.thorough.misfit_m)
    return 0.5 * config.thorough.effective_points * blocked * float((robust_m / sigma) ** 2)


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
