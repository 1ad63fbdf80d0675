"""Which class a partial view shows: a small PointNet on metric, upright points.

Letters: b clouds, n points, c channels, k classes.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import torch
from safetensors.torch import load_file
from torch import nn

from gfp_grasp.assets import data_file
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import SupportPlane

NUM_POINTS = 768
FLOOR_M = (
    0.006  # what is nearer to the table is left out, in training as in use: a detector cannot tell it from the table
)
_SCALE_M = 0.1  # one unit of the network; size is kept, for it tells a cup from a bottle
_YAWS = 4  # the answer is a mean over turns about up, for nothing in the network makes it blind to them


class CategoryNet(nn.Module):
    """PointNet: (b, n, 4) x, y, z and distance from the axis, in units of 0.1 m, to (b, k) logits."""

    def __init__(self, num_classes: int, *, width: int = 48) -> None:
        super().__init__()
        self.point = nn.Sequential(
            nn.Linear(4, width), nn.LayerNorm(width), nn.ReLU(),
            nn.Linear(width, 2 * width), nn.LayerNorm(2 * width), nn.ReLU(),
            nn.Linear(2 * width, 4 * width),
        )  # fmt: skip
        self.head = nn.Sequential(
            nn.Linear(8 * width, 2 * width), nn.LayerNorm(2 * width), nn.ReLU(), nn.Dropout(0.3),
            nn.Linear(2 * width, num_classes),
        )  # fmt: skip

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        local = self.point(features)
        return self.head(torch.cat([local.max(dim=1).values, local.mean(dim=1)], dim=1))


def classify(
    points: np.ndarray, up: np.ndarray, support: SupportPlane | None = None, *, device: str = "cpu"
) -> dict[str, float]:
    """Probability of each known class for the points of one object.

    Args:
        points: (n, 3) m, one object, no table; any n > 0, in any order that is the same each time.
        up: (3,) the support's normal.
        support: The table; None takes the lowest points for it.
        device: Where the network runs.

    Returns:
        Calibrated probabilities, which sum to one. An object of no known class gets an even spread.
    """
    network, classes, temperature = _load(device)
    cloud = sample_points(upright_points(points, up, support), NUM_POINTS, np.random.default_rng(0))
    turned = np.stack([_turned(cloud, 2 * np.pi * k / _YAWS) for k in range(_YAWS)])
    with torch.inference_mode():
        logits = network(torch.from_numpy(features(turned)).to(device)) / temperature
        scores = torch.softmax(logits, dim=1).mean(dim=0).cpu().numpy().astype(np.float64)
    return dict(zip(classes, (scores / scores.sum()).tolist(), strict=True))


def upright_points(points: np.ndarray, up: np.ndarray, support: SupportPlane | None) -> np.ndarray:
    """(n, 3) m with z above the support, along up, and the middle of their ground outline at x = y = 0."""
    level = points @ rotation_between(up, (0.0, 0.0, 1.0)).T
    low, high = np.percentile(level, (1, 99), axis=0)
    height_m = float(low[2]) - FLOOR_M if support is None else support.height_m
    return level - np.append((low[:2] + high[:2]) / 2, height_m)


def sample_points(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3), each point at most once where there are enough."""
    if len(points) >= count:
        return points[rng.choice(len(points), count, replace=False)]
    return points[np.concatenate([np.arange(len(points)), rng.integers(len(points), size=count - len(points))])]


def features(points: np.ndarray) -> np.ndarray:
    """(..., n, 4) float32 input of the network for (..., n, 3) upright points, m."""
    radius = np.linalg.norm(points[..., :2], axis=-1, keepdims=True)
    return (np.concatenate([points, radius], axis=-1) / _SCALE_M).astype(np.float32)


def _turned(points: np.ndarray, yaw_rad: float) -> np.ndarray:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


@cache
def _load(device: str) -> tuple[CategoryNet, tuple[str, ...], float]:
    card = json.loads(data_file("weights", "classifier.json").read_text(encoding="utf-8"))
    network = CategoryNet(len(card["data"]["classes"]), width=card["config"]["width"])
    network.load_state_dict(load_file(data_file("weights", "classifier.safetensors")))
    return network.eval().to(device), tuple(card["data"]["classes"]), float(card["metrics"]["temperature"])
