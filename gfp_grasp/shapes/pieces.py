"""Pieces that mixtures are made of: rounded and turned solids, tubes along curves, hulls, and where they are put."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh

from gfp_grasp.shapes.loft import loft, rows, smoothstep, unite
from gfp_grasp.transforms import make_T

GRID = np.linspace(0.0, 1.0, 40)
_SECTION = 14  # vertices of a section of a tube


def random_solid(rng: np.random.Generator, extents: np.ndarray) -> trimesh.Trimesh:
    """A box, a ball, a cylinder, a cone, or something rounded of given extents (3,)."""
    match rng.integers(5):
        case 0:
            mesh = trimesh.creation.box()
        case 1:
            mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
        case 2:
            mesh = trimesh.creation.cylinder(radius=0.5, height=1.0, sections=32)
        case 3:
            taper = np.linspace(0.5, rng.uniform(0.02, 0.35), 12)
            mesh = placed(turned(taper, np.linspace(0, 1, 12)), (0, 0, -0.5))
        case _:
            ends = smoothstep(np.minimum(GRID, 1 - GRID) / 0.25) ** 0.5
            profile = 0.5 * (rng.uniform(0.5, 0.9) * (1 - ends) + ends)
            mesh = placed(turned(profile, GRID, power=rng.uniform(2, 8)), (0, 0, -0.5))
    return trimesh.Trimesh(mesh.vertices * extents, mesh.faces, process=False)


def turned(radius: np.ndarray, height: np.ndarray, *, aspect: float = 1.0, power: float = 2.0) -> trimesh.Trimesh:
    """A closed solid of one profile."""
    ends = rows([1e-6], height[:1]), rows([1e-6], height[-1:])
    rings = np.concatenate([ends[0], rows(radius, height, aspect=aspect, power=power), ends[1]])
    return loft(rings, segments=40, longest_m=0.1)


def chain(path: np.ndarray, radius: np.ndarray | float, *, flat: float = 1.0) -> trimesh.Trimesh:
    """A tube along a curve (n, 3), of hulls of neighbouring sections, so that it may cross itself.

    Args:
        path: (n, 3).
        radius: (n,) or one for all, half-width of the section in the curve's own plane.
        flat: Half-width across, as a share of it.
    """
    radius = np.broadcast_to(radius, len(path))
    tangent = np.gradient(path, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-9)
    _, _, axes = np.linalg.svd(path - path.mean(axis=0))
    across = axes[2] - (tangent @ axes[2])[:, None] * tangent  # square to the plane that the curve is nearest to
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    side = np.cross(tangent, across)
    turn = np.arange(_SECTION)[:, None, None] * 2 * np.pi / _SECTION
    rings = path + radius[:, None] * (np.cos(turn) * side + flat * np.sin(turn) * across)
    links = [hull(rings[:, i : i + 2].reshape(-1, 3)) for i in range(len(path) - 1)]
    return unite(links, tolerance_m=1e-4)


def hull(points: np.ndarray) -> trimesh.Trimesh:
    """The convex hull of points (n, 3)."""
    mesh = manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=np.float64)).to_mesh64()
    return trimesh.Trimesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int64), process=False)


def without(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> trimesh.Trimesh:
    """What of a closed mesh is outside another one; all of it where nothing would be left."""
    cut = trimesh.boolean.difference([mesh, other], engine="manifold")
    return cut if len(cut.faces) else mesh


def placed(mesh: trimesh.Trimesh, place: Sequence[float] | np.ndarray, R: np.ndarray | None = None) -> trimesh.Trimesh:
    """A copy turned by R (3, 3) and then put at a place (3,)."""
    moved = mesh.copy()
    moved.apply_transform(make_T(R, place))
    return moved
