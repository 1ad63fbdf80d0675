"""A network that tells the things on a table apart by depth alone: each pixel votes for the middle of its thing.

Pixels of one thing vote for one place in space, and say how far votes for it spread (Neven et al., arXiv:1906.11109;
votes in three dimensions as arXiv:2007.08073 has them). The network knows no class.
Letters: b pictures, c channels, h rows, w columns; h and w are multiples of `MULTIPLE`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.networks import with_weights
from gfp_grasp.parallel import one_thread
from gfp_grasp.transforms import cross, rotation_about, rotation_between
from gfp_grasp.types import DepthImage, SupportPlane

MULTIPLE = 16
NUM_FEATURES = 8
PITCH_M = 0.0035  # size of a pixel on the things, about which the network has learned
ABOVE_M = 0.005  # height from which on a pixel may be a thing's
_UNIT_M = 0.1  # of positions, votes and spreads inside the network
_FARTHEST = 10.0  # positions beyond this, in units, are cut
_NUM_OUTPUTS = 5  # three of the vote, one of its spread, one of how good the pixel is as a seed
_LEVEL = 0.1  # cosine between the optical axis and the ground below which the camera looks straight down
_LEAST_SEED = 0.5
_LEAST_PX = 12
_NEW_SHARE = 0.5  # of the pixels about a seed that belong to none yet, or the seed is another thing's leftover


@dataclass(frozen=True, eq=False)
class Votes:
    """What the network says of the pixels of a picture.

    Attributes:
        places: (h, w, 3) m, where each pixel's thing has its middle; frame of the points that were given.
        spread_m: (h, w), standard deviation of the votes for that thing.
        seed: (h, w) between 0 and 1, how well the pixel stands for its thing; low on what is none.
    """

    places: np.ndarray
    spread_m: np.ndarray
    seed: np.ndarray


class InstanceNet(nn.Module):
    """Encoder and decoder with skips: features (b, 8, h, w) to (b, 5, h, w): vote, log of spread, seed."""

    def __init__(self, width: int = 24) -> None:
        super().__init__()
        widths = (width, 2 * width, 4 * width, 6 * width)
        self.stem = nn.Conv2d(NUM_FEATURES, width, 3, stride=2, padding=1)
        self.stages = nn.ModuleList(
            nn.Sequential(_Residual(w), _Residual(w, dilation=2 if w == widths[-1] else 1)) for w in widths
        )
        self.downs = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in pairwise(widths))
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairwise(widths))
        self.merges = nn.ModuleList(_Residual(a) for a in widths[:-1])
        self.head = nn.Sequential(
            _Residual(width), nn.Conv2d(width, width, 3, padding=1), nn.ReLU(),
            nn.Conv2d(width, 4 * _NUM_OUTPUTS, 1), nn.PixelShuffle(2),
        )  # fmt: skip

    def forward(self, features: Tensor) -> Tensor:
        x, skips = self.stem(features), []
        for number, stage in enumerate(self.stages):
            x = stage(x)
            if number < len(self.downs):
                skips.append(x)
                x = self.downs[number](x)
        for narrow, merge, skip in zip(reversed(self.narrow), reversed(self.merges), reversed(skips), strict=True):
            x = merge(skip + nn.functional.interpolate(narrow(x), scale_factor=2.0, mode="nearest"))
        return self.head(x)


class _Residual(nn.Module):
    def __init__(self, width: int, *, dilation: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation, bias=False),
            nn.BatchNorm2d(width), nn.ReLU(), nn.Conv2d(width, width, 3, padding=1, bias=False),
        )  # fmt: skip

    def forward(self, x: Tensor) -> Tensor:
        return x + self.body(x)


def level_picture(image: DepthImage, support: SupportPlane) -> np.ndarray:
    """(h, w, 3) m, what a picture sees: z up from the support, y away from the camera, which is at x = y = 0."""
    R = rotation_between(support.normal, (0.0, 0.0, 1.0))
    axes = R @ image.T_world_camera[:3, :3]
    # A camera that looks straight down has no forward on the ground; the upper edge of its picture is.
    x, y = axes[:2, 2] if np.linalg.norm(axes[:2, 2]) > _LEVEL else -axes[:2, 1]
    turned = rotation_about((0.0, 0.0, 1.0), np.pi / 2 - np.arctan2(y, x)) @ R
    level = (image.points() - image.viewpoint) @ turned.T
    level[..., 2] += support.distances(image.viewpoint)
    return level


def instance_features(level: np.ndarray, pitch_m: float) -> tuple[np.ndarray, np.ndarray]:
    """What the network looks at.

    Args:
        level: (h, w, 3) m, of `level_picture`.
        pitch_m: Size of a pixel on the things.

    Returns:
        (8, h, w) float32: position about the middle of what is above the table, normal, known or not, pitch; and
        above (h, w) bool, the pixels higher than the table.
    """
    known = np.asarray(np.isfinite(level).all(axis=2))
    level = np.where(known[..., None], level, 0.0)
    above = known & (level[..., 2] > ABOVE_M)
    middle = np.append(level[above][:, :2].mean(axis=0) if above.any() else np.zeros(2), 0.0)
    position = np.clip((level - middle) / _UNIT_M, -_FARTHEST, _FARTHEST) * known[..., None]
    pitch = np.full(known.shape, np.log(pitch_m / PITCH_M))
    stacked = np.dstack([position, _normals(level, known), known, pitch])
    return np.ascontiguousarray(stacked.transpose(2, 0, 1), dtype=np.float32), above


def _normals(level: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(h, w, 3) unit normals of the picture's surface, up or towards the camera; zero where it is torn."""
    share = ndimage.uniform_filter(known.astype(np.float32), 3)
    smooth = np.dstack([ndimage.uniform_filter(level[..., i].astype(np.float32), 3) for i in range(3)])
    smooth /= np.maximum(share, 1e-6)[..., None]
    across, along = np.zeros_like(smooth), np.zeros_like(smooth)
    across[:, 1:-1] = smooth[:, 2:] - smooth[:, :-2]
    along[1:-1] = smooth[2:] - smooth[:-2]
    normals = cross(across, along)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    # Rows of a picture run down, so the cross product of columns with rows looks away from the camera.
    return np.where(known[..., None] & (length > 0), -normals / np.maximum(length, 1e-12), 0.0)


def vote(level: np.ndarray, pitch_m: float, *, network: InstanceNet | None = None) -> tuple[Votes, np.ndarray]:
    """Where the things are that the pixels of a picture see; and which pixels (h, w) bool are above the table.

    Args:
        level: (h, w, 3) m, as `instance_features` takes it, of any size.
        pitch_m: Size of a pixel on the things.
        network: None takes the shipped one.
    """
    h, w = level.shape[:2]
    padded = np.full((-(-h // MULTIPLE) * MULTIPLE, -(-w // MULTIPLE) * MULTIPLE, 3), np.nan)
    padded[:h, :w] = level
    features, above = instance_features(padded, pitch_m)
    with one_thread(), torch.inference_mode():
        answer = (network or load_instances())(torch.from_numpy(features)[None])[0, :, :h, :w].double().numpy()
    places = np.nan_to_num(level) + _UNIT_M * answer[:3].transpose(1, 2, 0)
    spread_m = _UNIT_M * np.exp(answer[3])
    return Votes(places, spread_m, 1 / (1 + np.exp(-answer[4]))), above[:h, :w]


def gather_votes(votes: Votes, chosen: np.ndarray) -> np.ndarray:
    """Things as those pixels that vote for one place: the best seed first, with all whose votes are near its own.

    Args:
        votes: What the network says.
        chosen: (h, w) bool, pixels that may be a thing's.

    Returns:
        (h, w) int32 labels, 0 for none.
    """
    rows, columns = np.nonzero(chosen)
    places, spread_m, seed = votes.places[rows, columns], votes.spread_m[rows, columns], votes.seed[rows, columns]
    found, free, count = np.zeros(len(rows), dtype=np.int32), np.ones(len(rows), dtype=bool), 0
    waiting = np.where(seed > _LEAST_SEED, seed, 0.0)
    while waiting.max(initial=0.0) > 0:
        best = int(waiting.argmax())
        # The bell exp(-d^2 / (2 s^2)) is at one half where d^2 = 2 ln 2 s^2.
        near = ((places - places[best]) ** 2).sum(axis=1) < 2 * np.log(2) * spread_m[best] ** 2
        own = near & free
        waiting[best] = 0.0
        if own.sum() >= _LEAST_PX and own.sum() > _NEW_SHARE * near.sum():
            count += 1
            found[own] = count
            free &= ~own
        waiting[near] = 0.0
    labels = np.zeros(chosen.shape, dtype=np.int32)
    labels[rows, columns] = found
    return labels


@cache
def load_instances() -> InstanceNet:
    """The shipped network, in evaluation mode, loaded once."""
    card = json.loads(data_file("weights", "instances.json").read_text(encoding="utf-8"))
    path = data_file("weights", "instances.safetensors")
    return with_weights(InstanceNet(card["config"]["width"]), path, name="instances")
