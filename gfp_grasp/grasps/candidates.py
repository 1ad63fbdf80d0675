"""Antipodal closing lines through a mesh, and the gripper poses that close along them."""

import numpy as np
import trimesh

from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.meshes import sample_surface

# Rays start this far below the surface so that they do not hit the face they leave; the thinnest walls are 1 mm.
_NUDGE_M = 2e-5
# Two walls closer than this are one sheet: nothing to pinch.
_MIN_WIDTH_M = 5e-4
# Closing lines are spread over cells of about a pad's size.
_CELL_M = 0.015


def cast_closing_lines(
    mesh: trimesh.Trimesh, up: np.ndarray, *, config: GraspConfig, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Lines along which two jaws could close, both normals within the friction cone.

    A ray is cast inwards from each sample, and every place where it leaves the solid again is an end: the far side of a
    wall (a pinch at a rim or a handle) as well as the far side of the whole object.

    Args:
        mesh: Closed, outward, metres.
        up: (3,) unit.
        config: Number of rays, friction and widths.
        rng: Draws the samples and the rays' tilt.

    Returns:
        Start and end, each (m, 3) m.
    """
    cos_cone = 1.0 / np.hypot(1.0, config.friction)
    points, normals, _ = sample_surface(mesh, config.num_rays, rng)
    directions = _inwards(normals, up, np.arctan(config.friction) / 2.0, rng)
    hits, ray, face = mesh.ray.intersects_location(points + _NUDGE_M * directions, directions, multiple_hits=True)
    if len(hits) == 0:
        return np.empty((0, 3)), np.empty((0, 3))
    order = np.lexsort((*hits.T, ray))  # the ray caster promises no order
    hits, ray, face = hits[order], ray[order], face[order]
    length = np.linalg.norm(hits - points[ray], axis=1)
    enters = np.einsum("ij,ij->i", normals[ray], directions[ray]) < -cos_cone
    leaves = np.einsum("ij,ij->i", mesh.face_normals[face], directions[ray]) > cos_cone
    keep = np.flatnonzero(enters & leaves & (length > _MIN_WIDTH_M) & (length <= config.max_width_m))
    middle = (points[ray[keep]] + hits[keep]) / 2.0
    keep = keep[_spread(np.column_stack([middle, length[keep]]), config.num_lines, rng)]
    return points[ray[keep]], hits[keep]


def poses_about(
    start: np.ndarray, end: np.ndarray, up: np.ndarray, *, config: GraspConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gripper poses on closing lines, two for each approach direction that does not come from below.

    Args:
        start: (m, 3) m.
        end: (m, 3) m.
        up: (3,) unit.
        config: Directions and the steepest climb.

    Returns:
        T_world_gripper (p, 4, 4), width (p,) m, and whether (p,) the line is near the tips of the pads.
    """
    width = np.linalg.norm(end - start, axis=1)
    y = (end - start) / width[:, None]
    steepest = _across(y, -up)
    level = np.cross(y, steepest)
    angles = 2 * np.pi * np.arange(config.num_directions) / config.num_directions
    z = np.cos(angles)[:, None] * steepest[:, None] + np.sin(angles)[:, None] * level[:, None]
    line, turn = np.nonzero(z @ up <= config.max_climb)
    z, y = z[line, turn], y[line]
    T = np.tile(np.eye(4), (len(line), 1, 1))
    T[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    T[:, :3, 3] = (start[line] + end[line]) / 2.0
    at_tip = T.copy()
    at_tip[:, :3, 3] -= config.tip_offset_m * z
    return np.concatenate([T, at_tip]), np.tile(width[line], 2), np.arange(2 * len(T)) >= len(T)


def _spread(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Indices of at most count points (n, 4) m, taken in turns from all cells that have points."""
    shuffled = rng.permutation(len(points))
    _, cell = np.unique(np.floor(points[shuffled] / _CELL_M).astype(np.int64), axis=0, return_inverse=True)
    by_cell = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[by_cell], prepend=-1))
    turn = np.arange(len(points)) - np.repeat(starts, np.diff(starts, append=len(points)))
    return shuffled[by_cell[np.argsort(turn, kind="stable")[:count]]]


def _inwards(normals: np.ndarray, up: np.ndarray, angle_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Unit directions (n, 3) into the surface: a third along the normal, a third tilted off it at random by up to an
    angle, a third level, as upright things with ribs and threads are best closed on."""
    directions = -normals
    tilted, level = np.arange(len(normals)) % 3 == 1, np.arange(len(normals)) % 3 == 2
    sideways = _across(directions[tilted], rng.normal(size=(int(tilted.sum()), 3)))
    directions[tilted] += np.tan(angle_rad * np.sqrt(rng.uniform(size=(len(sideways), 1)))) * sideways
    flattened = directions[level] - np.outer(directions[level] @ up, up)
    steep = np.linalg.norm(flattened, axis=1) < 0.5  # off the cone in any case
    directions[level] = np.where(steep[:, None], directions[level], flattened)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _across(axes: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) square to unit axes (n, 3), as near as can be to a direction (3,) or (n, 3)."""
    towards = np.broadcast_to(towards, axes.shape)
    across = towards - np.einsum("ij,ij->i", towards, axes)[:, None] * axes
    along = np.linalg.norm(across, axis=1) < 1e-6
    if along.any():  # any direction square to the axis will do
        other = np.eye(3)[np.argmin(np.abs(axes[along]), axis=1)]
        across[along] = other - np.einsum("ij,ij->i", other, axes[along])[:, None] * axes[along]
    return across / np.linalg.norm(across, axis=1, keepdims=True)
