"""The largest ball that fits into a hollow mesh, and whether it still fits between the convex parts."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, KDTree, QhullError

from gfp_grasp.collision.parts import PartFaces, diagonal_m, lengths

_DRAWN = 6000
LEAST_BALL = 1 / 40  # of the diagonal, 5 mm of a mesh of 0.2 m: what no larger ball fits into is a dent
_AROUND = 1.5  # vertices within this many radii hold the centre of a ball in place
_HOLDERS = 64


def widest_gap(mesh: trimesh.Trimesh, *, seed: int = 0) -> np.ndarray | None:
    """Centre of a large ball outside a mesh whose centre lies within the mesh's convex hull, as in a cup.

    Args:
        mesh: Watertight, m.
        seed: Chooses the places that are tried.

    Returns:
        (3,) m; None where no ball has a radius of more than a fortieth of the mesh's diagonal.
    """
    rng = np.random.default_rng(seed)
    try:
        planes = ConvexHull(mesh.vertices).equations
    except QhullError:
        return None
    surface = KDTree(np.concatenate([mesh.vertices, mesh.triangles_center]))
    best, radius, least = mesh.bounds.mean(axis=0), 0.0, LEAST_BALL * diagonal_m(mesh.vertices)
    low, high = mesh.bounds
    for _ in range(3):  # around the best place of those before
        places = rng.uniform(low, high, (_DRAWN, 3))
        places = places[(places @ planes[:, :3].T + planes[:, 3]).max(axis=1) < 0]
        distance = surface.query(places)[0]
        wider = np.flatnonzero(distance > radius)
        wider = wider[~mesh.contains(places[wider])] if len(wider) else wider
        if len(wider):
            first = wider[distance[wider].argmax()]
            best, radius = places[first], float(distance[first])
        low, high = best - max(radius, least), best + max(radius, least)
    return best if radius > least else None


def barycentric_hold(point: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices around a point, and the weights with which the point follows them.

    Returns:
        Indices (n,) and weights (n,), which sum to one.
    """
    distance = np.linalg.norm(vertices - point, axis=1)
    near = np.flatnonzero(distance < _AROUND * distance.min())
    if len(near) < _HOLDERS:
        near = np.argsort(distance)[:_HOLDERS]
    here = np.vstack([vertices[near].T, np.ones(len(near))])
    return near, np.linalg.lstsq(here, np.append(point, 1.0), rcond=None)[0]


def ball_radii_m(centre: np.ndarray, mesh: trimesh.Trimesh, parts: PartFaces) -> tuple[float, float]:
    """Radius, m, of the largest ball around a centre (3,) m that a mesh leaves free, and that its parts leave free."""
    free = _clearance_m(centre, np.asarray(mesh.vertices)[mesh.faces])
    return free, 0.0 if parts.within(centre[None]).any() else _clearance_m(centre, parts.triangles)


def _clearance_m(point: np.ndarray, triangles: np.ndarray) -> float:
    # A triangle lies within the ball around its centroid that reaches its farthest corner.
    middle = (triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / 3
    arms = triangles - middle[:, None]
    reach = np.sqrt(np.einsum("nij,nij->ni", arms, arms).max(axis=1))
    distance = lengths(middle - point)
    near = triangles[distance - reach <= distance.min()]
    feet = trimesh.triangles.closest_point(near, np.broadcast_to(point, (len(near), 3)))
    return float(lengths(feet - point).min())
