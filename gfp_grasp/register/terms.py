"""The residual terms of the posterior.

Observed points lie on the surface (point to plane, robust); the surface does not stand where the view saw past it; its
lowest point touches the support; its axis, scale and modes are as likely as in the class; and its body may be asked to
be round. The robust weight is that of Geman and McClure.

Letters: s states, n points, m samples of the surface, k modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gfp_grasp.meshes import vertex_normals
from gfp_grasp.register.config import RefineConfig
from gfp_grasp.register.posterior import NormalEquations, ResidualTerm, StateSurface
from gfp_grasp.transforms import cross
from gfp_grasp.types import OUTSIDE, GenericPrimitive, LevelView, Silhouette

# In the search for the nearest sample, normals 60 degrees apart count like a distance of this share of the unit.
_NORMAL_LENGTH = 0.208
_MIN_NORMAL_COSINE = 0.5
_TRIMMED_SHARE = 0.9  # of the points, the nearest ones, over which the residual is averaged
_FLOOR_LIMIT = 3.0  # standard deviations below a guessed floor beyond which it pulls less and less
_FEET = 6  # lowest samples, which stand for what touches the support
_BANDS = 8  # of the height, each with an ellipticity of its own
_MIN_VERTICES = 12


def make_terms(evidence: LevelView, config: RefineConfig, unit_m: float) -> list[ResidualTerm]:
    """All terms of the posterior of one object; unit_m is the length of which the config's lengths are shares."""
    sigma_m = float(np.hypot(evidence.sigma_m, config.misfit * unit_m))
    points = PointTerm(evidence, config.effective_points, sigma_m, config.tangential, _NORMAL_LENGTH * unit_m)
    terms: list[ResidualTerm] = [points]
    if config.free_space and evidence.silhouette is not None:
        terms.append(make_free_space_term(evidence.silhouette, config, unit_m))
    if config.support:
        terms.append(SupportTerm(evidence))
    terms += [AxisTerm(), ClassTerm(config.scale_slack)]
    if config.ellipticity is not None:
        terms.append(RoundnessTerm(config.ellipticity * unit_m))
    return terms


def make_free_space_term(silhouette: Silhouette, config: RefineConfig, unit_m: float) -> FreeSpaceTerm:
    """The term of free space alone."""
    sigma = config.silhouette[0 if silhouette.certain else 1]
    return FreeSpaceTerm(silhouette, config.effective_points, sigma * unit_m)


@dataclass(frozen=True, eq=False)
class PointTerm:
    """Observed points lie on the surface; this term sets the residual, too.

    Attributes:
        evidence: n points with normals.
        effective_points: Number of independent points that they are worth.
        sigma_m: Standard deviation of their distance across the surface.
        tangential: Weight of the distance along the surface, relative to the distance across it.
        normal_length_m: Length that stands for a difference of normals of one, see `match_points`.
    """

    evidence: LevelView
    effective_points: float
    sigma_m: float
    tangential: float
    normal_length_m: float

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        surface, evidence = sums.surface, self.evidence
        states = np.arange(len(surface.world))
        index, agrees = match_points(surface, evidence, self.normal_length_m)
        normals = surface.normals[states[:, None], index]
        gap = evidence.points - surface.world[states[:, None], index]
        across = np.einsum("sni,sni->sn", normals, gap)
        share = self.effective_points / gap.shape[1] / self.sigma_m**2
        # The robust weight reads the whole gap: a point far from its sample says little in whichever direction it lies.
        squared = across**2 + self.tangential * np.einsum("sni,sni->sn", gap, gap)
        robust = 1.0 / (1.0 + squared / sums.robust_m**2)
        weight = share * robust**2 * agrees
        sums.pull_points(index, gap, normals, weight, self.tangential)
        # The cost uses the same robust scale for every start; a point without a partner pays the most there is.
        # The wider a surface, the farther apart are its samples: no point pays for that.
        beside = self.tangential * surface.sample_gap_m2[:, None]
        excess = squared - beside / (1.0 + beside / sums.robust_m**2)
        sums.cost += 0.5 * share * np.where(agrees, robust * excess, sums.robust_m**2).sum(axis=1)
        distance = np.sort(np.where(agrees, np.abs(across), np.linalg.norm(gap, axis=2)), axis=1)
        sums.residual_m = distance[:, : int(_TRIMMED_SHARE * gap.shape[1]) + 1].mean(axis=1)


@dataclass(frozen=True, eq=False)
class FreeSpaceTerm:
    """The surface does not stand in space that was seen empty.

    Attributes:
        silhouette: Pixels of the object, and the free space beside it.
        effective_points: Number of independent points that the view is worth.
        sigma_m: Standard deviation of the violation.
    """

    silhouette: Silhouette
    effective_points: float
    sigma_m: float

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        world, certain = sums.surface.world, self.silhouette.certain
        flat, back = self.silhouette.free_space_violation(world.reshape(-1, 3))
        state, index = np.divmod(flat, world.shape[1])
        distance = np.linalg.norm(back, axis=1)
        # A silhouette that is guessed from the points lacks what something hides: its force is capped sooner.
        limit = 4 * sums.robust_m if certain else 2 * sums.robust_m
        robust = 1.0 / (1.0 + (distance / limit) ** 2)
        share = self.effective_points / world.shape[1] / self.sigma_m**2
        sums.cost += 0.5 * share * np.bincount(state, robust * distance**2, minlength=len(world))
        sums.pull_samples(state, index, back, share * robust**2)


@dataclass(frozen=True, eq=False)
class SupportTerm:
    """The lowest point touches the support."""

    evidence: LevelView

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        evidence = self.evidence
        heights = sums.surface.world @ evidence.up - evidence.floor_m
        lowest = np.argpartition(heights, _FEET, axis=1)[:, :_FEET]
        height = np.take_along_axis(heights, lowest, axis=1)
        sigma = np.where(height > 0, evidence.floor_sigma_m[0], evidence.floor_sigma_m[1])
        share = 1.0 / lowest.shape[1] / sigma**2
        # The object may go on far below a floor that is guessed from its lowest point seen: the force is capped.
        robust = np.ones_like(height)
        if not evidence.floor_seen:
            robust = np.where(height < 0, 1.0 / (1.0 + (height / (_FLOOR_LIMIT * sigma)) ** 2), 1.0)
        weight = share * robust**2
        straight_up = np.broadcast_to(evidence.up, (*height.shape, 3))
        sums.pull_points(lowest, -height[..., None] * evidence.up, straight_up, weight, 0.0)
        sums.cost += 0.5 * (share * robust * height**2).sum(axis=1)


class AxisTerm:
    """The upright axis stays near the direction in which the hypothesis expects it."""

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        batch = sums.surface.batch
        axis = batch.R @ sums.surface.model.primitive.up
        tilt = cross(axis, batch.axis_world)
        precision = 1.0 / batch.axis_sigma_rad**2
        sums.H[:, :3, :3] += precision[:, None, None] * (np.eye(3) - axis[:, :, None] * axis[:, None, :])
        sums.g[:, :3] += precision[:, None] * tilt
        sums.cost += 0.5 * precision * (tilt**2).sum(axis=1)


@dataclass(frozen=True)
class ClassTerm:
    """Scale and modes stay near those of the class."""

    scale_slack: float

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        batch = sums.surface.batch
        precision = sums.surface.model.scale_precision / self.scale_slack**2
        pull = batch.log_scale @ precision
        sums.H[:, 6:9, 6:9] += precision
        sums.g[:, 6:9] -= pull
        k = batch.coefficients.shape[1]
        sums.H[:, 9:, 9:] += np.eye(k)
        sums.g[:, 9:] -= batch.coefficients
        sums.cost += 0.5 * ((pull * batch.log_scale).sum(axis=1) + (batch.coefficients**2).sum(axis=1))


@dataclass(frozen=True)
class RoundnessTerm:
    """The body is as deep as it is wide; sigma_m is the standard deviation of its ellipticity."""

    sigma_m: float

    def add(self, sums: NormalEquations) -> None:
        """See `ResidualTerm`."""
        batch, gram = sums.surface.batch, ellipticity_gram(sums.surface.model.primitive)
        s, k = batch.coefficients.shape
        scale = np.exp(batch.log_scale)
        scaled = scaled_modes(batch.coefficients, scale)
        u = scaled.reshape(s, -1)
        U = np.zeros((s, 3, 1 + k, 3 + k))
        axes = np.arange(3)
        U[:, axes, :, axes] = scaled.transpose(1, 0, 2)
        U[:, :, 1:, 3:] = scale[:, :, None, None] * np.eye(k)
        U = U.reshape(s, 3 * (1 + k), 3 + k)
        weighted = U.transpose(0, 2, 1) @ gram / self.sigma_m**2
        sums.H[:, 6:, 6:] += weighted @ U
        sums.g[:, 6:] -= (weighted @ u[..., None])[..., 0]
        sums.cost += 0.5 * np.einsum("si,ij,sj->s", u, gram, u) / self.sigma_m**2


def match_points(surface: StateSurface, evidence: LevelView, normal_length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """The sample of the surface on which each observed point is seen to lie.

    It is the nearest one in position and normal, so that a thin wall keeps its two sides apart; where there is a
    viewpoint, it is among the samples that face it.

    Args:
        surface: m samples of the surface of s states.
        evidence: n points.
        normal_length_m: Length that stands for a difference of unit normals of one.

    Returns:
        Index (s, n) of the sample, and whether the normals agree (s, n) bool.
    """
    world, normals = surface.world, surface.normals
    shape = (len(world), len(evidence.points))
    index, agrees = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    facing = np.ones(world.shape[:2], dtype=bool)
    if evidence.viewpoint is not None:
        facing = np.einsum("smi,smi->sm", normals, evidence.viewpoint - world) > 0
    # Near the origin float32 tells samples apart that lie micrometres from each other.
    origin = evidence.points.mean(axis=0)
    features = np.concatenate([world - origin, normal_length_m * normals], axis=2, dtype=np.float32)
    half = 0.5 * np.einsum("smi,smi->sm", features, features)
    asked, turned_over = (
        np.hstack([evidence.points - origin, sign * normal_length_m * evidence.normals], dtype=np.float32)
        for sign in (1.0, -1.0)
    )
    for i, faces in enumerate(facing):
        seen = np.flatnonzero(faces)
        if len(seen) == 0:
            continue
        own, own_half = features[i, seen], half[i, seen]
        closest, nearness = find_nearest(asked, own, own_half)
        if not evidence.oriented:
            other, other_nearness = find_nearest(turned_over, own, own_half)
            closest = np.where(other_nearness > nearness, other, closest)
        index[i] = seen[closest]
        cosine = np.einsum("ni,ni->n", evidence.normals, normals[i, index[i]])
        agrees[i] = (cosine if evidence.oriented else np.abs(cosine)) > _MIN_NORMAL_COSINE
    return index, agrees


def find_nearest(asked: np.ndarray, features: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (n,) of the feature (m, c) nearest to each of (n, c), and its nearness (n,), larger being nearer.

    The nearest feature has the largest dot product less half its square. The features are too few for a tree, which
    would be asked once only.

    Args:
        asked: (n, c).
        features: (m, c).
        half: (m,) half the square of each feature.
    """
    nearness = asked @ features.T
    nearness -= half
    index = nearness.argmax(axis=1)
    return index, nearness[np.arange(len(index)), index]


@lru_cache(maxsize=32)
def ellipticity_gram(primitive: GenericPrimitive) -> np.ndarray:
    """Quadratic form of the ellipticity of a primitive's body: of the second harmonic of its radius.

    Most cups and bottles are exactly as deep as they are wide, and the rest by any ratio. Modes with a Gaussian prior
    cannot say so, and a single view says least of the depth; so a round body is tried as a hypothesis (`try_circular`
    in fit.py). A square body has no ellipticity either.

    With u (3 * (1 + k),) the scales of x, y and z, each times (1, the coefficients), u @ gram @ u is the mean square,
    m2, of the second harmonic of the radius over bands of the height.

    Returns:
        (3 * (1 + k), 3 * (1 + k)), in the order of u.
    """
    normals = vertex_normals(primitive.vertices, primitive.faces)
    side = (primitive.regions == OUTSIDE) & (np.abs(normals[:, 2]) < 0.7)
    basis = np.concatenate([primitive.vertices[None], primitive.modes])[:, side]  # (1 + k, v, 3)
    vertices = primitive.vertices[side]
    angle = np.arctan2(vertices[:, 1], vertices[:, 0])
    radial = np.column_stack([np.cos(angle), np.sin(angle)])
    bands = np.array_split(np.argsort(vertices[:, 2], kind="stable"), _BANDS)
    gram = np.zeros((3 * len(basis), 3 * len(basis)))
    x_and_y = slice(0, 2 * len(basis))
    for band in bands:
        if len(band) < _MIN_VERTICES:
            continue
        waves = np.column_stack([np.ones(len(band)), np.cos(2 * angle[band]), np.sin(2 * angle[band])])
        fit = np.linalg.lstsq(waves, np.eye(len(band)), rcond=None)[0][1:]  # (2, v): amplitudes of a radius
        rows = np.concatenate([(basis[:, band, axis] * radial[band, axis]) @ fit.T for axis in (0, 1)])
        gram[x_and_y, x_and_y] += rows @ rows.T / _BANDS
    return gram


def scaled_modes(coefficients: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(s, 3, 1 + k), each of the scales (s, 3) times (1, the coefficients (s, k)): the u of `ellipticity_gram`."""
    return scale[:, :, None] * np.insert(coefficients, 0, 1.0, axis=1)[:, None, :]


@lru_cache(maxsize=32)
def circular_share(primitive: GenericPrimitive, limit_m: float) -> float:
    """Share, held to [0.05, 0.95], of the primitive's members whose ellipticity is below a limit."""
    k = len(primitive.modes)
    samples = primitive.coefficient_samples
    u = scaled_modes(samples[:, :k], np.exp(samples[:, k:])).reshape(len(samples), -1)
    ellipticity = np.sqrt(np.einsum("si,ij,sj->s", u, ellipticity_gram(primitive), u))
    return float(np.clip((ellipticity < limit_m).mean(), 0.05, 0.95))
