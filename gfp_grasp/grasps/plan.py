"""From a completed shape to ranked grasps: antipodal closing lines through its mesh, poses along them, their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.clearance import clearance_around, height_above, hidden_share
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.contact import Contacts, Graspable, Surface, find_contacts, load_ratio, obstacle_of, surface_of
from gfp_grasp.meshes import sample_surface
from gfp_grasp.parallel import one_thread
from gfp_grasp.types import Grasp, SupportPlane

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


# Load ratio above which more of it is worth little: with 30 N and a friction of 0.5 it is 9 N; ours.
_PLENTY = 0.3
# The first look at a pose takes this many points; most poses end there.
_COARSE_POINTS = 300
# Grasps closer than this to a better one are the same grasp: 8 mm, 15 degrees of closing axis, 25 of approach.
_SAME_M, _SAME_CLOSING, _SAME_APPROACH = 0.008, np.cos(np.deg2rad(15)), np.cos(np.deg2rad(25))


@one_thread()
def plan_grasps(
    completion: Graspable, num: int = 16, *, seed: int = 0, config: GraspConfig | None = None
) -> tuple[Grasp, ...]:
    """Antipodal grasps on a completed shape, best first.

    Closing lines are cast through the mesh; about each, the gripper comes from several directions, none from below the
    support. A grasp stays if the jaws take the width, both patches of contact lie within the friction cone, and the
    gripper, swept along its straight approach, meets neither the mesh, its convex parts, the support, what else was
    seen to stand about, nor what was seen of the object itself and not completed. Its quality is a product of factors
    between 0 and 1:

    - squareness: cosine between closing axis and contact normal, the worse side, from the edge of the cone to 1;
    - load: the load that the pads hold by friction and torque against gravity and a sway to any side, over the load
      that they hold of a weight that hangs between them (`contact.load_ratio`); from 0 to 1, but little more is gained
      above a few tenths, which is what most things weigh;
    - certainty: mean over both contact patches of 1 where the surface was observed, exp(-sigma / doubt_length_m) where
      it was not;
    - clearance: 1/2 to 1 as the gap around the gripper grows to good_sweep_clearance_m;
    - approach: 1 from straight above, side_preference on the level;
    - visibility: 1 with both jaws where the camera could see them, hidden_preference where the object hides them: a
      mug's back may have a handle, and its hollow may be less deep than it was completed;
    - depth: 1 with the closing line through the middle of the pads, tip_preference near their tips.

    Args:
        completion: Mesh, parts, what was observed, and its support; world frame.
        num: Grasps wanted, at most; near duplicates are left out.
        seed: Seed of all sampling; the same seed gives the same grasps.
        config: Limits and weights.

    Returns:
        Up to num grasps; none where nothing fits. Width is the opening of the jaws before they close.

    Raises:
        InvalidOption: num is not positive.
    """
    if num < 1:
        raise InvalidOption(f"num is {num}; a positive number of grasps is expected")
    config = config or GraspConfig()
    rng = np.random.default_rng(seed)
    support = _support_of(completion)
    start, end = cast_closing_lines(completion.mesh, support.normal, config=config, rng=rng)
    if len(start) == 0:
        return ()
    surface = surface_of(completion, config, rng)
    obstacle = obstacle_of(completion, surface, config, rng)
    poses = _Poses(*poses_about(start, end, support.normal, config=config))
    poses = poses.take(rng.permutation(len(poses.T))[: config.num_looks])
    poses = poses.take(_looks_free(poses, obstacle, support, config)[: config.num_poses])
    poses, contacts = _close_on(poses, surface, config)
    quality = _quality(poses, contacts, obstacle, completion, support, config)
    possible = np.flatnonzero(quality > 0)
    best_first = possible[np.argsort(-quality[possible], kind="stable")]
    opening = _opening(poses.width, config)
    return tuple(Grasp(poses.T[i], float(opening[i]), float(quality[i])) for i in _distinct(poses.T, best_first, num))


def bearable_weight(
    completion: Graspable,
    grasps: Sequence[Grasp],
    *,
    friction: float,
    grip_n: float,
    seed: int = 0,
    config: GraspConfig | None = None,
) -> np.ndarray:
    """Weight of a completed shape up to which its pads hold it by friction, for each grasp, (n,) N.

    It is 2 mu N times the load ratio of `plan_grasps`: what hangs beside the pads turns in them before it slips.

    Args:
        completion: Mesh and support; world frame.
        grasps: n grasps on it.
        friction: Coulomb coefficient mu between pads and object.
        grip_n: Force N of each jaw.
        seed: Seed of the surface's samples.
        config: Gripper and sway.

    Returns:
        The weights; NaN where the pads touch nothing.
    """
    if not grasps:
        return np.empty(0)
    config = config or GraspConfig()
    surface = surface_of(completion, config, np.random.default_rng(seed))
    T = np.stack([grasp.T_world_gripper for grasp in grasps])
    opening = np.array([grasp.width_m for grasp in grasps])
    contacts = find_contacts(
        T, opening, surface.points, surface.normals, surface.certainty, gripper=config.gripper, friction=friction
    )
    centre, up = _centre_of(completion.mesh), _support_of(completion).normal
    return 2.0 * friction * grip_n * load_ratio(T, contacts.levers_m, centre, up, friction=friction, sway=config.sway)


@dataclass(frozen=True, eq=False)
class _Poses:
    """T (p, 4, 4) in the world, width (p,) m between the surfaces, at_tip (p,) whether these are at the pads' tips."""

    T: np.ndarray
    width: np.ndarray
    at_tip: np.ndarray

    def take(self, which: np.ndarray) -> _Poses:
        return _Poses(self.T[which], self.width[which], self.at_tip[which])


def _support_of(completion: Graspable) -> SupportPlane:
    """The support that was seen, or one under the object's lowest point."""
    detection = completion.detection
    if detection.support is not None:
        return detection.support
    return SupportPlane(detection.up, float((completion.mesh.vertices @ detection.up).min()))


def _looks_free(poses: _Poses, obstacle: np.ndarray, support: SupportPlane, config: GraspConfig) -> np.ndarray:
    """Numbers of the poses that clear the support and a few points of the object."""
    opening, sweep = _opening(poses.width, config), {"gripper": config.gripper, "standoff_m": config.standoff_m}
    free = np.flatnonzero(height_above(poses.T, opening, support, **sweep) >= config.table_clearance_m)
    gap = clearance_around(poses.T[free], opening[free], obstacle[:_COARSE_POINTS], **sweep)
    return free[gap > 0]


def _close_on(poses: _Poses, surface: Surface, config: GraspConfig) -> tuple[_Poses, Contacts]:
    """Centre poses between the surfaces that the pads touch first, and keep those whose width the jaws take."""
    contacts = find_contacts(
        poses.T,
        _opening(poses.width, config),
        surface.points,
        surface.normals,
        surface.certainty,
        gripper=config.gripper,
        friction=config.friction,
    )
    width = contacts.high_m - contacts.low_m
    fits = np.isfinite(width) & (width <= config.max_width_m)
    contacts = contacts.take(fits)
    T = poses.T[fits].copy()
    T[:, :3, 3] += ((contacts.low_m + contacts.high_m) / 2)[:, None] * T[:, :3, 1]
    return _Poses(T, width[fits], poses.at_tip[fits]), contacts


def _quality(
    poses: _Poses,
    contacts: Contacts,
    obstacle: np.ndarray,
    completion: Graspable,
    support: SupportPlane,
    config: GraspConfig,
) -> np.ndarray:
    """The product that `plan_grasps` states, (p,); 0 where the grasp is not possible."""
    T, opening, up = poses.T, _opening(poses.width, config), support.normal
    sweep = {"gripper": config.gripper, "standoff_m": config.standoff_m}
    cone = 1.0 / np.hypot(1.0, config.friction)
    square = np.clip((contacts.squareness - cone) / (1.0 - cone), 0.0, 1.0)
    square[height_above(T, opening, support, **sweep) < config.table_clearance_m] = 0.0
    gap = np.zeros(len(T))
    gap[square > 0] = clearance_around(T[square > 0], opening[square > 0], obstacle, **sweep)
    free = gap > config.min_sweep_clearance_m
    clearance = np.where(free, 0.5 + 0.5 * np.clip(gap / config.good_sweep_clearance_m, 0.0, 1.0), 0.0)
    centre = _centre_of(completion.mesh)
    carried = load_ratio(T, contacts.levers_m, centre, up, friction=config.friction, sway=config.sway)
    steepness = np.clip(-T[:, :3, 2] @ up, 0.0, 1.0)
    approach = config.side_preference + (1.0 - config.side_preference) * steepness
    depth = np.where(poses.at_tip, config.tip_preference, 1.0)
    worth = carried * (1.0 + _PLENTY) / (carried + _PLENTY)
    quality = square * worth * contacts.certainty * clearance * approach * depth
    good = np.flatnonzero(quality > 0)
    quality[good] *= _visibility(T[good], opening[good], completion, config)
    return quality


def _centre_of(mesh: trimesh.Trimesh) -> np.ndarray:
    return mesh.center_mass if mesh.is_volume else mesh.centroid


def _visibility(T: np.ndarray, opening: np.ndarray, completion: Graspable, config: GraspConfig) -> np.ndarray:
    viewpoint = completion.detection.cloud.viewpoint
    if viewpoint is None or config.hidden_preference == 1:
        return np.ones(len(T))
    hidden = hidden_share(T, opening, completion.mesh, viewpoint, config.gripper)
    return 1.0 - (1.0 - config.hidden_preference) * hidden


def _opening(width: np.ndarray, config: GraspConfig) -> np.ndarray:
    """Jaw opening (p,) m before closing on widths (p,) m."""
    return np.minimum(width + 2 * config.jaw_clearance_m, config.gripper.stroke_m)


def _distinct(T: np.ndarray, best_first: np.ndarray, num: int) -> list[int]:
    """The first num indices that are not near duplicates of one before them."""
    chosen: list[int] = []
    for i in best_first:
        others = T[chosen]
        near = np.linalg.norm(others[:, :3, 3] - T[i, :3, 3], axis=1) < _SAME_M
        same_closing = np.abs(others[:, :3, 1] @ T[i, :3, 1]) > _SAME_CLOSING
        same_approach = others[:, :3, 2] @ T[i, :3, 2] > _SAME_APPROACH
        if not (near & same_closing & same_approach).any():
            chosen.append(int(i))
        if len(chosen) == num:
            break
    return chosen
