"""Training of the three GFPNets on labelled patches of registered primitives."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.assets import data_dir
from gfp_grasp.deform.gfpnet import WEIGHTS, PaperNet, Variant, make_network
from gfp_grasp.deform.patches import UNIT_M, make_patches
from gfp_grasp.primitives import load_primitive
from gfp_grasp.register import FitConfig
from gfp_grasp.shapes import FAMILIES
from gfp_grasp.train.labels import Label, make_labels
from gfp_grasp.train.loop import Batch, LoopConfig, shuffled, train, write_weights

DEFAULTS: dict[Variant, LoopConfig] = {
    "patch": LoopConfig(steps=5000, batch=128, rate=1e-3, decay=0.75, weight_decay=0.01),
    # The paper's optimiser, rate and batch; steps are ours.
    "paper-iterative": LoopConfig(steps=1500, batch=256),
    "paper-oneshot": LoopConfig(steps=3000, batch=256),
}
_CHAMFER_SHARE = 0.7  # the paper's loss: 0.7 Chamfer distance + 0.3 Laplacian
_NEIGHBOURS = 8
_NOISE_M = 0.0005


def train_gfpnet(
    variant: Variant = "patch",
    *,
    config: LoopConfig | None = None,
    num_views: int = 4,
    limit: int | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    fit: FitConfig = FitConfig(),
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train one network, measure it on the validation split and write weights and card.

    Args:
        variant: "patch" (per-point decoder), "paper-iterative" or "paper-oneshot".
        config: Schedule; None is the variant's own.
        num_views: Views of each shape.
        limit: Shapes of a family; None takes the whole split.
        out: Weights file; None is the shipped one.
        runs: Folder of caches and checkpoints.
        workers: Processes that make labels.
        fit: Registration that labels start from.
        report: Progress.

    Returns:
        Path of the card.
    """
    config = config or DEFAULTS[variant]
    torch.manual_seed(config.seed)
    data, counts = _patches("train", num_views, limit, runs, workers, fit)
    network, hours = train(
        make_network(variant),
        augmented(shuffled(data, config.batch)) if variant == "patch" else shuffled(data, config.batch),
        paper_loss if variant != "patch" else point_loss,
        config=config,
        checkpoint=runs / "gfpnet" / f"{variant}.pt",
        report=report,
    )
    network = network.half().float()
    held_out, _ = _patches("val", num_views, None if limit is None else max(1, limit // 4), runs, workers, fit)
    out = out or data_dir("weights") / f"{WEIGHTS[variant]}.safetensors"
    return write_weights(
        network,
        out,
        config=config,
        data={
            "families": FAMILIES,
            "split": "train",
            "views_a_shape": num_views,
            "patches": len(data[0]),
            "labels": counts,
        },
        hours=hours,
        metrics=_measure(network, held_out),
    )


def augmented(stream: Callable[[torch.Generator], Iterator[Batch]]) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Patches mirrored left to right, with noisier and sparser template points; all that a class may show anyway."""

    def batches(generator: torch.Generator) -> Iterator[Batch]:
        for source, source_normals, template, template_normals, carried, target in stream(generator):
            b, m, _ = template.shape
            sign = torch.ones(b, 1, 3)
            sign[:, 0, 1] = (torch.randint(0, 2, (b,), generator=generator) * 2 - 1).float()
            # A random share of the template points is lost: others stand in for them, as where few were seen.
            kept = torch.rand(b, 1, generator=generator) * 0.9 + 0.1
            stand_in = (torch.rand(b, m, generator=generator) * kept * m).long()
            pick = torch.argsort(torch.rand(b, m, generator=generator), dim=1).gather(1, stand_in)[..., None]
            noise = torch.randn(b, m, 3, generator=generator) * (_NOISE_M / UNIT_M)
            yield (
                source * sign,
                source_normals * sign,
                (template * sign + noise).gather(1, pick.expand(b, m, 3)),
                (template_normals * sign).gather(1, pick.expand(b, m, 3)),
                carried.gather(1, pick[..., 0]),
                target * sign,
            )

    return batches


def point_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Laplace likelihood of each vertex's offset, with the standard deviation that the network gives."""
    source, source_normals, template, template_normals, carried, target = batch
    offset, log_sigma = network(source, source_normals, template, template_normals, carried)
    error = (offset.float() - (target - source)).norm(dim=-1)
    log_sigma = log_sigma.float().clamp(-7, 2)
    # The plain error keeps the offsets learning where sigma would excuse them.
    return (error * torch.exp(-log_sigma) + log_sigma).mean() * 0.05 + error.mean()


def paper_loss(network: nn.Module, batch: Batch) -> Tensor:
    """The paper's eq. 1: 0.7 times the Chamfer distance to the label and 0.3 times the Laplacian's.

    Its eq. 3 as printed, the mean position of the neighbours, has no useful minimum; the Laplacian here is the
    distance of each point to the mean of its neighbours on S, less the label's own.
    """
    source, _, template, _, _, target = batch
    moved = network(source, template).float()
    pairwise = torch.cdist(moved, target)
    chamfer = pairwise.amin(dim=2).mean() + pairwise.amin(dim=1).mean()
    near = torch.cdist(source, source).topk(_NEIGHBOURS + 1, largest=False).indices[..., 1:]
    laplacian = (_lap(moved, near).norm(dim=-1) - _lap(target, near).norm(dim=-1)).abs().mean()
    return _CHAMFER_SHARE * chamfer + (1 - _CHAMFER_SHARE) * laplacian


def _lap(points: Tensor, near: Tensor) -> Tensor:
    b, n, k = near.shape
    around = torch.gather(points[:, None].expand(b, n, n, 3), 2, near[..., None].expand(b, n, k, 3))
    return points - around.mean(dim=2)


def _patches(
    split: str, num_views: int, limit: int | None, runs: Path, workers: int, fit: FitConfig
) -> tuple[Batch, dict[str, dict[str, int]]]:
    """Tensors S, its normals, T, its normals, carried, label (s, 64, ...) of all labels of a split."""
    columns: list[list[np.ndarray]] = [[] for _ in range(6)]
    counts = {}
    for family in FAMILIES:
        labels, counts[family] = make_labels(
            family, split, num_views=num_views, limit=limit, runs=runs, workers=workers, fit=fit
        )
        for label in labels:
            for column, part in zip(columns, _label_patches(label), strict=True):
                column.append(part.astype(np.float32))
    return tuple(torch.from_numpy(np.concatenate(column)) for column in columns), counts


def _label_patches(label: Label) -> tuple[np.ndarray, ...]:
    primitive = load_primitive(label.category)
    if label.twin:
        assert primitive.twin is not None
        primitive = primitive.twin
    p = make_patches(primitive, label.vertices, label.template)
    offset = np.einsum("bni,bij->bnj", (label.target - label.vertices)[p.index], p.frames) / UNIT_M
    return p.source, p.source_normals, p.template, p.template_normals, p.carried, p.source + offset


def _measure(network: nn.Module, data: Batch) -> dict[str, float]:
    """Mean distance of patch points to their labels, mm, undeformed and deformed."""
    source, source_normals, template, template_normals, carried, target = data
    before = (target - source).norm(dim=-1).mean()
    errors, within = [], []
    with torch.inference_mode():
        for s, sn, t, tn, c, y in zip(*(part.split(512) for part in data), strict=True):
            if isinstance(network, PaperNet):
                pairwise = torch.cdist(network(s, t), y)
                errors.append(pairwise.amin(dim=1).mean())
            else:
                offset, log_sigma = network(s, sn, t, tn, c)
                error = (s + offset - y).norm(dim=-1)
                errors.append(error.mean())
                within.append((error < 2 * log_sigma.exp()).float().mean())
    del source_normals, template, template_normals, carried
    metrics = {
        "val_patches": len(source),
        "mean_error_before_mm": round(float(before) * UNIT_M * 1000, 3),
        "mean_error_after_mm": round(float(torch.stack(errors).mean()) * UNIT_M * 1000, 3),
    }
    if within:
        metrics["share_within_two_sigma"] = round(float(torch.stack(within).mean()), 3)
    return metrics
