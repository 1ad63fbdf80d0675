"""GFPNet: networks that deform a patch S of a fitted primitive onto template points T.

Letters: b patches, n source points, m template points, c channels.

`PatchNet` is the default: it decodes every source point with the pooled codes of both branches into an offset, so
permuting S permutes its answer. `PaperNet` is the network of Cocias, Razvant and Grigorescu, "GFPNet: A Deep Network
for Learning Shape Completion in Generic Fitted Primitives" (RA-L 2020), sec. III: its decoder sees pooled codes only,
so the rows of its answer are a set of points with no tie to the rows of S.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import Literal

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.errors import InvalidOption
from gfp_grasp.register.pcrnet import mlp

NEAREST = 4  # template points whose offsets enter with each source point

Variant = Literal["patch", "paper-iterative", "paper-oneshot"]


class PatchNet(nn.Module):
    """Offset and log standard deviation of every source point."""

    def __init__(self, width: int = 128) -> None:
        super().__init__()
        self.source = mlp(6 + NEAREST * 7, width, width)
        self.template = mlp(7, width // 2, width, 2 * width)
        self.context = mlp(4 * width, 2 * width, width)
        last = nn.Linear(width, 4)
        self.decode = nn.Sequential(mlp(2 * width, width, width), last)
        nn.init.zeros_(last.weight)
        with torch.no_grad():
            last.bias.copy_(torch.tensor([0.0, 0.0, 0.0, -2.5]))

    def forward(
        self, source: Tensor, source_normals: Tensor, template: Tensor, template_normals: Tensor, carried: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Deform patches.

        Args:
            source: (b, n, 3), patch frame and unit.
            source_normals: (b, n, 3).
            template: (b, m, 3).
            template_normals: (b, m, 3).
            carried: (b, m), 1 where symmetry brought the point.

        Returns:
            Offsets (b, n, 3) and the logarithm of their standard deviation (b, n), same unit.
        """
        t = torch.cat([template, template_normals, carried[..., None]], dim=-1)
        near = _agreeing_nearest(source, source_normals, template, template_normals)
        b, n, k = near.shape
        picked = torch.gather(t[:, None].expand(b, n, *t.shape[1:]), 2, near[..., None].expand(b, n, k, 7))
        offsets = torch.cat([picked[..., :3] - source[:, :, None], picked[..., 3:]], dim=-1)
        s = self.source(torch.cat([source, source_normals, offsets.flatten(2)], dim=-1))
        pooled_t = self.template(t).amax(dim=1)
        pooled_s = torch.cat([s.amax(dim=1), s.mean(dim=1)], dim=-1)
        context = self.context(torch.cat([pooled_s, pooled_t], dim=-1))
        out = self.decode(torch.cat([s, context[:, None].expand(-1, n, -1)], dim=-1))
        return out[..., :3], out[..., 3]


class PaperNet(nn.Module):
    """The paper's siamese encoder and dense decoder: iterative (64-128-1024) or one-shot (64-128-512-1024)."""

    def __init__(self, num_source: int = 64, *, iterative: bool = True, dropout: float = 0.3) -> None:
        super().__init__()
        widths = (64, 128, 1024) if iterative else (64, 128, 512, 1024)
        self.iterations = 5 if iterative else 1
        self.source = mlp(3, *widths)
        self.template = mlp(3, *widths)
        self.decode = nn.Sequential(
            nn.Linear(2048, 1024),
            nn.ReLU(),
            nn.Linear(1024, 512),
            nn.ReLU(),
            nn.Linear(512, 256),
            nn.ReLU(),
            nn.Dropout(dropout if iterative else 0.0),
            nn.Linear(256, num_source * 3),
        )
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.xavier_uniform_(layer.weight)
                nn.init.zeros_(layer.bias)

    def forward(self, source: Tensor, template: Tensor, *, iterations: int | None = None) -> Tensor:
        """The deformed set MS (b, n, 3) of S (b, n, 3) and T (b, m, 3); T stays, MS is looped back as S."""
        code = self.template(template).amax(dim=1)
        for _ in range(self.iterations if iterations is None else iterations):
            pooled = self.source(source).amax(dim=1)
            source = self.decode(torch.cat([pooled, code], dim=-1)).view_as(source)
        return source


def make_network(variant: Variant) -> nn.Module:
    """A fresh network of one variant.

    Raises:
        InvalidOption: The variant is not known.
    """
    if variant == "patch":
        return PatchNet()
    if variant in ("paper-iterative", "paper-oneshot"):
        return PaperNet(iterative=variant == "paper-iterative")
    raise InvalidOption(f"network is {variant!r}; 'patch', 'paper-iterative' or 'paper-oneshot' is expected")


WEIGHTS = {"patch": "gfpnet", "paper-iterative": "gfpnet_paper", "paper-oneshot": "gfpnet_oneshot"}


@lru_cache(maxsize=4)
def load_network(variant: Variant) -> nn.Module:
    """The shipped network of one variant, in evaluation mode, loaded once."""
    network = make_network(variant)
    state = load_file(data_file("weights", f"{WEIGHTS[variant]}.safetensors"))
    network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    return network.eval()


@lru_cache(maxsize=4)
def load_card(variant: Variant) -> dict[str, object]:
    """How the shipped weights came to be: command, seed, data, hours, metrics, sha256."""
    return json.loads(data_file("weights", f"{WEIGHTS[variant]}.json").read_text())


def _agreeing_nearest(source: Tensor, source_normals: Tensor, template: Tensor, template_normals: Tensor) -> Tensor:
    """Indices (b, n, k) of the template points nearest in position and normal."""
    s = torch.cat([source, source_normals], dim=-1)
    t = torch.cat([template, template_normals], dim=-1)
    distance = (s * s).sum(-1)[:, :, None] - 2 * s @ t.transpose(1, 2) + (t * t).sum(-1)[:, None]
    return distance.topk(NEAREST, dim=-1, largest=False, sorted=True).indices
