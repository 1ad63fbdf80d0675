"""Closed meshes of revolution-like bodies (rings of superellipses on one axis) and of swept tubes."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.shapes.curves import thinned

# Profile points closer than this are one: rings that coincide would make faces without area.
_COINCIDENT = 2e-5
_PROFILE_TOLERANCE = 7e-5
_LONGEST_STEP = 0.009


def rows(
    radius: ArrayLike, height: ArrayLike, *, aspect: np.ndarray | float = 1.0, power: np.ndarray | float = 2.0
) -> np.ndarray:
    """Ring rows (n, 4): half-widths along x and y (m), height (m), superellipse power (2 is an ellipse)."""
    radius, height = np.asarray(radius, dtype=np.float64), np.asarray(height, dtype=np.float64)
    return np.stack([radius, radius * aspect, height, np.broadcast_to(power, radius.shape)], axis=1)


def loft(rings: np.ndarray, *, segments: int = 48, flutes: tuple[int, float] = (0, 0.0)) -> trimesh.Trimesh:
    """Closed mesh through rings, from the lowest row's middle to the last row's middle.

    Args:
        rings: (n, 4) rows as of `rows`; followed in order, outside first, so that faces look outward. The first and
            the last become points on the axis.
        segments: Vertices of a ring.
        flutes: Number of waves around and their relative depth.
    """
    rings = _thin(np.asarray(rings, dtype=np.float64))
    inner = rings[1:-1]
    angles = _angles(inner, segments)
    cos, sin = np.cos(angles)[None], np.sin(angles)[None]
    power = inner[:, 3:4]
    reach = ((np.abs(cos) / inner[:, :1]) ** power + (np.abs(sin) / inner[:, 1:2]) ** power) ** (-1 / power)
    reach = reach * (1 + flutes[1] * np.cos(flutes[0] * angles)[None])
    body = np.stack([reach * cos, reach * sin, np.broadcast_to(inner[:, 2:3], reach.shape)], axis=2)
    vertices = np.concatenate([[[0, 0, rings[0, 2]]], body.reshape(-1, 3), [[0, 0, rings[-1, 2]]]])
    return trimesh.Trimesh(vertices, ring_faces(len(inner), segments), process=False)


def sweep(
    path: np.ndarray, across: np.ndarray, along: np.ndarray, *, power: float = 2.0, segments: int = 20
) -> trimesh.Trimesh:
    """Closed tube along a curve in the plane y = 0.

    Args:
        path: (n, 3) m, y = 0.
        across: (n,) m, half-width along y.
        along: (n,) m, half-thickness in the plane of the curve.
        power: Exponent of the superellipse section.
        segments: Vertices of a ring.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.array([0.0, 1.0, 0.0])
    normal = np.cross(side, tangent)
    angles = np.arange(segments) * 2 * np.pi / segments
    reach = (np.abs(np.cos(angles)) ** power + np.abs(np.sin(angles)) ** power) ** (-1 / power)
    u, v = reach * np.cos(angles), reach * np.sin(angles)
    body = (
        path[:, None]
        + along[:, None, None] * u[None, :, None] * normal[:, None]
        + across[:, None, None] * v[None, :, None] * side[None, None]
    )
    vertices = np.concatenate([path[:1], body.reshape(-1, 3), path[-1:]])
    mesh = trimesh.Trimesh(vertices, ring_faces(len(path), segments), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def ring_faces(num_rings: int, segments: int) -> np.ndarray:
    """Faces (f, 3) of a point, rings of vertices, and a point, outward for rings that turn left and rise."""
    here = np.arange(segments)
    there = np.roll(here, -1)
    bottom = np.stack([np.zeros(segments, dtype=int), 1 + there, 1 + here], axis=1)
    lower = 1 + np.arange(num_rings - 1)[:, None] * segments
    quads = np.stack([lower + here, lower + there, lower + segments + here, lower + segments + there], axis=2)
    quads = quads.reshape(-1, 4)
    last = 1 + (num_rings - 1) * segments
    top = np.stack([last + here, last + there, np.full(segments, last + segments)], axis=1)
    return np.concatenate([bottom, quads[:, [0, 1, 3]], quads[:, [0, 3, 2]], top])


def _thin(rings: np.ndarray) -> np.ndarray:
    distinct = np.linalg.norm(np.diff(rings[:, :3], axis=0), axis=1) > _COINCIDENT
    rings = rings[np.concatenate([[True], distinct])]
    kept = rings[thinned(rings[:, :3], tolerance=_PROFILE_TOLERANCE, longest=_LONGEST_STEP)]
    middle = kept[(kept[:, 0] > 1e-4) & (kept[:, 1] > 1e-4)]
    return np.concatenate([rings[:1], middle, rings[-1:]])


def _angles(rings: np.ndarray, segments: int) -> np.ndarray:
    """Angles of a ring's vertices, evened out over the widest ring, whose ends and corners would else be coarse."""
    widest = rings[rings[:, 0].argmax()]
    dense = np.linspace(0, 2 * np.pi, 721)
    cos, sin = np.cos(dense), np.sin(dense)
    reach = ((np.abs(cos) / widest[0]) ** widest[3] + (np.abs(sin) / widest[1]) ** widest[3]) ** (-1 / widest[3])
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(reach * cos), np.diff(reach * sin)))])
    return np.interp(np.arange(segments) / segments * length[-1], length, dense)
