"""Labelled objects patch by patch, as the networks learn from them, and the primitives that they were fitted with.

Letters: o objects, p patches of one, n source points, m template points, c channels, q primitives, v vertices, k modes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from gfp_grasp.deform import fit_features, make_patches, patch_layout
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train.labels import Label
from gfp_grasp.train.loop import Batch
from gfp_grasp.types import FittedPrimitive, GenericPrimitive

_NOISE = 0.0167  # of template points, patch units: half a millimetre for things of a cup's size


class PrimitiveTable(NamedTuple):
    """Primitives that are learnt from, q of them, each with its variants.

    Attributes:
        categories: Classes.
        primitives: As they are fitted.
        without: Optional parts that each of them lacks.
        index: (q, p, n) vertices of the patches.
        modes: (q, v, 3, k) m; zero beyond a primitive's own vertices and modes.
        log_scale_cov: (q, 3, 3).
    """

    categories: tuple[str, ...]
    primitives: tuple[GenericPrimitive, ...]
    without: tuple[frozenset[str], ...]
    index: Tensor
    modes: Tensor
    log_scale_cov: Tensor

    @classmethod
    def of(cls, library: PrimitiveLibrary, categories: tuple[str, ...]) -> PrimitiveTable:
        """The table of some classes of a library."""
        own = [primitive for category in categories for primitive in library.members_of(category)]
        bodies = [(body, without) for primitive in own for body, without in _bodies(primitive)]
        primitives = tuple(body for body, _ in bodies)
        most, count = max(len(p.vertices) for p in primitives), max(len(p.modes) for p in primitives)
        modes = np.zeros((len(primitives), most, 3, count), dtype=np.float32)
        for row, primitive in zip(modes, primitives, strict=True):
            row[: len(primitive.vertices), :, : len(primitive.modes)] = primitive.modes.transpose(1, 2, 0)
        return cls(
            categories,
            primitives,
            tuple(without for _, without in bodies),
            torch.from_numpy(np.stack([patch_layout(primitive)[0] for primitive in primitives])),
            torch.from_numpy(modes),
            torch.from_numpy(np.stack([primitive.log_scale_cov for primitive in primitives])).float(),
        )

    def number(self, name: str, without: Iterable[str] = ()) -> int:
        """Which of the primitives has this name and lacks these optional parts."""
        names = [(primitive.name, lacks) for primitive, lacks in zip(self.primitives, self.without, strict=True)]
        return names.index((name, frozenset(without)))


def _bodies(primitive: GenericPrimitive) -> list[tuple[GenericPrimitive, frozenset[str]]]:
    """A primitive and its variants, with the optional parts that each of them lacks."""
    variants = [(variant.primitive, frozenset(variant.without)) for variant in primitive.variants]
    return [(primitive, frozenset()), *variants]


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
        coefficients: (o, k) of the fit, zero beyond the primitive's own.
        primitive: (o,) number in the table.
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
    coefficients: Tensor
    primitive: Tensor
    unit_m: Tensor


def augmented(stream: Callable[[torch.Generator], Iterator[Batch]]) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Objects with noisier and sparser template points.

    A quarter of each patch's source points are drawn, for they are decoded one by one, and half of its template points.
    """

    def batches(generator: torch.Generator) -> Iterator[Batch]:
        for batch in stream(generator):
            objects = Objects(*batch)
            o, p, m, _ = objects.template.shape
            num_source = objects.source.shape[2]
            some = torch.randperm(num_source, generator=generator)[: max(1, num_source // 4)]
            # A random share of the template points is lost: others stand in for them, as where few were seen.
            kept = torch.rand(o, 1, 1, generator=generator) * 0.9 + 0.1
            stand_in = (torch.rand(o, p, max(1, m // 2), generator=generator) * kept * m).long()
            pick = torch.argsort(torch.rand(o, p, m, generator=generator), dim=2).gather(2, stand_in)[..., None]
            noise = torch.randn(o, p, m, 3, generator=generator) * _NOISE
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


def load_objects(
    make: Callable[[str], tuple[list[Label], dict[str, int]]], table: PrimitiveTable
) -> tuple[Objects, dict[str, dict[str, int]]]:
    """All labelled objects of a split, and how many labels of each class were kept and dropped."""
    columns: list[list[np.ndarray]] = [[] for _ in Objects._fields]
    counts = {}
    for category in table.categories:
        labels, counts[category] = make(category)
        for label in labels:
            for column, part in zip(columns, object_of(label, table), strict=True):
                part = np.asarray(part)
                column.append(part.astype(np.float16) if part.dtype == np.float64 or part.dtype.kind == "b" else part)
    if not columns[0]:
        raise InvalidOption(f"no label could be made: {counts}; are there meshes of {', '.join(table.categories)}?")
    return Objects(*(torch.from_numpy(np.stack(column)) for column in columns)), counts


def object_of(label: Label, table: PrimitiveTable) -> tuple[object, ...]:
    """The fields of `Objects` for one label."""
    number = table.number(label.primitive, label.without)
    primitive = table.primitives[number]
    p = make_patches(primitive, label.vertices, label.template, label.viewpoint)
    # A fit that had few modes has as many coefficients; the rest of them are zero.
    coefficients = np.zeros(table.modes.shape[-1])
    coefficients[: len(label.coefficients)] = label.coefficients
    fit = FittedPrimitive(primitive, np.eye(4), label.scale, coefficients[: len(primitive.modes)], 0.0)
    offset = np.einsum("bni,bij->bnj", (label.target - label.vertices)[p.index], p.frames) / p.unit_m
    return (
        p.source, p.source_normals, p.template, p.template_normals, p.mirrored, p.residuals,
        p.pose_features, fit_features(fit),
        offset, p.frames, label.scale, coefficients, number, np.float32(p.unit_m),
    )  # fmt: skip
