"""Views of two classes and of things of no class, each from a seed, as the proposal network's training takes them."""

import math

import numpy as np

from gfp_grasp.train import Example
from gfp_grasp.train.proposal_data import Placed
from gfp_grasp.transforms import rotation_about

ORDERS = {"tapered": math.inf, "ear": 1, "footed": 4}  # things of other kinds have no axes of their own


def example(seed: int, category: str, subcategory: str = "", *, answers: tuple[str, ...] = (), low=0.0) -> Example:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.05, -0.03, low], [0.04, 0.06, 0.12], (300, 3)) * (1 + 0.1 * seed)
    answers = answers or (category,)
    viewpoint = np.array([0.3 - 0.2 * seed, 0.5, 0.4])
    placed = _placed(seed, ORDERS[subcategory]) if subcategory in ORDERS else None
    return Example(points, viewpoint, category, subcategory, answers, answers, ("upright", "lying")[seed % 2], placed)


def _placed(seed: int, order: float) -> Placed:
    R = rotation_about((0.2, -0.3, 1.0), 0.7 + seed)
    return Placed(R, (1 + 0.1 * seed) * np.array([0.09, 0.07, 0.12]), np.array([0.01, 0.02 * seed, 0.06]), order)


EXAMPLES = [
    example(0, "cup", "tapered"),
    example(1, "mug", "ear", answers=("mug", "cup")),
    example(2, "mug", "ear"),
    example(3, "cup", "footed"),
    example(4, "cup", "tapered"),
]
OTHERS = [example(5, "assorted-0"), example(6, "assorted-7")]
