"""What one view and its class say of a state of the fit, linearised for a Gauss-Newton step.

The posterior that is maximised: observed points lie on the surface (point to plane, robust), the surface does not
stand where the view saw past it, its lowest point touches the support, and modes and scale are as likely as in the
class. The robust weight is Geman and McClure's.

Letters: s states, n points, m samples of the surface, k modes. A step has 9 + k numbers: rotation 3, translation 3,
log scale 3, modes k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from gfp_grasp.register.correspond import correspond
from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.ovality import ovality_gram, scaled_modes
from gfp_grasp.register.state import ModesConfig, StateBatch
from gfp_grasp.register.surface import surface_samples
from gfp_grasp.types import GenericPrimitive

_FLOOR_LIMIT = 3.0  # standard deviations beyond which a guessed floor pulls less and less
_FEET = 6  # lowest samples that stand for what touches the support


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A primitive as the linearisation reads it.

    Attributes:
        up: (3,) its upright axis.
        mean: (m, 3) m, samples of the surface.
        flat_modes: (k, m * 3).
        point_modes: (m, k, 3).
        edges: (m * 6,) m, two edges of the face of each sample.
        edge_modes: (k, m * 6).
        scale_precision: (3, 3) of log scale.
        scale_sigma: (3,).
        ovality: As `ovality_gram` returns it.
    """

    up: np.ndarray
    mean: np.ndarray
    flat_modes: np.ndarray
    point_modes: np.ndarray
    edges: np.ndarray
    edge_modes: np.ndarray
    scale_precision: np.ndarray
    scale_sigma: np.ndarray
    ovality: np.ndarray

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
    covariance = primitive.log_scale_cov + 1e-4 * np.eye(3)
    return ShapeModel(
        primitive.up,
        samples.mean,
        samples.modes.reshape(len(samples.modes), -1),
        np.ascontiguousarray(samples.modes.transpose(1, 0, 2)),
        (primitive.vertices[corners[:, 1:]] - primitive.vertices[corners[:, :1]]).ravel(),
        (primitive.modes[:, corners[:, 1:]] - primitive.modes[:, corners[:, :1]]).reshape(len(primitive.modes), -1),
        np.linalg.inv(covariance),
        np.sqrt(np.diag(covariance)),
        ovality_gram(primitive),
    )


def linearise(
    batch: StateBatch, model: ShapeModel, evidence: Evidence, config: ModesConfig, robust_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrices (s, 9 + k, 9 + k) and gradients (s, 9 + k) of the step."""
    sums = _Sums(_Surface(batch, model))
    _summed(sums, evidence, config, robust_m)
    return sums.H, sums.g


def costs(
    batch: StateBatch, model: ShapeModel, evidence: Evidence, config: ModesConfig, robust_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Costs (s,) and residuals (s,) m: less work than a step's."""
    sums = _Sums(_Surface(batch, model), cost_only=True)
    residual_m = _summed(sums, evidence, config, robust_m)
    return sums.cost, residual_m


def _summed(sums: _Sums, evidence: Evidence, config: ModesConfig, robust_m: float) -> np.ndarray:
    """All terms added up; returns the residual (s,) m."""
    residual_m = _observed(sums, evidence, config, robust_m)
    if config.free_space and evidence.silhouette is not None:
        _seen_empty(sums, evidence, config, robust_m)
    if config.support:
        _on_support(sums, evidence)
    _as_the_hypothesis(sums)
    _as_the_class(sums, config)
    if config.oval_m is not None:
        _not_oval(sums, config.oval_m)
    return residual_m


def seen_empty(
    batch: StateBatch, model: ShapeModel, evidence: Evidence, config: ModesConfig, robust_m: float
) -> np.ndarray:
    """The term of free space alone in the costs (s,)."""
    sums = _Sums(_Surface(batch, model), cost_only=True)
    if evidence.silhouette is not None:
        _seen_empty(sums, evidence, config, robust_m)
    return sums.cost


class _Surface:
    """Samples of the surface of every state."""

    def __init__(self, batch: StateBatch, model: ShapeModel) -> None:
        self.batch, self.model = batch, model
        self.linear = batch.linear
        s = len(batch.R)
        self.local = model.mean + (batch.coefficients @ model.flat_modes).reshape(s, -1, 3)
        self.world = self.local @ self.linear.transpose(0, 2, 1) + batch.t[:, None]
        edges = (model.edges + batch.coefficients @ model.edge_modes).reshape(s, -1, 2, 3)
        # Normals go as the inverse transposed of what moves the surface.
        normals = _cross(edges[:, :, 0], edges[:, :, 1]) @ np.linalg.inv(self.linear)
        self.normals = normals / (np.sqrt(np.einsum("smi,smi->sm", normals, normals))[..., None] + 1e-18)


class _Sums:
    """Normal equations and cost, summed over the terms.

    With cost_only, samples and points that should move add nothing: only the cost is true.
    """

    def __init__(self, surface: _Surface, *, cost_only: bool = False) -> None:
        s, k = surface.batch.coefficients.shape
        self.surface, self.cost_only = surface, cost_only
        self.H, self.g, self.cost = np.zeros((s, 9 + k, 9 + k)), np.zeros((s, 9 + k)), np.zeros(s)

    def add_samples(self, state: np.ndarray, index: np.ndarray, gap: np.ndarray, weight: np.ndarray) -> None:
        """Samples index (n,) of states (n,), ascending, should move by gap (n, 3) m along its direction, by weight."""
        if self.cost_only:
            return
        length = np.linalg.norm(gap, axis=1)
        direction = gap / np.maximum(length, 1e-12)[:, None]
        J = np.einsum("nip,ni->np", self._derivative(state, index[:, None])[:, 0], direction)
        weighted = weight[:, None] * J
        bounds = np.searchsorted(state, np.arange(len(self.cost) + 1))
        for i, (a, b) in enumerate(pairwise(bounds)):
            if b > a:
                self.H[i] += weighted[a:b].T @ J[a:b]
                self.g[i] += weighted[a:b].T @ length[a:b]

    def add_points(
        self, index: np.ndarray, gap: np.ndarray, normals: np.ndarray, weight: np.ndarray, tangential: float
    ) -> None:
        """Samples index (s, n) of all states should move by gap (s, n, 3) m, by weight (s, n).

        Along unit normals (s, n, 3) in full, across them by the share tangential.
        """
        if self.cost_only:
            return
        D = self._derivative(np.arange(len(index)), index)
        # The root of the precision w (n n^T + t I) is w^1/2 (t^1/2 I + ((1 + t)^1/2 - t^1/2) n n^T).
        little, more = np.sqrt(tangential), np.sqrt(1.0 + tangential) - np.sqrt(tangential)
        root = np.sqrt(weight)[..., None]
        along = root * more * normals
        E = along[..., None] * np.einsum("snip,sni->snp", D, normals)[:, :, None]
        E += (little * root)[..., None] * D
        E = E.reshape(len(E), -1, E.shape[3])
        misses = along * np.einsum("sni,sni->sn", normals, gap)[..., None] + little * root * gap
        transposed = E.transpose(0, 2, 1)
        self.H += transposed @ E
        self.g += (transposed @ misses.reshape(len(gap), -1, 1))[..., 0]

    def _derivative(self, state: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Derivative (s', n, 3, 9 + k) of the positions of samples (s', n) of some states (s',)."""
        surface, model = self.surface, self.surface.model
        linear = surface.linear[state]
        arm = surface.world[state[:, None], index] - surface.batch.t[state][:, None]
        D = np.zeros((*index.shape, 3, self.g.shape[1]))
        for i, j, sign in ((0, 1, 1), (1, 2, 1), (2, 0, 1), (1, 0, -1), (2, 1, -1), (0, 2, -1)):
            D[:, :, i, j] = sign * arm[..., 3 - i - j]  # turn x arm
        D[:, :, [0, 1, 2], [3, 4, 5]] = 1.0
        D[..., 6:9] = linear[:, None] * surface.local[state[:, None], index][:, :, None]
        modes = model.point_modes[index]
        rows = modes.reshape(len(index), modes.shape[1] * modes.shape[2], 3) @ linear.transpose(0, 2, 1)
        D[..., 9:] = rows.reshape(modes.shape).swapaxes(2, 3)
        return D


def _observed(sums: _Sums, evidence: Evidence, config: ModesConfig, robust_m: float) -> np.ndarray:
    """Observed points lie on the surface; returns the residual (s,) m."""
    surface = sums.surface
    states = np.arange(len(surface.world))
    index, agrees = correspond(surface.world, surface.normals, evidence)
    normals = surface.normals[states[:, None], index]
    gap = evidence.points - surface.world[states[:, None], index]
    across = np.einsum("sni,sni->sn", normals, gap)
    sigma_m = np.hypot(evidence.sigma_m, config.misfit_m)
    share = config.effective_points / gap.shape[1] / sigma_m**2
    # The whole gap is what is robust: a point far from its sample says little, wherever it lies.
    squared = across**2 + config.tangential * np.einsum("sni,sni->sn", gap, gap)
    robust = 1.0 / (1.0 + squared / robust_m**2)
    weight = share * robust**2 * agrees
    sums.add_points(index, gap, normals, weight, config.tangential)
    # The cost is in the same robust measure for every start; a point without a partner pays in full.
    sums.cost += 0.5 * share * np.where(agrees, robust * squared, robust_m**2).sum(axis=1)
    distance = np.sort(np.where(agrees, np.abs(across), np.linalg.norm(gap, axis=2)), axis=1)
    return distance[:, : int(0.9 * gap.shape[1]) + 1].mean(axis=1)


def _seen_empty(sums: _Sums, evidence: Evidence, config: ModesConfig, robust_m: float) -> None:
    """Space seen empty stays empty."""
    assert evidence.silhouette is not None
    world = sums.surface.world
    certain = evidence.silhouette.certain
    flat, back = evidence.silhouette.trespass(world.reshape(-1, 3))
    state, index = np.divmod(flat, world.shape[1])
    distance = np.linalg.norm(back, axis=1)
    # Where the picture is guessed from the points, what lacks may be hidden by something: a capped force.
    limit = 4 * robust_m if certain else 2 * robust_m
    robust = 1.0 / (1.0 + (distance / limit) ** 2)
    share = config.effective_points / world.shape[1] / config.silhouette_m[0 if certain else 1] ** 2
    sums.cost += 0.5 * share * np.bincount(state, robust * distance**2, minlength=len(world))
    sums.add_samples(state, index, back, share * robust**2)


def _on_support(sums: _Sums, evidence: Evidence) -> None:
    """The lowest point touches the support."""
    heights = sums.surface.world @ evidence.up - evidence.floor_m
    lowest = np.argpartition(heights, _FEET, axis=1)[:, :_FEET]
    height = np.take_along_axis(heights, lowest, axis=1)
    sigma = np.where(height > 0, evidence.floor_sigma_m[0], evidence.floor_sigma_m[1])
    share = 1.0 / lowest.shape[1] / sigma**2
    # A floor that is guessed from the lowest point seen may be hidden far below it: a capped force.
    robust = np.ones_like(height)
    if not evidence.floor_seen:
        robust = np.where(height < 0, 1.0 / (1.0 + (height / (_FLOOR_LIMIT * sigma)) ** 2), 1.0)
    weight = share * robust**2
    straight_up = np.broadcast_to(evidence.up, (*height.shape, 3))
    sums.add_points(lowest, -height[..., None] * evidence.up, straight_up, weight, 0.0)
    sums.cost += 0.5 * (share * robust * height**2).sum(axis=1)


def _as_the_hypothesis(sums: _Sums) -> None:
    """The axis stays near where the hypothesis has it."""
    batch = sums.surface.batch
    axis = batch.R @ sums.surface.model.up
    tilt = _cross(axis, batch.axis_world)
    precision = 1.0 / batch.axis_sigma_rad**2
    sums.H[:, :3, :3] += precision[:, None, None] * (np.eye(3) - axis[:, :, None] * axis[:, None, :])
    sums.g[:, :3] += precision[:, None] * tilt
    sums.cost += 0.5 * precision * (tilt**2).sum(axis=1)


def _as_the_class(sums: _Sums, config: ModesConfig) -> None:
    """Scale and modes stay near the class."""
    batch = sums.surface.batch
    precision = sums.surface.model.scale_precision / config.scale_slack**2
    pull = batch.log_scale @ precision
    sums.H[:, 6:9, 6:9] += precision
    sums.g[:, 6:9] -= pull
    k = batch.coefficients.shape[1]
    sums.H[:, 9:, 9:] += np.eye(k)
    sums.g[:, 9:] -= batch.coefficients
    sums.cost += 0.5 * ((pull * batch.log_scale).sum(axis=1) + (batch.coefficients**2).sum(axis=1))


def _not_oval(sums: _Sums, sigma_m: float) -> None:
    """The body is as deep as it is wide."""
    batch, gram = sums.surface.batch, sums.surface.model.ovality
    s, k = batch.coefficients.shape
    scale = np.exp(batch.log_scale)
    scaled = scaled_modes(batch.coefficients, scale)
    u = scaled.reshape(s, -1)
    U = np.zeros((s, 3, 1 + k, 3 + k))
    axes = np.arange(3)
    U[:, axes, :, axes] = scaled.transpose(1, 0, 2)
    U[:, :, 1:, 3:] = scale[:, :, None, None] * np.eye(k)
    U = U.reshape(s, 3 * (1 + k), 3 + k)
    weighted = U.transpose(0, 2, 1) @ gram / sigma_m**2
    sums.H[:, 6:, 6:] += weighted @ U
    sums.g[:, 6:] -= (weighted @ u[..., None])[..., 0]
    sums.cost += 0.5 * np.einsum("si,ij,sj->s", u, gram, u) / sigma_m**2


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Last axis of a times that of b; numpy's own takes ten times as long."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )
