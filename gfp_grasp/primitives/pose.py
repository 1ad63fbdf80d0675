"""The members of a class in one orientation, and the upright frame of the class.

Members are turned by starts all over the rotations, then similarity ICP. The frame has z up, the axis through
x = y = 0, the base at z = 0, and a handle or the wider side towards +x.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gfp_grasp.meshes import sample_surface, vertex_normals
from gfp_grasp.primitives.procrustes import Similarity, align, centroid_size, choose_template
from gfp_grasp.primitives.regions import enclosed
from gfp_grasp.primitives.surface import Surface
from gfp_grasp.transforms import rotation_about, rotation_between

_UP = np.array([0.0, 0.0, 1.0])
# A body whose surface moves by less than this share of its diagonal when turned is one of revolution, handle or not.
_ROUND = 0.035
# An opening shows this share of the vertices as inside.
_HOLLOW = 0.08
# A pose at rest whose up is within 35 degrees of the axis stands on that end of it.
_SAME_END = np.cos(np.radians(35.0))
_RESTS = 6  # likeliest poses at rest whose up may be the axis
# The base is what lies within this share of the height above the lowest point.
_BASE = 0.02
_MAX_SEAT_TURN = np.radians(10.0)


def stand_up(members: np.ndarray, mean: np.ndarray, faces: np.ndarray, *, upright: bool) -> np.ndarray:
    """Put corresponded members into the frame of their class.

    The axis is the one about which the mean is roundest, else the one on which it rests most surely; up is where a
    cavity opens, else away from the wider end.

    Args:
        members: (s, v, 3) m, turned onto each other.
        mean: (v, 3), their mean.
        faces: (f, 3).
        upright: Whether z is up already.

    Returns:
        (s, v, 3) m; each member rests on z = 0.
    """
    R = np.eye(3) if upright else _upright(mean, faces)
    mean = mean @ R.T
    body = _body(mean, faces)
    axis = _axis(mean, body)
    yaw = _facing(mean, axis, body, faces)
    R = rotation_about(_UP, -yaw) @ R
    axis = rotation_about(_UP, -yaw)[:2, :2] @ axis
    mean = mean @ rotation_about(_UP, -yaw).T
    members = members @ R.T
    if not upright:
        members = np.stack([_seated(member, mean, faces) for member in members])
    # The axis is where the body's centroid of the mean says; a member's own extremes would be noisier.
    offset = mean[body, :2].mean(axis=0) - axis
    members = members.copy()
    size = np.array([centroid_size(member) for member in members])[:, None] / centroid_size(mean)
    members[..., :2] -= (members[:, body, :2].mean(axis=1) - size * offset)[:, None]
    members[..., 2] -= members[..., 2].min(axis=1)[:, None]
    return members


def _upright(mean: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) that stands the mean up."""
    mesh = trimesh.Trimesh(mean, faces, process=False)
    rng = np.random.default_rng(0)
    surface = Surface(mesh, rng, count=3000)
    diagonal = float(np.linalg.norm(mesh.extents))
    centre = surface.points.mean(axis=0)
    rests = _resting_turns(mesh)
    # A handle tilts the axes of inertia, by any angle where the body is about as high as it is wide.
    inertia = np.linalg.eigh(np.cov((surface.points - centre).T))[1]
    axes = [*inertia.T, *(rest.T @ _UP for rest in rests[:_RESTS])]
    moved = [_turned_distance(surface, centre, axis) for axis in axes]
    axis = axes[int(np.argmin(moved))]
    if min(moved) > _ROUND * diagonal:
        return rests[0]
    choices = [rotation_between(sign * axis, _UP) for sign in (1.0, -1.0)]
    hollow = [enclosed(trimesh.Trimesh(mean @ R.T, faces, process=False)).mean() for R in choices]
    score = hollow if max(hollow) > _HOLLOW else [_base_area(mean @ R.T) for R in choices]
    R = choices[int(np.argmax(score))]
    near = [rest for rest in rests if (R.T @ _UP) @ (rest.T @ _UP) > _SAME_END]
    return rotation_between(R @ near[0].T @ _UP, _UP) @ R if near else R


def _resting_turns(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Rotations (3, 3) in which the mesh rests on a plane, the likeliest first."""
    poses, chances = trimesh.poses.compute_stable_poses(mesh.convex_hull)
    return [poses[i][:3, :3] for i in np.argsort(-chances)]


def _turned_distance(surface: Surface, centre: np.ndarray, axis: np.ndarray) -> float:
    R = rotation_about(axis, np.radians(67.0))
    points = (surface.points - centre) @ R.T + centre
    # The median: a handle, a spout or a label's edge is a small part of the whole.
    closest = surface.closest(points, surface.normals @ R.T, normal_weight_m=0.002)[0]
    return float(np.median(np.linalg.norm(closest - points, axis=1)))


def _base_area(points: np.ndarray) -> float:
    """Area of the box around what lies near the lowest point: wide for a base, small for a neck."""
    low = points[points[:, 2] < points[:, 2].min() + _BASE * np.ptp(points[:, 2])]
    return float(np.prod(np.ptp(low[:, :2], axis=0)))


def _body(mean: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(v,) bool: vertices that are not far off the robust circle around the upright mean, i.e. no handle."""
    if trimesh.Trimesh(mean, faces, process=False).euler_number > 0:
        return np.ones(len(mean), dtype=bool)
    centre, radius = _circle(mean[:, :2], vertex_normals(mean, faces))
    return np.linalg.norm(mean[:, :2] - centre, axis=1) < 1.12 * radius


def _circle(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (2,) and radius of the circle that most of the upright, outward facing points lie on."""
    side = np.abs(normals[:, 2]) < 0.5
    points, normals = points[side], normals[side, :2]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = 0.0
    for _ in range(30):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        outward = (offset * normals).sum(axis=1) > 0.7 * distance
        radius = float(np.median(distance[outward]))
        weight = outward / np.maximum(np.abs(distance - radius), 0.01 * radius)  # L1: the handle does not pull
        foot = points - radius * offset / np.maximum(distance, 1e-12)[:, None]
        centre = (weight[:, None] * foot).sum(axis=0) / weight.sum()
    return centre, radius


def _axis(mean: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Where the axis passes through the plane: the middle of the body's box, (2,)."""
    points = mean[body, :2]
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _facing(mean: np.ndarray, axis: np.ndarray, body: np.ndarray, faces: np.ndarray) -> float:
    """Yaw of the handle, or of the wider side where there is no handle."""
    if not body.all():
        x, y = mean[~body, :2].mean(axis=0) - axis
        return float(np.arctan2(y, x))
    values, vectors = np.linalg.eigh(np.cov((mean[:, :2] - axis).T))
    if values[0] > 0.95 * values[1]:  # round: any yaw will do, so none is best
        return 0.0
    x, y = vectors[:, 1] * np.sign(vectors[0, 1] or 1.0)
    return float(np.arctan2(y, x))


def _seated(member: np.ndarray, mean: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Turn a member by the few degrees that its base, known from the mean, is off level."""
    down = vertex_normals(mean, faces)[:, 2] < -0.7
    base = down & (mean[:, 2] < mean[:, 2].min() + _BASE * np.ptp(mean[:, 2]))
    if base.sum() < 8:
        return member
    points = member[base] - member[base].mean(axis=0)
    normal = np.linalg.svd(points, full_matrices=False)[2][2]
    R = rotation_between(normal * np.sign(normal[2] or 1.0), _UP)
    angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
    return member @ R.T if angle < _MAX_SEAT_TURN else member


# Shapes have unit size here; normals at this weight tell the two sides of a wall apart.
_NORMAL_WEIGHT = 0.4
# About 20 degrees apart: well inside the reach of ICP with normals.
_NUM_TURNS, _NUM_YAWS = 400, 16
_NUM_COARSE, _NUM_FINE = 150, 1200
_REFINED, _FINISHED = 12, 3


def bring_into_one_pose(
    members: Sequence[trimesh.Trimesh],
    orientation: str,
    rng: np.random.Generator,
    *,
    reference: trimesh.Trimesh | None = None,
) -> list[trimesh.Trimesh]:
    """Turn, shift and scale members onto one of them, which is stood upright.

    Args:
        members: Closed, any size.
        orientation: "placed" leaves them alone; "upright" turns about z only; "any" turns freely.
        rng: Draws samples, and chooses the member that the others are turned onto.
        reference: What they are turned onto instead: the mean of a class, in its frame.

    Returns:
        Turned and centred copies, each in its own size. Shapes that look alike in several poses end in one of them.
    """
    if orientation == "placed":
        return list(members)
    target = _Cloud(_standing(members, orientation, rng) if reference is None else reference, rng)
    turns = _yaw_turns() if orientation == "upright" else _all_turns()
    axis = _UP if orientation == "upright" else None
    posed = []
    for member in members:
        cloud = _Cloud(member, rng)
        move = _register(cloud, target, turns, axis)
        turned = member.copy()
        turned.vertices = (np.asarray(member.vertices) - cloud.centre) @ move.R.T + move.t * cloud.size
        posed.append(turned)
    return posed


def _standing(members: Sequence[trimesh.Trimesh], orientation: str, rng: np.random.Generator) -> trimesh.Trimesh:
    """The most central member, stood upright."""
    chosen = members[choose_template(members, rng)]
    vertices = np.asarray(chosen.vertices)
    standing = stand_up(vertices[None], vertices, chosen.faces, upright=orientation == "upright")[0]
    return trimesh.Trimesh(standing, chosen.faces, process=False)


class _Cloud:
    """Samples with normals, moved to the origin and scaled to unit size."""

    def __init__(self, mesh: trimesh.Trimesh, rng: np.random.Generator) -> None:
        points, self.normals, _ = sample_surface(mesh, _NUM_FINE, rng)
        self.centre = points.mean(axis=0)
        self.size = float(np.sqrt(((points - self.centre) ** 2).sum(axis=1).mean()))
        self.points = (points - self.centre) / self.size
        self.tree = KDTree(np.hstack([self.points, self.normals * _NORMAL_WEIGHT]))


def _register(source: _Cloud, target: _Cloud, turns: np.ndarray, axis: np.ndarray | None) -> Similarity:
    """The best similarity from source to target, judged by position and normal in both directions."""
    starts = [Similarity(1.0, R, np.zeros(3)) for R in turns]
    best = _best(((_cost(source, target, move, _NUM_COARSE), move) for move in starts), _REFINED)
    best = _best((_icp(source, target, move, axis, 10, 300) for move in best), _FINISHED)
    return _best((_icp(source, target, move, axis, 30, _NUM_FINE) for move in best), 1)[0]


def _best(scored: Iterable[tuple[float, Similarity]], count: int) -> list[Similarity]:
    return [move for _, move in sorted(scored, key=lambda pair: pair[0])[:count]]


def _icp(
    source: _Cloud, target: _Cloud, move: Similarity, axis: np.ndarray | None, iterations: int, count: int
) -> tuple[float, Similarity]:
    for _ in range(iterations):
        ahead, behind = _matches(source, target, move, count)
        move = align(
            np.concatenate([source.points[:count], source.points[behind]]),
            np.concatenate([target.points[ahead], target.points[:count]]),
            axis=axis,
        )
    return _cost(source, target, move, count), move


def _cost(source: _Cloud, target: _Cloud, move: Similarity, count: int) -> float:
    there = target.tree.query(_features(source, move, count))[0]
    back = source.tree.query(_features(target, _inverse(move), count))[0]
    return float(there.mean() + move.scale * back.mean())


def _matches(source: _Cloud, target: _Cloud, move: Similarity, count: int) -> tuple[np.ndarray, np.ndarray]:
    there = target.tree.query(_features(source, move, count))[1]
    back = source.tree.query(_features(target, _inverse(move), count))[1]
    return np.asarray(there), np.asarray(back)


def _features(cloud: _Cloud, move: Similarity, count: int) -> np.ndarray:
    return np.hstack([move.apply(cloud.points[:count]), cloud.normals[:count] @ move.R.T * _NORMAL_WEIGHT])


def _inverse(move: Similarity) -> Similarity:
    return Similarity(1 / move.scale, move.R.T, -move.R.T @ move.t / move.scale)


def _yaw_turns() -> np.ndarray:
    return Rotation.from_rotvec(np.arange(_NUM_YAWS)[:, None] * 2 * np.pi / _NUM_YAWS * _UP).as_matrix()


def _all_turns() -> np.ndarray:
    """Rotations (n, 3, 3) spread evenly over SO(3): super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(_NUM_TURNS) + 0.5
    t = s / _NUM_TURNS
    d = 2 * np.pi * s
    r, big = np.sqrt(t), np.sqrt(1 - t)
    quaternions = np.stack(
        [r * np.sin(d / phi), r * np.cos(d / phi), big * np.sin(d / psi), big * np.cos(d / psi)], axis=1
    )
    return Rotation.from_quat(quaternions).as_matrix()
