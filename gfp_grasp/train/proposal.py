"""Trains the network that looks at an object once: its class's embedding, how it rests and is turned, its box.

`gfp-grasp train proposal` renders, trains, calibrates and measures. Each class that it learns from has proxies, unit
vectors that its views are drawn to (SoftTriple, arXiv:1909.05235). Beside the classes and their subcategories there are
dozens of kinds of other things, so that the embedding carries over to classes that it never saw. The proxies are thrown
away; a class is known by its prototypes. Axes are learnt as vectors: where the points do not say which of several it
is, the answer is their mean, and its length says how sure it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

from gfp_grasp.detect import PROTOTYPES, Look, ProposalNet, Prototypes, mixture
from gfp_grasp.shapes import FAMILIES, TRAFFIC
from gfp_grasp.train.calibration import calibrate, embedded, measure, measure_pose
from gfp_grasp.train.loop import train, training_key, weights_place, write_weights
from gfp_grasp.train.proposal_batches import ProposalConfig, augmented_batches, make_targets
from gfp_grasp.train.proposal_data import CACHE, Example, assorted_examples, class_examples
from gfp_grasp.train.prototypes import cluster
from gfp_grasp.types import TABLETOP, get_sensor

_FAR = 1e3
_MOST_VIEWS = 400  # of a class, that its prototypes are made from
_HELD_OUT_KIND = 1000  # kinds from here on are never learnt from: they calibrate, and from 2000 on they measure


class _WithProxies(nn.Module):
    """The network with what its training needs."""

    def __init__(self, config: ProposalConfig, class_of: Tensor) -> None:
        super().__init__()
        self.network = ProposalNet(config.channels, width=config.width)
        self.proxies = nn.Parameter(torch.randn(len(class_of), config.proxies, config.channels))
        self.log_sharpness = nn.Parameter(torch.tensor(2.7))
        self.class_of: Tensor
        self.register_buffer("class_of", class_of)

    def forward(self, clouds: Tensor) -> tuple[Tensor, Tensor, Look[Tensor]]:
        """Logits (b, a) of classes and (b, kinds) of kinds, and all that the network says."""
        seen = self.network(clouds)
        with torch.autocast(clouds.device.type, enabled=False):
            near = torch.einsum("bc,kpc->bkp", seen.embedding.float(), nn.functional.normalize(self.proxies, dim=2))
            kinds = (near * self.log_sharpness.exp()).logsumexp(dim=2)
            highest = kinds.amax(dim=1, keepdim=True)
            raised = torch.zeros(len(kinds), int(self.class_of.max()) + 1, device=clouds.device)
            raised = raised.index_add(1, self.class_of, (kinds - highest).exp())
            return raised.clamp_min(1e-12).log() + highest, kinds, seen


def train_proposal(
    config: ProposalConfig = ProposalConfig(),
    *,
    classes: Sequence[str] | None = None,
    data: Path | None = None,
    out: Path,
    cache: Path = CACHE,
    workers: int = 1,
    report=None,
) -> dict[str, object]:
    """Train, calibrate on val, measure on test, and write the weights with their card.

    Those of depth cameras are proposal.safetensors, those of a LiDAR proposal_lidar.safetensors, which holds the
    prototypes of its classes as well.

    Args:
        config: Schedule.
        classes: Classes to learn from, beside the kinds of other things; None takes all procedural families, for a
            LiDAR those of traffic.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        out: Folder of the weights.
        cache: Folder of rendered views and of the checkpoint; a later call goes on from there.
        workers: Processes that render.
        report: Told the step and the mean loss.

    Returns:
        The metrics of the card.

    Raises:
        CannotWrite: `out` or `cache`.
    """
    sensor = get_sensor(config.sensor)
    stem = "proposal" if sensor is TABLETOP else f"proposal_{sensor.name}"
    file = weights_place(out / f"{stem}.safetensors", stem, runs=cache)
    classes = tuple(classes or (FAMILIES if sensor is TABLETOP else TRAFFIC))

    def views(split: str, num_views: int) -> list[Example]:
        limit = config.limit if split == "train" or config.limit is None else max(1, config.limit // 4)
        return [
            example
            for name in classes
            for example in class_examples(
                name,
                split,
                num_views=num_views,
                classes=classes,
                limit=limit,
                data=data,
                sensor=sensor,
                workers=workers,
                folder=cache,
            )
        ]

    def others(first: int, count: int, members: int) -> list[Example]:
        how = {"num_members": members, "num_views": 2, "sensor": sensor, "workers": workers, "folder": cache}
        return assorted_examples(first, count, **how)

    examples, assorted = views("train", config.views), others(0, config.kinds, config.members)
    targets = make_targets(examples, assorted, config, cache)
    torch.manual_seed(config.seed)
    network, hours = train(
        _WithProxies(config, targets.class_of),
        augmented_batches(targets, config),
        lambda network, batch: _loss(network, batch, config),
        config=config,
        checkpoint=cache / f"proposal_{training_key(config, tuple(classes))}.pt",
        report=report,
    )
    assert isinstance(network, _WithProxies)
    network = network.network.half().float()  # measured as it will be loaded
    prototypes = _prototypes(network, examples, config.seed)
    held_out = max(1, config.kinds // 10)
    calibration = calibrate(network, prototypes, views("val", 2), others(_HELD_OUT_KIND, held_out, 2))
    test, outside = views("test", 4), others(2 * _HELD_OUT_KIND, held_out, 2)
    metrics = {
        "temperature": round(calibration.temperature, 5),
        "reach": round(calibration.reach, 5),
        **measure(network, prototypes, calibration, test, outside),
        **measure_pose(network, test),
    }
    own = {} if sensor is TABLETOP else {f"{PROTOTYPES}{name}": p.vectors for name, p in prototypes.items()}
    write_weights(
        network,
        file,
        beside=own,
        config=config,
        data={
            "classes": list(classes),
            "shapes": "procedural" if data is None else "a folder",
            "views": len(examples),
            "kinds_of_other_things": config.kinds,
            "views_of_other_things": len(assorted),
        },
        hours=hours,
        metrics=metrics,
    )
    return metrics


def _loss(network: nn.Module, batch: tuple[Tensor, ...], config: ProposalConfig) -> Tensor:
    clouds, classes, kind, rests, fronts, pose = batch
    class_logits, kind_logits, seen = network(clouds)
    value = nn.functional.cross_entropy(class_logits, classes, label_smoothing=0.01)
    value = value + config.kind_weight * nn.functional.cross_entropy(kind_logits, kind.long(), ignore_index=-1)
    return value + config.pose_weight * _pose_loss(seen, rests, fronts, pose)


def _pose_loss(seen: Look[Tensor], rests: Tensor, fronts: Tensor, pose: Tensor) -> Tensor:
    """Loss of what rests, up, front, extents and centre are said to be; things without axes of their own have none."""
    own = pose[:, 2, 0].isfinite()
    if not own.any():
        return seen.up.sum() * 0.0
    resting = nn.functional.cross_entropy(seen.rests[own], rests[own].long())
    up = (seen.up - pose[:, 0]).square().sum(dim=1)[own].mean()
    turned = own & fronts[:, 0, 0].isfinite()
    # What is no front is far away: a NaN would reach the gradient through the smallest distance.
    turns = (seen.front[:, None] - fronts.nan_to_num(nan=_FAR)).square().sum(dim=2)
    front = turns.amin(dim=1)[turned].sum() / turned.sum().clamp_min(1)
    box = torch.stack([seen.log_extents, seen.centre], dim=1)[own]
    size = nn.functional.smooth_l1_loss(box, pose[own, 1:], beta=0.1)
    return resting + up + front + 5 * size


def _prototypes(network: ProposalNet, examples: Sequence[Example], seed: int) -> dict[str, Prototypes]:
    """Prototypes of the classes from the very views that they were learnt from."""
    by_class: dict[str, list[Example]] = {}
    for example in examples:
        by_class.setdefault(example.category, []).append(example)
    return {
        name: mixture([cluster(embedded(network, own[:: -(-len(own) // _MOST_VIEWS)]), seed=seed)], [1.0])
        for name, own in by_class.items()
    }
