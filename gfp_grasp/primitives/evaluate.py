"""How good a primitive is: what it costs, how well it fits members it has not seen, how likely its inventions are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import Progress
from gfp_grasp.primitives.full_fit import fit_full_surface
from gfp_grasp.types import GenericPrimitive

_NUM_DRAWN = 200


@dataclass(frozen=True)
class PrimitiveReport:
    """Figures of one primitive.

    Attributes:
        vertices: Number of vertices of the mean mesh.
        modes: Number of modes.
        variance_kept: Share of the variance that the modes explain, after scale.
        held_out: Number of members that the generalization error was measured on.
        generalization_mm: Mean surface distance of the held-out members to their best fits.
        generalization_median_mm: Median of the same.
        generalization_worst_mm: Largest of the same.
        specificity_mm: Mean vertex distance of shapes drawn from the modes to the nearest member built from.
    """

    vertices: int
    modes: int
    variance_kept: float
    held_out: int
    generalization_mm: float
    generalization_median_mm: float
    generalization_worst_mm: float
    specificity_mm: float

    def figures(self) -> dict[str, float]:
        """As plain numbers, rounded to a micrometre."""
        return {name: round(value, 3) if isinstance(value, float) else value for name, value in asdict(self).items()}


def measure_primitive(
    primitive: GenericPrimitive,
    held_out: Sequence[trimesh.Trimesh],
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> PrimitiveReport:
    """Measure a primitive against members that it was not built from.

    Generalization and specificity as in Davies, Twining and Taylor, Statistical Models of Shape, 2008, chapter 9.

    Args:
        primitive: The primitive that is measured.
        held_out: Complete, upright members of its class, at least one.
        seed: Seed of samples and drawn shapes.
        progress: Wraps the stream of fits, told how many there will be.

    Raises:
        InvalidOption: No held-out member was given.
    """
    if not held_out:
        raise InvalidOption("no held-out member was given: generalization cannot be measured")
    watch = progress or (lambda stream, total: stream)
    errors = 1e3 * np.array(
        list(watch((fit_full_surface(primitive, mesh, seed=seed)[1] for mesh in held_out), len(held_out)))
    )
    return PrimitiveReport(
        vertices=len(primitive.vertices),
        modes=len(primitive.modes),
        variance_kept=float(primitive.explained.sum()),
        held_out=len(held_out),
        generalization_mm=float(errors.mean()),
        generalization_median_mm=float(np.median(errors)),
        generalization_worst_mm=float(errors.max()),
        specificity_mm=1e3 * specificity_m(primitive, np.random.default_rng(seed)),
    )


def specificity_m(primitive: GenericPrimitive, rng: np.random.Generator, *, count: int = _NUM_DRAWN) -> float:
    """Mean over drawn shapes of the mean vertex distance, in metres, to the nearest member that was built from."""
    members = _shapes(primitive, primitive.coefficient_samples)
    coefficients = rng.standard_normal((count, len(primitive.modes)))
    log_scale = rng.multivariate_normal(np.zeros(3), primitive.log_scale_cov, size=count)
    drawn = _shapes(primitive, np.hstack([coefficients, log_scale]))
    nearest = [np.linalg.norm(members - shape, axis=2).mean(axis=1).min() for shape in drawn]
    return float(np.mean(nearest))


def _shapes(primitive: GenericPrimitive, samples: np.ndarray) -> np.ndarray:
    return np.stack([primitive.shape(row[:-3], np.exp(row[-3:])) for row in samples])
