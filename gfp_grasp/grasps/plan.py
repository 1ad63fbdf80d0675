"""From a completed shape to ranked grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.candidates import cast_closing_lines, poses_about
from gfp_grasp.grasps.clearance import clearance_around, height_above
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.contact import Contacts, find_contacts
from gfp_grasp.grasps.surface import Graspable, Surface, obstacle_of, surface_of
from gfp_grasp.grasps.visibility import hidden_share
from gfp_grasp.grasps.wrench import load_ratio
from gfp_grasp.parallel import one_thread
from gfp_grasp.types import Grasp, SupportPlane

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
    gripper, swept along its straight approach, meets neither the mesh, its convex parts, the support nor what else was
    seen to stand about. Its quality is a product of factors between 0 and 1:

    - squareness: cosine between closing axis and contact normal, the worse side, from the edge of the cone to 1;
    - load ratio: the load that the pads hold by friction and torque against gravity and a sway to any side, over the
      load that they hold of a weight that hangs between them (`wrench.load_ratio`);
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
    quality = square * carried * contacts.certainty * clearance * approach * depth
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
