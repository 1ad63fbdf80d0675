"""Completed surfaces that stand: their feet lie in the support plane, and they do not topple off them.

Whatever is a millimetre off a plane rocks in a simulator.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.meshes import triangle_normals, vertex_normals
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import LevelView

# Multiples of the sensor's noise: what is this near to the support stands on it,
_FOOT = 1 / 3
_SUPPORT_REACHED = 20.0  # and an object whose lowest point is this far above the support that was seen is not on it.
_LEAST_MARGIN = 1.0  # of the centre of mass within the outline of the feet,
_MARGIN_SHARE = 0.03  # and where rings saw it, this share of its width: a bus on three wheels tips over
_FACES_DOWN = -0.3  # z of the normal of a vertex that can be stood on
_LEAST_BOTTOM = 1 / 3  # what faces up stays so far above the support, multiples of the noise
_MOST_TURN_DEG = 5.0  # that an object which would topple is turned by, to where it rests
# A foot that is too small grows to what lies so many times as high: a little before the object is turned, and after it.
_GROWN, _GROWN_MORE = (2, 4, 8), (16, 32, 64, 128)


def stood(vertices: np.ndarray, faces: np.ndarray, view: LevelView) -> np.ndarray:
    """Vertices (v, 3) m of a closed surface, in the level frame, moved so that it stands; see `stand_on`.

    The plane it stands on is the support that was seen, where the object reaches it, and else goes through the object's
    lowest point.
    """
    sigma_m, lowest = view.sensor.sigma_m, float(vertices[:, 2].min())
    floor_m = 0.0 if view.floor_seen and lowest < _SUPPORT_REACHED * sigma_m else lowest
    margin_m = _MARGIN_SHARE * float(np.ptp(vertices[:, :2], axis=0).min()) if view.sensor.step_rad else 0.0
    return stand_on(vertices, faces, floor_m, sigma_m=sigma_m, margin_m=margin_m)


def stand_on(
    vertices: np.ndarray,
    faces: np.ndarray,
    floor_m: float,
    *,
    sigma_m: float,
    margin_m: float = 0.0,
    turn: bool = True,
) -> np.ndarray:
    """Vertices (v, 3) m of a closed surface, z up, moved so that it stands on a floor.

    What faces down within a little of the floor comes to lie in it; nothing stays below it. The lowest point is drawn
    down to the floor, however high it is. Where the centre of mass is not above what is stood on, the real object has
    more of a foot than this one, or lies otherwise: the foot grows, and the object is turned onto the side that it
    would roll to, if that is near.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), outward.
        floor_m: z of the floor.
        sigma_m: The sensor's noise, the unit of what is little.
        margin_m: How far the centre of mass lies within the outline of the feet, where that is more than the noise.
        turn: Whether the object may be turned.
    """
    down = vertex_normals(vertices, faces)[:, 2]
    least_m = max(margin_m, _LEAST_MARGIN * sigma_m)
    first = _on_plane(vertices, down, floor_m, sigma_m)
    if _stands(first, faces, floor_m, least_m):
        return first
    grown = _with_grown_foot(vertices, faces, down, floor_m, sigma_m, least_m, _GROWN)
    if grown is not None:
        return grown
    centre = _centre_of_mass(first, faces)
    rotation = _turn_to_rest(vertices, centre) if turn else None
    if rotation is not None:
        turned = (vertices - centre) @ rotation.T + centre
        turned[:, 2] += floor_m - turned[:, 2].min()
        return _on_plane(turned, vertex_normals(turned, faces)[:, 2], floor_m, sigma_m)
    grown = _with_grown_foot(vertices, faces, down, floor_m, sigma_m, least_m, _GROWN_MORE)
    return first if grown is None else grown


def _with_grown_foot(
    vertices: np.ndarray,
    faces: np.ndarray,
    down: np.ndarray,
    floor_m: float,
    sigma_m: float,
    least_m: float,
    sizes: tuple[int, ...],
) -> np.ndarray | None:
    """The vertices on the first foot of some sizes that carries the centre of mass; None where none does."""
    for grown in sizes:
        answer = _on_plane(vertices, down, floor_m, sigma_m, grown)
        if _stands(answer, faces, floor_m, least_m):
            return answer
    return None


def _on_plane(vertices: np.ndarray, down: np.ndarray, floor_m: float, sigma_m: float, grown: int = 1) -> np.ndarray:
    """The vertices with those of the foot, which is so many times as high as it need be, in the floor.

    What faces down has a normal whose z, `down` (v,), is negative.
    """
    z, foot_m = vertices[:, 2], grown * _FOOT * sigma_m
    stands = (z < max(float(z.min()), floor_m) + foot_m) & (down < _FACES_DOWN)
    least_m = np.where(down > -_FACES_DOWN, floor_m + _LEAST_BOTTOM * sigma_m, floor_m)
    return np.column_stack([vertices[:, :2], np.where(stands, floor_m, np.maximum(z, least_m))])


def _stands(vertices: np.ndarray, faces: np.ndarray, floor_m: float, least_m: float) -> bool:
    """Whether the centre of mass is above the outline of what lies on the floor, so far within it."""
    feet = vertices[vertices[:, 2] < floor_m + 1e-6, :2]
    return _margin_m(feet, _centre_of_mass(vertices, faces)[:2]) >= least_m


def _centre_of_mass(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3,) of the solid within a closed surface."""
    middle = vertices.mean(axis=0)
    triangles = vertices[faces] - middle
    volumes = np.einsum("fi,fi->f", triangles[:, 0], triangle_normals(triangles))
    return middle + volumes @ triangles.sum(axis=1) / (4 * volumes.sum())


def _margin_m(ground: np.ndarray, place: np.ndarray) -> float:
    """How far a place (2,) lies within the outline of points (n, 2); negative outside, -inf where there is none."""
    try:
        hull = ConvexHull(ground)
    except (QhullError, ValueError):  # a line, a point, or nothing
        return -np.inf
    return float(-(hull.equations[:, :2] @ place + hull.equations[:, 2]).max())


def _turn_to_rest(vertices: np.ndarray, centre: np.ndarray) -> np.ndarray | None:
    """Rotation (3, 3) onto the nearest face of the hull that the centre of mass is above; None where none is near."""
    hull = ConvexHull(vertices)
    best, least = None, np.cos(np.radians(_MOST_TURN_DEG))
    for normal, corners in zip(hull.equations[:, :3], hull.simplices, strict=True):
        if -normal[2] <= least:
            continue
        R = rotation_between(normal, (0.0, 0.0, -1.0))
        flat = (vertices[corners] - centre) @ R.T
        near = (vertices - centre) @ R[2] < flat[:, 2].max() + 1e-6
        if _margin_m(((vertices[near] - centre) @ R.T)[:, :2], np.zeros(2)) >= 0.0:
            best, least = R, float(-normal[2])
    return best
