"""What each peer is handed in training, and its loss, as its paper has it.

Letters: b views, n points, m points of the truth, x, y, z cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.peers import (
    NUM_INPUT,
    Seen,
    likelihood_loss,
    log_distance_loss,
    network_class,
    prior_loss,
)
from gfp_grasp.train.loop import Batch
from gfp_grasp.train.peer_data import PeerView

_TRUE_POINTS = 1024  # drawn anew for each batch
_NEAREST = 1e-6  # sides of the cube: nearer points have no gradient of their distance


@dataclass(frozen=True)
class Lesson:
    """How one network learns.

    Attributes:
        given: What it is handed of what was seen; None where that is nothing.
        truth: What it is compared with; None where that is nothing.
        loss: Scalar of the network, what was given (b, ...) and the truth (b, ...).
    """

    given: Callable[[Seen, np.random.Generator], np.ndarray] | None
    truth: Callable[[PeerView, np.random.Generator], np.ndarray] | None
    loss: Callable[[nn.Module, Tensor, Tensor], Tensor]

    def loss_of_batch(self, network: nn.Module, batch: Batch) -> Tensor:
        """The loss in the form that the training loop takes."""
        given, truth = batch
        return self.loss(network, given, truth)


def lesson_of(name: str) -> Lesson:
    """The lesson of a peer; that of `3d-sc` is of its second encoder.

    Raises:
        InvalidOption: No such peer.
    """
    network = network_class(name)
    if network.resolution is None:
        return Lesson(_some_points, _true_points, _point_loss)
    # Its second encoder never sees a true shape.
    truth = None if name == "3d-sc" else _true_distances(network.resolution)
    return Lesson(lambda seen, rng: network.given(seen), truth, _GRID_LOSSES[name])


def prior_lesson() -> Lesson:
    """The lesson of the shape prior of `3d-sc`, which sees nothing but true shapes."""
    resolution = network_class("3d-sc").resolution
    assert resolution is not None
    return Lesson(None, _true_distances(resolution), lambda network, given, truth: prior_loss(network, truth))


def chamfer(a: Tensor, b: Tensor) -> Tensor:
    """Mean Chamfer distance of point sets (b, n, 3) and (b, m, 3): mean nearest distances of both ways, summed.

    Source: PCN, equation 1.
    """
    a, b = a.float(), b.float()
    return _mean_distance(a, b) + _mean_distance(b, a)


def _mean_distance(points: Tensor, others: Tensor) -> Tensor:
    near = torch.gather(others, 1, _nearest(points.detach(), others.detach())[..., None].expand(-1, -1, 3))
    return (points - near).square().sum(dim=2).clamp_min(_NEAREST**2).sqrt().mean()


def _nearest(points: Tensor, others: Tensor) -> Tensor:
    """Index (b, n) of the nearest of others (b, m, 3) for each of points (b, n, 3)."""
    if points.device.type != "cpu":
        return torch.cdist(points, others).argmin(dim=2)
    # On a CPU, trees take a tenth of the time of all distances.
    found = [KDTree(to.numpy()).query(own.numpy())[1] for own, to in zip(points, others, strict=True)]
    return torch.from_numpy(np.stack(found))


def _point_loss(network: nn.Module, given: Tensor, truth: Tensor) -> Tensor:
    """The sum of the Chamfer distances of all point sets that a network answers with."""
    distances = [chamfer(points, truth) for points in network(given)]
    return torch.stack(distances).sum()


def _epn_loss(network: nn.Module, given: Tensor, truth: Tensor) -> Tensor:
    return log_distance_loss(network(given).float(), truth.abs(), given[:, 1] < 0)


def _sc_loss(network: nn.Module, given: Tensor, truth: Tensor) -> Tensor:
    return likelihood_loss(network, given)


def _scrg_loss(network: nn.Module, given: Tensor, truth: Tensor) -> Tensor:
    return functional.binary_cross_entropy_with_logits(network(given).float(), (truth <= 0).float())


_GRID_LOSSES: Mapping[str, Callable[[nn.Module, Tensor, Tensor], Tensor]] = {
    "3d-epn": _epn_loss,
    "3d-sc": _sc_loss,
    "scrg": _scrg_loss,
}


def lesson_batches(
    views: Sequence[PeerView], lesson: Lesson, batch: int
) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Endless batches of views, pass after pass; half of them in the mirror y = 0 of the cube."""

    def stream(generator: torch.Generator) -> Iterator[Batch]:
        rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        while True:
            order = rng.permutation(len(views))
            for start in range(0, max(len(order) - batch, 0) + 1, batch):
                chosen = [views[index] for index in order[start : start + batch]]
                yield make_batch(chosen, lesson, rng, mirrored=rng.random(len(chosen)) < 0.5)

    return stream


def make_batch(
    views: Sequence[PeerView], lesson: Lesson, rng: np.random.Generator, *, mirrored: np.ndarray | None = None
) -> Batch:
    """What is handed over of views (b, ...), and their truth (b, ...); zeros (b, 0) where that is nothing.

    Args:
        views: So many are a batch.
        lesson: What is handed over.
        rng: Draws points.
        mirrored: (b,) bool, which of them are seen in the mirror y = 0; None is none of them.
    """
    nothing = np.zeros(0, dtype=np.float32)
    rows = []
    for number, view in enumerate(views):
        flip = mirrored is not None and bool(mirrored[number])
        given = nothing if lesson.given is None else lesson.given(view.seen.mirrored() if flip else view.seen, rng)
        truth = nothing if lesson.truth is None else lesson.truth(view, rng)
        rows.append((given, _mirrored(truth) if flip else truth))
    given, truth = (np.stack(column) for column in zip(*rows, strict=True))
    return torch.from_numpy(given), torch.from_numpy(truth)


def _mirrored(truth: np.ndarray) -> np.ndarray:
    """Points (m, 3) or cells (x, y, z) in the mirror y = 0."""
    if truth.ndim == 3:
        return truth[:, ::-1]
    return truth * np.array([1, -1, 1], dtype=np.float32) if truth.ndim == 2 else truth


def _some_points(seen: Seen, rng: np.random.Generator) -> np.ndarray:
    return _drawn(seen.points, NUM_INPUT, rng)


def _true_points(view: PeerView, rng: np.random.Generator) -> np.ndarray:
    return _drawn(view.points(), _TRUE_POINTS, rng)


def _drawn(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return points[rng.choice(len(points), count, replace=len(points) < count)].astype(np.float32)


def _true_distances(resolution: int) -> Callable[[PeerView, np.random.Generator], np.ndarray]:
    return lambda view, rng: view.distances(resolution)
