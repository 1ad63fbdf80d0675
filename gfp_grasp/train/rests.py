"""How an object of a view rests on its table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from gfp_grasp.meshes import triangle_normals
from gfp_grasp.shapes import FAMILIES, get_family, make_shape
from gfp_grasp.transforms import make_T, random_rotation, rotation_about, rotation_between
from gfp_grasp.types import RESTS

_ON_EDGE = 1e-6  # of a face, in barycentric shares: the hull's triangles part flat sides


def ways_of_shape(family: str, seed: int) -> tuple[str, ...]:
    """The ways in which a procedural shape rests, the likeliest first; all of them for "", which is no family."""
    if family not in FAMILIES:
        return RESTS
    known = get_family(family)
    kind = f"{family}.{make_shape(family, seed).kind}" if known.variants else family
    rests = known.spec_of(kind if kind in known.names else family).get("rests")
    return RESTS if rests is None else ways_of_resting(rests)  # pyright: ignore[reportArgumentType]


def ways_of_resting(rests: Mapping[str, float]) -> tuple[str, ...]:
    """The ways in which an object rests, the likeliest first."""
    return tuple(sorted(rests, key=lambda way: -rests[way]))


def rest_rotation(resting: str, roll_rad: float = 0.0) -> np.ndarray:
    """Rotation (3, 3) of an object that stands upright into the way it rests.

    Args:
        resting: "upright", "upside_down" or "lying".
        roll_rad: Turn about its own axis before it lies down.
    """
    if resting == "upside_down":
        return rotation_about((1, 0, 0), np.pi)
    if resting == "lying":
        return rotation_about((0, 1, 0), np.pi / 2) @ rotation_about((0, 0, 1), roll_rad)
    return np.eye(3)


def draw_rest(
    vertices: np.ndarray, rng: np.random.Generator, fallen_share: float, ways: tuple[str, ...]
) -> tuple[str, np.ndarray]:
    """How the object rests on z = 0, and its pose; it has fallen where it does not rest in the first of the ways."""
    likeliest, *others = ways
    fallen = rng.random() < fallen_share and len(others) > 0
    resting = others[int(rng.integers(len(others)))] if fallen else likeliest
    turn = random_rotation(rng) if resting == "lying" else np.eye(3)
    roll_rad = float(np.arctan2(turn[1, 0], turn[0, 0]))
    if likeliest == "lying":  # what lies as a rule lies flat, on either side
        roll_rad = _flattest_roll(vertices) + (np.pi if roll_rad > 0 else 0.0)
    R = rest_rotation(resting, roll_rad)
    R = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)) @ R
    turned = vertices @ R.T
    return resting, make_T(R, (0.0, 0.0, -turned[:, 2].min()))


def draw_stable_rest(mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    """A pose (4, 4), at any yaw, in which a solid rests on z = 0 and does not roll.

    A face of its hull is drawn by the angle that it takes up as seen from the centre of mass, about which a thing that
    is dropped at random falls on it.
    """
    vertices, centre = np.asarray(mesh.vertices), mesh.center_mass
    hull = ConvexHull(vertices)
    normals, depth = hull.equations[:, :3], -(hull.equations[:, :3] @ centre + hull.equations[:, 3])
    corners = vertices[hull.simplices]
    with np.errstate(divide="ignore", invalid="ignore"):  # needles, whose shares are no numbers
        foot = trimesh.triangles.points_to_barycentric(corners, centre + depth[:, None] * normals)
    doubled = np.linalg.norm(triangle_normals(corners), axis=1)
    odds = np.where((foot > -_ON_EDGE).all(axis=1), doubled / np.maximum(depth, 1e-9) ** 2, 0.0)
    face = int(rng.choice(len(odds), p=odds / odds.sum()))
    R = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)) @ rotation_between(normals[face], (0.0, 0.0, -1.0))
    return make_T(R, (0.0, 0.0, -float((vertices @ R[2]).min())))


def _flattest_roll(vertices: np.ndarray) -> float:
    """Turn, rad, about its own axis at which a lying object lies flat, on the side along which it spreads most."""
    _, axes = np.linalg.eigh(np.cov(vertices[:, :2].T))
    thin = axes[:, 0]
    return float(np.arctan2(-thin[1], thin[0]))  # the row of the lying rotation that gives the height looks along it
