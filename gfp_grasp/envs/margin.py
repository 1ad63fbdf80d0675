"""The margin of a grasp: the least friction at which it still holds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gfp_grasp.types import Outcome

# Frictions that are tried lie within these: metal on oily metal, and rubber that clings. Five halvings of their ratio
# of 2^5 end within a ninth of the answer.
FRICTIONS = 0.05, 1.6
# Outcomes that more friction does not mend.
_HOPELESS = ("collided_on_approach", "no_contact", "unreachable_width", "no_grasp_found")


def least_friction(attempt: Callable[[float], Outcome], first: Outcome, *, num_trials: int) -> float:
    """The least friction at which a grasp holds, by halving the range of frictions in logarithms.

    A grasp that holds at one friction is taken to hold at every higher one.

    Args:
        attempt: The trial at a friction, from the same start every time.
        first: Outcome of the trial at the friction that the object has.
        num_trials: n trials, which end within a factor of 2^(5 / 2^n).

    Returns:
        The least friction tried at which the grasp held; inf where it held at none.
    """
    least = np.inf
    if first.reason in _HOPELESS:
        return least
    low, high = FRICTIONS
    for _ in range(num_trials):
        middle = float(np.sqrt(low * high))
        if attempt(middle).success:
            least = high = middle
        else:
            low = middle
    return float(least)


def octaves(friction: float | None) -> float:
    """How many times a least friction can be doubled until it is the highest; 0 where no friction held, or no trial."""
    return 0.0 if friction is None else float(np.log2(FRICTIONS[1] / min(friction, FRICTIONS[1])))
