"""Training of the three GFPNets on labelled patches of registered primitives.

Letters: o objects, p patches of one, n source points, m template points, c channels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.assets import data_dir
from gfp_grasp.datasets import layout_of
from gfp_grasp.deform import make_patches, patch_layout
from gfp_grasp.deform.gfpnet import MODES, PRIMITIVES, WEIGHTS, Variant, change_units, fit_features, make_network
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import load_primitive
from gfp_grasp.register import FitConfig
from gfp_grasp.shapes import FAMILIES
from gfp_grasp.train.labels import Label, make_labels
from gfp_grasp.train.loop import Batch, LoopConfig, shuffled, train, write_weights
from gfp_grasp.types import FittedPrimitive, GenericPrimitive

DEFAULTS: dict[Variant, LoopConfig] = {
    "patch": LoopConfig(steps=8000, batch=16, rate=1e-3, decay=0.7, weight_decay=0.01),  # a batch of whole objects
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
    data: Path | None = None,
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
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
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
    make = partial(make_labels, num_views=num_views, runs=runs, workers=workers, fit=fit, data=data)
    objects, counts = _objects(partial(make, split="train", limit=limit))
    network, hours = train(
        make_network(variant),
        augmented(shuffled(objects, config.batch)) if variant == "patch" else shuffled(_single(objects), config.batch),
        point_loss if variant == "patch" else paper_loss,
        config=config,
        checkpoint=runs / "gfpnet" / f"{variant}.pt",
        report=report,
    )
    network = network.half().float()
    held_out, _ = _objects(partial(make, split="val", limit=None if limit is None else max(1, limit // 4)))
    return write_weights(
        network,
        out or data_dir("weights") / f"{WEIGHTS[variant]}.safetensors",
        config=config,
        data={
            "families": FAMILIES,
            "shapes": "procedural" if data is None else layout_of(data),
            "split": "train",
            "shapes_a_family": limit or "all",
            "views_a_shape": num_views,
            "samples": len(objects.source),
            "labels": counts,
        },
        hours=hours,
        metrics=_measure(network, held_out) if variant == "patch" else _measure_paper(network, _single(held_out)),
        extra={"primitives": {name: load_primitive(name).card["shape_sha256"] for name in PRIMITIVES}},
    )


class Objects(NamedTuple):
    """Labelled objects, o of them, patch by patch; floats are float16 until they are used.

    Attributes:
        source: (o, p, n, 3) S, and as the rest in the patch's own frame and unit.
        source_normals: (o, p, n, 3).
        template: (o, p, m, 3) T.
        template_normals: (o, p, m, 3).
        mirrored: (o, p, m).
        residuals: (o, p, n, c).
        pose_features: (o, p, c).
        fit: (o, c) as of `fit_features`.
        offset: (o, p, n, 3) from S to its label.
        frames: (o, p, 3, 3) axes of the patches as columns.
        scale: (o, 3) of the fit.
        primitive: (o,) index into `_primitives()`.
        unit_m: (o,) float32, the length that is 1 in the patches.
    """

    source: Tensor
    source_normals: Tensor
    template: Tensor
    template_normals: Tensor
    mirrored: Tensor
    residuals: Tensor
    pose_features: Tensor
    fit: Tensor
    offset: Tensor
    frames: Tensor
    scale: Tensor
    primitive: Tensor
    unit_m: Tensor


def augmented(stream: Callable[[torch.Generator], Iterator[Batch]]) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Objects with noisier and sparser template points.

    Half of each patch's source points are drawn: they are decoded one by one, and all of them would cost twice.
    """

    def batches(generator: torch.Generator) -> Iterator[Batch]:
        for batch in stream(generator):
            objects = Objects(*batch)
            o, p, m, _ = objects.template.shape
            num_source = objects.source.shape[2]
            some = torch.randperm(num_source, generator=generator)[: num_source // 2]
            # A random share of the template points is lost: others stand in for them, as where few were seen.
            kept = torch.rand(o, 1, 1, generator=generator) * 0.9 + 0.1
            stand_in = (torch.rand(o, p, m, generator=generator) * kept * m).long()
            pick = torch.argsort(torch.rand(o, p, m, generator=generator), dim=2).gather(2, stand_in)[..., None]
            noise = torch.randn(o, p, m, 3, generator=generator) * (_NOISE_M / objects.unit_m)[:, None, None, None]
            thinned = objects._replace(
                source=objects.source[:, :, some],
                source_normals=objects.source_normals[:, :, some],
                template=(objects.template + noise).gather(2, pick.expand(-1, -1, -1, 3)),
                template_normals=objects.template_normals.gather(2, pick.expand(-1, -1, -1, 3)),
                mirrored=objects.mirrored.gather(2, pick[..., 0]),
                residuals=objects.residuals[:, :, some],
                offset=objects.offset[:, :, some],
            )
            yield (*thinned, some)

    return batches


def point_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Mean error of each vertex, and the Gaussian likelihood of that error under the deviation the network gives."""
    *parts, some = batch
    objects = Objects(*parts)
    error, log_sigma = _errors(network, objects, some)
    log_sigma = log_sigma.float().clamp(-7, 2)
    # The error is a given to the likelihood: offsets do not learn less where sigma would excuse them.
    likelihood = 0.5 * (error.detach() * torch.exp(-log_sigma)) ** 2 + log_sigma
    return error.mean() + 0.02 * likelihood.clamp_max(20.0).mean()


def _errors(network: nn.Module, objects: Objects, some: Tensor) -> tuple[Tensor, Tensor]:
    """What is left (o, p, n) between each point as moved and its label, patch units, and log sigma (o, p, n)."""
    offset, log_sigma, change = network(*objects[:8])
    moved = offset.float() + _field(objects, change, some)
    return _surface_error(moved - objects.offset.float(), objects.source_normals.float()), log_sigma


def _field(objects: Objects, change: Tensor, some: Tensor) -> Tensor:
    """What a change (o, c) of the fits does to points some (n,) of each patch: `mode_field` in patch frame and unit."""
    index, modes, units = _primitives()
    change = change * units[objects.primitive].to(change)
    # First the field of all vertices, then what each patch has of it.
    whole = torch.einsum("oc,ocvi->ovi", change[:, :MODES], modes[objects.primitive]) * objects.scale[:, None]
    at = index[objects.primitive][:, :, some]  # (o, p, n)
    o, p, n = at.shape
    field = whole.gather(1, at.reshape(o, -1, 1).expand(-1, -1, 3)).view(o, p, n, 3)
    frames = objects.frames.float()
    vertices = (
        torch.einsum("opij,opnj->opni", frames, objects.source.float()) + objects.pose_features[:, :, None, :3].float()
    )
    unit_m = objects.unit_m[:, None, None, None]
    field = field + unit_m * vertices * change[:, None, None, MODES : MODES + 3] + change[:, None, None, MODES + 3 :]
    return torch.einsum("opij,opni->opnj", frames, field) / unit_m


def _surface_error(gap: Tensor, normals: Tensor) -> Tensor:
    """Length of gaps (..., 3) of which what lies along the surface counts little: it does not change the shape."""
    across = (gap * normals).sum(dim=-1, keepdim=True) * normals
    return (across + _ALONG * (gap - across)).norm(dim=-1)


def paper_loss(network: nn.Module, batch: Batch) -> Tensor:
    """The paper's eq. 1: 0.7 times the Chamfer distance to the label and 0.3 times the Laplacian's.

    Its eq. 3 as printed, the mean position of the neighbours, has no useful minimum; the Laplacian here is the
    distance of each point to the mean of its neighbours on S, less the label's own.
    """
    source, template, target, _ = batch
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


@lru_cache(maxsize=1)
def _primitives() -> tuple[Tensor, Tensor, Tensor]:
    """Of every shipped primitive and then its twin: vertices of the patches (q, p, n), modes (q, k, v, 3) m, and what
    one unit of a change of its fit is (q, c)."""
    shipped = [primitive for name in PRIMITIVES for primitive in _with_twin(name)]
    index = np.stack([patch_layout(primitive)[0] for primitive in shipped])
    most = max(len(primitive.vertices) for primitive in shipped)
    modes = np.zeros((len(shipped), MODES, most, 3), dtype=np.float32)
    for own, primitive in zip(modes, shipped, strict=True):
        own[: len(primitive.modes), : len(primitive.vertices)] = primitive.modes[:MODES]
    units = np.stack([change_units(primitive) for primitive in shipped])
    return torch.from_numpy(index), torch.from_numpy(modes), torch.from_numpy(units)


def _with_twin(name: str) -> tuple[GenericPrimitive, GenericPrimitive]:
    """A shipped primitive and its handle-less twin; itself again where it has none."""
    primitive = load_primitive(name)
    return primitive, primitive.twin or primitive


def _objects(
    make: Callable[[str], tuple[list[Label], dict[str, int]]],
) -> tuple[Objects, dict[str, dict[str, int]]]:
    """All labelled objects of a split, and how many labels of each class were kept and dropped."""
    columns: list[list[np.ndarray]] = [[] for _ in Objects._fields]
    counts = {}
    for family in FAMILIES:
        labels, counts[family] = make(family)
        for label in labels:
            for column, part in zip(columns, _object(label), strict=True):
                part = np.asarray(part)
                half = part.dtype.kind != "i" and part.ndim > 0
                column.append(part.astype(np.float16) if half else part)
    if not columns[0]:
        raise InvalidOption(f"no label could be made: {counts}; are there meshes of {', '.join(FAMILIES)}?")
    return Objects(*(torch.from_numpy(np.stack(column)) for column in columns)), counts


def _object(label: Label) -> tuple[object, ...]:
    """The fields of `Objects` for one label."""
    primitive = _with_twin(label.primitive)[label.twin]
    p = make_patches(primitive, label.vertices, label.template, label.viewpoint)
    coefficients = np.zeros(len(primitive.modes))
    coefficients[: len(label.coefficients)] = label.coefficients  # of a fit that had few modes
    fit = FittedPrimitive(primitive, np.eye(4), label.scale, coefficients, 0.0)
    offset = np.einsum("bni,bij->bnj", (label.target - label.vertices)[p.index], p.frames) / p.unit_m
    number = 2 * PRIMITIVES.index(label.primitive) + int(label.twin)
    return (
        p.source, p.source_normals, p.template, p.template_normals, p.mirrored, p.residuals, p.pose_features,
        fit_features(fit), offset, p.frames, label.scale, number, np.float32(p.unit_m),
    )  # fmt: skip


def single_patches(split: str, num_views: int, limit: int | None, runs: Path, workers: int = 1) -> Batch:
    """S, T, label (b, n, 3) and unit (b,) m of the patches of a split that see something, for the paper's networks."""
    objects, _ = _objects(
        partial(make_labels, split=split, num_views=num_views, limit=limit, runs=runs, workers=workers)
    )
    return _single(objects)


def _single(objects: Objects) -> Batch:
    """S, T, label (b, n, 3) and unit (b,) m of the patches that see something."""
    sees = objects.pose_features[..., -1] > 0
    unit_m = objects.unit_m[:, None].expand(sees.shape)
    return tuple(p[sees] for p in (objects.source, objects.template, objects.source + objects.offset, unit_m))


def _measure_paper(network: nn.Module, data: Batch) -> dict[str, float]:
    """Mean distance of the patches' points to the labels, mm, undeformed and as their nearest of the predicted set."""
    after = []
    with torch.inference_mode():
        for source, template, target, _ in zip(*(part.split(512) for part in data), strict=True):
            moved = network(source.float(), template.float())
            after.append(torch.cdist(moved, target.float()).amin(dim=1))
    return {
        "val_samples": len(data[0]),
        "mean_error_before_mm": _mean_mm((data[2] - data[0]).float().norm(dim=-1), data[3]),
        "mean_error_after_mm": _mean_mm(torch.cat(after), data[3]),
    }


def _measure(network: nn.Module, objects: Objects) -> dict[str, float]:
    """Mean distance of the points to their labels, mm, undeformed and deformed, of all and of what was not seen."""
    hidden = objects.pose_features[..., -1] == 0
    before = _surface_error(objects.offset.float(), objects.source_normals.float())
    everything = torch.arange(objects.source.shape[2])
    after, within = [], []
    with torch.inference_mode():
        for parts in zip(*(part.split(32) for part in objects), strict=True):
            part = Objects(*(p.float() if p.is_floating_point() else p for p in parts))
            error, log_sigma = _errors(network, part, everything)
            after.append(error)
            within.append(error < 2 * log_sigma.exp())
    error, unit_m = torch.cat(after), objects.unit_m
    hidden_unit_m = unit_m[:, None].expand(hidden.shape)[hidden]
    metrics = {
        "val_samples": len(objects.source),
        "mean_error_before_mm": _mean_mm(before, unit_m),
        "mean_error_after_mm": _mean_mm(error, unit_m),
        "hidden_error_before_mm": _mean_mm(before[hidden], hidden_unit_m),
        "hidden_error_after_mm": _mean_mm(error[hidden], hidden_unit_m),
        "share_within_two_sigma": round(float(torch.cat(within).float().mean()), 3),
    }
    classes = objects.primitive // 2
    for number, name in enumerate(PRIMITIVES):
        mine = classes == number
        metrics[f"{name}_error_before_mm"] = _mean_mm(before[mine], unit_m[mine])
        metrics[f"{name}_error_after_mm"] = _mean_mm(error[mine], unit_m[mine])
    return metrics


def _mean_mm(distance: Tensor, unit_m: Tensor) -> float:
    """Mean of distances (b, ...) in units (b,) m."""
    return round(float((distance.flatten(1).mean(dim=1) * unit_m).mean()) * 1000, 3)
