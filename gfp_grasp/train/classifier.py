"""Trains the classifier's embedding, and makes the prototypes that a class is known by.

`gfp-grasp train classifier` renders, trains, calibrates and measures. Each class that it learns from has proxies, unit
vectors that its views are drawn to (SoftTriple, arXiv:1909.05235). Beside the classes and their subcategories there are
dozens of kinds of other things, so that the embedding carries over to classes that it never saw. The proxies are thrown
away; a class is known by its prototypes.

Prototypes are embedded views of a class's members, a few that stand for all of them. Where the members are not at hand,
they are those that the primitive was built from, as its own modes and scale say they were: prototypes can be made anew
for another network from the primitive alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.cluster.vq import kmeans2
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.detect import FLOOR_M, EmbeddingNet, Prototypes, embed, mixture
from gfp_grasp.parallel import one_thread
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train.calibration import calibrate, embedded, measure
from gfp_grasp.train.classifier_data import (
    CACHE,
    VIEWS,
    ClassifierConfig,
    Example,
    alike_in,
    assorted_examples,
    augmented_batches,
    class_examples,
    make_targets,
)
from gfp_grasp.train.loop import train, write_weights
from gfp_grasp.train.views import views_of_mesh
from gfp_grasp.types import GenericPrimitive, SupportPlane

NUM_PROTOTYPES = 16
_NUM_VIEWS = 192  # of all members together: ten seconds
_TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)


@one_thread()
def make_prototypes(
    primitive: GenericPrimitive,
    *,
    meshes: Sequence[trimesh.Trimesh] | None = None,
    network: EmbeddingNet | None = None,
    seed: int = 0,
    num_views: int = _NUM_VIEWS,
) -> np.ndarray:
    """Look at the members of a class from all sides, as they rest, and keep what is typical.

    Args:
        primitive: Primitive of a class or of a subcategory.
        meshes: Its members, m, z up; None takes what the primitive says of those that it was built from.
        network: Network that embeds; None takes the shipped one.
        seed: Seed of the views and of the clustering.
        num_views: Number of views of all members together.

    Returns:
        (k, c) unit vectors, k at most NUM_PROTOTYPES.
    """
    rng = np.random.default_rng(seed)
    count = len(primitive.coefficient_samples) if meshes is None else len(meshes)
    embedded = []
    for number in np.resize(rng.permutation(count), num_views).tolist():
        mesh = _member(primitive, number) if meshes is None else meshes[number]
        for view in views_of_mesh(ObjectSource(primitive.name, primitive.name), mesh, rng, num_views=1, config=VIEWS):
            above = view.points[view.points[:, 2] > FLOOR_M]
            if len(above):
                embedded.append(embed(above, _TABLE.normal, _TABLE, network=network))
    return cluster(np.array(embedded), seed=seed)


def _member(primitive: GenericPrimitive, number: int) -> trimesh.Trimesh:
    """One of the members that a primitive was built from, as its modes and scale give it."""
    coefficients, log_scale = np.split(primitive.coefficient_samples[number], [len(primitive.modes)])
    return trimesh.Trimesh(primitive.shape(coefficients, np.exp(log_scale)), primitive.faces, process=False)


def with_prototypes(
    primitive: GenericPrimitive, *, meshes: Sequence[trimesh.Trimesh] | None = None, seed: int = 0
) -> GenericPrimitive:
    """The primitive with prototypes of the shipped network, whose sha256 its card then names."""
    weights = data_file("weights", "classifier.safetensors")
    card = {**primitive.card, "prototypes_sha256": hashlib.sha256(weights.read_bytes()).hexdigest()}
    return replace(primitive, prototypes=make_prototypes(primitive, meshes=meshes, seed=seed), card=card)


def cluster(embedded: np.ndarray, *, count: int = NUM_PROTOTYPES, seed: int = 0) -> np.ndarray:
    """Unit vectors (k, c) that stand for embedded views (n, c): the middles of k-means clusters, k at most count."""
    if len(embedded) <= count:
        return embedded
    middles, labels = kmeans2(embedded, count, minit="++", rng=np.random.default_rng(seed))
    middles = middles[np.bincount(labels, minlength=count) > 0]
    return middles / np.linalg.norm(middles, axis=1, keepdims=True)


_MOST_VIEWS = 400  # of a class, that its prototypes are made from
_HELD_OUT_KIND = 1000  # kinds from here on are never learnt from: they calibrate, and from 2000 on they measure


class _WithProxies(nn.Module):
    """The network with what its training needs."""

    def __init__(self, config: ClassifierConfig, class_of: Tensor) -> None:
        super().__init__()
        self.embedding = EmbeddingNet(config.channels, width=config.width)
        self.proxies = nn.Parameter(torch.randn(len(class_of), config.proxies, config.channels))
        self.log_sharpness = nn.Parameter(torch.tensor(2.7))
        self.class_of: Tensor
        self.register_buffer("class_of", class_of)

    def forward(self, clouds: Tensor) -> tuple[Tensor, Tensor]:
        """Logits (b, a) of classes and (b, kinds) of kinds."""
        embedded = self.embedding(clouds)
        with torch.autocast(clouds.device.type, enabled=False):
            near = torch.einsum("bc,kpc->bkp", embedded.float(), nn.functional.normalize(self.proxies, dim=2))
            kinds = (near * self.log_sharpness.exp()).logsumexp(dim=2)
            highest = kinds.amax(dim=1, keepdim=True)
            raised = torch.zeros(len(kinds), int(self.class_of.max()) + 1, device=clouds.device)
            raised = raised.index_add(1, self.class_of, (kinds - highest).exp())
            return raised.clamp_min(1e-12).log() + highest, kinds


def train_classifier(
    config: ClassifierConfig = ClassifierConfig(),
    *,
    classes: Sequence[str] | None = None,
    data: Path | None = None,
    out: Path,
    cache: Path = CACHE,
    workers: int = 1,
    report=None,
) -> dict[str, object]:
    """Train, calibrate on val, measure on test, and write classifier.safetensors with its card.

    Args:
        config: Schedule.
        classes: Classes to learn from, beside the kinds of other things; None takes those that ship.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        out: Folder of the weights.
        cache: Folder of rendered views and of the checkpoint; a later call goes on from there.
        workers: Processes that render.
        report: Told the step and the mean loss.

    Returns:
        The metrics of the card.
    """

    classes = tuple(classes or PrimitiveLibrary.shipped().categories)

    def views(split: str, num_views: int) -> list[Example]:
        limit = config.limit if split == "train" or config.limit is None else max(1, config.limit // 4)
        return [
            example
            for name in classes
            for example in class_examples(
                name,
                split,
                num_views=num_views,
                alike=alike_in(classes, name),
                limit=limit,
                data=data,
                workers=workers,
                folder=cache,
            )
        ]

    def others(first: int, count: int, members: int) -> list[Example]:
        kinds = range(first, first + count)
        return assorted_examples(kinds, num_members=members, num_views=2, workers=workers, folder=cache)

    examples, assorted = views("train", config.views), others(0, config.kinds, config.members)
    targets = make_targets(examples, assorted, config, cache)
    torch.manual_seed(config.seed)
    network, hours = train(
        _WithProxies(config, targets.class_of),
        augmented_batches(targets, config),
        lambda network, batch: _loss(network, batch, config),
        config=config,
        checkpoint=cache / f"classifier_{_key(config, classes)}.pt",
        report=report,
    )
    assert isinstance(network, _WithProxies)
    network = network.embedding.half().float()  # measured as it will be loaded
    prototypes = _prototypes(network, examples, config.seed)
    held_out = max(1, config.kinds // 10)
    calibration = calibrate(network, prototypes, views("val", 2), others(_HELD_OUT_KIND, held_out, 2))
    test, outside = views("test", 4), others(2 * _HELD_OUT_KIND, held_out, 2)
    metrics = {
        "temperature": round(calibration.temperature, 5),
        "reach": round(calibration.reach, 5),
        **measure(network, prototypes, calibration, test, outside),
    }
    write_weights(
        network,
        out / "classifier.safetensors",
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


def _loss(network: nn.Module, batch: tuple[Tensor, ...], config: ClassifierConfig) -> Tensor:
    clouds, classes, kind = batch
    class_logits, kind_logits = network(clouds)
    value = nn.functional.cross_entropy(class_logits, classes, label_smoothing=0.01)
    return value + config.kind_weight * nn.functional.cross_entropy(kind_logits, kind.long(), ignore_index=-1)


def _prototypes(network: EmbeddingNet, examples: Sequence[Example], seed: int) -> dict[str, Prototypes]:
    """Prototypes of the classes from the very views that they were learnt from."""
    by_class: dict[str, list[Example]] = {}
    for example in examples:
        by_class.setdefault(example.category, []).append(example)
    return {
        name: mixture([cluster(embedded(network, own[:: -(-len(own) // _MOST_VIEWS)]), seed=seed)], [1.0])
        for name, own in by_class.items()
    }


def _key(config: ClassifierConfig, classes: Sequence[str]) -> str:
    return hashlib.sha256(repr((config, tuple(classes))).encode()).hexdigest()[:10]
