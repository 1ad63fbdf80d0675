"""What every peer's network can do, and the part that those that answer with points have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import torch
import trimesh
from torch import Tensor, nn

from gfp_grasp.peers.encoder import NUM_INPUT
from gfp_grasp.peers.seen import Seen, fixed_number
from gfp_grasp.peers.skin import skin_of_points


class PeerNetwork(nn.Module, ABC):
    """A network of a peer.

    Attributes:
        resolution: Cells along each axis of the grids that it takes and gives; None where it does with points.
    """

    resolution: int | None = None

    @staticmethod
    @abstractmethod
    def given(seen: Seen) -> np.ndarray:
        """float32, what the network takes of what was seen, without the axis of a batch."""

    @abstractmethod
    def surface(self, seen: Seen) -> trimesh.Trimesh:
        """The completed surface, watertight, in sides of the cube.

        Raises:
            NoSurface: The network finds none.
        """

    def batch_of(self, seen: Seen) -> Tensor:
        """(1, ...) of `given`, where the weights are."""
        return torch.from_numpy(self.given(seen))[None].to(next(self.parameters()).device)


class PointNetwork(PeerNetwork):
    """A network that takes points and answers with points."""

    @staticmethod
    def given(seen: Seen) -> np.ndarray:
        """(NUM_INPUT, 3)."""
        return fixed_number(seen.points, NUM_INPUT)

    @abstractmethod
    def forward(self, points: Tensor) -> tuple[Tensor, ...]:
        """Point sets (b, m, 3) from coarse to fine, of points (b, n, 3)."""

    def finest(self, seen: Seen) -> np.ndarray:
        """(m, 3) finest points, in sides of the cube."""
        with torch.inference_mode():
            return self(self.batch_of(seen))[-1][0].double().cpu().numpy()

    def surface(self, seen: Seen) -> trimesh.Trimesh:
        """The skin of the finest points."""
        return skin_of_points(self.finest(seen))


class Exact(nn.Linear):
    """A layer in single precision: places in bfloat16 are a five-hundredth of the cube off."""

    def forward(self, input: Tensor) -> Tensor:
        with torch.autocast(input.device.type, enabled=False):
            return super().forward(input.float())


def grid_of(across: int, along: int, *, half: float) -> Tensor:
    """(across * along, 2) places on a square from -half to half."""
    axes = (torch.linspace(-half, half, across), torch.linspace(-half, half, along))
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), dim=-1).reshape(-1, 2)
