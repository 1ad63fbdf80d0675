"""Training of PCRNet on the starts that registration really has, for views of shapes.

Pairs are seen as a completion sees them: z up and x towards the viewer. Traffic has a network of its
own, which saw what a LiDAR sees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.datasets import layout_of
from gfp_grasp.level import make_level_view
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import PCRNet, PoseShape, make_starts, network_input, pcrnet_weights, rotation_of
from gfp_grasp.scenes import shipped_families
from gfp_grasp.shapes import TRAFFIC
from gfp_grasp.train.by_sensor import class_views
from gfp_grasp.train.curves import LearningCurve, some_of
from gfp_grasp.train.loop import Batch, LoopConfig, shuffled, train, training_key, weights_place, write_weights
from gfp_grasp.train.views import View
from gfp_grasp.transforms import invert_T, rotation_about, rotation_between
from gfp_grasp.types import TABLETOP, GenericPrimitive, SensorProfile

PCRNET_CONFIG = LoopConfig(steps=2500, batch=32, rate=1e-3, decay=0.7)
_MAX_TURN_RAD = np.deg2rad(50)
_SHIFT = 0.065  # standard deviation of what a start is shifted by, of the primitive's size: 6 mm for a cup
_CURVE_PAIRS = 256  # that each point of the learning curve is measured on


def train_pcrnet(
    *,
    config: LoopConfig = PCRNET_CONFIG,
    sensor: SensorProfile = TABLETOP,
    classes: Sequence[str] | None = None,
    library: PrimitiveLibrary | None = None,
    data: Path | None = None,
    num_views: int = 4,
    limit: int | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train, measure on the validation split and write weights and card.

    Args:
        config: Schedule.
        sensor: What sees them.
        classes: Classes whose shapes are learnt from; None takes all of the library, of the shipped one those that the
            sensor meets.
        library: Their primitives; None takes the shipped ones.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        num_views: Views of each shape.
        limit: Shapes of a class; None takes the whole split.
        out: Weights file; None is the shipped one.
        runs: Folder of caches and checkpoints.
        report: Progress.

    Returns:
        Path of the card.

    Raises:
        CannotWrite: `out` or `runs`.
    """
    out = weights_place(out, pcrnet_weights(sensor), runs=runs)
    torch.manual_seed(config.seed)
    met = TRAFFIC if sensor.of_traffic else shipped_families()
    categories = tuple(classes or (met if library is None else library.categories))
    library = library or PrimitiveLibrary.shipped()

    def samples(split: str, seed: int, copies: int) -> Batch:
        rows = []
        rng = np.random.default_rng(seed)
        for category in categories:
            views = class_views(category, split, num_views=num_views, limit=limit, sensor=sensor, runs=runs, data=data)
            rows += _samples(views, library.primitive(category), rng, copies=copies, sensor=sensor)
        columns = zip(*rows, strict=True)
        return tuple(torch.tensor(np.array(column), dtype=torch.float32) for column in columns)

    network = PCRNet()
    pairs, held_out = samples("train", config.seed, 2), samples("val", config.seed + 1, 1)
    key = training_key(config, sensor, categories, library, num_views, limit, data)
    folder = runs / "pcrnet"
    curve = LearningCurve(
        network, _loss, some_of(held_out, _CURVE_PAIRS), config.bf16, folder / f"{key}_curve.json", report
    )
    network, hours = train(
        network,
        augmented(shuffled(pairs, config.batch)),
        _loss,
        config=config,
        checkpoint=folder / f"{key}.pt",
        report=curve,
    )
    return write_weights(
        network.half().float(),
        out,
        config=config,
        data={
            "classes": categories,
            "shapes": "procedural" if data is None else layout_of(data),
            "split": "train",
            "views_a_shape": num_views,
            "samples": len(pairs[0]),
        },
        hours=hours,
        metrics=_measure(network, held_out),
        extra={"learning_curve": curve.points},
    )


def augmented(stream: Callable[[torch.Generator], Iterator[Batch]]) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Pairs mirrored left to right, and templates moved a little more, the truth along with them."""

    def batches(generator: torch.Generator) -> Iterator[Batch]:
        for template, cloud, R, t, radius in stream(generator):
            b = len(template)
            sign = torch.ones(b, 1, 3)
            sign[:, 0, 1] = (torch.randint(0, 2, (b,), generator=generator) * 2 - 1).float()
            R = sign.transpose(1, 2) * R * sign
            quaternion = torch.cat([torch.ones(b, 1), 0.05 * torch.randn(b, 3, generator=generator)], dim=1)
            turn, step = rotation_of(quaternion), 0.1 * torch.randn(b, 3, generator=generator)
            # template' = turn template + step, so R' = R turn^T and t' = t - R' step.
            R = R @ turn.transpose(1, 2)
            t = t * sign[:, 0] - (R @ step[..., None])[..., 0]
            yield (template * sign) @ turn.transpose(1, 2) + step[:, None], cloud * sign, R, t, radius

    return batches


def _samples(
    views: Sequence[View],
    primitive: GenericPrimitive,
    rng: np.random.Generator,
    *,
    copies: int,
    sensor: SensorProfile = TABLETOP,
) -> list:
    """Rows of template and cloud (n, 3), true rotation (3, 3) and translation (3,), radius m, for views of a class."""
    rows = []
    for view in views:
        level = make_level_view(view.detection(sensor=sensor))
        T_level_object = invert_T(level.T_world_level) @ view.T_world_object
        near = [s for s in make_starts(primitive, level, (view.resting,)) if _is_near(s, T_level_object, primitive)]
        for _ in range(copies if near else 0):
            state = _jittered(near[int(rng.integers(len(near)))], rng, _SHIFT * primitive.size_m)
            template, cloud, centre, radius = network_input(state, primitive, level.points)
            R, t = _truth(state, T_level_object, primitive)
            # About the centre, in units of the radius: x -> R (x - c) + (R c + t - c), as the network moves it.
            rows.append((template, cloud, R, (R @ centre + t - centre) / radius, radius))
    return rows


def _truth(state: PoseShape, T_here_object: np.ndarray, primitive: GenericPrimitive) -> tuple[np.ndarray, np.ndarray]:
    """Rigid motion (R, t) that brings the start onto the true pose, as far as symmetry lets it show."""
    R_true, t_true = T_here_object[:3, :3], T_here_object[:3, 3]
    symmetric = np.isinf(primitive.symmetry.order)
    R = rotation_between(state.R[:, 2], R_true[:, 2]) if symmetric else R_true @ state.R.T
    return R, t_true - R @ state.t


def _is_near(state: PoseShape, T_here_object: np.ndarray, primitive: GenericPrimitive) -> bool:
    """Whether the start is within the turn that the network is asked to correct."""
    R, _ = _truth(state, T_here_object, primitive)
    return float(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))) < _MAX_TURN_RAD


def _jittered(state: PoseShape, rng: np.random.Generator, shift_m: float) -> PoseShape:
    R = rotation_about(state.axis_world, rng.normal(0, np.deg2rad(8))) @ state.R
    size = float(np.exp(state.log_scale).mean())
    return replace(
        state,
        R=R,
        t=state.t + rng.normal(0, shift_m, 3) * size,
        log_scale=state.log_scale + rng.normal(0, 0.05, 3),
    )


def _loss(network: nn.Module, batch: Batch) -> Tensor:
    """Mean distance of the moved template to where it should be, over all iterations."""
    template, cloud, R_true, t_true, _ = batch
    assert isinstance(network, PCRNet)
    target = template @ R_true.transpose(1, 2) + t_true[:, None]
    total = template.new_zeros(())
    steps = 0
    for R, t in network.iterate(template, cloud):
        total = total + (template @ R.transpose(1, 2) + t[:, None] - target).norm(dim=-1).mean()
        steps += 1
    return total / steps


def _measure(network: nn.Module, data: Batch) -> dict[str, float]:
    """Mean distance of the template to its true place, mm, before and after."""
    template, cloud, R_true, t_true, radius = data
    target = template @ R_true.transpose(1, 2) + t_true[:, None]
    with torch.inference_mode():
        moved = []
        for a, b in zip(template.split(256), cloud.split(256), strict=True):
            R, t = network(a, b)
            moved.append(a @ R.transpose(1, 2) + t[:, None])
    after = ((torch.cat(moved) - target).norm(dim=-1).mean(dim=1) * radius).mean()
    before = ((template - target).norm(dim=-1).mean(dim=1) * radius).mean()
    return {
        "val_samples": len(template),
        "mean_error_before_mm": round(float(before) * 1000, 3),
        "mean_error_after_mm": round(float(after) * 1000, 3),
    }
