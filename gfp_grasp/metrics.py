"""How far a completed shape is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree
from trimesh.ray.ray_pyembree import RayMeshIntersector

from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption
from gfp_grasp.meshes import sample_surface

# Rays that are tried for each sample before it is called hidden.
_NUM_DIRECTIONS = 64
# Rays start this share of the diagonal off the surface: above embree's float32, below a tenth of a 1 mm wall.
_LIFT_OFF = 2e-5


@dataclass(frozen=True)
class CompletionErrors:
    """Errors of one completion.

    Attributes:
        cd_m: Chamfer distance, m, of visible surface samples.
        f_score: Harmonic mean of precision and recall at 5 mm, 0 to 1.
        scale_error: Signed relative error of size: the cube root of the ratio of the convex hulls' volumes, less one.
    """

    cd_m: float
    f_score: float
    scale_error: float


def completion_errors(
    mesh: trimesh.Trimesh | np.ndarray, truth: trimesh.Trimesh, *, rng: np.random.Generator, count: int = 8192
) -> CompletionErrors:
    """Compare a completion with the truth on what can be seen of both from outside or through an opening.

    Args:
        mesh: Completed mesh, or points (n, 3) m that are compared as they are, in the frame of the truth.
        truth: True mesh.
        rng: Draws the samples.
        count: Number of samples of each surface.

    Raises:
        InvalidCloud: Points of a wrong shape, or too few for a hull.
        InvalidMesh: A mesh without visible surface.
    """
    points = visible_surface(mesh, count, rng) if isinstance(mesh, trimesh.Trimesh) else _points(mesh, "mesh")
    target = visible_surface(truth, count, rng)
    return CompletionErrors(chamfer_m(points, target), f_score(points, target), scale_error(mesh, truth))


def chamfer_m(a: np.ndarray, b: np.ndarray) -> float:
    """Chamfer distance: mean nearest distance from a to b plus that from b to a, m; neither squared nor halved.

    Args:
        a: (n, 3) m.
        b: (m, 3) m.

    Raises:
        InvalidCloud: A set is empty, not finite, or of another shape.

    Source:
        GFPNet, equation 2.
    """
    to_b, to_a = _nearest_m(a, b)
    return float(to_b.mean() + to_a.mean())


def f_score(a: np.ndarray, b: np.ndarray, threshold_m: float = 0.005) -> float:
    """Harmonic mean of the shares of a near b and of b near a, 0 to 1.

    Args:
        a: (n, 3) m.
        b: (m, 3) m.
        threshold_m: Points within this distance are near, m.

    Raises:
        InvalidCloud: A set is empty, not finite, or of another shape.
        InvalidOption: The threshold is not positive.
    """
    if not threshold_m > 0:
        raise InvalidOption(f"threshold_m is {threshold_m}; a positive distance in metres is expected")
    to_b, to_a = _nearest_m(a, b)
    precision, recall = float((to_b < threshold_m).mean()), float((to_a < threshold_m).mean())
    return 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0


def scale_error(mesh: trimesh.Trimesh | np.ndarray, truth: trimesh.Trimesh) -> float:
    """Signed relative error of size: the cube root of the ratio of the convex hulls' volumes, less one.

    Args:
        mesh: Completed mesh, or points (n, 3) m.
        truth: True mesh.
    """
    hull = mesh if isinstance(mesh, trimesh.Trimesh) else trimesh.PointCloud(_points(mesh, "mesh"))
    return float(np.cbrt(hull.convex_hull.volume / truth.convex_hull.volume)) - 1.0


def iou(mesh_a: trimesh.Trimesh, mesh_b: trimesh.Trimesh) -> float:
    """Intersection over union of two solids, 0 to 1, from their exact boolean intersection.

    Raises:
        InvalidMesh: One of them is not a closed volume.
    """
    for name, mesh in (("mesh_a", mesh_a), ("mesh_b", mesh_b)):
        if not mesh.is_volume:
            raise InvalidMesh(f"{name} is not a closed volume, so it has no inside: see meshes.make_solid")
    overlap = trimesh.boolean.intersection([mesh_a, mesh_b], engine="manifold")
    common = float(overlap.volume) if len(overlap.faces) else 0.0
    return common / (float(mesh_a.volume) + float(mesh_b.volume) - common)


def visible_surface(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform samples of the surface that can be seen from outside or through an opening.

    A sample is seen if one of 64 rays over its outward hemisphere leaves without a hit: the inside of an open vessel
    counts, the void in a closed shell does not. Both sides of an open sheet are looked at.

    Args:
        mesh: Triangle mesh.
        count: Number of samples.
        rng: Draws the samples.

    Returns:
        (count, 3) m.

    Raises:
        InvalidMesh: The mesh has no area, or nothing of it can be seen.
    """
    caster = RayMeshIntersector(mesh)
    two_sided, lift = not mesh.is_volume, _LIFT_OFF * float(np.linalg.norm(mesh.extents))
    found: list[np.ndarray] = []
    missing, tried, share = count, 0, 1.0
    while missing > 0:
        points, normals, _ = sample_surface(mesh, int(missing / share * 1.1) + 64, rng)
        seen = _escapes(caster, points, normals, lift, rng)
        if two_sided:
            seen[~seen] = _escapes(caster, points[~seen], -normals[~seen], lift, rng)
        found.append(points[seen][:missing])
        missing, tried, share = missing - len(found[-1]), tried + len(points), max(float(seen.mean()), 0.05)
        if tried > 50 * count + 10_000:
            raise InvalidMesh("almost nothing of the mesh can be seen from outside: are its faces turned inside out?")
    return np.concatenate(found) if found else np.zeros((0, 3))


def _escapes(
    caster: RayMeshIntersector, points: np.ndarray, normals: np.ndarray, lift: float, rng: np.random.Generator
) -> np.ndarray:
    """Whether any ray of the hemisphere around each normal leaves: (n,) bool.

    Most samples escape by their first ray, so the rays are cast in rounds that grow.
    """
    frames = _frames(normals, rng.uniform(0, 2 * np.pi, len(points)))
    origins, directions = points + lift * normals, _hemisphere(_NUM_DIRECTIONS)
    hidden, start = np.arange(len(points)), 0
    for stop in (1, 4, 12, 28, _NUM_DIRECTIONS):
        if len(hidden) == 0:
            break
        rays = np.einsum("nij,kj->nki", frames[hidden], directions[start:stop])
        hit = caster.intersects_any(np.repeat(origins[hidden], stop - start, axis=0), rays.reshape(-1, 3))
        hidden, start = hidden[hit.reshape(len(hidden), -1).all(axis=1)], stop
    seen = np.ones(len(points), dtype=bool)
    seen[hidden] = False
    return seen


def _hemisphere(count: int) -> np.ndarray:
    """(count, 3) unit, spread evenly over z > 0, in an order whose every start is spread as well; z first."""
    heights = 1 - np.arange(count) / count * 0.98
    azimuths = np.arange(count) * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - heights**2)
    spread = np.stack([flat * np.cos(azimuths), flat * np.sin(azimuths), heights], axis=1)
    return spread[np.argsort([int(f"{i:06b}"[::-1], 2) for i in range(count)], kind="stable")]


def _frames(normals: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) that take z to each normal, turned about it so that samples do not share blind spots."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    x = np.cross(helper, normals)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    y = np.cross(normals, x)
    cos, sin = np.cos(turns)[:, None], np.sin(turns)[:, None]
    return np.stack([cos * x + sin * y, cos * y - sin * x, normals], axis=2)


def _nearest_m(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = _points(a, "a"), _points(b, "b")
    return np.asarray(KDTree(b).query(a)[0]), np.asarray(KDTree(a).query(b)[0])


def _points(points: np.ndarray, name: str) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
        raise InvalidCloud(f"{name} has shape {points.shape}; finite, non-empty (n, 3) points in metres are expected")
    return points


_RESAMPLINGS = 2000


def mean_of_groups(groups: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """Mean of all values and its 95 % interval, by resampling whole groups: views of one object are alike.

    Args:
        groups: Values by group; at least one group, and none empty.

    Returns:
        Mean, and the lower and the upper end of the interval (percentile bootstrap).
    """
    sums, counts = (np.array([f(group) for group in groups], dtype=float) for f in (np.sum, len))
    drawn = np.random.default_rng(0).integers(len(groups), size=(_RESAMPLINGS, len(groups)))
    low, high = np.quantile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), [0.025, 0.975])
    return float(sums.sum() / counts.sum()), float(low), float(high)
