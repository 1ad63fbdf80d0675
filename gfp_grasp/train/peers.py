"""Trains the networks that GFPNet is compared with: all on the same views, each with the loss of its paper.

`gfp-grasp train peer NAME` renders, trains and measures in the metric way, with `--true-box` in that of the papers,
which goes on from the weights of the metric way. The schedules take about forty minutes of one core each (EPYC with
AVX-512, one thread, nothing beside it), those in the true box ten; how long each took is on its card.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn

from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.peers import (
    AmortisedFit,
    PeerNetwork,
    PointNetwork,
    ShapePrior,
    complete_by_peer,
    get_peer,
    load_network,
    make_network,
    weights_stem,
)
from gfp_grasp.shapes import HOUSEHOLD, IN_PAPER, get_family
from gfp_grasp.train.curves import LearningCurve
from gfp_grasp.train.loop import LoopConfig, train, training_key, weights_place, write_weights
from gfp_grasp.train.peer_data import PeerView, peer_views
from gfp_grasp.train.peer_losses import Lesson, lesson_batches, lesson_of, make_batch, prior_lesson
from gfp_grasp.transforms import apply_T

# What the card's figures are of: households, and the classes of the paper's table that are none.
CLASSES = tuple(dict.fromkeys((*HOUSEHOLD, *IN_PAPER)))
_CURVE_VIEWS = 32  # of the validation split, that each point of a learning curve is measured on
_SAMPLES = 4096


@dataclass(frozen=True)
class PeerConfig(LoopConfig):
    """Schedule and data of a peer.

    Attributes:
        members: Members of each class.
        views: Views of each member.
        prior_share: Share of the steps that a shape prior is trained in; only `3d-sc` has one, in either cube.
    """

    rate: float = 1e-3
    decay: float = 0.7
    members: int = 120
    views: int = 4
    prior_share: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.members < 1 or self.views < 1 or not 0 <= self.prior_share < 1:
            raise InvalidOption("members and views must be at least 1, prior_share from 0 to less than 1")


# Forty minutes of one core each, as the seconds of a step were measured.
PEER_CONFIGS: Mapping[str, PeerConfig] = {
    "pcn": PeerConfig(steps=7_000, batch=16),
    "foldingnet": PeerConfig(steps=6_500, batch=16),
    "topnet": PeerConfig(steps=13_000, batch=16),
    "3d-epn": PeerConfig(steps=11_500, batch=16),
    "3d-sc": PeerConfig(steps=4_400, batch=16, prior_share=0.5),
    "scrg": PeerConfig(steps=5_000, batch=16),
}

_GOES_ON = 1 / 4  # of the steps and of the rate: what the true box takes after the metric way


def peer_config(name: str, *, true_box: bool) -> PeerConfig:
    """Schedule of a peer in either way.

    Raises:
        InvalidOption: No such peer.
    """
    get_peer(name)
    config = PEER_CONFIGS[name]
    if not true_box:
        return config
    return replace(config, steps=round(_GOES_ON * config.steps), rate=_GOES_ON * config.rate)


def train_peer(
    name: str,
    *,
    true_box: bool = False,
    config: PeerConfig | None = None,
    classes: Sequence[str] | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train a peer, measure its completions of the validation split and write weights and card.

    Args:
        name: One of `gfp_grasp.peers.PEERS`.
        true_box: Learn in the cube around the true box, in place of that around what was seen, from the weights that
            the peer has there.
        config: Schedule and data; None takes those of `peer_config`.
        classes: Procedural families; None takes CLASSES.
        out: Weights file; None is the shipped one.
        runs: Folder of views, truths and checkpoints; a later call goes on from there.
        workers: Processes that render.
        report: Told the step and the loss.

    Returns:
        Path of the card.

    Raises:
        InvalidOption: No such peer.
        UnknownCategory: No such family.
        NotTrained: The metric way, which the true box goes on from, has no weights.
        CannotWrite: `out` or `runs`.
    """
    config = config or peer_config(name, true_box=true_box)
    classes = tuple(classes or CLASSES)
    for family in classes:
        get_family(family)
    out = weights_place(out, weights_stem(name, true_box=true_box), runs=runs)
    start = deepcopy(load_network(name, true_box=False)) if true_box else None
    how = {"true_box": true_box, "runs": runs, "workers": workers}
    views = peer_views(classes, "train", members=config.members, num_views=config.views, **how)
    val = peer_views(classes, "val", members=max(1, config.members // 15), num_views=1, **how)
    own = () if start is None else (tensor.numpy() for tensor in start.state_dict().values())
    made_from = [_digest(arrays) for arrays in (_arrays_of(views), _arrays_of(val), own)]
    key = training_key(name, true_box, config, classes, *made_from)
    course = _Course(config, views, val, runs / "peers", key, report)
    network, hours, curves = _trained(name, course, start)
    network.half().float()  # measured as it will be loaded
    return write_weights(
        network,
        out,
        config=config,
        data={
            "classes": classes,
            "split": "train",
            "true_box": true_box,
            "views": len(views),
            "start": weights_stem(name, true_box=False) if true_box else None,
        },
        hours=hours,
        metrics={"val": measure_peer(name, network, val, true_box=true_box)},
        extra=curves,
    )


def measure_peer(name: str, network: PeerNetwork, views: Sequence[PeerView], *, true_box: bool) -> dict[str, object]:
    """Chamfer distances of completions, by class and as the mean of all views that have an answer.

    Args:
        name: The peer.
        network: Its network.
        views: What is completed.
        true_box: Whether it is told the true box.

    Returns:
        Number of views and of those without an answer; `cd_m` of the meshes, in metres; `cd_boxes`, in longest sides of
        true boxes; and `points_cd_m`, in metres, of the points themselves, where the network answers with points.
    """
    found: dict[str, list[tuple[float, ...]]] = {}
    failed = 0
    for number, view in enumerate(views):
        T, rng = view.view.T_world_object, np.random.default_rng(number)
        box = view.truth.box(T)
        try:
            shape = complete_by_peer(view.view.detection(), name, box=box if true_box else None, network=network)
            points = visible_surface(shape.mesh, _SAMPLES, rng)
        except GfpGraspError:
            failed += 1
            continue
        truth = apply_T(T, view.truth.points)
        cd_m = chamfer_m(points, truth)
        row = (cd_m, cd_m / float(box.extents.max()))
        if isinstance(network, PointNetwork):
            row = (*row, chamfer_m(view.cube.outward(network.finest(view.seen)), truth))
        for key in ("all", view.view.family):
            found.setdefault(key, []).append(row)
    means = {key: np.mean(rows, axis=0) for key, rows in found.items()}
    names = ("cd_m", "cd_boxes", "points_cd_m")[: 3 if isinstance(network, PointNetwork) else 2]
    columns = {name: {key: round(float(mean[i]), 5) for key, mean in means.items()} for i, name in enumerate(names)}
    return {"views": len(views), "failed": failed, **columns}


def _arrays_of(views: Sequence[PeerView]) -> Iterator[np.ndarray]:
    """What views are made of: other views or truths make another training."""
    yield from (view.seen.points for view in views)
    for truth in dict.fromkeys(view.truth for view in views):
        yield from (truth.points, truth.distance, truth.wall)


def _digest(arrays: Iterable[np.ndarray]) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for array in arrays:
        digest.update(array.tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class _Course:
    """All that the trainings of one peer share."""

    config: PeerConfig
    views: Sequence[PeerView]
    val: Sequence[PeerView]
    folder: Path
    key: str
    report: Callable[[int, float], None] | None

    def run(self, network: nn.Module, lesson: Lesson, *, steps: int, part: str, before: int = 0):
        """Train a network; it, its hours and its learning curve.

        Args:
            network: Freshly made.
            lesson: How it learns.
            steps: Number of steps of the optimiser.
            part: Name of this training, for its files.
            before: Steps that other parts took.
        """
        config = replace(self.config, steps=steps)
        every = max(1, len(self.val) // _CURVE_VIEWS)
        held_out = make_batch(self.val[::every][:_CURVE_VIEWS], lesson, np.random.default_rng(config.seed))
        report = self.report

        def then(step: int, loss: float) -> None:
            if report is not None:
                report(before + step, loss)

        path = self.folder / f"{self.key}_{part}_curve.json"
        curve = LearningCurve(network, lesson.loss_of_batch, held_out, config.bf16, path, then)
        trained, hours = train(
            network,
            lesson_batches(self.views, lesson, config.batch),
            lesson.loss_of_batch,
            config=config,
            checkpoint=self.folder / f"{self.key}_{part}.pt",
            report=curve,
        )
        return trained, hours, curve.points


def _trained(name: str, course: _Course, start: PeerNetwork | None) -> tuple[PeerNetwork, float, dict[str, object]]:
    """The trained network of a peer, the hours of all its parts, and its learning curves for the card.

    Args:
        name: The peer.
        course: Views and schedule.
        start: What is trained on; None starts anew.
    """
    torch.manual_seed(course.config.seed)
    steps, hours, curves = course.config.steps, 0.0, {}
    network, before = start or make_network(name), 0
    if isinstance(network, AmortisedFit):
        before, prior = max(1, round(course.config.prior_share * steps)), ShapePrior()
        if start is not None:
            prior.decode.load_state_dict(network.decode.state_dict())
        prior, hours, points = course.run(prior, prior_lesson(), steps=before, part="prior")
        assert isinstance(prior, ShapePrior)
        network.decode.load_state_dict(prior.decode.state_dict())
        curves["learning_curve_of_prior"] = points
    trained, own_hours, points = course.run(
        network, lesson_of(name), steps=max(1, steps - before), part="own", before=before
    )
    assert isinstance(trained, PeerNetwork)
    return trained, hours + own_hours, {"learning_curve": points, **curves}
