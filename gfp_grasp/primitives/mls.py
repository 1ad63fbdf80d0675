"""Projection onto the moving-least-squares surface of an oriented point set, without melting thin walls together."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidMesh, InvalidOption

# Neighbours whose normals differ by more than this belong to another sheet: the two sides of a wall differ by 180.
MAX_ANGLE_DEG = 60.0
# Normal equations of a local fit are kept solvable where neighbours lie on a line; relative to their trace.
_RIDGE = 1e-7


def project(
    points: np.ndarray,
    normals: np.ndarray,
    surface_points: np.ndarray,
    surface_normals: np.ndarray,
    *,
    radius_m: float,
    degree: int = 2,
    iterations: int = 2,
    num_neighbours: int = 48,
) -> np.ndarray:
    """Move points onto the smooth surface that an oriented, noisy point set describes.

    Each point gets a plane from its Gaussian-weighted neighbours and a polynomial height above it; it moves along the
    plane's normal onto that height (Alexa et al., IEEE TVCG 9(1), 2003; Levin 2004).

    Args:
        points: (n, 3) m, the points to move.
        normals: (n, 3) unit, the side of the surface on which each of them lies.
        surface_points: (m, 3) m, noisy samples.
        surface_normals: (m, 3) unit, outward.
        radius_m: Width of the Gaussian weight; about two to four sample spacings.
        degree: 1 fits planes, 2 quadrics, which keep curvature.
        iterations: Projections, each from where the last one ended.
        num_neighbours: Nearest samples that are looked at.

    Returns:
        (n, 3) m. A point with fewer than three compatible neighbours stays where it is.

    Raises:
        InvalidMesh: Shapes do not fit each other.
        InvalidOption: radius_m, degree or iterations is out of range.
    """
    points, normals = np.array(points, dtype=np.float64), np.asarray(normals, dtype=np.float64)
    surface_points = np.asarray(surface_points, dtype=np.float64)
    surface_normals = np.asarray(surface_normals, dtype=np.float64)
    for a, b, name in ((points, normals, "normals"), (surface_points, surface_normals, "surface_normals")):
        if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
            raise InvalidMesh(f"{name} have shape {b.shape} for points of shape {a.shape}; both must be (n, 3)")
    if not radius_m > 0 or degree not in (1, 2) or iterations < 1:
        raise InvalidOption(
            f"radius_m={radius_m}, degree={degree}, iterations={iterations}: a positive radius, degree 1 or 2 and at "
            "least one iteration are expected"
        )
    tree = KDTree(surface_points)
    for _ in range(iterations):
        points = _project_once(points, normals, tree, surface_points, surface_normals, radius_m, degree, num_neighbours)
    return points


def _project_once(
    points: np.ndarray,
    normals: np.ndarray,
    tree: KDTree,
    surface_points: np.ndarray,
    surface_normals: np.ndarray,
    radius_m: float,
    degree: int,
    num_neighbours: int,
) -> np.ndarray:
    count = min(num_neighbours, len(surface_points))
    distances, index = tree.query(points, k=count)
    distances, index = distances.reshape(len(points), count), index.reshape(len(points), count)
    near, near_normals = surface_points[index], surface_normals[index]
    compatible = np.einsum("nkc,nc->nk", near_normals, normals) > np.cos(np.radians(MAX_ANGLE_DEG))
    weight = np.exp(-((distances / radius_m) ** 2)) * compatible
    enough = (weight > 1e-9).sum(axis=1) >= 3
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    weight = weight / total
    origin = np.einsum("nk,nkc->nc", weight, near)
    normal = np.einsum("nk,nkc->nc", weight, near_normals)
    normal = np.where(enough[:, None], normal, normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    u, v = _tangents(normal)
    height = _local_height(points, origin, u, v, normal, near, weight, radius_m, degree)
    offset = points - origin
    along = np.einsum("nc,nc->n", offset, normal)
    moved = points + (height - along)[:, None] * normal
    return np.where(enough[:, None], moved, points)


def _local_height(
    points: np.ndarray,
    origin: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    normal: np.ndarray,
    near: np.ndarray,
    weight: np.ndarray,
    radius_m: float,
    degree: int,
) -> np.ndarray:
    """Height (n,) m of the fitted polynomial above each plane, at each point's own foot."""
    offsets = (near - origin[:, None]) / radius_m  # dimensionless, so that the normal equations are well scaled
    basis = _monomials(np.einsum("nkc,nc->nk", offsets, u), np.einsum("nkc,nc->nk", offsets, v), degree)
    heights = np.einsum("nkc,nc->nk", offsets, normal)
    # Quadrics from a handful of neighbours swing wildly: there the ridge turns them into planes.
    weighted = basis * weight[..., None]
    gram = np.einsum("nki,nkj->nij", weighted, basis)
    trace = np.trace(gram, axis1=1, axis2=2)[:, None, None]
    gram = gram + _RIDGE * np.maximum(trace, 1e-12) * np.eye(basis.shape[-1])
    coefficients = np.linalg.solve(gram, np.einsum("nki,nk->ni", weighted, heights)[..., None])[..., 0]
    foot = (points - origin) / radius_m
    own = _monomials(np.einsum("nc,nc->n", foot, u), np.einsum("nc,nc->n", foot, v), degree)
    return np.einsum("ni,ni->n", own, coefficients) * radius_m


def _monomials(x: np.ndarray, y: np.ndarray, degree: int) -> np.ndarray:
    columns = [np.ones_like(x), x, y]
    if degree == 2:
        columns += [x * x, x * y, y * y]
    return np.stack(columns, axis=-1)


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) each, orthogonal to the (n, 3) unit normals and to each other."""
    helper = np.zeros_like(normal)
    helper[np.arange(len(normal)), np.abs(normal).argmin(axis=1)] = 1.0
    u = np.cross(normal, helper)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normal, u)
