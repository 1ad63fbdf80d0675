"""How good a primitive is: what it costs, how well it fits members it has not seen, how likely its inventions are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.parallel import Progress
from gfp_grasp.primitives.surface import Surface, surface_distance_m
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import GenericPrimitive

_COMPATIBLE = 0.5
# Distances above this count by their length, below it by their square.
_HUBER_M = 0.0005
_UP = np.array([0.0, 0.0, 1.0])
# Starts are this far apart, over the angle that the symmetry leaves open.
_YAW_STEP_RAD = np.radians(45.0)
# Gauss-Newton steps of each start before the best is chosen, and of the best.
_TRIAL_STEPS, _STEPS = 8, 40
# What a coefficient of one is weighed against; small makes the priors weak.
_NOISE_M = 0.0003
# Samples of the surface that look back at the model.
_NUM_SAMPLES = 2500


@dataclass(frozen=True, eq=False)
class _State:
    R: np.ndarray
    t: np.ndarray
    log_scale: np.ndarray
    coefficients: np.ndarray

    def vertices(self, primitive: GenericPrimitive) -> np.ndarray:
        return primitive.shape(self.coefficients, np.exp(self.log_scale)) @ self.R.T + self.t


def fit_full_surface(primitive: GenericPrimitive, mesh: trimesh.Trimesh, *, seed: int = 0) -> tuple[np.ndarray, float]:
    """Fit pose, scale and modes to the full surface of an upright object, by point-to-plane least squares both ways.

    Args:
        primitive: Primitive of the object's class.
        mesh: The object, m, z up; yaw and place are free.
        seed: Seed of the samples.

    Returns:
        Fitted vertices (v, 3) m in the mesh's frame, and the mean distance between the two surfaces, m, from each to
        the other and averaged.
    """
    rng = np.random.default_rng(seed)
    surface = Surface(mesh, rng)
    starts = []
    for yaw in _yaws(primitive):
        state, cost = _descend(primitive, _start(primitive, surface, yaw), surface, _TRIAL_STEPS)
        starts.append((cost, state))
    best = min(starts, key=lambda pair: pair[0])[1]
    state, _ = _descend(primitive, best, surface, _STEPS)
    vertices = state.vertices(primitive)
    return vertices, surface_distance_m(mesh, trimesh.Trimesh(vertices, primitive.faces, process=False), seed=seed)


def _yaws(primitive: GenericPrimitive) -> np.ndarray:
    if math.isinf(primitive.symmetry.order):
        return np.zeros(1)
    turn = 2 * np.pi / primitive.symmetry.order
    return np.arange(0, turn - 1e-9, min(_YAW_STEP_RAD, turn))


def _start(primitive: GenericPrimitive, surface: Surface, yaw: float) -> _State:
    """Scale and place from the boxes, seen in the frame that the yaw gives."""
    R = rotation_about(_UP, yaw)
    local = surface.points @ R
    low, high = local.min(axis=0), local.max(axis=0)
    own_low, own_high = primitive.vertices.min(axis=0), primitive.vertices.max(axis=0)
    scale = (high - low) / (own_high - own_low)
    return _State(R, R @ (low - scale * own_low), np.log(scale), np.zeros(len(primitive.modes)))


def _descend(primitive: GenericPrimitive, state: _State, surface: Surface, iterations: int) -> tuple[_State, float]:
    diagonal = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    back = slice(None, None, max(1, len(surface.points) // _NUM_SAMPLES))
    points, normals = surface.points[back], surface.normals[back]
    cost = np.inf
    for step in range(iterations):
        weight = diagonal * (0.1 if step < iterations // 2 else 0.04)
        vertices = state.vertices(primitive)
        own = vertex_normals(vertices, primitive.faces)
        index = surface.nearest(vertices, own, normal_weight_m=weight)
        good = (surface.normals[index] * own).sum(axis=1) > _COMPATIBLE
        tree = KDTree(np.hstack([vertices, own * weight]))
        near = np.asarray(tree.query(np.hstack([points, normals * weight]))[1])
        kept = (normals * own[near]).sum(axis=1) > _COMPATIBLE
        rows = np.concatenate([np.flatnonzero(good), near[kept]])
        target = np.concatenate([surface.points[index[good]], points[kept]])
        plane = np.concatenate([surface.normals[index[good]], normals[kept]])
        share = np.concatenate([np.full(good.sum(), 1 / len(vertices)), np.full(kept.sum(), 1 / len(points))])
        offset = vertices[rows] - target
        cost = float(share @ np.linalg.norm(offset, axis=1)) + diagonal * float(1 - good.mean() + 1 - kept.mean())
        # Huber's weights: what counts is the mean distance, and scans have bulges that no member of the class has.
        height = np.abs((plane * offset).sum(axis=1))
        robust = share * np.minimum(1.0, _HUBER_M / np.maximum(height, 1e-9))
        state = _step(primitive, state, rows, plane, offset, robust)
    return state, cost


def _step(primitive: GenericPrimitive, state: _State, rows, plane, offset, share) -> _State:
    """One Gauss-Newton step on rotation, translation, log scale and coefficients."""
    scale = np.exp(state.log_scale)
    shaped = (primitive.vertices + np.tensordot(state.coefficients, primitive.modes, 1))[rows] * scale
    local_plane = plane @ state.R
    turned = shaped @ state.R.T
    jacobian = np.hstack(
        [
            np.cross(turned, plane),  # d/dw of n . exp(w) x
            plane,
            local_plane * shaped,
            np.einsum("kvc,vc->vk", primitive.modes[:, rows] * scale, local_plane),
        ]
    )
    residual = (plane * offset).sum(axis=1)
    prior = np.zeros(jacobian.shape[1])
    prior[9:] = _NOISE_M**2
    prior[6:9] = _NOISE_M**2
    pull = prior * np.concatenate([np.zeros(6), state.log_scale, state.coefficients])
    damping = 1e-9 + 1e-6 * np.diag((jacobian * share[:, None]).T @ jacobian)
    gram = (jacobian * share[:, None]).T @ jacobian + np.diag(prior + damping)
    delta = -np.linalg.solve(gram, jacobian.T @ (share * residual) + pull)
    angle = float(np.linalg.norm(delta[:3]))
    R = rotation_about(delta[:3], min(angle, 0.3)) @ state.R if angle > 1e-12 else state.R
    return _State(
        R,
        state.t + delta[3:6],
        state.log_scale + np.clip(delta[6:9], -0.3, 0.3),
        np.clip(state.coefficients + np.clip(delta[9:], -1.0, 1.0), -4.0, 4.0),
    )


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
        generalization_percent: Mean of the same as a share of each member's longest extent.
        specificity_mm: Mean vertex distance of shapes drawn from the modes to the nearest member built from.
    """

    vertices: int
    modes: int
    variance_kept: float
    held_out: int
    generalization_mm: float
    generalization_median_mm: float
    generalization_worst_mm: float
    generalization_percent: float
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
        generalization_percent=float(
            np.mean([e / (10 * m.extents.max()) for e, m in zip(errors, held_out, strict=True)])
        ),
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
