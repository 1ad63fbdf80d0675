"""The negative log posterior of a fit as a sum of residual terms, linearised for a Gauss-Newton step.

The terms themselves stand in terms.py; this module holds what they are summed over (the surface of a primitive in
several states) and what they are summed into (the normal equations).

Letters: s states, n points, m samples of the surface, k modes. A step has 9 + k numbers: rotation 3, translation 3,
log scale 3, modes k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Protocol

import numpy as np

from gfp_grasp.meshes import triangle_normals
from gfp_grasp.register.state import StateBatch, surface_samples
from gfp_grasp.transforms import cross
from gfp_grasp.types import INSIDE, GenericPrimitive

# Mean squared distance of a surface's places from its nearest sample, times the samples an area: measured on eight
# primitives with 400 to 1500 samples, 0.27 to 0.37.
_SAMPLE_GAP = 0.3


class ResidualTerm(Protocol):
    """One summand of the negative log posterior."""

    def add(self, sums: NormalEquations) -> None:
        """Add the cost of every state, and the normal matrix and gradient of a step."""
        ...


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A primitive with its first modes, sampled for the linearisation.

    Attributes:
        primitive: The primitive with no more than these modes.
        mean: (m, 3) m, samples of the surface.
        flat_modes: (k, m * 3).
        point_modes: (m, 3, k) float32.
        edges: (m * 6,) m, two edges of the face of each sample.
        edge_modes: (k, m * 6).
        outer: (m,) one over the area of the face of each sample on the outside, in any unit; 0 for those inside.
        area_m2: Of the whole surface.
        scale_precision: (3, 3) of log scale.
        scale_sigma: (3,).
    """

    primitive: GenericPrimitive
    mean: np.ndarray
    flat_modes: np.ndarray
    point_modes: np.ndarray
    edges: np.ndarray
    edge_modes: np.ndarray
    outer: np.ndarray
    area_m2: float
    scale_precision: np.ndarray
    scale_sigma: np.ndarray

    @property
    def num_modes(self) -> int:
        """k."""
        return len(self.flat_modes)


@lru_cache(maxsize=64)
def shape_model(primitive: GenericPrimitive, num_samples: int, num_modes: int) -> ShapeModel:
    """The model of a primitive with its first modes, made once."""
    if num_modes < len(primitive.modes):
        primitive = replace(primitive, modes=primitive.modes[:num_modes], explained=primitive.explained[:num_modes])
    samples = surface_samples(primitive, num_samples)
    corners = primitive.faces[samples.face]
    areas = np.linalg.norm(triangle_normals(primitive.vertices[primitive.faces]), axis=1)
    covariance = primitive.log_scale_cov + 1e-4 * np.eye(3)
    return ShapeModel(
        primitive,
        samples.mean,
        samples.modes.reshape(len(samples.modes), 3 * num_samples),
        np.ascontiguousarray(samples.modes.transpose(1, 2, 0), dtype=np.float32),
        (primitive.vertices[corners[:, 1:]] - primitive.vertices[corners[:, :1]]).ravel(),
        (primitive.modes[:, corners[:, 1:]] - primitive.modes[:, corners[:, :1]]).reshape(
            len(primitive.modes), 6 * num_samples
        ),
        np.where((primitive.regions[corners] == INSIDE).all(axis=1), 0.0, 1.0 / np.maximum(areas[samples.face], 1e-12)),
        0.5 * float(areas.sum()),
        np.linalg.inv(covariance),
        np.sqrt(np.diag(covariance)),
    )


def linearise(
    batch: StateBatch, model: ShapeModel, terms: Sequence[ResidualTerm], robust_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices (s, 9 + k, 9 + k) and gradients (s, 9 + k) of the step, at a robust scale in metres."""
    sums = _summed(NormalEquations(StateSurface(batch, model), robust_m), terms)
    return sums.H, sums.g


def evaluate_costs(
    batch: StateBatch, model: ShapeModel, terms: Sequence[ResidualTerm], robust_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Costs (s,) and residuals (s,) m, with less work than a step takes."""
    sums = _summed(NormalEquations(StateSurface(batch, model), robust_m, cost_only=True), terms)
    return sums.cost, sums.residual_m


def _summed(sums: NormalEquations, terms: Sequence[ResidualTerm]) -> NormalEquations:
    for term in terms:
        term.add(sums)
    return sums


class StateSurface:
    """Samples of the surface of every state.

    Attributes:
        local: (s, m, 3) m, in the primitive's frame before scale.
        world: (s, m, 3) m.
        normals: (s, m, 3) unit, outward.
        linear: (s, 3, 3) from local to world, without the translation.
        sample_gap_m2: (s,) m2, mean squared distance of the surface's places from their nearest samples, as far as the
            outside makes it; that of the inside counts against a hollow body where a solid one explains as much.
    """

    def __init__(self, batch: StateBatch, model: ShapeModel) -> None:
        self.batch, self.model = batch, model
        self.linear = batch.linear
        s = len(batch.R)
        self.local = model.mean + (batch.coefficients @ model.flat_modes).reshape(s, -1, 3)
        self.world = self.local @ self.linear.transpose(0, 2, 1) + batch.t[:, None]
        edges = (model.edges + batch.coefficients @ model.edge_modes).reshape(s, -1, 2, 3)
        # Normals transform by the inverse transpose of what moves the surface.
        normals = cross(edges[:, :, 0], edges[:, :, 1]) @ np.linalg.inv(self.linear)
        lengths = np.sqrt(np.einsum("smi,smi->sm", normals, normals))
        self.normals = normals / (lengths[..., None] + 1e-18)
        growth = np.exp(batch.log_scale.sum(axis=1)) * (lengths * model.outer).mean(axis=1)
        self.sample_gap_m2 = _SAMPLE_GAP * model.area_m2 / len(model.outer) * growth

    def along_body(self, state: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Vectors (s', n, 3) of the world, float32, along the axes of the object in some states (s',)."""
        return (vectors @ self.batch.R[state]).astype(np.float32)

    def derivative(self, state: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Derivative (s', n, 3, 9 + k) float32 of samples (s', n) of some states (s',), along the object's own axes.

        Seen along those axes, scale and modes move a sample by plain products; single precision halves the time, and
        the normal equations that come of it are damped by far more than its rounding.
        """
        model, batch = self.model, self.batch
        scale = np.exp(batch.log_scale[state], dtype=np.float32)
        body_from_world = batch.R[state].transpose(0, 2, 1).astype(np.float32)
        arm = scale[:, None] * self.local[state[:, None], index].astype(np.float32)
        turned = np.zeros((*index.shape, 3, 3), dtype=np.float32)
        for i, j, sign in ((0, 1, 1), (1, 2, 1), (2, 0, 1), (1, 0, -1), (2, 1, -1), (0, 2, -1)):
            turned[:, :, i, j] = sign * arm[..., 3 - i - j]  # rotation vector x arm
        D = np.zeros((*index.shape, 3, 9 + model.num_modes), dtype=np.float32)
        rows = turned.reshape(len(index), 3 * index.shape[1], 3)
        D[..., :3] = (rows @ body_from_world).reshape(turned.shape)
        D[..., 3:6] = body_from_world[:, None]
        D[..., [0, 1, 2], [6, 7, 8]] = arm
        np.multiply(scale[:, None, :, None], model.point_modes[index], out=D[..., 9:])
        return D


class NormalEquations:
    """Normal equations and cost, summed over the terms.

    Attributes:
        surface: The surface of every state.
        robust_m: Robust scale of the step.
        H: (s, 9 + k, 9 + k) normal matrices; zero with cost_only.
        g: (s, 9 + k) gradients, minus the slope of the cost; zero with cost_only.
        cost: (s,).
        residual_m: (s,) trimmed mean distance of the points across the surface; infinite until the points were added.
    """

    def __init__(self, surface: StateSurface, robust_m: float, *, cost_only: bool = False) -> None:
        s, k = surface.batch.coefficients.shape
        self.surface, self.robust_m, self._cost_only = surface, robust_m, cost_only
        self.H, self.g, self.cost = np.zeros((s, 9 + k, 9 + k)), np.zeros((s, 9 + k)), np.zeros(s)
        self.residual_m = np.full(s, np.inf)

    def pull_samples(self, state: np.ndarray, index: np.ndarray, gap: np.ndarray, weight: np.ndarray) -> None:
        """Samples index (n,) of states (n,), ascending, are pulled by gap (n, 3) m along its direction, by weight."""
        if self._cost_only:
            return
        length = np.linalg.norm(gap, axis=1)
        direction = self.surface.along_body(state, (gap / np.maximum(length, 1e-12)[:, None])[:, None])
        J = np.einsum("nip,ni->np", self.surface.derivative(state, index[:, None])[:, 0], direction[:, 0])
        weighted = weight.astype(np.float32)[:, None] * J
        bounds = np.searchsorted(state, np.arange(len(self.cost) + 1))
        for i, (a, b) in enumerate(pairwise(bounds)):
            if b > a:
                self.H[i] += weighted[a:b].T @ J[a:b]
                self.g[i] += weighted[a:b].T @ length[a:b]

    def pull_points(
        self, index: np.ndarray, gap: np.ndarray, normals: np.ndarray, weight: np.ndarray, tangential: float
    ) -> None:
        """Samples index (s, n) of all states are pulled by gap (s, n, 3) m, by weight (s, n).

        The pull along the unit normals (s, n, 3) counts in full, the pull across them by the share tangential besides.
        """
        if self._cost_only:
            return
        states = np.arange(len(index))
        D = self.surface.derivative(states, index)
        normals, gap = (self.surface.along_body(states, vectors) for vectors in (normals, gap))
        # The root of the precision w (n n^T + t I) is w^1/2 (t^1/2 I + ((1 + t)^1/2 - t^1/2) n n^T).
        little, more = (np.float32(a) for a in (tangential**0.5, (1.0 + tangential) ** 0.5 - tangential**0.5))
        root = np.sqrt(weight, dtype=np.float32)[..., None]
        along = root * more * normals
        E = along[..., None] * np.einsum("snip,sni->snp", D, normals)[:, :, None]
        E += (little * root)[..., None] * D
        E = E.reshape(len(E), -1, E.shape[3])
        misses = along * np.einsum("sni,sni->sn", normals, gap)[..., None] + little * root * gap
        transposed = E.transpose(0, 2, 1)
        self.H += transposed @ E
        self.g += (transposed @ misses.reshape(len(gap), -1, 1))[..., 0]
