"""How sure the classifier may be, and how good it is: on views of classes, and of things of no class."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from gfp_grasp.detect import (
    NUM_POINTS,
    Calibration,
    ProposalNet,
    Prototypes,
    look_at_clouds,
    sample_points,
    score_table,
    size_of,
)
from gfp_grasp.train.proposal_batches import equal_fronts, placed_in_seen_frame, seen_cloud
from gfp_grasp.train.proposal_data import Example
from gfp_grasp.types import RESTS

_UNKNOWN_WEIGHT = 0.2  # in the calibration: an even spread for what is of no class, against a right answer


def calibrate(
    network: ProposalNet,
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
    network: ProposalNet,
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
    network: ProposalNet,
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


def measure_pose(network: ProposalNet, test: Sequence[Example]) -> dict[str, object]:
    """Errors of pose and box on views of the classes: medians, and shares of wrong rests and of wrong fronts."""
    placed = [example for example in test if example.placed is not None]
    clouds = _clouds(placed)
    seen = look_at_clouds(clouds, network)
    unit_m = size_of(clouds[..., :3])
    up_deg, front_deg, size, centre_m = [], [], [], []
    for i, example in enumerate(placed):
        truth = placed_in_seen_frame(example)
        up_deg.append(_angle_deg(seen.up[i], truth.R[:, 2]))
        if not math.isinf(truth.order):
            front_deg.append(min(_angle_deg(seen.front[i], x) for x in equal_fronts(truth.R, int(truth.order))))
        size.append(np.abs(seen.log_extents[i] + np.log(unit_m[i]) - np.log(truth.extents)).mean())
        centre_m.append(np.linalg.norm(seen.centre[i] * unit_m[i] - truth.centre) / np.linalg.norm(truth.extents))
    rests = [RESTS[k] for k in np.asarray(seen.rests).argmax(axis=1)]
    return {
        "wrong_rest": round(float(np.mean([r != e.resting for r, e in zip(rests, placed, strict=True)])), 4),
        "up_deg": round(float(np.median(up_deg)), 2),
        "front_deg": round(float(np.median(front_deg)), 2),
        "front_over_30_deg": round(float(np.mean(np.array(front_deg) > 30)), 4),
        "size_error": round(float(np.median(size)), 4),
        "centre_error": round(float(np.median(centre_m)), 4),
    }


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def embedded(network: ProposalNet, examples: Sequence[Example], *, table_known: bool = True) -> np.ndarray:
    """Embeddings (e, c) of examples."""
    return np.asarray(look_at_clouds(_clouds(examples, table_known=table_known), network).embedding)


def _clouds(examples: Sequence[Example], *, table_known: bool = True) -> np.ndarray:
    """(e, NUM_POINTS, 9)."""
    rng = np.random.default_rng(0)
    return np.stack([sample_points(seen_cloud(e, rng, table_known=table_known), NUM_POINTS, rng) for e in examples])
