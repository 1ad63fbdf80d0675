"""Shape completion enabled robotic grasping: seen cells in, occupied cells out, and a mesh that the points join.

Source: J. Varley et al., Shape Completion Enabled Robotic Grasping, arXiv:1609.08546, sections III and IV. It has 64
channels and full layers of 5000 and 64000 numbers. For a CPU, this has 16 and 24 channels, a second pooling, full
layers of 96 and 2048 numbers and transposed convolutions up to the 40 cells. Its optimisation that smooths the mesh is
a filter here.
Letters: b grids, x, y, z cells.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from scipy import ndimage
from torch import Tensor, nn

from gfp_grasp.peers.network import PeerNetwork
from gfp_grasp.peers.seen import Seen, occupied_cells
from gfp_grasp.peers.skin import surface_of_field

RESOLUTION = 40
_FINER = 2  # times: the grid on which the points join what was completed
_SMOOTH = 0.5  # cells of that grid: a layer of one cell stays
_WIDTHS = (16, 16, 24)
_CODE = 96
_COARSE = RESOLUTION // 8


class VoxelCompletion(PeerNetwork):
    """Three convolutions of four cells, full layers, and the way up."""

    resolution = RESOLUTION

    def __init__(self) -> None:
        super().__init__()
        a, b, c = _WIDTHS
        self.encode = nn.Sequential(
            *(nn.Conv3d(1, a, 4), nn.ReLU()),  # 37 cells
            *(nn.Conv3d(a, b, 4), nn.ReLU(), nn.MaxPool3d(2)),  # 17
            *(nn.Conv3d(b, c, 4), nn.ReLU(), nn.MaxPool3d(2)),  # 7
            *(nn.Flatten(), nn.Linear(c * 7**3, _CODE), nn.ReLU()),
        )
        self.widen = nn.Sequential(nn.Linear(_CODE, 16 * _COARSE**3), nn.ReLU())
        self.up = nn.Sequential(
            *(nn.ConvTranspose3d(16, 16, 4, stride=2, padding=1), nn.ReLU()),
            *(nn.ConvTranspose3d(16, 12, 4, stride=2, padding=1), nn.ReLU()),
            nn.ConvTranspose3d(12, 1, 4, stride=2, padding=1),
        )

    @staticmethod
    def given(seen: Seen) -> np.ndarray:
        """(1, x, y, z), 0 or 1: cells that points lie in."""
        return occupied_cells(seen.points, RESOLUTION)[None].astype(np.float32)

    def forward(self, given: Tensor) -> Tensor:
        """Logits (b, x, y, z) of occupied cells, of (b, 1, x, y, z)."""
        coarse = self.widen(self.encode(given)).view(len(given), 16, _COARSE, _COARSE, _COARSE)
        return self.up(coarse)[:, 0]

    def surface(self, seen: Seen) -> trimesh.Trimesh:
        """The surface around what is occupied, on a finer grid whose cells with seen points are occupied, too."""
        with torch.inference_mode():
            share = torch.sigmoid(self(self.batch_of(seen)))[0].double().cpu().numpy()
        fine = np.asarray(ndimage.zoom(share, _FINER, order=1, mode="nearest", grid_mode=True))
        merged = np.maximum(fine, occupied_cells(seen.points, _FINER * RESOLUTION))
        return surface_of_field(0.5 - ndimage.gaussian_filter(merged, _SMOOTH))
