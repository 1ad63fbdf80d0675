"""Training of the default GFPNet on labelled patches of registered primitives: `gfp-grasp train gfpnet`.

Letters: o objects, p patches of one, n source points, m template points, c channels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn

from gfp_grasp.datasets import layout_of
from gfp_grasp.deform import (
    BELIEF,
    MISFIT_SHARE,
    WEIGHTS,
    Levers,
    PatchAnswer,
    Variant,
    make_levers,
    make_network,
    read_network,
    solve_change,
)
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.journal import read_figures
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import shipped_families
from gfp_grasp.train.labels import make_labels
from gfp_grasp.train.loop import Batch, LoopConfig, mean_mm, shuffled, train, training_key, weights_place, write_weights
from gfp_grasp.train.patch_data import Objects, PrimitiveTable, augmented, load_objects

GFPNET_CONFIG = LoopConfig(steps=4000, batch=16, rate=1e-3, decay=0.7, weight_decay=0.01)  # a batch of whole objects
_ALONG = 0.3  # weight of an error along the surface against one across it


def train_gfpnet(
    *,
    classes: Sequence[str] | None = None,
    library: PrimitiveLibrary | None = None,
    config: LoopConfig = GFPNET_CONFIG,
    num_views: int = 4,
    limit: int | None = None,
    data: Path | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    fit: FitConfig = FitConfig(),
    start: Path | None = None,
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train one network, measure it on the validation split and write weights and card.

    Args:
        classes: Classes whose shapes are learnt from; None takes all of the library, the household ones of the shipped
            one.
        library: Their primitives; None takes the shipped ones.
        config: Schedule.
        num_views: Views of each shape.
        limit: Shapes of a class; None takes the whole split.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        out: Weights file; None is the shipped one.
        runs: Folder of caches and checkpoints.
        workers: Processes that make labels.
        fit: Registration that labels start from.
        start: Weights file to go on from, whose card becomes a part of the new one; None starts
            anew.
        report: Progress.

    Returns:
        Path of the card.

    Raises:
        UnreadableFile: `start` holds no weights of this network, or has no card beside it.
        CannotWrite: `out` or `runs`.
    """
    out = weights_place(out, WEIGHTS["patch"], runs=runs)
    classes = classes or (shipped_families() if library is None else library.categories)
    library = library or PrimitiveLibrary.shipped()
    table = PrimitiveTable.of(library, tuple(classes))
    torch.manual_seed(config.seed)
    network, before = (make_network("patch"), None) if start is None else begun("patch", start)
    make = partial(make_labels, library=library, num_views=num_views, runs=runs, workers=workers, fit=fit, data=data)
    objects, counts = load_objects(partial(make, split="train", limit=limit), table)
    key = training_key(config, table.categories, library, num_views, limit, data, fit, before)
    network, hours = train(
        network,
        augmented(shuffled(objects, config.batch)),
        partial(point_loss, table=table),
        config=config,
        checkpoint=runs / "gfpnet" / f"patch_{key}.pt",
        report=report,
    )
    network = network.half().float()
    held_out, _ = load_objects(partial(make, split="val", limit=None if limit is None else max(1, limit // 4)), table)
    return write_weights(
        network,
        out,
        config=config,
        data={
            "classes": table.categories,
            "shapes": "procedural" if data is None else layout_of(data),
            "split": "train",
            "shapes_a_class": limit or "all",
            "views_a_shape": num_views,
            "samples": len(objects.source),
            "labels": counts,
        },
        hours=hours,
        metrics=_measure(network, held_out, table),
        extra=None if before is None else {"start": before},
    )


def begun(variant: Variant, start: Path) -> tuple[nn.Module, dict[str, object]]:
    """The network of a weights file, in training mode, and the card beside it.

    Raises:
        UnreadableFile: The file holds no weights of this variant, or no card that can be read is beside it.
    """
    card = start.with_suffix(".json")
    if not card.is_file():
        raise UnreadableFile(f"{start} has no card {card.name} beside it: `gfp-grasp train gfpnet` writes both")
    return read_network(variant, start).train(), read_figures(card)


def point_loss(network: nn.Module, batch: Batch, *, table: PrimitiveTable) -> Tensor:
    """Mean error of each vertex, and two likelihoods under the deviations that the network gives.

    One is of that error; the other of what is left along the normal against the advance that the fit is to make, whose
    precision is its weight in the regression.
    """
    *parts, some = batch
    objects = Objects(*parts)
    error, answer = _errors(network, objects, some, table)
    # The error is a given to the likelihood: offsets do not learn less where sigma would excuse them.
    sure = _unlikelihood(error.detach(), answer.log_sigma.clamp(-7, 2))
    ahead = (objects.offset.float() * objects.source_normals.float()).sum(dim=-1) / MISFIT_SHARE
    asked = _unlikelihood(ahead - answer.advance, -0.5 * answer.log_weight)
    return error.mean() + 0.02 * (sure + asked)


def _unlikelihood(error: Tensor, log_sigma: Tensor) -> Tensor:
    """Mean negative logarithm of a Gaussian likelihood; a far outlier counts no more than a far one."""
    return (0.5 * (error * torch.exp(-log_sigma)) ** 2 + log_sigma).clamp_max(20.0).mean()


def _errors(
    network: nn.Module, objects: Objects, some: Tensor, table: PrimitiveTable, *, belief: float = 1.0
) -> tuple[Tensor, PatchAnswer]:
    """What is left (o, p, n) between each point as moved and its label, patch units, and what the network said."""
    answer = network(*objects[:8])
    # Least squares need more digits than the network's products.
    with torch.autocast(objects.source.device.type, enabled=False):
        answer = PatchAnswer(*(part.float() for part in answer))
        moved = belief * (answer.offset + _field(objects, answer, some, table))
        return _surface_error(moved - objects.offset.float(), objects.source_normals.float()), answer


def _field(objects: Objects, answer: PatchAnswer, some: Tensor, table: PrimitiveTable) -> Tensor:
    """What `change_field` does to points some (n,) of each patch, (o, p, n, 3), in patch frame and unit."""
    o, p, n, _ = objects.source.shape
    frames = objects.frames.float()
    at = table.index[objects.primitive][:, :, some].reshape(o, -1)
    vertices = (
        torch.einsum("opij,opnj->opni", frames, objects.source.float()) + objects.pose_features[:, :, None, :3].float()
    )
    levers = make_levers(
        objects.unit_m[:, None, None] * vertices.reshape(o, -1, 3),
        table.modes[objects.primitive[:, None], at],
        objects.scale.float(),
        objects.coefficients.float(),
        table.log_scale_cov[objects.primitive],
        objects.unit_m,
    )
    normals = torch.einsum("opij,opnj->opni", frames, objects.source_normals.float()).reshape(o, -1, 3)
    change = solve_change(Levers(*levers), normals, answer)
    field = MISFIT_SHARE * torch.einsum("oqiu,ou->oqi", levers.moves, change).view(o, p, n, 3)
    return torch.einsum("opij,opni->opnj", frames, field)


def _surface_error(gap: Tensor, normals: Tensor) -> Tensor:
    """Length of gaps (..., 3) of which what lies along the surface counts little: it does not change the shape."""
    across = (gap * normals).sum(dim=-1, keepdim=True) * normals
    return (across + _ALONG * (gap - across)).norm(dim=-1)


def _measure(network: nn.Module, objects: Objects, table: PrimitiveTable) -> dict[str, float]:
    """Mean distance of the points to their labels, mm, undeformed and deformed, of all and of what was not seen."""
    hidden = objects.pose_features[..., -1] == 0
    unit_m = objects.unit_m[:, None, None]
    before = unit_m * _surface_error(objects.offset.float(), objects.source_normals.float())
    everything = torch.arange(objects.source.shape[2])
    after, within = [], []
    with torch.inference_mode():
        for parts in zip(*(part.split(32) for part in objects), strict=True):
            part = Objects(*(p.float() if p.is_floating_point() else p for p in parts))
            error, answer = _errors(network, part, everything, table, belief=BELIEF)
            after.append(error)
            within.append(error < 2 * answer.log_sigma.exp())
    error = unit_m * torch.cat(after)
    metrics = {
        "val_samples": len(objects.source),
        "mean_error_before_mm": mean_mm(before),
        "mean_error_after_mm": mean_mm(error),
        "hidden_error_before_mm": mean_mm(before[hidden]),
        "hidden_error_after_mm": mean_mm(error[hidden]),
        "share_within_two_sigma": round(float(torch.cat(within).float().mean()), 3),
    }
    for name in dict.fromkeys(primitive.name for primitive in table.primitives):
        numbers = [i for i, primitive in enumerate(table.primitives) if primitive.name == name]
        mine = torch.isin(objects.primitive, torch.tensor(numbers))
        if mine.any():
            metrics[f"{name}_error_before_mm"] = mean_mm(before[mine])
            metrics[f"{name}_error_after_mm"] = mean_mm(error[mine])
    return metrics
