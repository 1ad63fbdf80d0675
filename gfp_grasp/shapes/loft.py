"""Solids from profiles: bodies of revolution and their like, swept tubes, and booleans of closed solids.

A profile is (m, 2) of radius and height in metres, from the axis at the bottom, up and outside, to the axis again. What
a boolean returns is a volume without exactly coplanar pieces.
"""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from gfp_grasp.meshes import triangle_normals


def smooth_noise(rng: np.random.Generator, t: np.ndarray, *, amplitude: float, knots: int) -> np.ndarray:
    """Smooth random curve (n,) over t in 0 .. 1, a natural cubic spline through normal values at even knots."""
    values = rng.normal(0.0, amplitude, knots)
    return CubicSpline(np.linspace(0, 1, knots), values, bc_type="natural")(t)


def smoothstep(t: np.ndarray) -> np.ndarray:
    """0 to 1 with level ends; t is clipped to 0 .. 1."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def rounded_off(height: np.ndarray, reach: float, depth: float) -> np.ndarray:
    """What a rounded bottom edge takes off a radius, (n,) m: a quarter of an ellipse.

    Args:
        height: (n,) m above the bottom.
        reach: Height up to which the edge is rounded, m.
        depth: What the edge takes off at the bottom, m.
    """
    missing = np.clip(1 - height / reach, 0, 1)
    return depth * (1 - np.sqrt(1 - missing**2))


def arc_length(curve: np.ndarray) -> np.ndarray:
    """Length (n,) m of a polyline (n, d) m from its start to each of its points."""
    return np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])


def rounded(corners: np.ndarray | list, radii: np.ndarray | list, *, steps: int = 6) -> np.ndarray:
    """Polyline (n, 2) with its inner corners replaced by arcs.

    Args:
        corners: (m, 2) m.
        radii: (m,) m, wanted radius at each corner; limited by what the neighbouring edges leave. The ends stay.
        steps: Points of an arc.
    """
    corners = np.asarray(corners, dtype=np.float64)
    points = [corners[:1]]
    for i in range(1, len(corners) - 1):
        here, back, ahead = corners[i], corners[i - 1] - corners[i], corners[i + 1] - corners[i]
        room = 0.49 * min(np.linalg.norm(back), np.linalg.norm(ahead))
        if radii[i] <= 0 or room < 1e-6:
            points.append(here[None])
            continue
        back, ahead = back / np.linalg.norm(back), ahead / np.linalg.norm(ahead)
        half = np.arccos(np.clip(back @ ahead, -1, 1)) / 2
        cut = min(radii[i] / max(np.tan(half), 1e-6), room)
        t = np.linspace(0, 1, steps)[:, None]
        # A quadratic Bezier arc: within a few per cent of the circle, and it cannot overshoot.
        points.append((1 - t) ** 2 * (here + cut * back) + 2 * t * (1 - t) * here + t**2 * (here + cut * ahead))
    return np.concatenate([*points, corners[-1:]])


def inset(radius: np.ndarray, height: np.ndarray, wall_m: float) -> np.ndarray:
    """Radius (n,) of the curve at a distance of wall_m inside radius(height): erosion by a disc.

    Args:
        radius: (n,) m over rising heights; beyond the ends it goes on as it ended.
        height: (n,) m, rising.
        wall_m: Distance, m.
    """
    steps = np.linspace(-1, 1, 33)
    shifted = np.interp(height[:, None] + wall_m * steps[None], height, radius)
    return (shifted - wall_m * np.sqrt(1 - steps**2)[None]).min(axis=1)


def thinned(points: np.ndarray, *, tolerance: float, longest: float) -> np.ndarray:
    """Indices of the points that keep a polyline within a tolerance (Douglas-Peucker), no two further than `longest`.

    Args:
        points: (n, d) m.
        tolerance: m.
        longest: m.

    Returns:
        (k,) int, rising, with both ends.
    """
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        chord, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        t = np.clip(inner @ chord / max(chord @ chord, 1e-18), 0, 1)
        distance = np.linalg.norm(inner - t[:, None] * chord, axis=1)
        far = int(distance.argmax()) + 1
        if distance[far - 1] <= tolerance:
            if np.linalg.norm(chord) <= longest:
                continue
            far = (last - first) // 2
        keep[first + far] = True
        stack += [(first, first + far), (first + far, last)]
    return np.flatnonzero(keep)


# Profile points closer than this are one: rings that coincide would make faces without area.
_COINCIDENT = 2e-5
_PROFILE_TOLERANCE = 7e-5
_LONGEST_STEP = 0.009
_FLAT = 0.25  # half-width over half-width of a ring that is squeezed flat


def rows(
    radius: ArrayLike, height: ArrayLike, *, aspect: np.ndarray | float = 1.0, power: np.ndarray | float = 2.0
) -> np.ndarray:
    """Ring rows (n, 4): half-widths along x and y (m), height (m), superellipse power (2 is an ellipse)."""
    radius, height = np.asarray(radius, dtype=np.float64), np.asarray(height, dtype=np.float64)
    return np.stack([radius, radius * aspect, height, np.broadcast_to(power, radius.shape)], axis=1)


def loft(
    rings: np.ndarray,
    *,
    segments: int = 48,
    flutes: tuple[int, float] = (0, 0.0),
    longest_m: float = _LONGEST_STEP,
) -> trimesh.Trimesh:
    """Closed mesh through rings, from the lowest row's middle to the last row's middle.

    Args:
        rings: (n, 4) rows as of `rows`; followed in order, outside first, so that faces look outward. The first and
            the last become points on the axis.
        segments: Vertices of a ring.
        flutes: Number of waves around and their relative depth.
        longest_m: Two rings are at most about so far from each other.
    """
    return around(_thin(np.asarray(rings, dtype=np.float64), longest_m), segments=segments, flutes=flutes)


def around(rings: np.ndarray, *, segments: int = 48, flutes: tuple[int, float] = (0, 0.0)) -> trimesh.Trimesh:
    """`loft` through all of the rings: as many as are given, so that equal counts give equal faces."""
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


def skin(rings: np.ndarray) -> trimesh.Trimesh:
    """Closed mesh through rings of vertices, the first and the last closed by fans around their middles.

    Args:
        rings: (n, k, 3) m; seen from where the rings go to, each turns left.
    """
    ends = rings[[0, -1]].mean(axis=1)
    vertices = np.concatenate([ends[:1], rings.reshape(-1, 3), ends[1:]])
    return trimesh.Trimesh(vertices, ring_faces(len(rings), rings.shape[1]), process=False)


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


def _thin(rings: np.ndarray, longest_m: float) -> np.ndarray:
    distinct = np.linalg.norm(np.diff(rings[:, :3], axis=0), axis=1) > _COINCIDENT
    rings = rings[np.concatenate([[True], distinct])]
    kept = rings[thinned(rings[:, :3], tolerance=_PROFILE_TOLERANCE, longest=longest_m)]
    middle = kept[(kept[:, 0] > 1e-4) & (kept[:, 1] > 1e-4)]
    return np.concatenate([rings[:1], middle, rings[-1:]])


def _angles(rings: np.ndarray, segments: int) -> np.ndarray:
    """Angles of a ring's vertices, evened out over the widest ring, whose ends and corners would else be coarse."""
    flat = (rings[:, 1] < _FLAT * rings[:, 0]).any()
    # Even over a flat end, as a tube's crimp is, vertices would crowd at the sides of the round rest.
    widest = rings[(rings[:, 0] * rings[:, 1]).argmax() if flat else rings[:, 0].argmax()]
    dense = np.linspace(0, 2 * np.pi, 721)
    cos, sin = np.cos(dense), np.sin(dense)
    reach = ((np.abs(cos) / widest[0]) ** widest[3] + (np.abs(sin) / widest[1]) ** widest[3]) ** (-1 / widest[3])
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(reach * cos), np.diff(reach * sin)))])
    return np.interp(np.arange(segments) / segments * length[-1], length, dense)


# Convex decomposition aborts on some unions with exactly coplanar faces; this much jitter cures it, and a union is not
# known to a micrometre anyway.
_JITTER_M = 1e-6
# Edges that a union leaves shorter than this are collapsed.
_SLIVER_M = 1e-5


def unite(
    meshes: Sequence[trimesh.Trimesh], *, tolerance_m: float = _SLIVER_M, longest_m: float | None = None
) -> trimesh.Trimesh:
    """Union of closed meshes, jittered by at most a micrometre.

    Args:
        meshes: Closed.
        tolerance_m: Vertices without which the surface moves by less are left out.
        longest_m: Edges that are longer then are split evenly; None leaves them.
    """
    whole = manifold3d.Manifold.batch_boolean([_solid(mesh) for mesh in meshes], manifold3d.OpType.Add)
    whole = whole.simplify(tolerance_m)
    mesh = _mesh(whole if longest_m is None else whole.refine_to_length(longest_m))
    room = np.minimum(_JITTER_M, 0.05 * _smallest_altitudes(mesh.vertices, mesh.faces))
    turn = np.random.default_rng(len(mesh.vertices)).uniform(-1, 1, mesh.vertices.shape)
    return trimesh.Trimesh(mesh.vertices + room[:, None] * turn, mesh.faces, process=False)


def subtract(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> trimesh.Trimesh:
    """The part of a closed mesh that is outside another one."""
    return _mesh(_solid(mesh) - _solid(other))


def _smallest_altitudes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Smallest altitude (v,) m of the faces around each vertex: moved by less, no sliver turns over."""
    corners = vertices[faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    doubled = np.linalg.norm(triangle_normals(corners), axis=1)
    smallest = np.full(len(vertices), np.inf)
    np.minimum.at(smallest, faces.ravel(), np.repeat(doubled / edges.max(axis=1), 3))
    return smallest


def _solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    vertices, faces = (
        np.array(mesh.vertices, dtype=np.float64, order="C"),
        np.array(mesh.faces, dtype=np.uint64, order="C"),
    )
    return manifold3d.Manifold(manifold3d.Mesh64(vertices, faces))


def _mesh(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    raw = solid.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts).astype(np.int64), process=False
    )
