"""3D shape completion without complete shapes for observations: a shape prior, and an encoder into its codes.

The prior is a denoising variational auto-encoder of occupied cells and signed distances. Then a new encoder learns to
give the code whose shape makes what was seen likeliest; it never sees what the object is really like.

Source: D. Stutz and A. Geiger, Learning 3D Shape Completion from Laser Scan Data with Weak Supervision, CVPR 2018, and
Learning 3D Shape Completion under Weak Supervision, arXiv:1805.07290, sections 3 and 4.2. A code has 64 numbers instead
of 10, because one prior is learnt for all classes; layers have 16 to 64 channels, for a CPU. Prior and encoder learn
from the same shapes, which are not shifted.
Letters: b grids, c channels, x, y, z cells, q numbers of a code.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
import trimesh
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.peers.network import PeerNetwork
from gfp_grasp.peers.seen import Seen, empty_cells, occupied_cells
from gfp_grasp.peers.skin import surface_of_field

RESOLUTION = 32
CODE = 64
_WIDTHS = (16, 32, 64)
_COARSE = RESOLUTION // 2 ** len(_WIDTHS)
_TRUNCATION = 5.0  # cells
_SIGMA = float(np.exp(-1.0))  # of a log-transformed distance: the logarithm of its variance is -2
_KL_WEIGHT = 2.0  # of the code's prior; the paper's at its lowest resolution
_EMPTY_WEIGHT = 0.25  # of empty cells, for observations with noise
_FLIPPED, _NOISE = 0.1, float(np.sqrt(0.05))  # what the prior's encoder has to do without


def log_distance(distance: Tensor) -> Tensor:
    """Signed distances in cells, truncated, and their logarithm with their sign."""
    return distance.sign() * torch.log1p(distance.abs().clamp_max(_TRUNCATION))


class AmortisedFit(PeerNetwork):
    """The encoder of observations with the decoder of a prior, which stays as it is."""

    resolution = RESOLUTION

    def __init__(self) -> None:
        super().__init__()
        self.encode = _Encoder(CODE)
        self.decode = _Decoder().requires_grad_(False)

    def train(self, mode: bool = True) -> AmortisedFit:
        """Train the encoder alone: the decoder keeps its weights and the means of its normalisations."""
        super().train(mode)
        self.decode.eval()
        return self

    @staticmethod
    def given(seen: Seen) -> np.ndarray:
        """(2, x, y, z), 0 or 1: cells that points lie in; cells known to be empty."""
        occupied = occupied_cells(seen.points, RESOLUTION)
        return np.stack([occupied, empty_cells(seen, RESOLUTION) & ~occupied]).astype(np.float32)

    def forward(self, given: Tensor) -> tuple[Tensor, Tensor]:
        """Codes (b, q) of (b, 2, x, y, z), and what `ShapePrior` decodes from them, (b, 2, x, y, z)."""
        code = self.encode(given)
        return code, self.decode(code)

    def surface(self, seen: Seen) -> trimesh.Trimesh:
        """The zero level of the signed distances."""
        with torch.inference_mode():
            # Twice the same: small grids that come alone torch convolves on a CPU in ten times the time.
            decoded = self(self.batch_of(seen).expand(2, -1, -1, -1, -1))[1]
        return surface_of_field(decoded[0, 1].double().cpu().numpy())


class ShapePrior(nn.Module):
    """The variational auto-encoder that the decoder comes from."""

    def __init__(self) -> None:
        super().__init__()
        self.encode = _Encoder(2 * CODE)
        self.decode = _Decoder()

    def forward(self, shapes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Means and log-variances (b, q) of codes, and what one draw from each decodes to, (b, 2, x, y, z).

        Args:
            shapes: (b, 2, x, y, z) of `shape_channels`.
        """
        mean, log_variance = self.encode(shapes).float().chunk(2, dim=1)
        code = mean + torch.randn_like(mean) * (log_variance / 2).exp() if self.training else mean
        return mean, log_variance, self.decode(code)


def shape_channels(distance: Tensor) -> Tensor:
    """(b, 2, x, y, z) of signed distances (b, x, y, z) in cells: whether a cell is inside; the log-distance."""
    return torch.stack([(distance <= 0).float(), log_distance(distance)], dim=1)


def corrupted(shapes: Tensor) -> Tensor:
    """Shapes of `shape_channels` with cells flipped and distances disturbed."""
    flipped = (torch.rand_like(shapes[:, 0]) < _FLIPPED).float()
    occupied = (shapes[:, 0] - flipped).abs()
    return torch.stack([occupied, shapes[:, 1] + _NOISE * torch.randn_like(shapes[:, 1])], dim=1)


def prior_loss(network: nn.Module, distance: Tensor) -> Tensor:
    """Negative evidence lower bound a cell, of signed distances (b, x, y, z) in cells.

    Source: equation 4 of arXiv:1805.07290.
    """
    shapes = shape_channels(distance)
    mean, log_variance, decoded = network(corrupted(shapes) if network.training else shapes)
    decoded = decoded.float()
    cells = functional.binary_cross_entropy_with_logits(decoded[:, 0], shapes[:, 0])
    far = (decoded[:, 1] - shapes[:, 1]).square().mean() / (2 * _SIGMA**2)
    divergence = (mean.square() + log_variance.exp() - 1 - log_variance).sum(dim=1).mean() / 2
    return cells + far + _KL_WEIGHT * divergence / RESOLUTION**3


def likelihood_loss(network: nn.Module, given: Tensor) -> Tensor:
    """Negative logarithm of the likelihood of what was seen, (b, 2, x, y, z), and of the code, a cell.

    A distance makes a cell occupied as likely as it is not positive.

    Source: equations 7 to 10 of arXiv:1805.07290.
    """
    code, decoded = network(given)
    code, decoded = code.float(), decoded.float()
    occupied, empty = given[:, 0], given[:, 1]
    # log Phi, which does not overflow far from the surface as the logarithm of an error function does
    inside, outside = (torch.special.log_ndtr(sign * decoded[:, 1] / _SIGMA) for sign in (-1, 1))
    of_cells = -occupied * (functional.logsigmoid(decoded[:, 0]) + inside)
    of_cells = of_cells - _EMPTY_WEIGHT * empty * (functional.logsigmoid(-decoded[:, 0]) + outside)
    of_code = code.square().sum(dim=1).mean() / 2
    return (of_cells.flatten(1).sum(dim=1).mean() + _KL_WEIGHT * of_code) / RESOLUTION**3


class _Encoder(nn.Module):
    """Three stages of two convolutions and max pooling, and a full layer."""

    def __init__(self, num_out: int) -> None:
        super().__init__()
        widths = (2, *_WIDTHS)
        stages = [nn.Sequential(_conv(a, b), _conv(b, b), nn.MaxPool3d(2)) for a, b in pairwise(widths)]
        self.stages = nn.Sequential(*stages)
        self.last = nn.Linear(widths[-1] * _COARSE**3, num_out)

    def forward(self, grids: Tensor) -> Tensor:
        return self.last(self.stages(grids).flatten(1))


class _Decoder(nn.Module):
    """The encoder's mirror image: nearest neighbours in place of pooling."""

    def __init__(self) -> None:
        super().__init__()
        widths = (*_WIDTHS[::-1], _WIDTHS[0])
        self.first = nn.Linear(CODE, widths[0] * _COARSE**3)
        stages = [nn.Sequential(nn.Upsample(scale_factor=2), _conv(a, b), _conv(b, b)) for a, b in pairwise(widths)]
        self.stages = nn.Sequential(*stages)
        self.last = nn.Conv3d(widths[-1], 2, 3, padding=1)

    def forward(self, code: Tensor) -> Tensor:
        """Logits of occupied cells and log-transformed signed distances, (b, 2, x, y, z)."""
        coarse = self.first(code).view(len(code), _WIDTHS[-1], _COARSE, _COARSE, _COARSE)
        return self.last(self.stages(coarse))


def _conv(num_in: int, num_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv3d(num_in, num_out, 3, padding=1), nn.BatchNorm3d(num_out), nn.ReLU())
