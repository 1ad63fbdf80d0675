"""How far an object goes on behind what hides a part of it: a distribution, of which the mean is taken."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.register.config import FitConfig
from gfp_grasp.register.occlusion import blocking_cost
from gfp_grasp.register.posterior import NormalEquations, shape_model
from gfp_grasp.register.refine import refine
from gfp_grasp.register.state import PoseShape
from gfp_grasp.types import GenericPrimitive, LevelView

# Lengths that are tried, in standard deviations of the class's logarithm of scale about the likeliest one.
_TRIED = np.linspace(-1.0, 2.0, 7)
_DOUBT = 4.0  # by which differences of cost are divided, for they are as much those of misfit; ours
_HELD = 1e4  # precision by which a length is held
_UP = 2  # the axis, of a primitive's own, that its length is measured along


@dataclass(frozen=True, eq=False)
class LengthTerm:
    """The logarithm (s,) of the scale of each state along the upright axis is held."""

    log_scale: np.ndarray

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`; it costs nothing."""
        sums.H[:, 6 + _UP, 6 + _UP] += _HELD
        sums.g[:, 6 + _UP] += _HELD * (self.log_scale - sums.surface.batch.log_scale[:, _UP])


def hidden_end(state: PoseShape, primitive: GenericPrimitive, evidence: LevelView) -> int:
    """Which end of the upright axis something hides: 1 for the upper, -1 for the lower, 0 for neither."""
    if evidence.cut is None:
        return 0
    local = primitive.shape(state.coefficients, np.ones(3))
    sight = state.world(local) - evidence.viewpoint
    behind = sight @ evidence.cut / np.linalg.norm(sight, axis=1)
    columns = np.column_stack([local, np.ones(len(local))])
    toward = np.linalg.lstsq(columns, behind)[0][:3] * np.ptp(local, axis=0)
    return int(np.sign(toward[_UP])) if np.abs(toward).argmax() == _UP else 0


def settle_length(
    state: PoseShape, primitive: GenericPrimitive, evidence: LevelView, config: FitConfig, *, end: int
) -> tuple[PoseShape, np.ndarray]:
    """The state of the mean length, where something hides an end of the object.

    Args:
        state: The likeliest one.
        primitive: What is fitted.
        evidence: What was seen.
        config: Weights.
        end: Which end is hidden, see `hidden_end`.

    Returns:
        The state, and the standard deviation (v,) m of its vertices over all lengths.
    """

    def at_length(start: PoseShape, log_scales: np.ndarray) -> list[PoseShape]:
        states, held = [_stretched(start, primitive, length, end) for length in log_scales], (LengthTerm(log_scales),)
        for laps in (config.middle, config.thorough):
            states = refine(states, primitive, evidence, laps, held=held)
        return states

    model = shape_model(primitive, config.thorough.num_samples, config.thorough.num_modes)
    lengths = state.log_scale[_UP] + _TRIED * model.scale_sigma[_UP]
    states = at_length(state, lengths)
    cost = np.array([s.cost + blocking_cost(s, primitive, evidence, config.thorough) for s in states])
    log_scale = np.array([s.log_scale for s in states])
    own = 0.5 * np.einsum("si,ij,sj->s", log_scale, model.scale_precision, log_scale)
    # What was seen says little of the length, and the fit gives the scale some slack: here the class tells it. What
    # hides an end of something longer leaves just this much of it in sight by less of a chance.
    cost = (cost - own / config.thorough.scale_slack**2) / _DOUBT + own + lengths
    weight = np.exp(cost.min() - cost)
    weight /= weight.sum()
    mean = float(weight @ lengths)
    (settled,) = at_length(states[int(np.abs(lengths - mean).argmin())], np.array([mean]))
    vertices = np.array([s.world(primitive.shape(s.coefficients, np.ones(3))) for s in states])
    off_mean = vertices - np.einsum("s,svi->vi", weight, vertices)
    return replace(settled, cost=state.cost), np.sqrt(np.einsum("s,svi,svi->v", weight, off_mean, off_mean))


def _stretched(state: PoseShape, primitive: GenericPrimitive, log_scale: float, end: int) -> PoseShape:
    """The state at another length; the end that was seen stays where it is."""
    local = primitive.shape(state.coefficients, np.ones(3))[:, _UP]
    seen_end = local.min() if end > 0 else local.max()
    scale = np.array(state.log_scale)
    scale[_UP] = log_scale
    move = seen_end * (np.exp(state.log_scale[_UP]) - np.exp(log_scale))
    return replace(state, log_scale=scale, t=state.t + move * state.R[:, _UP])
