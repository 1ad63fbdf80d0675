"""GFPNet: networks that deform a patch S of a fitted primitive onto template points T.

Letters: o objects, p patches of one, b patches, n source points, m template points, c channels, u levers of a fit.

`PatchNet` is the default: it decodes every source point with the pooled codes of both branches into an offset, so
permuting S permutes its answer; and the patches of one object tell each other what they saw. What they saw reaches the
hidden side by the primitive's own levers, its modes, scale and place: the network says how far and how surely each
point is to move along its normal, and a ridge regression finds the change of the fit that does so best. The network is
told what a primitive is like, never which one it is or what its modes mean, so it takes any primitive.

`PaperNet` is the network of Cocias, Razvant and Grigorescu, "GFPNet: A Deep Network for Learning Shape Completion in
Generic Fitted Primitives" (RA-L 2020), sec. III: it sees one patch, and its decoder sees pooled codes only, so the rows
of its answer are a set of points with no tie to the rows of S.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.deform.patches import MISFIT_SHARE, NUM_POSE_FEATURES, NUM_RESIDUALS, Patches
from gfp_grasp.deform.template import patch_unit_m
from gfp_grasp.errors import InvalidOption
from gfp_grasp.register import mlp
from gfp_grasp.types import FittedPrimitive

NUM_FIT = 16  # numbers that say what was fitted
# Share of what the default network says that is done: on shapes that it did not learn it says too much. On 172 objects
# of the validation split three quarters leave 1.32 mm, all of it 1.34 mm, none of it 1.46 mm.
BELIEF = 0.75
RIGID = 6  # levers that every primitive has: three of log scale, three of translation; its modes follow
_GROUPS = 3  # scale, translation, modes: each is held back by a strength of its own
_RIDGE = -1.0  # logarithm of that strength at first
_MOST_LOG_WEIGHT = 4.0
_LEAST_SPREAD = 0.01  # of a log scale within a class: its matrix stays invertible

Variant = Literal["patch", "paper-iterative", "paper-oneshot"]


class PatchAnswer(NamedTuple):
    """What the network says of some objects.

    Attributes:
        offset: (o, p, n, 3) own displacement of each source point, patch frame and unit.
        log_sigma: (o, p, n) logarithm of the standard deviation, patch units, of where all changes together lead.
        advance: (o, p, n) how far the fit is to move each point along its normal, misfits.
        log_weight: (o, p, n) logarithm of how much that counts: of its precision, 1 / misfit^2.
        log_ridge: (o, 3) how strongly scale, translation and modes are held back.
        recall: (o,) share of the way back to the class's mean at which they are held.
    """

    offset: Tensor
    log_sigma: Tensor
    advance: Tensor
    log_weight: Tensor
    log_ridge: Tensor
    recall: Tensor


class PatchNet(nn.Module):
    """Offset and log standard deviation of every source point of every patch, and what the whole fit is to follow."""

    def __init__(self, width: int = 128, *, layers: int = 2) -> None:
        super().__init__()
        self.source = mlp(6 + NUM_RESIDUALS, width, width)
        self.template = mlp(7, width // 2, width, width)
        self.pose = mlp(NUM_POSE_FEATURES, width, width)
        self.fit = mlp(NUM_FIT, width, width)
        self.code = nn.Linear(4 * width, width)
        block = nn.TransformerEncoderLayer(
            width, 4, 2 * width, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.exchange = nn.TransformerEncoder(block, layers, enable_nested_tensor=False)
        self.decode = nn.Sequential(mlp(2 * width, width, width), _quiet(width, (0.0, 0.0, 0.0, 0.0, -0.5, 0.0, 0.0)))
        self.whole = nn.Sequential(mlp(2 * width, width), _quiet(width, (*(_RIDGE,) * _GROUPS, -4.0)))

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
    ) -> PatchAnswer:
        """Look at all patches of some objects.

        Args:
            source: (o, p, n, 3), patch frame and unit.
            source_normals: (o, p, n, 3).
            template: (o, p, m, 3); of no effect where the patch sees nothing.
            template_normals: (o, p, m, 3).
            mirrored: (o, p, m), 1 where symmetry brought the point.
            residuals: (o, p, n, c) as in `Patches`.
            pose_features: (o, p, c) as in `Patches`; the last is the share of template points seen.
            fit: (o, c) of `fit_features`.
        """
        o, p, n, _ = source.shape
        sees = (pose_features[..., -1] > 0).flatten()[:, None]
        s = self.source(torch.cat([source, source_normals, residuals], dim=-1).flatten(0, 1))
        t = self.template(torch.cat([template, template_normals, mirrored[..., None]], dim=-1).flatten(0, 1))
        pooled_t = torch.where(sees, t.amax(dim=1), 0.0)
        # The mean, not the largest, of the source: it is the same for any number of points.
        own = torch.cat([s.mean(dim=1), pooled_t], dim=-1).view(o, p, -1)
        whole = self.fit(fit)
        here = torch.cat([own, self.pose(pose_features), whole[:, None].expand(-1, p, -1)], dim=-1)
        codes = self.exchange(self.code(here))
        held = self.whole(torch.cat([codes.mean(dim=1), whole], dim=-1)).float()
        code = codes.flatten(0, 1)
        out = self.decode(torch.cat([s, code[:, None].expand(-1, n, -1)], dim=-1)).float().view(o, p, n, 7)
        # Most of it is along the normal, which need not be learnt for every direction anew.
        offset = out[..., :3] + out[..., 3:4] * source_normals
        return PatchAnswer(
            offset=MISFIT_SHARE * offset,
            log_sigma=out[..., 4] + math.log(MISFIT_SHARE),
            advance=out[..., 5],
            log_weight=out[..., 6].clamp(-_MOST_LOG_WEIGHT, _MOST_LOG_WEIGHT),
            log_ridge=held[:, :_GROUPS],
            recall=torch.sigmoid(held[:, _GROUPS]),
        )


def _quiet(width: int, bias: Sequence[float]) -> nn.Linear:
    """A last layer that says the same of everything at first."""
    layer = nn.Linear(width, len(bias))
    nn.init.zeros_(layer.weight)
    with torch.no_grad():
        layer.bias.copy_(torch.tensor(bias))
    return layer


def fit_features(fit: FittedPrimitive) -> np.ndarray:
    """What the network is told of a fit as a whole, (NUM_FIT,), all of it without a unit.

    Extents against a patch, log scale in standard deviations, symmetry, shares of the regions, how the class varies.
    """
    primitive = fit.primitive
    unit_m = patch_unit_m(primitive)
    extents = np.ptp(primitive.shape(fit.coefficients, fit.scale), axis=0)
    spread = np.sqrt(np.maximum(np.diag(primitive.log_scale_cov), 1e-6))
    order, mirror = primitive.symmetry.order, primitive.symmetry.mirror_normal
    variation = np.sqrt((primitive.modes**2).sum(axis=(0, 2)).mean()) if len(primitive.modes) else 0.0
    return np.array(
        [
            *np.log(np.maximum(extents / unit_m, 1e-6)),
            *np.clip(np.log(fit.scale) / spread, -4, 4),
            *np.log(spread / 0.1),
            float(np.isinf(order)),
            float(1 < order < np.inf),
            float(mirror is not None),
            float(primitive.on_region("inside").mean()),
            float(primitive.on_part.mean()),
            variation / unit_m,
            float(np.sqrt((fit.coefficients**2).mean())) if len(fit.coefficients) else 0.0,
        ]
    )


class Levers(NamedTuple):
    """What moves the points of some fits, to first order; a lever's unit is one standard deviation within the class.

    Attributes:
        moves: (o, q, 3, u) displacement of each point, misfits, by one unit of each lever, in the primitive's frame.
        state: (o, u) where each lever stands, from the class's mean; translation stands at zero.
    """

    moves: Tensor
    state: Tensor


def make_levers(
    vertices: Tensor, modes: Tensor, scale: Tensor, coefficients: Tensor, log_scale_cov: Tensor, unit_m: Tensor
) -> Levers:
    """The levers of some fits at some of their vertices: log scale, translation, and the modes.

    Args:
        vertices: (o, q, 3) m, of the fits.
        modes: (o, q, 3, k) m at these vertices, before scale; zero where a primitive has fewer.
        scale: (o, 3).
        coefficients: (o, k).
        log_scale_cov: (o, 3, 3) of the classes.
        unit_m: (o,) of their patches.
    """
    spread = torch.linalg.cholesky(log_scale_cov + _LEAST_SPREAD**2 * torch.eye(3, dtype=scale.dtype))
    misfit_m = (MISFIT_SHARE * unit_m)[:, None, None, None]
    stretch = vertices[..., None] * spread[:, None] / misfit_m
    shift = torch.eye(3, dtype=scale.dtype).expand_as(stretch)
    bend = scale[:, None, :, None] * modes / misfit_m
    stretched = torch.linalg.solve_triangular(spread, scale.log()[..., None], upper=False)[..., 0]
    return Levers(
        torch.cat([stretch, shift, bend], dim=-1),
        torch.cat([stretched, torch.zeros_like(stretched), coefficients], dim=-1),
    )


def solve_change(levers: Levers, normals: Tensor, answer: PatchAnswer) -> Tensor:
    """The change (o, u) of the fits, in units of their levers, that follows what the patches say together.

    It is the smallest mean of weight * (normal . moves @ change - advance)^2, held near the way back to the class's
    mean by a ridge: a damped Gauss-Newton step of a fit to what the network believes of every point.

    Args:
        levers: At the points of the patches, (o, p * n, ...).
        normals: (o, p * n, 3) at these points, in the primitive's frame.
        answer: Answer of the network, for the same points.
    """
    o, _, _, u = levers.moves.shape
    ahead = torch.einsum("oqi,oqiu->oqu", normals, levers.moves)
    weight = answer.log_weight.reshape(o, -1, 1).exp() / ahead.shape[1]
    group = torch.tensor([0] * 3 + [1] * 3 + [2] * (u - RIGID))
    ridge = answer.log_ridge.exp()[:, group]
    held = -answer.recall[:, None] * levers.state
    matrix = ahead.transpose(1, 2) @ (weight * ahead) + torch.diag_embed(ridge)
    wanted = (ahead * weight * answer.advance.reshape(o, -1, 1)).sum(dim=1) + ridge * held
    return torch.linalg.solve(matrix, wanted[..., None])[..., 0]


def change_field(fit: FittedPrimitive, patches: Patches, answer: PatchAnswer) -> np.ndarray:
    """Displacement (v, 3) m of a fit's vertices, in the primitive's frame, by what its patches say of it as a whole.

    Args:
        fit: One fit.
        patches: Its own.
        answer: Answer of the network, o = 1.
    """
    primitive = fit.primitive
    unit_m = patch_unit_m(primitive)

    def one(array: np.ndarray) -> Tensor:
        return torch.from_numpy(np.array(array, dtype=np.float64))[None]

    every = make_levers(
        one(primitive.shape(fit.coefficients, fit.scale)),
        one(primitive.modes.transpose(1, 2, 0)),
        one(fit.scale),
        one(fit.coefficients),
        one(primitive.log_scale_cov),
        torch.tensor([unit_m], dtype=torch.float64),
    )
    normals = np.einsum("bij,bnj->bni", patches.frames, patches.source_normals)
    index = torch.from_numpy(patches.index.ravel())
    answer = PatchAnswer(*(part.double() for part in answer))
    change = solve_change(Levers(every.moves[:, index], every.state), one(normals.reshape(-1, 3)), answer)
    return MISFIT_SHARE * unit_m * torch.einsum("qiu,u->qi", every.moves[0], change[0]).numpy()


class PaperNet(nn.Module):
    """The paper's siamese encoder and dense decoder.

    Args:
        widths: Widths of the encoder's layers: 64-128-1024 is the paper's iterative network, 64-128-512-1024 is its
            one-shot network.
        iterations: How often the answer is looped back.
        hidden: Widths of the decoder's layers between both codes and the set.
        dropout: Before the last layer.
        num_source: Points of S.
    """

    def __init__(
        self,
        widths: Sequence[int] = (64, 128, 1024),
        *,
        iterations: int = 5,
        hidden: Sequence[int] = (1024, 512, 256),
        dropout: float = 0.3,
        num_source: int = 64,
    ) -> None:
        super().__init__()
        self.iterations = iterations
        self.source = mlp(3, *widths)
        self.template = mlp(3, *widths)
        self.decode = nn.Sequential(
            *mlp(2 * widths[-1], *hidden), nn.Dropout(dropout), nn.Linear(hidden[-1], num_source * 3)
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
