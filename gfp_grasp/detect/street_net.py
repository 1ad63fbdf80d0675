"""The two networks of the detector of LiDAR scans, after PointRCNN (arXiv:1812.04244), sized for a CPU.

The first stage gives each point above the road its class and a box in bins; the second looks at the points of each box
in the box's own frame, moves the box, and says how sure it is. Where the paper has PointNet++, which a CPU takes
seconds for, the points' features come from a convolutional network on the picture of the scan from above.

Shapes: b pictures, c channels, h and w cells, p points, r boxes, k points of a box, n classes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.detect.turned import to_box

CELL_M = 0.2  # of the picture from above
STRIDE = 2  # cells of the picture a cell of the features
LEVELS_M = (0.2, 0.5, 0.8, 1.1, 1.4, 1.7, 2.0, 2.5, 3.0, 3.7, 4.5)  # heights above the road
CHANNELS = len(LEVELS_M) - 1 + 4
MULTIPLE = 8  # sides of the picture
POINT_CHANNELS = 4
BOX_POINTS = 160  # of a box that the second stage looks at
MARGIN_M = 0.6  # by which a box is grown for it
_FAR_M = 50.0
# Edges of the bins of the way from a point to the middle of its thing, m: fine for people, wide for buses.
_EDGES_M = np.array([0.0, 0.3, 0.7, 1.2, 1.8, 2.6, 3.6, 5.0, 7.0, 10.0])
_REFINE_EDGES_M = np.array([0.0, 0.25, 0.75, 1.5, 2.5])


@dataclass(frozen=True, eq=False)
class Bins:
    """A quantity as one of several bins and a place within the bin.

    Attributes:
        edges: (n + 1,), rising.
    """

    edges: np.ndarray

    @property
    def count(self) -> int:
        """Number of bins."""
        return len(self.edges) - 1

    def encode(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """Number of the bin (...) and the place in it (...), from -1 to 1."""
        edges = torch.as_tensor(self.edges, dtype=values.dtype, device=values.device)
        number = torch.bucketize(values.contiguous(), edges[1:-1], right=True)
        low, high = edges[number], edges[number + 1]
        return number, ((2 * values - low - high) / (high - low)).clamp(-1, 1)

    def decode(self, answer: Tensor) -> Tensor:
        """Values (...) of answers (..., 2 n): odds of the bins, and the place in each."""
        edges = torch.as_tensor(self.edges, dtype=answer.dtype, device=answer.device)
        odds, places = answer.chunk(2, dim=-1)
        number = odds.argmax(dim=-1)
        place = places.gather(-1, number[..., None])[..., 0]
        low, high = edges[number], edges[number + 1]
        return (low + high + place.clamp(-1, 1) * (high - low)) / 2

    def loss(self, answer: Tensor, values: Tensor, weights: Tensor) -> Tensor:
        """Cross-entropy of the bins and smooth L1 of the places, weighted (p,)."""
        number, wanted = self.encode(values)
        odds, places = answer.chunk(2, dim=-1)
        place = places.gather(-1, number[..., None])[..., 0]
        off = functional.smooth_l1_loss(place, wanted, reduction="none", beta=0.2)
        return (weights * (functional.cross_entropy(odds, number, reduction="none") + off)).sum()


def _both_sides(edges: np.ndarray) -> np.ndarray:
    return np.concatenate([-edges[:0:-1], edges])


WAY = Bins(_both_sides(_EDGES_M))
TURN = Bins(np.linspace(-np.pi / 2, np.pi / 2, 13))  # a heading without front and back
SHIFT = Bins(_both_sides(_REFINE_EDGES_M))
TWIST = Bins(np.linspace(-np.pi / 4, np.pi / 4, 10))
_BOX_ANSWERS = 4 * WAY.count + 2 * TURN.count + 4
_REFINED_ANSWERS = 4 * SHIFT.count + 2 * TWIST.count + 4


def picture_from_above(points: np.ndarray, corner: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """What the network sees of a scan.

    Args:
        points: (n, 3) m, x and y from the sensor, z from the road.
        corner: (2,) m, the corner of the picture with least x and y.
        shape: Cells along x and along y.

    Returns:
        (c, h, w) float32: points at each level of height, the highest, lowest and mean height, and the distance from
        the sensor.
    """
    cells = np.floor((points[:, :2] - corner) / CELL_M).astype(np.int64)
    level = np.searchsorted(LEVELS_M, points[:, 2], side="right") - 1
    ok = (cells >= 0).all(axis=1) & (cells < shape).all(axis=1) & (level >= 0) & (level < len(LEVELS_M) - 1)
    flat, z, level = cells[ok, 0] * shape[1] + cells[ok, 1], points[ok, 2], level[ok]
    size = shape[0] * shape[1]
    num_levels = len(LEVELS_M) - 1
    found = np.zeros((CHANNELS, size), dtype=np.float32)
    counts = np.bincount(level * size + flat, minlength=num_levels * size).reshape(num_levels, size)
    found[:num_levels] = np.log1p(counts) / 2
    total = counts.sum(axis=0)
    seen = total > 0
    order = np.argsort(z)
    found[num_levels, flat[order]] = z[order]
    found[num_levels + 1, flat[order[::-1]]] = z[order[::-1]]
    found[num_levels + 2, seen] = np.bincount(flat, z, minlength=size)[seen] / total[seen]
    x, y = (corner[axis] + CELL_M * (np.arange(shape[axis]) + 0.5) for axis in range(2))
    found[num_levels + 3] = np.hypot(x[:, None], y[None]).ravel() / _FAR_M
    return found.reshape(CHANNELS, *shape)


class _Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = _conv(width, width), _conv(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.second(self.first(x))


def _conv(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )


def _layers(*widths: int) -> nn.Sequential:
    parts: list[nn.Module] = []
    for before, after in pairwise(widths):
        parts += [nn.Linear(before, after), nn.LayerNorm(after), nn.ReLU(inplace=True)]
    return nn.Sequential(*parts)


class StreetNet(nn.Module):
    """Both stages."""

    def __init__(self, num_classes: int, width: int = 32) -> None:
        super().__init__()
        self.num_classes = num_classes
        self.stem = nn.Sequential(_conv(CHANNELS, width), _conv(width, width, 2), _Block(width), _Block(width))
        self.halved = nn.Sequential(_conv(width, 2 * width, 2), _Block(2 * width), _Block(2 * width))
        self.quartered = nn.Sequential(_conv(2 * width, 4 * width, 2), *(_Block(4 * width) for _ in range(3)))
        self.join_half = _conv(6 * width, 2 * width)
        self.join_whole = _conv(3 * width, 2 * width)
        self.at_point = _layers(2 * width + POINT_CHANNELS, 96, 96)
        self.to_class = nn.Linear(96, num_classes)
        self.to_box = nn.Linear(96, _BOX_ANSWERS)
        self.of_box = _layers(2 * width + 8, 96, 128)
        self.in_box = _layers(256, 128, 192)
        self.refined = _layers(192 + 3, 128)
        self.to_sure = nn.Linear(128, 1)
        self.to_refined_class = nn.Linear(128, num_classes)
        self.to_refined = nn.Linear(128, _REFINED_ANSWERS)
        nn.init.constant_(self.to_class.bias, -4.0)

    def seen(self, picture: Tensor) -> Tensor:
        """Features (b, c, h / 2, w / 2) of pictures (b, CHANNELS, h, w)."""
        whole = self.stem(picture)
        half = self.halved(whole)
        quarter = self.quartered(half)
        half = self.join_half(torch.cat([half, functional.interpolate(quarter, scale_factor=2.0)], dim=1))
        return self.join_whole(torch.cat([whole, functional.interpolate(half, scale_factor=2.0)], dim=1))

    def features_at(self, seen: Tensor, places: Tensor) -> Tensor:
        """Features (b, p, c) at places (b, p, 2), as shares of the picture from -1 to 1."""
        sampled = functional.grid_sample(seen.float(), places[:, None].flip(-1), align_corners=False)
        return sampled[:, :, 0].transpose(1, 2)

    def first(self, features: Tensor, own: Tensor) -> tuple[Tensor, Tensor]:
        """Odds of the classes (b, p, n) and boxes in bins (b, p, q) of points with features (b, p, c + 4)."""
        hidden = self.at_point(torch.cat([features, own], dim=-1))
        return self.to_class(hidden).float(), self.to_box(hidden).float()

    def second(self, pooled: Tensor, mask: Tensor, sizes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """How sure (r,), odds of the classes (r, n) and the boxes' moves in bins (r, q).

        Args:
            pooled: (r, k, c + 8), points in the frame of their box with their features.
            mask: (r, k) bool, which points there are.
            sizes: (r, 3) m.
        """
        own = self.of_box(pooled)
        gone = ~mask[..., None]
        around = own.masked_fill(gone, -1e4).amax(dim=1, keepdim=True).clamp(min=0.0).expand_as(own)
        both = self.in_box(torch.cat([own, around], dim=-1)).masked_fill(gone, -1e4).amax(dim=1).clamp(min=0.0)
        hidden = self.refined(torch.cat([both, sizes.log()], dim=-1))
        sure = self.to_sure(hidden).float()[:, 0]
        return sure, self.to_refined_class(hidden).float(), self.to_refined(hidden).float()


def places_in(points: Tensor, corner: Tensor, shape: tuple[int, int]) -> Tensor:
    """Places (..., 2) from -1 to 1 of points (..., 3) m in a picture with that corner (..., 2) m."""
    size = points.new_tensor(shape) * CELL_M
    return 2 * (points[..., :2] - corner) / size - 1


def point_features(points: Tensor) -> Tensor:
    """(..., 4): height above the road, where in its cell a point (..., 3) m lies, and its distance from the sensor."""
    within = points[..., :2] / (STRIDE * CELL_M) % 1.0 - 0.5
    return torch.cat([points[..., 2:], within, points[..., :2].norm(dim=-1, keepdim=True) / _FAR_M], dim=-1)


def boxes_of(points: Tensor, answer: Tensor) -> Tensor:
    """Boxes (..., 7) that points (..., 3) m tell of, from the first stage's answers (..., q)."""
    w = 2 * WAY.count
    x, y = WAY.decode(answer[..., :w]), WAY.decode(answer[..., w : 2 * w])
    yaw = TURN.decode(answer[..., 2 * w : -4])
    z, sizes = answer[..., -4], answer[..., -3:].clamp(-2.5, 3.5).exp()
    centre = torch.stack([points[..., 0] + x, points[..., 1] + y, points[..., 2] + z], dim=-1)
    return torch.cat([centre, sizes, yaw[..., None]], dim=-1)


def box_loss(answer: Tensor, points: Tensor, boxes: Tensor, weights: Tensor) -> Tensor:
    """Loss of boxes in bins (p, q) of points (p, 3) m whose things have boxes (p, 7)."""
    w, way = 2 * WAY.count, boxes[:, :3] - points
    lost = WAY.loss(answer[:, :w], way[:, 0], weights) + WAY.loss(answer[:, w : 2 * w], way[:, 1], weights)
    lost = lost + TURN.loss(answer[:, 2 * w : -4], half_turn(boxes[:, 6]), weights)
    rest = torch.cat([way[:, 2:], boxes[:, 3:6].log()], dim=1)
    off = functional.smooth_l1_loss(answer[:, -4:], rest, reduction="none", beta=0.1).sum(dim=1)
    return lost + 2 * (weights * off).sum()


def refined_boxes(boxes: Tensor, answer: Tensor) -> Tensor:
    """Boxes (r, 7) moved by the second stage's answers (r, q)."""
    w = 2 * SHIFT.count
    along, across = SHIFT.decode(answer[:, :w]), SHIFT.decode(answer[:, w : 2 * w])
    twist = TWIST.decode(answer[:, 2 * w : -4])
    c, s = boxes[:, 6].cos(), boxes[:, 6].sin()
    x, y = boxes[:, 0] + c * along - s * across, boxes[:, 1] + s * along + c * across
    sizes = boxes[:, 3:6] * answer[:, -3:].clamp(-1, 1).exp()
    return torch.cat([torch.stack([x, y, boxes[:, 2] + answer[:, -4]], 1), sizes, (boxes[:, 6] + twist)[:, None]], 1)


def refined_loss(answer: Tensor, boxes: Tensor, truth: Tensor) -> Tensor:
    """Mean loss of the moves in bins (r, q) from boxes (r, 7) to the true ones (r, 7)."""
    w, weights = 2 * SHIFT.count, answer.new_full((len(answer),), 1 / max(len(answer), 1))
    c, s, moved = boxes[:, 6].cos(), boxes[:, 6].sin(), truth[:, :3] - boxes[:, :3]
    lost = SHIFT.loss(answer[:, :w], c * moved[:, 0] + s * moved[:, 1], weights)
    lost = lost + SHIFT.loss(answer[:, w : 2 * w], c * moved[:, 1] - s * moved[:, 0], weights)
    twist = half_turn(truth[:, 6] - boxes[:, 6])
    told = (twist.abs() < np.pi / 4).to(weights.dtype)
    lost = lost + TWIST.loss(answer[:, 2 * w : -4], twist.clamp(-np.pi / 4, np.pi / 4), weights * told)
    rest = torch.cat([moved[:, 2:], (truth[:, 3:6] / boxes[:, 3:6]).log().clamp(-1, 1)], dim=1)
    return (
        lost
        + 2 * (weights * functional.smooth_l1_loss(answer[:, -4:], rest, reduction="none", beta=0.1).sum(dim=1)).sum()
    )


def half_turn(yaw: Tensor) -> Tensor:
    """The same line's heading between -pi/2 and pi/2."""
    return (yaw + np.pi / 2) % np.pi - np.pi / 2


def pool(points: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points of each box, grown by a margin, in its own frame.

    Args:
        points: (p, 3) m.
        boxes: (r, 7).
        rng: Chooses among too many.

    Returns:
        Indices (r, k) of points, which of them count (r, k) bool, and what the second stage is told of each (r, k, 8)
        float32: its place, its place from the sides of the box, its height above the road, and its distance from the
        sensor.
    """
    index, mask = np.zeros((len(boxes), BOX_POINTS), dtype=np.int64), np.zeros((len(boxes), BOX_POINTS), dtype=bool)
    told = np.zeros((len(boxes), BOX_POINTS, 8), dtype=np.float32)
    reach = np.hypot(boxes[:, 3], boxes[:, 4]) / 2 + 2 * MARGIN_M
    for row, box in enumerate(boxes):
        near = np.flatnonzero((np.abs(points[:, :2] - box[:2]) < reach[row]).all(axis=1))
        local = to_box(points[near], box[None])[0]
        beyond = np.abs(local) - box[3:6] / 2
        own = np.flatnonzero((beyond < MARGIN_M).all(axis=1))
        if len(own) > BOX_POINTS:
            own = rng.choice(own, BOX_POINTS, replace=False)
        count = len(own)
        index[row, :count], mask[row, :count] = near[own], True
        place = points[near[own]]
        told[row, :count] = np.column_stack(
            [local[own], beyond[own], place[:, 2], np.linalg.norm(place[:, :2], axis=1) / _FAR_M]
        )
    return index, mask, told
