"""3D-EPN: distances to the seen surface and what is known of each cell in, distances to the whole surface out.

Source: A. Dai, C. Qi and M. Niessner, Shape Completion using 3D-Encoder-Predictor CNNs and Shape Synthesis,
arXiv:1612.00101, section 4. Its first layer has 80 channels; this has 12, for a CPU. Neither its classification of the
shape nor the later synthesis from retrieved models is here, nor are distances to learn truncated. It normalises after
the first layer and not after the last of the encoder, and objects are not shifted in training. The mesh is the skin of
the distances.
Letters: b grids, c channels, x, y, z cells.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.peers.network import PeerNetwork
from gfp_grasp.peers.seen import Seen, distance_to_points, empty_cells
from gfp_grasp.peers.skin import skin_of_distances

RESOLUTION = 32
TRUNCATION = 3.0  # cells
_WIDTH = 12


class EncoderPredictor(PeerNetwork):
    """Four strided convolutions, two full layers, and four transposed convolutions that see the encoder's features."""

    resolution = RESOLUTION

    def __init__(self) -> None:
        super().__init__()
        w = _WIDTH
        self.encode = nn.ModuleList([_down(2, w), _down(w, 2 * w), _down(2 * w, 4 * w), _down(4 * w, 8 * w, last=True)])
        self.bottleneck = nn.Sequential(nn.Linear(8 * w, 8 * w), nn.ReLU(), nn.Linear(8 * w, 8 * w), nn.ReLU())
        self.predict = nn.ModuleList([_up(16 * w, 4 * w, first=True), _up(8 * w, 2 * w), _up(4 * w, w)])
        self.last = nn.ConvTranspose3d(2 * w, 1, 4, stride=2, padding=1)

    @staticmethod
    def given(seen: Seen) -> np.ndarray:
        """(2, x, y, z): distances to the seen points, truncated, in cells; 1 where a cell is known and -1 elsewhere.

        Cells before the seen surface are known.
        """
        distance = distance_to_points(seen.points, RESOLUTION, reach=TRUNCATION)
        known = np.where(empty_cells(seen, RESOLUTION), 1.0, -1.0)
        return np.stack([distance, known]).astype(np.float32)

    def forward(self, given: Tensor) -> Tensor:
        """Unsigned distances (b, x, y, z) from the whole surface, in cells, of (b, 2, x, y, z)."""
        features, inward = [], given
        for layer in self.encode:
            inward = layer(inward)
            features.append(inward)
        outward = self.bottleneck(inward.flatten(1)).view_as(inward)
        for layer, feature in zip(self.predict, reversed(features), strict=False):
            outward = layer(torch.cat([outward, feature], dim=1))
        return self.last(torch.cat([outward, features[0]], dim=1)).abs()[:, 0]

    def surface(self, seen: Seen) -> trimesh.Trimesh:
        """The skin of the distances; in cells that are known, they are those to what was seen."""
        given = self.batch_of(seen)
        with torch.inference_mode():
            distance = torch.where(given[:, 1] > 0, given[:, 0], self(given))[0]
        return skin_of_distances(distance.double().cpu().numpy())


def log_distance_loss(answer: Tensor, truth: Tensor, unknown: Tensor) -> Tensor:
    """Mean absolute error of log(1 + distance) over the cells (b, x, y, z) bool that are not known.

    Source: section 4.2.
    """
    error = functional.l1_loss(torch.log1p(answer), torch.log1p(truth), reduction="none")
    return (error * unknown).sum() / unknown.sum().clamp_min(1)


def _down(num_in: int, num_out: int, *, last: bool = False) -> nn.Sequential:
    """Half as many cells; the last takes four of them to one."""
    conv = nn.Conv3d(num_in, num_out, 4) if last else nn.Conv3d(num_in, num_out, 4, stride=2, padding=1)
    return nn.Sequential(conv, nn.LeakyReLU(0.2)) if last else _normed(conv, num_out, nn.LeakyReLU(0.2))


def _up(num_in: int, num_out: int, *, first: bool = False) -> nn.Sequential:
    """Twice as many cells; the first takes one to four."""
    conv = (
        nn.ConvTranspose3d(num_in, num_out, 4) if first else nn.ConvTranspose3d(num_in, num_out, 4, stride=2, padding=1)
    )
    return _normed(conv, num_out, nn.ReLU())


def _normed(conv: nn.Module, num_out: int, after: nn.Module) -> nn.Sequential:
    return nn.Sequential(conv, nn.BatchNorm3d(num_out), after)
