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
    "patch": LoopConfig(steps=4000, batch=16, rate=1e-3, decay=0.7, weight_decay=0.01),  # a batch of whole objects
    # The paper's optimiser, rate and batch; steps are ours.
    "paper-iterative": LoopConfig(steps=400, batch=256),
    "paper-oneshot": LoopConfig(steps=1500, batch=256),
}
_CHAMFER_SHARE = 0.7  # the paper's loss: 0.7 Chamfer distance + 0.3 Laplacian
_NEIGHBOURS = 8
_NOISE_M = 0.0005
_ALONG = 0.3  # weight of an error along the surface against one across it


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
    if variant != "patch":
        data = _single(data)
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
            "samples": len(data[0]),
            "labels": counts,
        },
        hours=hours,
        metrics=_measure(network, held_out if variant == "patch" else _single(held_out)),
    )


def augmented(stream: Callable[[torch.Generator], Iterator[Batch]]) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Objects mirrored left to right, with noisier and sparser template points; all that a class may show anyway.

    Half of each patch's source points are drawn: they are decoded one by one, and all of them would cost twice.
    """

    def batches(generator: torch.Generator) -> Iterator[Batch]:
        for source, source_normals, template, template_normals, carried, pull, place, target in stream(generator):
            o, p, m, _ = template.shape
            some = torch.randperm(source.shape[2], generator=generator)[: source.shape[2] // 2]
            sign = torch.ones(o, 1, 1, 3)
            sign[:, 0, 0, 1] = (torch.randint(0, 2, (o,), generator=generator) * 2 - 1).float()
            vectors = place[..., :9].unflatten(-1, (3, 3)) * sign
            # A random share of the template points is lost: others stand in for them, as where few were seen.
            kept = torch.rand(o, 1, 1, generator=generator) * 0.9 + 0.1
            stand_in = (torch.rand(o, p, m, generator=generator) * kept * m).long()
            pick = torch.argsort(torch.rand(o, p, m, generator=generator), dim=2).gather(2, stand_in)[..., None]
            noise = torch.randn(o, p, m, 3, generator=generator) * (_NOISE_M / UNIT_M)
            yield (
                source[:, :, some] * sign,
                source_normals[:, :, some] * sign,
                (template * sign + noise).gather(2, pick.expand(-1, -1, -1, 3)),
                (template_normals * sign).gather(2, pick.expand(-1, -1, -1, 3)),
                carried.gather(2, pick[..., 0]),
                pull[:, :, some],
                torch.cat([vectors.flatten(2), place[..., 9:]], dim=-1),
                target[:, :, some] * sign,
            )

    return batches


def point_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Mean error of each vertex, and the Gaussian likelihood of that error under the deviation the network gives."""
    *inputs, target = batch
    offset, log_sigma = network(*inputs)
    error = _surface_error(offset.float() - (target - inputs[0]), inputs[1])
    log_sigma = log_sigma.float().clamp(-7, 2)
    # The error is a given to the likelihood: offsets do not learn less where sigma would excuse them.
    likelihood = 0.5 * (error.detach() * torch.exp(-log_sigma)) ** 2 + log_sigma
    return error.mean() + 0.02 * likelihood.clamp_max(20.0).mean()


def _surface_error(gap: Tensor, normals: Tensor) -> Tensor:
    """Length of gaps (..., 3) of which what lies along the surface counts little: it does not change the shape."""
    across = (gap * normals).sum(dim=-1, keepdim=True) * normals
    return (across + _ALONG * (gap - across)).norm(dim=-1)


def paper_loss(network: nn.Module, batch: Batch) -> Tensor:
    """The paper's eq. 1: 0.7 times the Chamfer distance to the label and 0.3 times the Laplacian's.

    Its eq. 3 as printed, the mean position of the neighbours, has no useful minimum; the Laplacian here is the
    distance of each point to the mean of its neighbours on S, less the label's own.
    """
    source, _, template, *_, target = batch
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
    """Tensors S, its normals, T, its normals, carried, pull, place, label (o, p, ...) of all labels of a split."""
    columns: list[list[np.ndarray]] = [[] for _ in range(8)]
    counts = {}
    for family in FAMILIES:
        labels, counts[family] = make_labels(
            family, split, num_views=num_views, limit=limit, runs=runs, workers=workers, fit=fit
        )
        for label in labels:
            for column, part in zip(columns, _label_patches(label), strict=True):
                column.append(part.astype(np.float32))
    return tuple(torch.from_numpy(np.stack(column)) for column in columns), counts


def _label_patches(label: Label) -> tuple[np.ndarray, ...]:
    primitive = load_primitive(label.category)
    if label.twin:
        assert primitive.twin is not None
        primitive = primitive.twin
    p = make_patches(primitive, label.vertices, label.template, label.viewpoint)
    offset = np.einsum("bni,bij->bnj", (label.target - label.vertices)[p.index], p.frames) / UNIT_M
    return p.source, p.source_normals, p.template, p.template_normals, p.carried, p.pull, p.place, p.source + offset


def _single(data: Batch) -> Batch:
    """Patches (b, ...) that see something, of whole objects (o, p, ...)."""
    sees = data[6][..., -1] > 0
    return tuple(part[sees] for part in data)


def _measure(network: nn.Module, data: Batch) -> dict[str, float]:
    """Mean distance of patch points to their labels, mm, undeformed and deformed, of all and of what was not seen."""
    place, target = data[6], data[7]
    before = (target - data[0]).norm(dim=-1)
    hidden = place[..., -1] == 0
    after, within = [], []
    with torch.inference_mode():
        for *inputs, y in zip(*(part.split(32 if place.ndim == 3 else 512) for part in data), strict=True):
            if isinstance(network, PaperNet):
                after.append(torch.cdist(network(inputs[0], inputs[2]), y).amin(dim=1))
            else:
                offset, log_sigma = network(*inputs)
                after.append((inputs[0] + offset - y).norm(dim=-1))
                within.append(_surface_error(inputs[0] + offset - y, inputs[1]) < 2 * log_sigma.exp())
    error = torch.cat(after)

    def mean_mm(distance: Tensor) -> float:
        return round(float(distance.mean()) * UNIT_M * 1000, 3)

    metrics = {
        "val_samples": len(target),
        "mean_error_before_mm": mean_mm(before),
        "mean_error_after_mm": mean_mm(error),
    }
    if within:
        metrics |= {
            "hidden_error_before_mm": mean_mm(before[hidden]),
            "hidden_error_after_mm": mean_mm(error[hidden]),
            "share_within_two_sigma": round(float(torch.cat(within).float().mean()), 3),
        }
    return metrics
