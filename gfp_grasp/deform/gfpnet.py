"""GFPNet: networks that deform a patch S of a fitted primitive onto template points T.

Letters: o objects, p patches of one, b patches, n source points, m template points, c channels.

`PatchNet` is the default: it decodes every source point with the pooled codes of both branches into an offset, so
permuting S permutes its answer; and the patches of one object tell each other what they saw, so that a patch on the
hidden side knows how the seen side differs from the fit. `PaperNet` is the network of Cocias, Razvant and Grigorescu,
"GFPNet: A Deep Network for Learning Shape Completion in Generic Fitted Primitives" (RA-L 2020), sec. III: it sees one
patch, and its decoder sees pooled codes only, so the rows of its answer are a set of points with no tie to the rows
of S.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.deform.layout import patch_unit_m
from gfp_grasp.deform.patches import MISFIT_SHARE, NUM_POSE_FEATURES, NUM_RESIDUALS
from gfp_grasp.errors import InvalidOption
from gfp_grasp.register import mlp
from gfp_grasp.types import FittedPrimitive, GenericPrimitive

MODES = 24  # of a primitive that the network knows
PRIMITIVES = ("cup", "cup.lidded", "cup.stemmed", "mug", "bottle", "bottle.jug", "bottle.spray")  # that it learns
FIT = MODES + 3 + len(PRIMITIVES) + 1  # numbers that say what was fitted
CHANGE = MODES + 6  # numbers that change a fit: modes, log scale, translation
_STEP = MISFIT_SHARE  # unit of the answer: a network is slow to learn numbers far smaller than its others

Variant = Literal["patch", "paper-iterative", "paper-oneshot"]


class PatchNet(nn.Module):
    """Offset and log standard deviation of every source point of every patch of an object, and a change of its fit.

    What the patches of an object say together is answered in the primitive's own terms, modes, scale and place, which
    reach the hidden side; what each of them sees, in offsets of its points.
    """

    def __init__(self, width: int = 128, *, layers: int = 2) -> None:
        super().__init__()
        self.source = mlp(6 + NUM_RESIDUALS, width, width)
        self.template = mlp(7, width // 2, width, width)
        self.place = mlp(NUM_POSE_FEATURES, width, width)
        self.fit = mlp(FIT, width, width)
        self.code = nn.Linear(4 * width, width)
        block = nn.TransformerEncoderLayer(
            width, 4, 2 * width, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.exchange = nn.TransformerEncoder(block, layers, enable_nested_tensor=False)
        last = nn.Linear(width, 5)
        self.decode = nn.Sequential(mlp(2 * width, width, width), last)
        nn.init.zeros_(last.weight)
        with torch.no_grad():
            last.bias.copy_(torch.tensor([0.0, 0.0, 0.0, 0.0, -0.5]))
        change = nn.Linear(width, CHANGE)
        self.change = nn.Sequential(mlp(2 * width, width, width), change)
        nn.init.zeros_(change.weight)
        nn.init.zeros_(change.bias)

    def forward(
        self,
        source: Tensor,
        source_normals: Tensor,
        template: Tensor,
        template_normals: Tensor,
        mirrored: Tensor,
        residuals: Tensor,
        pose_features: Tensor,
        fit: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Deform all patches of some objects.

        Args:
            source: (o, p, n, 3), patch frame and unit.
            source_normals: (o, p, n, 3).
            template: (o, p, m, 3); of no effect where the patch sees nothing.
            template_normals: (o, p, m, 3).
            mirrored: (o, p, m), 1 where symmetry brought the point.
            residuals: (o, p, n, c) as in `Patches`.
            pose_features: (o, p, c) as in `Patches`; its last channel is how many template points the patch sees.
            fit: (o, c) as of `fit_features`.

        Returns:
            Offsets (o, p, n, 3), the logarithm of the standard deviation (o, p, n), same unit, of where both changes
            together lead, and the change (o, CHANGE) of the fit, as `mode_field` reads it.
        """
        o, p, n, _ = source.shape
        sees = (pose_features[..., -1] > 0).flatten()[:, None]
        s = self.source(torch.cat([source, source_normals, residuals], dim=-1).flatten(0, 1))
        t = self.template(torch.cat([template, template_normals, mirrored[..., None]], dim=-1).flatten(0, 1))
        pooled_t = torch.where(sees, t.amax(dim=1), 0.0)
        # The mean, not the largest, of the source: it is the same for any number of points.
        own = torch.cat([s.mean(dim=1), pooled_t], dim=-1).view(o, p, -1)
        whole = self.fit(fit)
        here = torch.cat([own, self.place(pose_features), whole[:, None].expand(-1, p, -1)], dim=-1)
        codes = self.exchange(self.code(here))
        change = self.change(torch.cat([codes.mean(dim=1), whole], dim=-1)).float()
        code = codes.flatten(0, 1)
        out = self.decode(torch.cat([s, code[:, None].expand(-1, n, -1)], dim=-1)).float().view(o, p, n, 5)
        # Most of it is along the normal, which need not be learnt for every direction anew.
        offset = out[..., :3] + out[..., 3:4] * source_normals
        return _STEP * offset, out[..., 4] + math.log(_STEP), change


def fit_features(fit: FittedPrimitive, *, known: bool = True) -> np.ndarray:
    """What the network is told of a fit as a whole, (FIT,): modes, log scale, primitive, and whether there is a handle.

    Of a primitive that it does not know (known is False) modes and name mean nothing to it.
    """
    features = np.zeros(FIT)
    features[MODES : MODES + 3] = np.log(fit.scale)
    if known:
        count = min(MODES, len(fit.coefficients))
        features[:count] = 0.5 * fit.coefficients[:count]
        features[MODES + 3 + PRIMITIVES.index(fit.primitive.name)] = 1.0
    features[-1] = float(fit.primitive.on_part.any())
    return features


def change_units(primitive: GenericPrimitive) -> np.ndarray:
    """(CHANGE,) standard deviations, log scale and metres that one unit of a change of a primitive's fit is."""
    return np.concatenate([np.full(MODES, 0.3), np.full(3, 0.02), np.full(3, MISFIT_SHARE * patch_unit_m(primitive))])


def mode_field(fit: FittedPrimitive, change: np.ndarray, *, known: bool = True) -> np.ndarray:
    """Displacement (v, 3) m of a fit's vertices, in the primitive's frame, by a change (CHANGE,) of it, to first order.

    The modes of a primitive that the network does not know stay as they are.
    """
    change = change * change_units(fit.primitive)
    field = fit.primitive.shape(fit.coefficients, fit.scale) * change[MODES : MODES + 3] + change[MODES + 3 :]
    if known:
        count = min(MODES, len(fit.coefficients))
        field = field + fit.scale * np.tensordot(change[:count], fit.primitive.modes[:count], axes=1)
    return field


class PaperNet(nn.Module):
    """The paper's siamese encoder and dense decoder.

    Args:
        widths: Of the encoder's layers: 64-128-1024 is the paper's iterative network, 64-128-512-1024 its one-shot.
        iterations: How often the answer is looped back.
        dropout: Before the last layer.
        num_source: Points of S.
    """

    def __init__(
        self,
        widths: Sequence[int] = (64, 128, 1024),
        *,
        iterations: int = 5,
        dropout: float = 0.3,
        num_source: int = 64,
    ) -> None:
        super().__init__()
        self.iterations = iterations
        self.source = mlp(3, *widths)
        self.template = mlp(3, *widths)
        self.decode = nn.Sequential(
            nn.Linear(2048, 1024),
            nn.ReLU(),
            nn.Linear(1024, 512),
            nn.ReLU(),
            nn.Linear(512, 256),
            nn.ReLU(),
            nn.Dropout(dropout),
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
    if variant == "paper-iterative":
        return PaperNet()
    if variant == "paper-oneshot":
        return PaperNet((64, 128, 512, 1024), iterations=1, dropout=0.0)
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


def knows(variant: Variant, primitive: GenericPrimitive) -> bool:
    """Whether the shipped network was trained on this very primitive: the modes of another one mean something else."""
    return primitive.card.get("shape_sha256") in dict(load_card(variant).get("primitives", {})).values()  # type: ignore[call-overload]
