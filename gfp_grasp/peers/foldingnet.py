"""FoldingNet's decoder as a completion: a square grid that a code folds twice.

Source: Y. Yang et al., FoldingNet, arXiv:1712.07262, section 3.2; with PCN's encoder, as PCN's and TopNet's papers
compare it. Its foldings have 512 channels; these have 256, for a CPU. Its loss is the larger way of the Chamfer
distance; here, as for the others, it is the sum of both.
Letters: b clouds, n points, g places of the grid.
"""

from __future__ import annotations

from torch import Tensor, nn

from gfp_grasp.peers.encoder import CODE, StackedEncoder
from gfp_grasp.peers.network import Exact, PointNetwork, grid_of

_SIDE = 45
_HALF = 0.3
_WIDTH = 256


class FoldingNet(PointNetwork):
    """The encoder and two foldings."""

    def __init__(self) -> None:
        super().__init__()
        self.encode = StackedEncoder()
        self.first = _Folding(2)
        self.second = _Folding(3)
        self.grid: Tensor
        self.register_buffer("grid", grid_of(_SIDE, _SIDE, half=_HALF), persistent=False)

    def forward(self, points: Tensor) -> tuple[Tensor]:
        """Points (b, g, 3) of points (b, n, 3)."""
        code = self.encode(points)
        return (self.second(code, self.first(code, self.grid.expand(len(code), -1, -1))),)


class _Folding(nn.Module):
    """New places of places, by a code; the layer that takes both is split, for the code is the same for all places."""

    def __init__(self, num_in: int) -> None:
        super().__init__()
        self.of_code = nn.Linear(CODE, _WIDTH)
        self.of_place = nn.Linear(num_in, _WIDTH, bias=False)
        self.rest = nn.Sequential(nn.ReLU(), nn.Linear(_WIDTH, _WIDTH), nn.ReLU(), Exact(_WIDTH, 3))

    def forward(self, code: Tensor, places: Tensor) -> Tensor:
        return self.rest(self.of_place(places) + self.of_code(code)[:, None])
