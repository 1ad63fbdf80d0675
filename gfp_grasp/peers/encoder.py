"""The encoder of the peers that take points: two PointNets, one on the other.

Source: PCN, section 4.1. Its widths are 128, 256, 512 and a code of 1024; these are for a CPU.
Letters: b clouds, n points, c channels.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

NUM_INPUT = 1024
CODE = 384


class StackedEncoder(nn.Module):
    """Code of a cloud, whatever the order of its points and however often one repeats."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Sequential(nn.Linear(3, 64), nn.ReLU(), nn.Linear(64, 128))
        self.second = nn.Sequential(nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, CODE))

    def forward(self, points: Tensor) -> Tensor:
        """(b, CODE) of points (b, n, 3)."""
        own = self.first(points)
        common = own.amax(dim=1, keepdim=True).expand_as(own)
        return self.second(torch.cat([own, common], dim=2)).amax(dim=1)
