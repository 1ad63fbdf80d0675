"""PCRNet: a siamese PointNet that moves a primitive onto a cloud, in five iterations.

Source: Sarode et al., "PCRNet: Point Cloud Registration Network using PointNet Encoding" (arXiv 1908.07906); GFPNet
sec. III-A uses it with five iterations. Letters: b pairs, n points, c channels.

Lengths are in units of the template's own radius and relative to its start, so that the network sees neither where in
the world nor how large the object is. Rotations that the class's symmetry hides are not asked for: the truth it learns
from has the start's own turn about the axis.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.clouds import thin
from gfp_grasp.networks import with_weights
from gfp_grasp.parallel import one_thread
from gfp_grasp.register.state import PoseShape, surface_samples
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import GenericPrimitive, LevelView, SensorProfile

NUM_POINTS = 128
ITERATIONS = 5


class PCRNet(nn.Module):
    """7-D pose (quaternion, translation) that moves a template (b, n, 3) onto a cloud (b, n, 3)."""

    def __init__(self) -> None:
        super().__init__()
        self.encode = mlp(3, 64, 64, 64, 128, 1024)
        last = nn.Linear(256, 7)
        self.decode = nn.Sequential(mlp(2048, 1024, 512, 256), last)
        nn.init.normal_(last.weight, std=1e-3)
        with torch.no_grad():
            last.bias.copy_(torch.tensor([1.0, 0, 0, 0, 0, 0, 0]))

    def forward(self, template: Tensor, cloud: Tensor, *, iterations: int = ITERATIONS) -> tuple[Tensor, Tensor]:
        """Rotation (b, 3, 3) and translation (b, 3) after all iterations, about the origin."""
        *_, last = self.iterate(template, cloud, iterations=iterations)
        return last

    def iterate(
        self, template: Tensor, cloud: Tensor, *, iterations: int = ITERATIONS
    ) -> Iterator[tuple[Tensor, Tensor]]:
        """The pose after each iteration; none is differentiated through the ones before it."""
        code = self.encode(cloud).amax(dim=1)
        R = torch.eye(3, dtype=template.dtype, device=template.device).expand(len(template), 3, 3)
        t = torch.zeros(len(template), 3, dtype=template.dtype, device=template.device)
        for _ in range(iterations):
            R, t = R.detach(), t.detach()
            moved = template @ R.transpose(1, 2) + t[:, None]
            pose = self.decode(torch.cat([self.encode(moved).amax(dim=1), code], dim=-1)).float()
            turn, step = rotation_of(pose[:, :4]), pose[:, 4:]
            R, t = turn @ R, (turn @ t[..., None])[..., 0] + step
            yield R, t


def rotation_of(quaternion_wxyz: Tensor) -> Tensor:
    """Rotation matrices (b, 3, 3) of quaternions (b, 4), scalar first, of any length."""
    w, x, y, z = (quaternion_wxyz / quaternion_wxyz.norm(dim=-1, keepdim=True).clamp_min(1e-9)).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=-1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=-1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1),
    ]
    return torch.stack(rows, dim=1)


def network_input(
    state: PoseShape, primitive: GenericPrimitive, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Template and cloud as the network sees them.

    Returns:
        Template (NUM_POINTS, 3), cloud (NUM_POINTS, 3), the centre (3,) m that was subtracted and the radius m that
        both were divided by.
    """
    samples = surface_samples(primitive).local(state.coefficients)
    world = state.world(samples[np.linspace(0, len(samples) - 1, NUM_POINTS).astype(int)])
    centre = world.mean(axis=0)
    radius = float(np.sqrt(((world - centre) ** 2).sum(axis=1).mean()))
    seen = thin(points, NUM_POINTS)
    seen = seen[np.linspace(0, len(seen) - 1, NUM_POINTS).astype(int)]
    return (world - centre) / radius, (seen - centre) / radius, centre, radius


def correct_starts(states: list[PoseShape], primitive: GenericPrimitive, evidence: LevelView) -> list[PoseShape]:
    """Starts moved by the network, all of them in one batch."""
    if not states:
        return states
    inputs = [network_input(state, primitive, evidence.points) for state in states]
    # Up is z in what the network was trained on.
    turn = _up_to_z(evidence.up)
    template, cloud = (torch.tensor(np.stack([i[k] for i in inputs]) @ turn.T, dtype=torch.float32) for k in (0, 1))
    with one_thread(), torch.inference_mode():
        R, t = load_pcrnet(pcrnet_weights(evidence.sensor))(template, cloud)
    R, t = turn.T @ R.double().numpy() @ turn, t.double().numpy() @ turn
    moved = []
    for state, R_i, t_i, (_, _, centre, radius) in zip(states, R, t, inputs, strict=True):
        R_i = Rotation.from_matrix(R_i).as_matrix()  # float32 leaves it a little off orthonormal
        moved.append(replace(state, R=R_i @ state.R, t=R_i @ (state.t - centre) + centre + radius * t_i))
    return moved


def pcrnet_weights(sensor: SensorProfile) -> str:
    """Name of the shipped weights that saw what a sensor sees: things on tables, or scans of traffic."""
    return "pcrnet_lidar" if sensor.of_traffic else "pcrnet"


@cache
def load_pcrnet(weights: str = "pcrnet") -> PCRNet:
    """A shipped network, in evaluation mode, loaded once."""
    return with_weights(PCRNet(), data_file("weights", f"{weights}.safetensors"), name=weights)


def _up_to_z(up: np.ndarray) -> np.ndarray:
    return rotation_between(up, (0.0, 0.0, 1.0))


def mlp(*widths: int) -> nn.Sequential:
    """Linear layers of these widths, each followed by a ReLU."""
    layers: list[nn.Module] = []
    for a, b in pairwise(widths):
        layers += [nn.Linear(a, b), nn.ReLU()]
    return nn.Sequential(*layers)
