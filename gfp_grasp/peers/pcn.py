"""PCN: a coarse cloud from a code, and around each of its points a folded patch.

Source: W. Yuan et al., PCN: Point Completion Network, arXiv:1808.00671, section 4. It has 1024 coarse and 16384 fine
points and 512 channels; this has 256, 2304 and 256, for a CPU, and two full layers before the coarse cloud in place of
three. Its coarse cloud is trained with the earth mover's distance, and the fine one counts more as time goes by; here
both are trained with the Chamfer distance, and count alike.
Letters: b clouds, n points, k coarse points, g places of a patch.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gfp_grasp.peers.encoder import CODE, StackedEncoder
from gfp_grasp.peers.network import Exact, PointNetwork, grid_of

NUM_COARSE = 256
_PATCH = 3
_HALF_PATCH = 0.05
_WIDTH = 256


class PCN(PointNetwork):
    """The whole network."""

    def __init__(self) -> None:
        super().__init__()
        self.encode = StackedEncoder()
        self.coarse = nn.Sequential(nn.Linear(CODE, CODE), nn.ReLU(), Exact(CODE, 3 * NUM_COARSE))
        # The first layer of the folding, in two parts: that of the code is the same for all points.
        self.of_code = nn.Linear(CODE, _WIDTH)
        self.of_place = nn.Linear(5, _WIDTH, bias=False)
        self.fold = nn.Sequential(nn.ReLU(), nn.Linear(_WIDTH, _WIDTH), nn.ReLU(), Exact(_WIDTH, 3))
        self.patch: Tensor
        self.register_buffer("patch", grid_of(_PATCH, _PATCH, half=_HALF_PATCH), persistent=False)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Coarse (b, k, 3) and fine (b, k * g, 3) points of points (b, n, 3)."""
        code = self.encode(points)
        coarse = self.coarse(code).view(len(code), NUM_COARSE, 3)
        centres = coarse.repeat_interleave(len(self.patch), dim=1)
        places = self.patch.repeat(NUM_COARSE, 1).expand(len(code), -1, -1)
        hidden = self.of_place(torch.cat([places, centres], dim=2)) + self.of_code(code)[:, None]
        return coarse, centres + self.fold(hidden)
