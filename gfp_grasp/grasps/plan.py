"""From a completed shape to ranked grasps."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.camera import cloud_of
from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.candidates import cast_closing_lines, poses_about
from gfp_grasp.grasps.clearance import height_above, room_around
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.contact import Contacts, find_contacts
from gfp_grasp.grasps.sight import hidden_share
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import Detection, Grasp, SupportPlane

# The first look at a pose takes this many points; most poses end there.
_COARSE_POINTS = 300
_REACH_M = 0.35  # neighbours farther from the object than this are out of the gripper's way
# Grasps closer than this to a better one are the same grasp: 8 mm, 15 degrees of closing axis, 25 of approach.
_SAME_M, _SAME_CLOSING, _SAME_APPROACH = 0.008, np.cos(np.deg2rad(15)), np.cos(np.deg2rad(25))


class Graspable(Protocol):
    """What the planner looks at; `Completion` is one."""

    @property
    def mesh(self) -> trimesh.Trimesh: ...
    @property
    def parts(self) -> tuple[trimesh.Trimesh, ...]: ...
    @property
    def observed(self) -> np.ndarray: ...
    @property
    def sigma_m(self) -> np.ndarray: ...
    @property
    def detection(self) -> Detection: ...


def plan_grasps(
    completion: Graspable, num: int = 16, *, seed: int = 0, config: GraspConfig | None = None
) -> tuple[Grasp, ...]:
    """Antipodal grasps on a completed shape, best first.

    Closing lines are cast through the mesh; about each, the gripper comes from several directions, none from below the
    support. A grasp stays if the jaws take the width, both patches of contact lie within the friction cone, and the
    gripper, swept along its straight approach, meets neither the mesh, its convex parts, the support nor what else was
    seen to stand about. Its quality
    is a product of factors between 0 and 1:

    - squareness: cosine between closing axis and contact normal, the worse side, from the edge of the cone to 1;
    - balance: exp(-d / balance_length_m), d the distance from the grasp to the centre of mass, of whose part along up
      only the share upright_lever counts: gravity has no lever there, shaking has;
    - realness: mean over the contact patch of 1 where the surface was observed, exp(-sigma / doubt_length_m) elsewhere;
    - room: 1/2 to 1 as the gap around the gripper grows to good_clearance_m;
    - approach: 1 from straight above, side_preference on the level;
    - seat: shortest lever against turning over good_lever_m, at most 1; a round lip between the pads lets a cup swing;
    - sight: 1 with both jaws where the camera could see them, hidden_preference where the object hides them, but for
      its own hollow; the back of a mug may have a handle;
    - depth: 1 with the closing line through the middle of the pads, tip_preference near their tips.

    Args:
        completion: Mesh, parts, what was observed, and its support; world frame.
        num: Grasps wanted, at most; near duplicates are left out.
        seed: Of all sampling; the same seed gives the same grasps.
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
    surface = _sample(completion, config, rng)
    T, width, at_tip = poses_about(start, end, support.normal, config=config)
    T, width, at_tip = _take(rng.permutation(len(T))[: config.num_looks], T, width, at_tip)
    free = np.flatnonzero(_looks_free(T, width, surface, support, config))
    T, width, at_tip = _take(free[: config.num_poses], T, width, at_tip)
    T, width, at_tip, contacts = _close_on(T, width, at_tip, surface, config)
    opening = _opening(width, config)
    quality = _quality(T, opening, contacts, surface, support, config)
    quality *= np.where(at_tip, config.tip_preference, 1.0)
    quality *= _sight(T, opening, completion, config)
    good = np.flatnonzero(quality > 0)
    best_first = good[np.argsort(-quality[good], kind="stable")]
    chosen = _distinct(T, best_first, num)
    return tuple(Grasp(T[i], float(opening[i]), float(quality[i])) for i in chosen)


@dataclass(frozen=True, eq=False)
class _Surface:
    """points (n, 3) and normals (n, 3) of the mesh, odds (n,) of being real, obstacle (k, 3) of mesh and parts."""

    points: np.ndarray
    normals: np.ndarray
    odds: np.ndarray
    obstacle: np.ndarray
    centre: np.ndarray


def _support_of(completion: Graspable) -> SupportPlane:
    """The support that was seen, or one under the object's lowest point."""
    detection = completion.detection
    if detection.support is not None:
        return detection.support
    return SupportPlane(detection.up, float((completion.mesh.vertices @ detection.up).min()))


def _sample(completion: Graspable, config: GraspConfig, rng: np.random.Generator) -> _Surface:
    mesh = completion.mesh
    points, normals, face = sample_surface(mesh, config.num_points, rng)
    odds_vertex = np.where(completion.observed, 1.0, np.exp(-completion.sigma_m / config.doubt_length_m))
    odds = odds_vertex[mesh.faces[face]].mean(axis=1)
    parts = completion.parts
    areas = np.array([part.area for part in parts])
    counts = np.ceil(config.num_points / 2 * areas / areas.sum()).astype(int) if len(parts) else []
    of_parts = [sample_surface(part, int(n), rng)[0] for part, n in zip(parts, counts, strict=True)]
    corners = [np.asarray(part.vertices) for part in parts]
    corners.append(_neighbours(completion.detection, config))
    centre = mesh.center_mass if mesh.is_volume else points.mean(axis=0)
    return _Surface(points, normals, odds, rng.permutation(np.concatenate([points, *of_parts, *corners])), centre)


def _neighbours(detection: Detection, config: GraspConfig) -> np.ndarray:
    """Points (n, 3) m of what else stands about: off the support, and off the object."""
    view, support = detection.view, detection.support
    if view is None or support is None:
        return np.empty((0, 3))
    points = cloud_of(view, None if detection.mask is None else ~detection.mask).points
    points = points[support.distances(points) > config.neighbour_gap_m]
    own = np.asarray(detection.cloud.points)
    points = points[np.linalg.norm(points - own.mean(axis=0), axis=1) < _REACH_M]
    if not len(points):
        return points
    apart = KDTree(own).query(points, distance_upper_bound=config.neighbour_gap_m)[0]
    return points[np.isinf(apart)]


def _looks_free(
    T: np.ndarray, width: np.ndarray, surface: _Surface, support: SupportPlane, config: GraspConfig
) -> np.ndarray:
    """Which poses (p,) clear the support and a few points of the object."""
    opening, sweep = _opening(width, config), {"gripper": config.gripper, "standoff_m": config.standoff_m}
    free = height_above(T, opening, support, **sweep) >= config.table_clearance_m
    free[free] = room_around(T[free], opening[free], surface.obstacle[:_COARSE_POINTS], **sweep) > 0
    return free


def _close_on(
    T: np.ndarray, width: np.ndarray, at_tip: np.ndarray, surface: _Surface, config: GraspConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Contacts]:
    """Centre poses between the surfaces that the pads touch first, and keep those whose width the jaws take."""
    opening = _opening(width, config)
    contacts = find_contacts(
        T,
        opening,
        surface.points,
        surface.normals,
        surface.odds,
        gripper=config.gripper,
        friction=config.friction,
    )
    width = contacts.high_m - contacts.low_m
    fits = np.isfinite(width) & (width <= config.max_width_m)
    T, width, at_tip = _take(fits, T.copy(), width, at_tip)
    contacts = Contacts(*_take(fits, *vars(contacts).values()))
    T[:, :3, 3] += ((contacts.low_m + contacts.high_m) / 2)[:, None] * T[:, :3, 1]
    return T, width, at_tip, contacts


def _quality(
    T: np.ndarray,
    opening: np.ndarray,
    contacts: Contacts,
    surface: _Surface,
    support: SupportPlane,
    config: GraspConfig,
) -> np.ndarray:
    """The product that `plan_grasps` states, (p,); 0 where the grasp is not possible."""
    sweep = {"gripper": config.gripper, "standoff_m": config.standoff_m}
    cone = 1.0 / np.hypot(1.0, config.friction)
    square = np.clip((contacts.squareness - cone) / (1.0 - cone), 0.0, 1.0)
    square[height_above(T, opening, support, **sweep) < config.table_clearance_m] = 0.0
    room = np.zeros(len(T))
    room[square > 0] = room_around(T[square > 0], opening[square > 0], surface.obstacle, **sweep)
    away = surface.centre - T[:, :3, 3]
    upright = (away @ support.normal)[:, None] * support.normal
    lever = np.linalg.norm(away - (1.0 - config.upright_lever) * upright, axis=1)
    balance = np.exp(-lever / config.balance_length_m)
    steepness = np.clip(-T[:, :3, 2] @ support.normal, 0.0, 1.0)
    approach = config.side_preference + (1.0 - config.side_preference) * steepness
    roominess = np.where(room > config.least_room_m, 0.5 + 0.5 * np.clip(room / config.good_clearance_m, 0.0, 1.0), 0.0)
    seat = np.clip(contacts.lever_m / config.good_lever_m, 0.0, 1.0)
    return square * balance * contacts.realness * roominess * approach * seat


def _sight(T: np.ndarray, opening: np.ndarray, completion: Graspable, config: GraspConfig) -> np.ndarray:
    viewpoint = completion.detection.cloud.viewpoint
    if viewpoint is None:
        return np.ones(len(T))
    hidden = hidden_share(T, opening, completion.mesh, viewpoint, config.gripper)
    return 1.0 - (1.0 - config.hidden_preference) * hidden


def _opening(width: np.ndarray, config: GraspConfig) -> np.ndarray:
    """Jaw opening (p,) m before closing on widths (p,) m."""
    return np.minimum(width + 2 * config.jaw_clearance_m, config.gripper.stroke_m)


def _take(which: np.ndarray, *arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(array[which] for array in arrays)


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
