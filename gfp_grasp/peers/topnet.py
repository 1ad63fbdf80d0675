"""TopNet: a tree whose leaves are the points; each node makes its children from its feature and the code.

Source: L. Tchapmi et al., TopNet: Structural Point Cloud Decoder, CVPR 2019, section 4. Levels, features of 8 numbers
and 2048 leaves are the paper's; the code has 384 numbers instead of 1024, the layers of a level 256 and 64, and none
is normalised, for a CPU.
Letters: b clouds, n points, k nodes.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gfp_grasp.peers.encoder import CODE, StackedEncoder
from gfp_grasp.peers.network import Exact, PointNetwork

_CHILDREN = (2, 4, 4, 4, 4, 4)
_FEATURE = 8
_WIDTHS = (256, 64)


class TopNet(PointNetwork):
    """The encoder and the tree."""

    def __init__(self) -> None:
        super().__init__()
        self.encode = StackedEncoder()
        self.root = _Level(0, _FEATURE, _CHILDREN[0])
        last = len(_CHILDREN) - 2
        self.levels = nn.ModuleList(
            _Level(_FEATURE, 3 if number == last else _FEATURE, children)
            for number, children in enumerate(_CHILDREN[1:])
        )

    def forward(self, points: Tensor) -> tuple[Tensor]:
        """Points (b, 2048, 3) of points (b, n, 3)."""
        code = self.encode(points)
        nodes = torch.tanh(self.root(code, code.new_zeros(len(code), 1, 0)))
        for level in self.levels[:-1]:
            nodes = torch.tanh(level(code, nodes))
        return (torch.tanh(self.levels[-1](code, nodes)),)


class _Level(nn.Module):
    """Children of all nodes of a level."""

    def __init__(self, num_in: int, num_out: int, children: int) -> None:
        super().__init__()
        first, second = _WIDTHS
        self.num_out = num_out
        self.of_code = nn.Linear(CODE, first)
        self.of_node = nn.Linear(num_in, first, bias=False) if num_in else None
        self.rest = nn.Sequential(nn.ReLU(), nn.Linear(first, second), nn.ReLU(), Exact(second, children * num_out))

    def forward(self, code: Tensor, nodes: Tensor) -> Tensor:
        """(b, k * children, num_out) of code (b, CODE) and nodes (b, k, num_in)."""
        hidden = self.of_code(code)[:, None]
        hidden = hidden.expand(-1, nodes.shape[1], -1) if self.of_node is None else hidden + self.of_node(nodes)
        return self.rest(hidden).reshape(len(code), -1, self.num_out)
