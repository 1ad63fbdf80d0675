"""The network of the class-free completion: from what is known of cells to the surface's distance and its uncertainty.

It knows cells only, so an object may be of any size. Letters: b grids, c channels, x, y, z cells.
"""

from __future__ import annotations

import json
from functools import cache

import torch
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.assets import data_file
from gfp_grasp.classfree.grid import NUM_CHANNELS, REACH
from gfp_grasp.networks import with_weights

_LEAST_LOG_SCALE = -3.5
_GROUPS = 8
_SMALL = 20480


class DistanceNet(nn.Module):
    """U-Net that looks at blocks of two by two by two cells, and tells of each cell of a block by itself.

    Args:
        width: Channels of the finest blocks, a multiple of 8; twice as many at every coarser level.
        depth: Pairs of convolutions at the coarsest level, whose cells are 8 times as long.
    """

    def __init__(self, width: int = 32, depth: int = 3) -> None:
        super().__init__()
        self.stem = _Conv(8 * NUM_CHANNELS, width)
        self.to_middle = nn.Conv3d(width, 2 * width, 2, stride=2)
        self.middle = _Block(2 * width)
        self.to_coarse = nn.Conv3d(2 * width, 4 * width, 2, stride=2)
        self.coarse = nn.Sequential(*(_Block(4 * width) for _ in range(depth)))
        self.from_coarse = nn.ConvTranspose3d(4 * width, 2 * width, 2, stride=2)
        self.middle_again = _Block(2 * width)
        self.from_middle = nn.ConvTranspose3d(2 * width, width, 2, stride=2)
        self.fine = _Block(width)
        self.head = nn.Conv3d(width, 16, 1)

    def forward(self, known: Tensor) -> tuple[Tensor, Tensor]:
        """Signed distances (b, x, y, z) from -REACH to REACH cells, negative inside, and logarithms of their scale.

        The scale is that of a Laplace distribution, in cells.

        Args:
            known: (b, c, x, y, z) of `channels`; x, y and z are multiples of 8.
        """
        fine = self.stem(_blocks(known))
        middle = self.middle(self.to_middle(fine))
        coarse = self.coarse(self.to_coarse(middle))
        middle = self.middle_again(middle + self.from_coarse(coarse))
        fine = self.fine(fine + self.from_middle(middle))
        distance, log_scale = _cells(self.head(fine).float()).unbind(dim=1)
        return REACH * torch.tanh(distance / REACH), log_scale.clamp_min(_LEAST_LOG_SCALE)

    def add_to_log_scale(self, more: float) -> None:
        """Make all scales exp(more) times as large, but for the least."""
        assert self.head.bias is not None
        with torch.no_grad():
            self.head.bias[8:] += more


class _Block(nn.Module):
    """Two convolutions whose answer is added to what came in."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norms = nn.ModuleList(nn.GroupNorm(_GROUPS, width) for _ in range(2))
        self.convs = nn.ModuleList(_Conv(width, width) for _ in range(2))

    def forward(self, inward: Tensor) -> Tensor:
        outward = inward
        for norm, conv in zip(self.norms, self.convs, strict=True):
            outward = conv(functional.relu(norm(outward)))
        return inward + outward


class _Conv(nn.Conv3d):
    """A convolution of 3 x 3 x 3 cells; a small one is computed as one of 3 x 3 on planes that know their neighbours.

    The sum is the same; on a CPU, torch's own takes four times as long for inputs of up to 20480 numbers a plane.
    """

    def __init__(self, num_in: int, num_out: int) -> None:
        super().__init__(num_in, num_out, 3, padding=1)

    def forward(self, input: Tensor) -> Tensor:
        batch, channels, x, y, z = input.shape
        if channels * x * y > _SMALL:
            return super().forward(input)
        planes = functional.pad(input, (0, 0, 0, 0, 1, 1)).transpose(1, 2)
        planes = torch.cat([planes[:, :-2], planes[:, 1:-1], planes[:, 2:]], dim=2).flatten(0, 1)
        weight = self.weight.transpose(1, 2).flatten(1, 2)
        return functional.conv2d(planes, weight, self.bias, padding=1).view(batch, x, -1, y, z).transpose(1, 2)


def _blocks(cells: Tensor) -> Tensor:
    """(b, 8 c, x / 2, y / 2, z / 2) of (b, c, x, y, z): the cells of a block one after the other."""
    b, c, x, y, z = cells.shape
    parts = cells.view(b, c, x // 2, 2, y // 2, 2, z // 2, 2)
    return parts.permute(0, 1, 3, 5, 7, 2, 4, 6).reshape(b, 8 * c, x // 2, y // 2, z // 2)


def _cells(blocks: Tensor) -> Tensor:
    """(b, c, 2 x, 2 y, 2 z) of (b, 8 c, x, y, z): what `_blocks` undoes."""
    b, c, x, y, z = blocks.shape
    parts = blocks.view(b, c // 8, 2, 2, 2, x, y, z).permute(0, 1, 5, 2, 6, 3, 7, 4)
    return parts.reshape(b, c // 8, 2 * x, 2 * y, 2 * z)


@cache
def load_network() -> DistanceNet:
    """The shipped network, in evaluation mode, loaded once."""
    card = json.loads(data_file("weights", "classfree.json").read_text(encoding="utf-8"))
    network = DistanceNet(card["config"]["width"], card["config"]["depth"])
    return with_weights(network, data_file("weights", "classfree.safetensors"), name="classfree")
