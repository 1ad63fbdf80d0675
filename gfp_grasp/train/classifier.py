"""Trains the classifier: `python -m gfp_grasp.train.classifier --seed 0` renders, trains, calibrates and measures."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.detect.classifier import (
    FLOOR_M,
    NUM_POINTS,
    POOL_POINTS,
    CategoryNet,
    features,
    sample_points,
    upright_points,
    with_surface,
)
from gfp_grasp.errors import InvalidOption
from gfp_grasp.shapes import FAMILIES
from gfp_grasp.train.classifier_data import CACHE, Example, family_examples, foreign_examples
from gfp_grasp.train.loop import LoopConfig, train, write_weights
from gfp_grasp.types import SupportPlane

UP = np.array([0.0, 0.0, 1.0])
_TRAIN_POINTS = 256  # a third of what is used later: max-pooling does not mind, and steps are thrice as fast


@dataclass(frozen=True)
class ClassifierConfig(LoopConfig):
    """Schedule and data of the classifier.

    Attributes:
        width: Of the network.
        views: Of each shape of the training split.
        foreign: Views of things of no class; their target is an even spread (outlier exposure, arXiv:1812.04606).
        foreign_weight: Of their loss.
        unknown_table: Share of samples whose lowest point stands for the table.
    """

    steps: int = 4000
    batch: int = 48
    rate: float = 2e-3
    decay: float = 0.65
    bf16: bool = True
    width: int = 48
    views: int = 3
    foreign: int = 700
    foreign_weight: float = 0.5
    unknown_table: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.width < 1 or self.views < 1 or not 0 <= self.unknown_table <= 1:
            raise InvalidOption("width and views must be at least 1, unknown_table a share between 0 and 1")


def train_classifier(
    config: ClassifierConfig, *, out: Path, cache: Path = CACHE, workers: int = 1, report=None
) -> dict[str, object]:
    """Train, calibrate on val, measure on test, and write classifier.safetensors with its card.

    Args:
        config: Schedule.
        out: Folder of the weights.
        cache: Folder of rendered views and of the checkpoint; a later call goes on from there.
        workers: Processes that render.
        report: Told the step and the mean loss.

    Returns:
        The metrics of the card.
    """
    examples = family_examples("train", num_views=config.views, workers=workers, folder=cache)
    foreign = foreign_examples(config.foreign, seed=config.seed, workers=workers, folder=cache)
    pool, targets, weights = _tensors(examples + foreign, config)
    torch.manual_seed(config.seed)
    network, hours = train(
        CategoryNet(len(FAMILIES), width=config.width),
        _augmented_batches(pool, targets, weights, config),
        _loss,
        config=config,
        checkpoint=cache / f"classifier_{config.seed}_{config.steps}_{config.width}.pt",
        report=report,
    )
    network = network.half().float()  # measured as it will be loaded
    temperature = _temperature(network, family_examples("val", num_views=2, workers=workers, folder=cache))
    test = family_examples("test", num_views=4, workers=workers, folder=cache)
    outside = foreign_examples(150, seed=config.seed + 1, workers=workers, folder=cache)
    metrics = {"temperature": round(temperature, 4), **_measure(network, temperature, test, outside)}
    data = {
        "classes": list(FAMILIES),
        "train": f"procedural train split: {len(examples)} views, {config.views} a shape; {len(foreign)} foreign ones",
    }
    weights_path = out / "classifier.safetensors"
    card_path = write_weights(network, weights_path, config=config, data=data, hours=hours, metrics=metrics)
    card = json.loads(card_path.read_text(encoding="utf-8"))
    card["command"] = f"python -m gfp_grasp.train.classifier --seed {config.seed} --steps {config.steps}"
    card_path.write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    return metrics


def _tensors(examples: list[Example], config: ClassifierConfig) -> tuple[Tensor, Tensor, Tensor]:
    """Pools of points (e, POOL_POINTS, 6) above the table, targets (e, k) and weights (e,)."""
    rng = np.random.default_rng(config.seed)
    pool, targets, weights = [], [], []
    for example in examples:
        points = example.points[example.points[:, 2] > FLOOR_M]
        if len(points) < 30:
            continue
        pool.append(with_surface(sample_points(points, POOL_POINTS, rng)).astype(np.float32))
        target = np.zeros(len(FAMILIES), dtype=np.float32)
        named = [FAMILIES.index(answer) for answer in example.answers] or list(range(len(FAMILIES)))
        target[named] = 1 / len(named)
        targets.append(target)
        weights.append(1.0 if example.answers else config.foreign_weight)
    return torch.from_numpy(np.stack(pool)), torch.from_numpy(np.stack(targets)), torch.tensor(weights)


def _augmented_batches(pool: Tensor, targets: Tensor, weights: Tensor, config: ClassifierConfig):
    """Endless batches: any yaw, mirrored, stretched a little, noisier, cropped, thinner, the table known or not."""

    def stream(generator: torch.Generator):
        rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        while True:
            order = rng.permutation(len(pool))
            for start in range(0, len(order) - config.batch + 1, config.batch):
                index = order[start : start + config.batch]
                clouds = np.stack([_augmented(pool[k].numpy(), rng, config) for k in index])
                yield torch.from_numpy(features(clouds)), targets[index], weights[index]

    return stream


def _augmented(cloud: np.ndarray, rng: np.random.Generator, config: ClassifierConfig) -> np.ndarray:
    points, surface = cloud[:, :3] * rng.uniform(0.93, 1.07, 3), cloud[:, 3:]
    if rng.random() < 0.1:  # a part is hidden
        along = points @ rng.normal(size=3)
        seen = along > np.quantile(along, rng.uniform(0.0, 0.4))
        points, surface = points[seen], surface[seen]
    kept = rng.permutation(len(points))[: _TRAIN_POINTS if rng.random() < 0.7 else int(rng.integers(80, _TRAIN_POINTS))]
    points = points[kept] + rng.normal(scale=rng.uniform(0, 0.0015), size=(len(kept), 3))
    yaw, mirror = rng.uniform(0, 2 * np.pi), rng.choice([-1.0, 1.0])
    c, s = np.cos(yaw), np.sin(yaw)
    points = points @ np.array([[c, s * mirror, 0], [-s, c * mirror, 0], [0, 0, 1]])
    table = None if rng.random() < config.unknown_table else SupportPlane(UP, rng.normal(scale=0.002))
    points = upright_points(points, UP, table)
    points[:, :2] += rng.normal(scale=0.004, size=2)
    return sample_points(np.column_stack([points, surface[kept]]), _TRAIN_POINTS, rng)


def _loss(network: nn.Module, batch: tuple[Tensor, ...]) -> Tensor:
    clouds, targets, weights = batch
    each = nn.functional.cross_entropy(network(clouds), targets, reduction="none", label_smoothing=0.01)
    return (each * weights).sum() / weights.sum()


def _temperature(network: nn.Module, examples: list[Example]) -> float:
    """The temperature with the smallest negative log likelihood of a right answer (arXiv:1706.04599)."""
    logits = _logits(network, examples, table_known=True)
    accepted = np.array([[family in example.answers for family in FAMILIES] for example in examples])
    candidates = np.geomspace(0.3, 5.0, 57)
    losses = [-np.log(np.maximum((_softmax(logits / t) * accepted).sum(axis=1), 1e-9)).mean() for t in candidates]
    return float(candidates[int(np.argmin(losses))])


def _measure(network: nn.Module, temperature: float, test: list[Example], outside: list[Example]) -> dict[str, object]:
    scores = _softmax(_logits(network, test, table_known=True) / temperature)
    right = _right(scores, test)
    strict = np.array([FAMILIES[k] in e.answers for k, e in zip(scores.argmax(axis=1), test, strict=True)])
    resting = np.array([example.resting for example in test])
    return {
        "test_views": len(test),
        "accuracy": round(float(right.mean()), 4),
        "accuracy_cups_named_cup": round(float(strict.mean()), 4),
        "accuracy_by_rest": {str(rest): round(float(right[resting == rest].mean()), 4) for rest in np.unique(resting)},
        "accuracy_table_unknown": round(float(_right(_logits(network, test, table_known=False), test).mean()), 4),
        "mean_top_score": round(float(scores.max(axis=1).mean()), 4),
        "mean_top_score_foreign": round(
            float(_softmax(_logits(network, outside, table_known=True) / temperature).max(axis=1).mean()), 4
        ),
    }


def _right(scores: np.ndarray, examples: list[Example]) -> np.ndarray:
    best = scores.argmax(axis=1)
    return np.array([FAMILIES[k] in example.accepted for k, example in zip(best, examples, strict=True)])


def _logits(network: nn.Module, examples: list[Example], *, table_known: bool) -> np.ndarray:
    rng = np.random.default_rng(0)
    table = SupportPlane(UP, 0.0) if table_known else None
    clouds = []
    for example in examples:
        above = example.points[example.points[:, 2] > FLOOR_M]
        above = above if len(above) else example.points
        pool = with_surface(sample_points(upright_points(above, UP, table), POOL_POINTS, rng))
        clouds.append(features(sample_points(pool, NUM_POINTS, rng)))
    with torch.inference_mode():
        return torch.cat([network(part) for part in torch.from_numpy(np.stack(clouds)).split(64)]).double().numpy()


def _softmax(logits: np.ndarray) -> np.ndarray:
    raised = np.exp(logits - logits.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=ClassifierConfig.steps)
    parser.add_argument("--out", type=Path, default=Path("gfp_grasp/weights"))
    parser.add_argument("--cache", type=Path, default=CACHE)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    metrics = train_classifier(
        ClassifierConfig(seed=options.seed, steps=options.steps, batch=ClassifierConfig.batch),
        out=options.out,
        cache=options.cache,
        workers=options.workers,
        report=lambda step, loss: sys.stderr.write(f"step {step}: loss {loss:.4f}\n"),
    )
    sys.stderr.write(f"{metrics}\n")


if __name__ == "__main__":
    main()
