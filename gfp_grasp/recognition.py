"""Which classes a detection may be of, and which primitives are therefore fitted to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import Detection, GenericPrimitive

# Below this the best class is an opinion, not a finding: of held-out views of the classes one in ten is below it, of
# things of no class seven in ten are.
SURE_SCORE = 0.7
_LEAST_SCORE = 1e-6


def recognise(detection: Detection, library: PrimitiveLibrary) -> Detection:
    """The detection with the scores of a library's classes; as it is where its class is given or known."""
    if detection.scores or detection.category:
        return detection
    from gfp_grasp.detect import classify  # torch is loaded where it is needed only

    scores = classify(detection.cloud.points, detection.up, detection.support, library=library)
    return replace(detection, category=max(scores, key=lambda name: scores[name]), scores=scores)


def sureness(scores: Mapping[str, float], library: PrimitiveLibrary) -> float:
    """Score of the best class, together with those it is easily taken for; 1 where no class was asked for."""
    together = [
        sum(scores.get(n, 0.0) for n in (name, *library.spec(name).alike)) for name in scores if name in library
    ]
    return max([*scores.values(), *together]) if scores else 1.0


def candidate_primitives(
    detection: Detection, library: PrimitiveLibrary, *, rival_share: float, subcategories: bool
) -> list[tuple[GenericPrimitive, float]]:
    """Primitives that may explain a detection, each with its negative log odds.

    Args:
        detection: With its class or its scores.
        library: The classes that there are.
        rival_share: A class takes part whose score is at least this share of the best class's.
        subcategories: Whether the subcategories of a class take part too.
    """
    scores = {name: score for name, score in detection.scores.items() if name in library.categories}
    least = rival_share * max(scores.values(), default=0.0)
    names = sorted((n for n, score in scores.items() if score >= least), key=lambda n: -scores[n])
    candidates = []
    for name in names or [detection.category]:
        odds = -np.log(max(scores.get(name, 1.0), _LEAST_SCORE))
        primitives = library.members_of(name) if subcategories else (library.primitive(name),)
        candidates += [(primitive, odds + primitive.spec.cost) for primitive in primitives]
    return candidates
