"""Bringing the members of a class into one orientation: starts all over the rotations, then similarity ICP."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gfp_grasp.meshes import sample_surface
from gfp_grasp.primitives.frame import stand_up
from gfp_grasp.primitives.procrustes import Similarity, align
from gfp_grasp.primitives.template import choose_template

_UP = np.array([0.0, 0.0, 1.0])
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
