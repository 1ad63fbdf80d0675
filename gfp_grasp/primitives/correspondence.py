"""Non-rigid fit of a template to a member of its class: the member's surface, in the template's vertex order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import triangle_normals, vertex_normals
from gfp_grasp.primitives.surface import Surface, folded_faces, relax_folds

# Matches whose normals differ by more than 60 degrees are on another sheet of the surface.
_COMPATIBLE = 0.5


@dataclass(frozen=True)
class CorrespondenceConfig:
    """How a template is bent onto a member. Lengths are shares of the template's diagonal.

    Attributes:
        stiff: Length over which the displacement is smooth in the first step.
        soft: The same in the last step.
        steps: Number of lengths from stiff to soft, in geometric order.
        rounds: Matchings for each step.
        normal_weight: Length that a unit difference of normals counts as, when matching, in the first step; the last
            step uses half of it.
        sliding: Share of the tangential part of a match that is followed; the normal part is followed in full.
        binding: Strength with which the two sides of a wall move together while the fit is stiff.
        num_samples: Samples of the member that look back at the template.
    """

    stiff: float = 0.5
    soft: float = 0.02
    steps: int = 12
    rounds: int = 5
    normal_weight: float = 0.12
    sliding: float = 0.35
    binding: float = 0.3
    num_samples: int = 3000

    def __post_init__(self) -> None:
        if not (0 < self.soft <= self.stiff and self.steps >= 2 and self.rounds >= 1 and 0 <= self.sliding <= 1):
            raise InvalidOption(f"{self}: 0 < soft <= stiff, steps >= 2, rounds >= 1, 0 <= sliding <= 1 are expected")


@dataclass(frozen=True, eq=False)
class Correspondence:
    """A member in the template's vertex order.

    Attributes:
        vertices: (v, 3) m, on the member's surface where it has one there.
        residual_m: Mean distance from the member's surface to the bent template.
        covered: Share of the template's vertices that found the member with an agreeing normal.
        flipped: Share of faces that are turned inside out against the member.
    """

    vertices: np.ndarray
    residual_m: float
    covered: float
    flipped: float


class TemplateFitter:
    """A template with its stiffness factorised once, to be bent onto any number of members."""

    def __init__(
        self, template: trimesh.Trimesh, *, config: CorrespondenceConfig = CorrespondenceConfig(), seed: int = 0
    ) -> None:
        self._vertices = np.array(template.vertices, dtype=np.float64)
        self._faces = np.array(template.faces)
        self._config, self._seed = config, seed
        self._diagonal = float(np.linalg.norm(np.ptp(self._vertices, axis=0)))
        mass, bending, binding = _operators(self._vertices, self._faces, self._diagonal)
        lengths = np.geomspace(config.stiff, config.soft, config.steps) * self._diagonal
        self._solvers = [
            splu((mass + length**4 * bending + config.binding * length**2 * binding).tocsc()) for length in lengths
        ]
        self._mass = mass.diagonal()

    def fit(self, member: trimesh.Trimesh, *, placed: np.ndarray | None = None) -> Correspondence:
        """Bend the template onto a member that lies in its frame.

        The displacement d minimises sum_i a_i |x_i + d_i - q_i|^2 + l^4 |bend(d)|^2 with areas a and targets q that
        are matched anew in each round (optimal-step non-rigid ICP, Amberg et al., CVPR 2007, with a thin-plate energy
        in place of the affine one); l shrinks from stiff to soft.

        Args:
            member: Closed surface, in the template's frame and about its size.
            placed: (v, 3) m, the template's vertices brought near the member (`place`); None to do that here.
        """
        config, rng = self._config, np.random.default_rng(self._seed)
        surface = Surface(member, rng)
        back = rng.choice(len(surface.points), config.num_samples, replace=False)
        start = place(self._vertices, self._faces, surface) if placed is None else placed
        vertices = start
        weights = np.linspace(1.0, 0.5, config.steps) * config.normal_weight * self._diagonal
        for step, (solver, weight) in enumerate(zip(self._solvers, weights, strict=True)):
            reach = np.inf if step < config.steps // 2 else 0.08 * self._diagonal
            for _ in range(config.rounds):
                pull = self._pull(vertices, surface, back, weight, reach)
                target = vertices + pull - start
                vertices = start + solver.solve(self._mass[:, None] * target)
        return self._finish(vertices, surface, weights[-1], rng)

    def _pull(
        self, vertices: np.ndarray, surface: Surface, back: np.ndarray, weight: float, reach: float
    ) -> np.ndarray:
        """Where each vertex wants to go (v, 3): to its match, and to the mean of the samples that match it."""
        normals = vertex_normals(vertices, self._faces)
        index = surface.nearest(vertices, normals, normal_weight_m=weight)
        ahead = self._slide(surface.points[index] - vertices, surface.normals[index])
        good = ((surface.normals[index] * normals).sum(axis=1) > _COMPATIBLE).astype(float)
        points, point_normals = surface.points[back], surface.normals[back]
        tree = KDTree(np.hstack([vertices, normals * weight]))
        near = np.asarray(tree.query(np.hstack([points, point_normals * weight]))[1])
        offset = points - vertices[near]
        keep = ((point_normals * normals[near]).sum(axis=1) > _COMPATIBLE) & (np.linalg.norm(offset, axis=1) < reach)
        near, offset = near[keep], self._slide(offset, point_normals)[keep]
        count = np.bincount(near, minlength=len(vertices))
        behind = np.stack([np.bincount(near, offset[:, i], minlength=len(vertices)) for i in range(3)], axis=1)
        behind /= np.maximum(count, 1)[:, None]
        seen = (count > 0).astype(float)
        return (good[:, None] * ahead + seen[:, None] * behind) / np.maximum(good + seen, 1)[:, None]

    def _slide(self, offset: np.ndarray, normals: np.ndarray) -> np.ndarray:
        along = (offset * normals).sum(axis=1, keepdims=True) * normals
        return along + self._config.sliding * (offset - along)

    def _finish(
        self, vertices: np.ndarray, surface: Surface, weight: float, rng: np.random.Generator
    ) -> Correspondence:
        normals = vertex_normals(vertices, self._faces)
        closest, closest_normals = surface.closest(vertices, normals, normal_weight_m=weight)
        near = np.linalg.norm(closest - vertices, axis=1) < 0.02 * self._diagonal
        good = ((closest_normals * normals).sum(axis=1) > _COMPATIBLE) & near
        vertices = np.where(good[:, None], closest, vertices)
        vertices = relax_folds(
            vertices, self._faces, lambda points, sides: surface.closest(points, sides, normal_weight_m=weight)[0]
        )
        bent = trimesh.Trimesh(vertices, self._faces, process=False)
        flipped = float(folded_faces(vertices, self._faces).mean())
        back = surface.points[:: max(1, len(surface.points) // 2000)]
        residual = float(np.linalg.norm(Surface(bent, rng).closest(back)[0] - back, axis=1).mean())
        return Correspondence(vertices, residual, float(good.mean()), flipped)


def place(vertices: np.ndarray, faces: np.ndarray, surface: Surface, *, iterations: int = 25) -> np.ndarray:
    """Scale along x, y and z, and shift, a template onto a member that has its orientation already.

    Args:
        vertices: (v, 3) m, the template's.
        faces: (f, 3).
        surface: The member's.

    Returns:
        (v, 3) m, of the better of two starts: the member's box, and its box with the same scale along x and y.
    """
    low, high = surface.points.min(axis=0), surface.points.max(axis=0)
    own_low, own_high = vertices.min(axis=0), vertices.max(axis=0)
    box = (high - low) / np.maximum(own_high - own_low, 1e-9)
    even = np.array([min(box[0], box[1]), min(box[0], box[1]), box[2]])
    diagonal = float(np.linalg.norm(high - low))
    best, best_cost = vertices, np.inf
    for scale in (box, even):
        moved = (vertices - own_low) * scale + low
        if scale is even:  # anchor on the side away from +x, where no handle is
            moved[:, 1] += 0.5 * (low[1] + high[1] - moved[:, 1].min() - moved[:, 1].max())
        moved, cost = _place_from(moved, faces, surface, diagonal, iterations)
        if cost < best_cost:
            best, best_cost = moved, cost
    return best


def _place_from(
    vertices: np.ndarray, faces: np.ndarray, surface: Surface, diagonal: float, iterations: int
) -> tuple[np.ndarray, float]:
    weight = 0.12 * diagonal
    cost = np.inf
    back = slice(None, None, max(1, len(surface.points) // 1500))
    points, point_normals = surface.points[back], surface.normals[back]
    for _ in range(iterations):
        normals = vertex_normals(vertices, faces)
        index = surface.nearest(vertices, normals, normal_weight_m=weight)
        near = KDTree(np.hstack([vertices, normals * weight])).query(np.hstack([points, point_normals * weight]))[1]
        source = np.vstack([vertices, vertices[near]])
        target = np.vstack([surface.points[index], points])
        share = np.r_[np.full(len(vertices), 1 / len(vertices)), np.full(len(points), 1 / len(points))]
        centre, wanted = share @ source / 2, share @ target / 2
        covariance = share @ ((source - centre) * (target - wanted))
        scale = np.clip(covariance / (share @ (source - centre) ** 2), 0.8, 1.25)
        vertices = wanted + (vertices - centre) * scale
        cost = float(share @ np.linalg.norm(source - target, axis=1))
        if np.abs(scale - 1).max() < 1e-3:
            break
    return vertices, cost


def _operators(
    vertices: np.ndarray, faces: np.ndarray, diagonal: float
) -> tuple[sparse.csc_matrix, sparse.csc_matrix, sparse.csc_matrix]:
    """Lumped mass (m^2), thin-plate bending K M^-1 K (1/m^2), and a Laplacian that binds close sheets together."""
    corners = vertices[faces]
    stiffness = sparse.csc_matrix((len(vertices), len(vertices)))
    double_area = np.linalg.norm(triangle_normals(corners), axis=1)
    double_area = np.maximum(double_area, 1e-6 * double_area.mean())
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cotangent = ((corners[:, j] - corners[:, i]) * (corners[:, k] - corners[:, i])).sum(axis=1) / double_area
        stiffness = stiffness + _laplacian(faces[:, j], faces[:, k], np.clip(0.5 * cotangent, 0.02, 5.0), len(vertices))
    area = np.bincount(faces.ravel(), np.repeat(double_area / 6, 3), minlength=len(vertices))
    area = np.maximum(area, 1e-3 * area.mean())
    mass, inverse = sparse.diags(area).tocsc(), sparse.diags(1 / area).tocsc()
    pairs = KDTree(vertices).query_pairs(0.05 * diagonal, output_type="ndarray")
    distance = np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1)
    # Each vertex is bound as strongly to all of its neighbourhood as its own area over (5 % of the diagonal)^2.
    count = np.bincount(pairs.ravel(), minlength=len(vertices))
    strength = np.minimum(area[pairs[:, 0]], area[pairs[:, 1]]) / np.maximum(count[pairs[:, 0]], 1)
    strength = strength * np.exp(-((distance / (0.03 * diagonal)) ** 2)) / (0.05 * diagonal) ** 2
    binding = _laplacian(pairs[:, 0], pairs[:, 1], strength, len(vertices))
    return mass, (stiffness @ inverse @ stiffness).tocsc(), binding


def _laplacian(i: np.ndarray, j: np.ndarray, weight: np.ndarray, count: int) -> sparse.csc_matrix:
    rows, columns = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j])
    return sparse.csc_matrix(
        (np.concatenate([-weight, -weight, weight, weight]), (rows, columns)), shape=(count, count)
    )
