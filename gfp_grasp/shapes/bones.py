"""Bones, from which meshes are made and by which they are bent: tapered rods, tyres, and tubes along rods.

What moves a bone is an affine map (3, 4), `[M | t]`; a tyre has one for each point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import ring_faces
from gfp_grasp.transforms import rotation_about

SIDES = {"left": 1.0, "right": -1.0}  # the sign of y on each side

_LEFT = np.array([0.0, 1.0, 0.0])
_AHEAD = np.array([1.0, 0.0, 0.0])
_AROUND_TYRE = 10  # vertices of a section of a tyre
_STEP_M = 0.06  # rings of a pipe are at most so far apart, so that it can bend

Bones = Mapping[str, Any]  # each a Bone or a Ring


@dataclass(frozen=True, eq=False)
class Bone:
    """A rod of the mesh before it is bent.

    Attributes:
        start: (3,) m.
        end: (3,) m.
        radii: m at start and end.
        aspect: Half-widths of the section across (as near +y as can be) and in the third direction, in radii.
    """

    start: np.ndarray
    end: np.ndarray
    radii: Sequence[float]
    aspect: tuple[float, float] = (1.0, 1.0)

    @property
    def frame(self) -> np.ndarray:
        """Columns (3, 3): along, across and the third direction."""
        return _frame(np.subtract(self.end, self.start))

    @property
    def length_m(self) -> float:
        """Distance from start to end, m."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def corners(self) -> np.ndarray:
        """(4, 3) m, corners of two cubes that together with what is between them hold the bone."""
        return np.concatenate([
            end + radius * max(self.aspect) * np.array([[-1.0], [1.0]])
            for end, radius in zip((self.start, self.end), self.radii, strict=True)
        ])  # fmt: skip

    def nearness(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 3) are from the axis, measured in sections' units of m, and the radius (n,) m there."""
        along, across, third = ((points - self.start) @ self.frame).T
        t = np.clip(along / self.length_m, 0, 1)
        off = np.sqrt((along - t * self.length_m) ** 2 + (across / self.aspect[0]) ** 2 + (third / self.aspect[1]) ** 2)
        return off, self.radii[0] + t * (self.radii[1] - self.radii[0])

    def turned(self, R: np.ndarray, scale: Sequence[float], at: np.ndarray) -> np.ndarray:
        """Map (3, 4) that scales along, across and in the third direction, turns by R and takes the start to `at`."""
        M = R @ self.frame @ np.diag(scale) @ self.frame.T
        return np.column_stack([M, at - M @ self.start])

    def between(self, start: np.ndarray, end: np.ndarray, girth: Sequence[float] = (1.0, 1.0)) -> np.ndarray:
        """Map (3, 4) that takes the bone's ends to two places, without a twist, and scales its section by girth."""
        way = np.subtract(end, start)
        R = _turn(self.frame[:, 0], way)
        return self.turned(R, (float(np.linalg.norm(way)) / self.length_m, *girth), start)


@dataclass(frozen=True, eq=False)
class Ring:
    """A tyre around an axle along y, before it is bent; a bone like others.

    Attributes:
        start: Middle of the ring, (3,) m.
        radius_m: Distance from there to the middle of the tyre.
        tyre_m: Half the tyre's thickness.
    """

    start: np.ndarray
    radius_m: float
    tyre_m: float

    def corners(self) -> np.ndarray:
        """(2, 3) m, opposite corners of a box that holds the ring."""
        outer = self.radius_m + self.tyre_m
        return self.start + np.array([[-1.0], [1.0]]) * [outer, self.tyre_m, outer]

    def nearness(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points (n, 3) are from the middle of the tyre, m, and its thickness (n,) m there."""
        x, y, z = (points - self.start).T
        return np.hypot(np.hypot(x, z) - self.radius_m, y), np.full(len(points), self.tyre_m)

    def moved(self, points: np.ndarray, R: np.ndarray, at: np.ndarray, *, radius_m: float, tyre_m: float) -> np.ndarray:
        """Maps (n, 3, 4) of points (n, 3) that make it a ring of other measures, turned by R, its middle at `at`."""
        out = (points - self.start) * [1, 0, 1]
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        across = np.broadcast_to([0.0, 1.0, 0.0], out.shape)
        ahead = np.cross(across, out)
        thick, around = tyre_m / self.tyre_m, radius_m / self.radius_m
        frame = np.stack([out, across, ahead], axis=2)
        M = R @ (frame * [thick, thick, around]) @ frame.transpose(0, 2, 1)
        middle = np.einsum("nij,nj->ni", M, self.start + self.radius_m * out)
        return np.concatenate([M, (at + radius_m * out @ R.T - middle)[:, :, None]], axis=2)

    def mesh(self, *, around: int = 44) -> trimesh.Trimesh:
        """The tyre as a closed mesh with `around` sections."""
        turn, side = np.meshgrid(np.arange(around) / around, np.arange(_AROUND_TYRE) / _AROUND_TYRE, indexing="ij")
        turn, side = 2 * np.pi * turn, 2 * np.pi * side
        reach = self.radius_m + self.tyre_m * np.cos(side)
        places = [reach * np.cos(turn), self.tyre_m * np.sin(side), reach * np.sin(turn)]
        here = np.arange(around * _AROUND_TYRE).reshape(around, _AROUND_TYRE)
        ahead, up = np.roll(here, -1, axis=0), np.roll(here, -1, axis=1)
        both = np.roll(ahead, -1, axis=1)
        faces = np.concatenate([np.stack([here, ahead, both], 2), np.stack([here, both, up], 2)]).reshape(-1, 3)
        mesh = trimesh.Trimesh(self.start + np.stack(places, axis=2).reshape(-1, 3), faces, process=False)
        if mesh.volume < 0:
            mesh.invert()
        return mesh


def pipe(bones: Sequence[Bone], *, segments: int = 8) -> trimesh.Trimesh:
    """Closed tube along bones that follow each other, with flat ends and a ring in each joint, halving its angle."""
    ends = np.array([*(bone.start for bone in bones), bones[-1].end])
    ways = np.diff(ends, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    halves = np.concatenate([ways[:1], ways[:-1] + ways[1:], ways[-1:]])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    angles = np.arange(segments)[:, None] * 2 * np.pi / segments
    across, third = (bones[0].frame[:, i] * bones[0].aspect[i - 1] for i in (1, 2))
    section, rings = np.cos(angles) * across + np.sin(angles) * third, []
    for i, bone in enumerate(bones):
        if i > 0:
            section = section @ _turn(ways[i - 1], ways[i]).T
        for t in np.linspace(0, 1, 2 + int(bone.length_m / _STEP_M))[min(i, 1) :]:
            ring = (bone.radii[0] + t * (bone.radii[1] - bone.radii[0])) * section
            half = halves[i + 1] if t == 1 else halves[i] if t == 0 else ways[i]
            along = -(ring @ half) / (ways[i] @ half)  # slides the ring's vertices along the tube into its plane
            rings.append(bone.start + t * np.subtract(bone.end, bone.start) + ring + along[:, None] * ways[i])
    vertices = np.concatenate([ends[:1], *rings, ends[-1:]])
    return trimesh.Trimesh(vertices, ring_faces(len(rings), segments), process=False)


def carried(move: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) m moved by a bone's map (3, 4)."""
    return np.asarray(points) @ move[:, :3].T + move[:, 3]


def _turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) from one direction to another."""
    axis = np.cross(before, after)
    angle = float(np.arctan2(np.linalg.norm(axis), before @ after))
    return rotation_about(axis, angle) if angle > 1e-9 else np.eye(3)


def _frame(along: np.ndarray) -> np.ndarray:
    """Columns (3, 3): a direction, the one across it that is nearest to +y (+x along y), and the third direction."""
    along = along / np.linalg.norm(along)
    reference = _LEFT if abs(along[1]) < 0.9 else _AHEAD
    across = reference - (reference @ along) * along
    across /= np.linalg.norm(across)
    return np.column_stack([along, across, np.cross(along, across)])
