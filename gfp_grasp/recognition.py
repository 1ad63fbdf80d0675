"""Which classes a detection may be of, which primitives are therefore fitted to it, and which of them fits best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gfp_grasp.errors import FitDiverged
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, fit_best
from gfp_grasp.types import Detection, FittedPrimitive, GenericPrimitive, LevelView

# Below this the best class is an opinion, not a finding: of 160 views of the validation split of the household classes
# 3 % are below it, of 80 things of no class 51 %.
SURE_SCORE = 0.5
_LEAST_SCORE = 1e-6
# No right class of 60 unhidden views of the validation split is fitted at a greater cost; of bottles of which half is
# hidden every second one is, and of things that fell those whose class was not among the likely ones.
_POOR_COST = 60.0
_UNLIKELY = 0.005  # where the fit is poor, classes of this share of the score that counted as likely are fitted too,
_MOST_CANDIDATES = 16  # but no more primitives than this


def recognise(detection: Detection, library: PrimitiveLibrary) -> Detection:
    """The detection with what one look at it proposes, and with the scores of a library's classes.

    What is given or known stays as it is.
    """
    from gfp_grasp.detect import look, scores_in  # torch is loaded where it is needed only

    cloud, proposal = detection.cloud, detection.proposal
    if proposal is None:
        proposal = look(
            cloud.points, detection.up, detection.support, viewpoint=cloud.viewpoint, sensor=detection.sensor
        )
        detection = replace(detection, proposal=proposal)
    if detection.scores or detection.category:
        return detection
    scores = scores_in(proposal.embedding, library, detection.sensor)
    return replace(detection, category=max(scores, key=lambda name: scores[name]), scores=scores)


def class_is_given(detection: Detection) -> bool:
    """Whether the class of a recognised detection was given: then no other has a score."""
    return len(detection.scores) <= 1


def sureness(scores: Mapping[str, float], library: PrimitiveLibrary) -> float:
    """Score of the best class, together with those it is easily taken for; 1 where no class was asked for."""
    together = [
        sum(scores.get(n, 0.0) for n in (name, *library.spec(name).alike)) for name in scores if name in library
    ]
    return max([*scores.values(), *together]) if scores else 1.0


def likeliest(scores: Mapping[str, float], count: int) -> list[tuple[str, float]]:
    """The classes of the highest scores, highest first, each with its score."""
    return sorted(scores.items(), key=lambda item: -item[1])[:count]


def fit_likeliest(
    view: LevelView,
    detection: Detection,
    library: PrimitiveLibrary,
    *,
    config: FitConfig,
    rival_share: float,
    subcategories: bool,
    unlikely: bool = True,
) -> FittedPrimitive:
    """The best fit of the likely primitives, and where none of those fits of unlikely ones.

    Args:
        view: What is fitted to.
        detection: The same object, with its class or its scores.
        library: The classes that there are.
        config: Registration of a primitive.
        rival_share: A primitive is likely whose probability is at least this share of the best one's.
        subcategories: Whether the subcategories of a class take part too.
        unlikely: Whether unlikely primitives are fitted at all.

    Raises:
        FitDiverged: No primitive could be fitted.
    """
    best, failure, tried = None, None, 0
    for share in (rival_share, _UNLIKELY * rival_share)[: 1 + unlikely]:
        candidates = candidate_primitives(detection, library, rival_share=share, subcategories=subcategories)
        candidates = candidates[:_MOST_CANDIDATES]
        if len(candidates) == tried:
            break
        tried = len(candidates)
        try:
            fit = fit_best(view, candidates, config=config)
        except FitDiverged as error:
            failure = error
            continue
        if best is None or fit.cost < best.cost:
            best = fit
        if best.cost < _POOR_COST:
            break
    if best is None:
        assert failure is not None
        raise failure
    return best


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

    return shares_in(detection.proposal.embedding, primitives, detection.sensor)
