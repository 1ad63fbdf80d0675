"""How sure the classifier may be, and how good it is: on views of classes, and of things of no class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gfp_grasp.detect import (
    NUM_POINTS,
    POOL_POINTS,
    Calibration,
    EmbeddingNet,
    Prototypes,
    embed_clouds,
    sample_points,
    score_table,
    upright_points,
    with_surface,
)
from gfp_grasp.train.classifier_data import UP, Example, above_table
from gfp_grasp.types import SupportPlane

_UNKNOWN_WEIGHT = 0.2  # in the calibration: an even spread for what is of no class, against a right answer
_TABLE = SupportPlane(UP, 0.0)


def calibrate(
    network: EmbeddingNet,
    prototypes: Mapping[str, Prototypes],
    known: Sequence[Example],
    unknown: Sequence[Example],
) -> Calibration:
    """Temperature and reach of the smallest loss: a right answer for the known, an even spread for the unknown.

    The likelihood of a right answer is that of arXiv:1706.04599, the even spread that of arXiv:1812.04606.
    """
    names = list(prototypes)
    accepted = np.array([[name in e.answers for name in names] for e in known])
    near, far = embedded(network, known), embedded(network, unknown)
    best, chosen = np.inf, Calibration(0.05, 0.5)
    for temperature in np.geomspace(0.01, 0.3, 25):
        for reach in np.linspace(0.05, 1.2, 24):
            calibration = Calibration(float(temperature), float(reach))
            right = (_table(near, prototypes, calibration) * accepted).sum(axis=1)
            spread = np.log(np.maximum(_table(far, prototypes, calibration), 1e-9)).mean(axis=1)
            value = -np.log(np.maximum(right, 1e-9)).mean() - _UNKNOWN_WEIGHT * float(spread.mean())
            if value < best:
                best, chosen = value, calibration
    return chosen


def _table(embeddings: np.ndarray, prototypes: Mapping[str, Prototypes], calibration: Calibration) -> np.ndarray:
    return score_table(embeddings, list(prototypes.values()), calibration)


def _scores(
    network: EmbeddingNet,
    prototypes: Mapping[str, Prototypes],
    calibration: Calibration,
    examples: Sequence[Example],
    *,
    table_known: bool = True,
) -> np.ndarray:
    return _table(embedded(network, examples, table_known=table_known), prototypes, calibration)


def _right(scores: np.ndarray, names: Sequence[str], examples: Sequence[Example]) -> np.ndarray:
    return np.array([names[k] in e.accepted for k, e in zip(scores.argmax(axis=1), examples, strict=True)])


def measure(
    network: EmbeddingNet,
    prototypes: Mapping[str, Prototypes],
    calibration: Calibration,
    test: Sequence[Example],
    outside: Sequence[Example],
) -> dict[str, object]:
    """Accuracy on views of the classes, and how sure the answers are, of those and of things of no class."""
    names = list(prototypes)
    scores = _scores(network, prototypes, calibration, test)
    blind = _scores(network, prototypes, calibration, test, table_known=False)
    right, right_blind = _right(scores, names, test), _right(blind, names, test)
    strict = np.array([names[k] in e.answers for k, e in zip(scores.argmax(axis=1), test, strict=True)])
    resting = np.array([example.resting for example in test])
    return {
        "test_views": len(test),
        "accuracy": round(float(right.mean()), 4),
        "accuracy_named_as_taught": round(float(strict.mean()), 4),
        "accuracy_by_rest": {str(rest): round(float(right[resting == rest].mean()), 4) for rest in np.unique(resting)},
        "accuracy_table_unknown": round(float(right_blind.mean()), 4),
        "mean_top_score": round(float(scores.max(axis=1).mean()), 4),
        "mean_top_score_foreign": round(
            float(_scores(network, prototypes, calibration, outside).max(axis=1).mean()), 4
        ),
    }


def embedded(network: EmbeddingNet, examples: Sequence[Example], *, table_known: bool = True) -> np.ndarray:
    """Embeddings (e, c) of examples, one turn each."""
    rng = np.random.default_rng(0)
    table = _TABLE if table_known else None
    clouds = []
    for example in examples:
        pool = with_surface(sample_points(upright_points(above_table(example), UP, table), POOL_POINTS, rng))
        clouds.append(sample_points(pool, NUM_POINTS, rng))
    return embed_clouds(np.stack(clouds), network)
