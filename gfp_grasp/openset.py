"""Whether an object is of any class of a library at all: open-set recognition, by how it looks and how it is fitted.

Two logistic models tell the probability that it is of none. The first has seen how the object looks, which is known
before anything is fitted; the second also how well the best class explains it. Neither knows the name of a class, so
both hold for a user's own.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from gfp_grasp.assets import data_file
from gfp_grasp.misfit import Misfit
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import sureness
from gfp_grasp.types import Detection, FittedPrimitive

# Probability by the look alone that is enough for an answer of no class, unless an end of the object is hidden: a class
# knows more about how the object goes on. On plain views of results/openset.json 0.6 % of the things of a class look
# so, and 64 % of those of no class. To fit these takes longer than the answer does.
_LOOK_ENOUGH = 0.8
_NEAREST = 0.005  # of distances from prototypes, below which they are not told apart
_SURENESS = (0.02, 0.999)
_LEAST_OFF = 0.003
_WIDEST = 6.0  # standard deviations


@dataclass(frozen=True)
class LogisticModel:
    """Probability of being of no class: 1 / (1 + exp(-(bias + weights @ evidence))).

    Attributes:
        weights: One for each number of the evidence.
        bias: Log odds where all of them are zero.
    """

    weights: tuple[float, ...]
    bias: float

    def probability(self, evidence: Sequence[float] | np.ndarray) -> float:
        """The probability of being of no class."""
        return float(1.0 / (1.0 + np.exp(-np.clip(self.bias + np.dot(self.weights, evidence), -50.0, 50.0))))


def evidence_of_look(detection: Detection, library: PrimitiveLibrary) -> np.ndarray:
    """(2,) numbers that grow with doubt: distance from the nearest prototype, and how unsure the classifier is.

    Args:
        detection: With its scores and what one look at it proposes.
        library: The classes that there are.
    """
    from gfp_grasp.detect import distance_in  # torch is loaded where it is needed only

    assert detection.proposal is not None
    distance = distance_in(detection.proposal.embedding, library, detection.sensor)
    sure = float(np.clip(sureness(detection.scores, library), *_SURENESS))
    return np.array([np.log(distance + _NEAREST), np.log1p(-sure) - np.log(sure)])


def evidence_of_fit(fit: FittedPrimitive, misfit: Misfit) -> np.ndarray:
    """(5,) numbers: odd size and odd shape for the class, points off the surface, surface in free space, hidden ends.

    The more, the more doubtful; but of what hides an end of the object the look knows less.

    Args:
        fit: Fit of the class that fits best.
        misfit: Misfit of its completed surface.
    """
    log_scale = np.log(fit.scale)
    covariance = fit.primitive.log_scale_cov + 1e-4 * np.eye(3)
    odd_size = np.sqrt(log_scale @ np.linalg.solve(covariance, log_scale) / 3)
    odd_shape = np.sqrt(np.mean(fit.coefficients**2)) if len(fit.coefficients) else 0.0
    return np.array(
        [
            min(float(odd_size), _WIDEST),
            min(float(odd_shape), _WIDEST),
            np.log(max(misfit.off_points, _LEAST_OFF)),
            np.sqrt(misfit.in_free_space),
            float(fit.spread_m is not None),
        ]
    )


@cache
def load_models() -> tuple[LogisticModel, LogisticModel]:
    """The shipped models: of the look alone, and of look and fit."""
    card = json.loads(data_file("weights", "openset.json").read_text(encoding="utf-8"))
    look, both = (
        LogisticModel(tuple(card["models"][name]["weights"]), card["models"][name]["bias"]) for name in ("look", "both")
    )
    return look, both


def probability_by_look(look: Sequence[float] | np.ndarray) -> float:
    """The probability of being of no class, by the look alone (`evidence_of_look`)."""
    return load_models()[0].probability(look)


def is_unknown_by_look(probability: float, above: float, cut_off: Callable[[], bool]) -> bool:
    """Whether the look alone tells that an object is of no class.

    Args:
        probability: Of `probability_by_look`.
        above: Probability from which on it is of none, hidden or not.
        cut_off: Tells whether an end of the object is hidden; asked only where that decides.
    """
    return probability >= above or (probability >= _LOOK_ENOUGH and not cut_off())


def probability_unknown(look: Sequence[float] | np.ndarray, fit: Sequence[float] | np.ndarray) -> float:
    """The probability of being of no class, by look and fit (`evidence_of_fit`)."""
    return load_models()[1].probability(np.concatenate([look, fit]))
