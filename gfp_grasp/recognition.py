"""Which classes a detection may be of, and which primitives are therefore fitted to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import Detection, GenericPrimitive

# Below this the best class is an opinion, not a finding: of 160 views of the validation split of the household classes
# 3 % are below it, of 80 things of no class 51 %.
SURE_SCORE = 0.5
_LEAST_SCORE = 1e-6


def recognise(detection: Detection, library: PrimitiveLibrary) -> Detection:
    """The detection with what one look at it proposes, and with the scores of a library's classes.

    What is given or known stays as it is.
    """
    from gfp_grasp.detect import look, scores_in  # torch is loaded where it is needed only

    cloud, proposal = detection.cloud, detection.proposal
    if proposal is None:
        proposal = look(cloud.points, detection.up, detection.support, viewpoint=cloud.viewpoint)
        detection = replace(detection, proposal=proposal)
    if detection.scores or detection.category:
        return detection
    scores = scores_in(proposal.embedding, library)
    return replace(detection, category=max(scores, key=lambda name: scores[name]), scores=scores)


def sureness(scores: Mapping[str, float], library: PrimitiveLibrary) -> float:
    """Score of the best class, together with those it is easily taken for; 1 where no class was asked for."""
    together = [
        sum(scores.get(n, 0.0) for n in (name, *library.spec(name).alike)) for name in scores if name in library
    ]
    return max([*scores.values(), *together]) if scores else 1.0


def likeliest(scores: Mapping[str, float], count: int) -> list[tuple[str, float]]:
    """The classes of the highest scores, highest first, each with its score."""
    return sorted(scores.items(), key=lambda item: -item[1])[:count]


def candidate_primitives(
    detection: Detection, library: PrimitiveLibrary, *, rival_share: float, subcategories: bool
) -> list[tuple[GenericPrimitive, float]]:
    """Primitives that may explain a detection, each with its negative log odds.

    Args:
        detection: With its class or its scores.
        library: The classes that there are.
        rival_share: A primitive takes part whose probability is at least this share of the best one's.
        subcategories: Whether the subcategories of a class take part too.
    """
    scores = {name: score for name, score in detection.scores.items() if name in library.categories}
    best = max(scores.values(), default=0.0)
    found = []
    for name in [name for name, score in scores.items() if score >= rival_share * best] or [detection.category]:
        score = scores.get(name, 1.0)
        primitives = library.members_of(name) if subcategories else (library.primitive(name),)
        shares = _shares(detection, primitives)
        for primitive in primitives:
            share = shares.get(primitive.name, 1.0)
            cost = -np.log(max(share, _LEAST_SCORE)) if shares else primitive.spec.cost
            found.append((primitive, cost - np.log(max(score, _LEAST_SCORE)), score * share))
    least = rival_share * max(likely for _, _, likely in found)
    kept = [(primitive, float(odds)) for primitive, odds, likely in found if likely >= least]
    return sorted(kept, key=lambda candidate: candidate[1])


def _shares(detection: Detection, primitives: Sequence[GenericPrimitive]) -> dict[str, float]:
    """Probability of each of a class's primitives within it; empty where nobody has looked, or there is one alone."""
    if detection.proposal is None or len(primitives) == 1:
        return {}
    from gfp_grasp.detect import shares_in  # torch is loaded where it is needed only

    return shares_in(detection.proposal.embedding, primitives)
