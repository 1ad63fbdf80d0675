"""Which class a partial view shows: a small PointNet on metric, upright points.

Letters: b clouds, n points, c channels, k classes.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import torch
from safetensors.torch import load_file
from scipy.spatial import KDTree
from torch import nn

from gfp_grasp.assets import data_file
from gfp_grasp.parallel import one_thread
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import SupportPlane

POOL_POINTS = 1200  # at this density the surroundings are looked at, and of these
NUM_POINTS = 768  # go into the network
NUM_FEATURES = 7
FLOOR_M = (
    0.006  # what is nearer to the table is left out, in training as in use: a detector cannot tell it from the table
)
_SCALE_M = 0.1  # one unit of the network; size is kept, for it tells a cup from a bottle
_NEIGHBOURS = 24
_YAWS = 4  # the answer is a mean over turns about up, for nothing in the network makes it blind to them


class CategoryNet(nn.Module):
    """PointNet with one look around: (b, n, 7) features to (b, k) logits.

    After a first max-pooling every point is seen next to the whole cloud, without which "beyond the body's radius",
    that is a handle, cannot be said.
    """

    def __init__(self, num_classes: int, *, width: int = 48) -> None:
        super().__init__()
        self.near = nn.Sequential(
            nn.Linear(NUM_FEATURES, width), nn.LayerNorm(width), nn.ReLU(), nn.Linear(width, 2 * width)
        )  # fmt: skip
        self.around = nn.Sequential(
            nn.LayerNorm(4 * width), nn.ReLU(), nn.Linear(4 * width, 2 * width), nn.ReLU(),
            nn.Linear(2 * width, 4 * width),
        )  # fmt: skip
        self.head = nn.Sequential(
            nn.Linear(8 * width, 2 * width), nn.LayerNorm(2 * width), nn.ReLU(), nn.Dropout(0.2),
            nn.Linear(2 * width, num_classes),
        )  # fmt: skip

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        near = self.near(features)
        whole = near.max(dim=1, keepdim=True).values.expand_as(near)
        around = self.around(torch.cat([near, whole], dim=2))
        return self.head(torch.cat([around.max(dim=1).values, around.mean(dim=1)], dim=1))


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
    rng = np.random.default_rng(0)
    cloud = with_surface(sample_points(upright_points(points, up, support), POOL_POINTS, rng))
    cloud = sample_points(cloud, NUM_POINTS, rng)
    turned = np.stack([_turned(cloud, 2 * np.pi * k / _YAWS) for k in range(_YAWS)])
    with one_thread(), torch.inference_mode():
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
    """(count, c) rows of (n, c), each point at most once where there are enough."""
    if len(points) >= count:
        return points[rng.choice(len(points), count, replace=False)]
    return points[np.concatenate([np.arange(len(points)), rng.integers(len(points), size=count - len(points))])]


def with_surface(points: np.ndarray) -> np.ndarray:
    """(n, 6): upright points with what their surroundings look like, none of which a turn about up changes.

    Of the covariance of the nearest 24 points, eigenvalues e0 <= e1 <= e2: how level the surface is (|z| of the
    normal), how rough (e0 / e1) and how much like a wire (1 - e1 / e2), as a handle is.
    """
    _, near = KDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    local = points[near] - points[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))
    e0, e1, e2 = np.maximum(spread, 1e-12).T
    return np.column_stack([points, np.abs(axes[:, 2, 0]), e0 / e1, 1 - e1 / e2])


def features(cloud: np.ndarray) -> np.ndarray:
    """(..., n, 7) float32 input of the network for (..., n, 6) clouds of with_surface."""
    points = cloud[..., :3] / _SCALE_M
    radius = np.linalg.norm(points[..., :2], axis=-1, keepdims=True)
    return np.concatenate([points, radius, cloud[..., 3:]], axis=-1).astype(np.float32)


def _turned(cloud: np.ndarray, yaw_rad: float) -> np.ndarray:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turned = cloud.copy()
    turned[:, :2] = cloud[:, :2] @ np.array([[c, s], [-s, c]])
    return turned


@cache
def _load(device: str) -> tuple[CategoryNet, tuple[str, ...], float]:
    card = json.loads(data_file("weights", "classifier.json").read_text(encoding="utf-8"))
    network = CategoryNet(len(card["data"]["classes"]), width=card["config"]["width"])
    network.load_state_dict(load_file(data_file("weights", "classifier.safetensors")))
    return network.eval().to(device), tuple(card["data"]["classes"]), float(card["metrics"]["temperature"])
