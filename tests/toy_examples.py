"""Views of two classes and of things of no class, each from a seed, as the classifier's training takes them."""

import numpy as np

from gfp_grasp.train.classifier_data import Example


def example(seed: int, category: str, subcategory: str = "", *, answers: tuple[str, ...] = (), low=0.0) -> Example:
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.05, -0.03, low], [0.04, 0.06, 0.12], (300, 3)) * (1 + 0.1 * seed)
    answers = answers or (category,)
    return Example(points, category, subcategory, answers, answers, ("upright", "lying")[seed % 2])


EXAMPLES = [
    example(0, "cup", "tapered"),
    example(1, "mug", "ear", answers=("mug", "cup")),
    example(2, "mug", "ear"),
    example(3, "cup", "footed"),
    example(4, "cup", "tapered"),
]
OTHERS = [example(5, "assorted-0"), example(6, "assorted-7")]
