"""Training of the paper's two networks in the paper's own setting: `gfp-grasp train gfpnet --variant paper-iterative`.

They learn from patches one by one (see `paper_data`), by Chamfer distance and Laplacian. Letters: b patches, n source
points, m template points, k neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn

from gfp_grasp.datasets import layout_of
from gfp_grasp.deform import WEIGHTS, PaperNet, Variant, make_network
from gfp_grasp.errors import InvalidOption
from gfp_grasp.shapes import IN_PAPER
from gfp_grasp.train.curves import LearningCurve, some_of
from gfp_grasp.train.gfpnet import begun
from gfp_grasp.train.loop import Batch, LoopConfig, mean_mm, shuffled, train, training_key, weights_place, write_weights
from gfp_grasp.train.paper_data import paper_patches

_CHAMFER_SHARE = 0.7  # the paper's loss: 0.7 Chamfer distance + 0.3 Laplacian
_NEIGHBOURS = 8
_CURVE_PATCHES = 512  # that each point of a learning curve is measured on
_MEMBERS = 80  # of each class

# How two open ends of the paper's loss are read; the first is ours.
Reading = Literal["as taken", "CD to T", "eq. 3 as printed"]
# Optimiser and batch are the paper's. At its rate of 1e-4 curves are flat after several times as many steps.
PAPER_CONFIGS: dict[Variant, LoopConfig] = {
    "paper-iterative": LoopConfig(steps=6000, batch=256, rate=1e-3, decay=0.7),
    "paper-oneshot": LoopConfig(steps=3000, batch=256, rate=1e-3, decay=0.7),
}


def paper_loss(network: Callable[[Tensor, Tensor], Tensor], batch: Batch, *, reading: Reading = "as taken") -> Tensor:
    """The paper's eq. 1: 0.7 times the Chamfer distance to the label and 0.3 times the Laplacian's.

    Its eq. 3 as printed, the mean position of the neighbours, has no useful minimum; the Laplacian here is the
    distance of each point to the mean of its neighbours on S, less the label's own.

    Args:
        network: Answers S and T with MS.
        batch: S, T, label (b, n, 3) and unit (b,).
        reading: "as taken"; "CD to T", the Chamfer distance to what was observed in place of the label; or "eq. 3 as
            printed".
    """
    source, template, target, _ = batch
    moved = network(source, template).float()
    chamfer = chamfer_of_sets(moved, template if reading == "CD to T" else target).mean()
    near = torch.cdist(source, source).topk(_NEIGHBOURS + 1, largest=False).indices[..., 1:]
    if reading == "eq. 3 as printed":
        laplacian = (moved - _lap(moved, near)).norm(dim=-1).mean()
    else:
        laplacian = (_lap(moved, near).norm(dim=-1) - _lap(target, near).norm(dim=-1)).abs().mean()
    return _CHAMFER_SHARE * chamfer + (1 - _CHAMFER_SHARE) * laplacian


def _lap(points: Tensor, near: Tensor) -> Tensor:
    b, n, k = near.shape
    around = torch.gather(points[:, None].expand(b, n, n, 3), 2, near[..., None].expand(b, n, k, 3))
    return points - around.mean(dim=2)


def looped_loss(network: PaperNet, batch: Batch, *, reading: Reading = "as taken") -> Tensor:
    """The loss `paper_loss` of `looped_back`: a network learns each number of its iterations for the price of one."""
    return paper_loss(partial(looped_back, network), batch, reading=reading)


def looped_back(network: PaperNet, source: Tensor, template: Tensor) -> Tensor:
    """The set MS (b, n, 3) after one to `network.iterations` iterations, as many as torch's generator says.

    Gradients flow through the last iteration alone: those before it give a set to start from, as if it were S.
    """
    with torch.no_grad():
        source = network(source, template, iterations=int(torch.randint(network.iterations, ())))
    return network(source, template, iterations=1)


def train_paper(
    variant: Variant,
    *,
    classes: Sequence[str] | None = None,
    config: LoopConfig | None = None,
    num_views: int = 4,
    limit: int | None = None,
    data: Path | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    start: Path | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train one of the paper's networks, measure it on the validation split and write weights and card.

    Args:
        variant: "paper-iterative" or "paper-oneshot".
        classes: Classes whose shapes are learnt from; None takes those of the paper's table.
        config: Schedule; None is the variant's own.
        num_views: Views of each shape.
        limit: Shapes of a class; None takes 80.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        out: Weights file; None is the shipped one.
        runs: Folder of caches and checkpoints.
        workers: Processes that render and label.
        start: Weights file of the same variant to go on from, whose card becomes a part of the new one; None starts
            anew.
        report: Progress.

    Returns:
        Path of the card.

    Raises:
        InvalidOption: Not a variant of the paper's, or no label could be made.
        UnreadableFile: `start` holds no weights of this variant, or has no card beside it.
        CannotWrite: `out` or `runs`.
    """
    if variant not in PAPER_CONFIGS:
        raise InvalidOption(f"variant is {variant!r}; one of {', '.join(PAPER_CONFIGS)} is expected")
    out = weights_place(out, WEIGHTS[variant], runs=runs)
    config, classes = config or PAPER_CONFIGS[variant], tuple(classes or IN_PAPER)
    torch.manual_seed(config.seed)
    network, before = (make_network(variant), None) if start is None else begun(variant, start)
    assert isinstance(network, PaperNet)
    make = partial(paper_patches, classes=classes, num_views=num_views, data=data, runs=runs, workers=workers)
    members = limit or _MEMBERS
    patches, counts = make("train", members=members)
    held_out, _ = make("val", members=max(1, members // 8))
    key = training_key(config, classes, members, num_views, data, before, len(patches[0]))
    curve = LearningCurve(
        network,
        paper_loss,
        some_of(held_out, _CURVE_PATCHES),
        config.bf16,
        runs / "gfpnet" / f"{variant}_{key}_curve.json",
        report,
    )
    network, hours = train(
        network,
        shuffled(patches, config.batch),
        looped_loss,
        config=config,
        checkpoint=runs / "gfpnet" / f"{variant}_{key}.pt",
        report=curve,
    )
    network = network.half().float()
    return write_weights(
        network,
        out,
        config=config,
        data={
            "classes": classes,
            "shapes": "procedural" if data is None else layout_of(data),
            "split": "train",
            "shapes_a_class": members,
            "views_a_shape": num_views,
            "samples": len(patches[0]),
            "labels": counts,
        },
        hours=hours,
        metrics=measure_paper(network, held_out),
        extra={"learning_curve": curve.points} if before is None else {"learning_curve": curve.points, "start": before},
    )


def measure_paper(network: nn.Module, patches: Batch) -> dict[str, float]:
    """Chamfer distance to the label, mm, of the patches as they are and of the predicted sets (means of patches)."""
    source, template, target, unit_m = patches
    before, after = [], []
    with torch.inference_mode():
        for parts in zip(source.split(512), template.split(512), target.split(512), strict=True):
            s, t, wanted = (part.float() for part in parts)
            before.append(chamfer_of_sets(s, wanted))
            after.append(chamfer_of_sets(network(s, t), wanted))
    return {
        "val_samples": len(source),
        "cd_before_mm": mean_mm(unit_m * torch.cat(before)),
        "cd_after_mm": mean_mm(unit_m * torch.cat(after)),
    }


def chamfer_of_sets(a: Tensor, b: Tensor) -> Tensor:
    """Chamfer distance (b,) of the sets (b, n, 3)."""
    pairwise = torch.cdist(a, b)
    return pairwise.amin(dim=2).mean(dim=1) + pairwise.amin(dim=1).mean(dim=1)
