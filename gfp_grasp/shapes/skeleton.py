"""Closed meshes that bones bend: all members of a family bent from one mesh share its vertices and faces.

A bone is a tapered rod of elliptic section between two joints. What moves it is an affine map (3, 4), `[M | t]`; each
vertex follows the bones near it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from scipy import sparse

from gfp_grasp.meshes import crossing_faces, vertex_normals

_LEFT = np.array([0.0, 1.0, 0.0])
_AHEAD = np.array([1.0, 0.0, 0.0])
# Bones pull with this power of their nearness in radii: at an elbow the bend then spreads over about a diameter.
_POWER = 7.0


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
    radii: tuple[float, float]
    aspect: tuple[float, float] = (1.0, 1.0)

    @property
    def frame(self) -> np.ndarray:
        """Columns (3, 3): along, across and the third direction."""
        return _frame(np.subtract(self.end, self.start))

    @property
    def length_m(self) -> float:
        """From start to end."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

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
        """Map (3, 4) that takes the bone's ends to two places and scales its section by girth."""
        way = np.subtract(end, start)
        M = _frame(way) @ np.diag([np.linalg.norm(way) / self.length_m, *girth]) @ self.frame.T
        return np.column_stack([M, start - M @ self.start])


def carried(move: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3) m moved by a bone's map (3, 4)."""
    return np.asarray(points) @ move[:, :3].T + move[:, 3]


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A mesh and its bones.

    Attributes:
        bones: By name.
        vertices: (v, 3) m before bending.
        faces: (f, 3), closed.
        weights: (v, b), the share of each bone in each vertex; rows sum to one.
    """

    bones: Mapping[str, Bone]
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, mesh: trimesh.Trimesh, bones: Mapping[str, Bone]) -> Skeleton:
        """The skeleton of a closed mesh around its bones."""
        vertices = np.array(mesh.vertices)
        near = [off / radius for off, radius in (bone.nearness(vertices) for bone in bones.values())]
        pull = np.maximum(np.stack(near, axis=1), 0.05) ** -_POWER
        return cls(dict(bones), vertices, np.array(mesh.faces), pull / pull.sum(axis=1, keepdims=True))

    def bent(self, moves: Mapping[str, np.ndarray], *, vertices: np.ndarray | None = None) -> trimesh.Trimesh:
        """The mesh with each bone moved by its map (3, 4) (linear blend skinning).

        Args:
            moves: One for each bone.
            vertices: (v, 3) m, instead of the skeleton's own: bulges that the bones carry along.
        """
        vertices = self.vertices if vertices is None else vertices
        maps = np.stack([moves[name] for name in self.bones])
        blended = np.einsum("vb,bij->vij", self.weights, maps, optimize=True)
        places = np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]
        return trimesh.Trimesh(places, self.faces, process=False)


def first_clean(bend: Callable[[float], trimesh.Trimesh], *, tries: int = 9) -> trimesh.Trimesh:
    """The first mesh without crossing faces as `bend` gives way, from 0 (as wanted) to 1 (as safe as can be)."""
    for give in np.linspace(0, 1, tries):
        mesh = bend(float(give))
        if mesh.volume > 0 and len(crossing_faces(mesh.vertices, mesh.faces)) == 0:
            break
    return mesh


def grown(bones: Mapping[str, Bone], *, edge_m: float, fillet_m: float) -> trimesh.Trimesh:
    """Closed mesh of even edges around bones, their sections smoothly united.

    Args:
        bones: By name.
        edge_m: Length of its edges.
        fillet_m: Reach of the smooth union (negative log of the summed exp of distances).
    """

    def depth(points: np.ndarray) -> np.ndarray:
        apart = np.stack([off - radius for off, radius in (bone.nearness(points) for bone in bones.values())])
        nearest = apart.min(axis=0)
        return fillet_m * np.log(np.exp((nearest - apart) / fillet_m).sum(axis=0)) - nearest

    ends = np.array([end for bone in bones.values() for end in (bone.start, bone.end)])
    reach = 2.5 * max(max(bone.radii) for bone in bones.values())
    low, high = ends.min(axis=0) - reach, ends.max(axis=0) + reach
    mesh = _level(depth, [*low, *high], edge_m)
    vertices = _evened(np.array(mesh.vertices), mesh.faces, depth, edge_m)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def _frame(along: np.ndarray) -> np.ndarray:
    along = along / np.linalg.norm(along)
    reference = _LEFT if abs(along[1]) < 0.9 else _AHEAD
    across = reference - (reference @ along) * along
    across /= np.linalg.norm(across)
    return np.column_stack([along, across, np.cross(along, across)])


def _level(depth: Callable[[np.ndarray], np.ndarray], box: list[float], edge_m: float) -> trimesh.Trimesh:
    """Zero level of a field that is positive inside; asked for all points of the grid at once."""
    asked: list[tuple[float, float, float]] = []

    def listen(x: float, y: float, z: float) -> float:
        asked.append((x, y, z))
        return -1.0

    manifold3d.Manifold.level_set(listen, box, edge_m)
    known = dict(zip(asked, depth(np.array(asked)).tolist(), strict=True))
    raw = manifold3d.Manifold.level_set(lambda x, y, z: known[x, y, z], box, edge_m).to_mesh()
    return trimesh.Trimesh(
        np.asarray(raw.vert_properties, dtype=np.float64)[:, :3], np.asarray(raw.tri_verts).astype(np.int64)
    )


def _evened(vertices: np.ndarray, faces: np.ndarray, depth: Callable, edge_m: float) -> np.ndarray:
    """Vertices (v, 3) spread evenly over the zero level: each goes to the middle of its neighbours, and back to it."""
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    near = sparse.csr_matrix((np.ones(len(i)), (i, j)), shape=(len(vertices), len(vertices)))
    near = sparse.diags(1 / np.asarray(near.sum(axis=1)).ravel()) @ near
    for _ in range(8):
        normals = vertex_normals(vertices, faces)
        pull = near @ vertices - vertices
        vertices = vertices + 0.6 * (pull - (pull * normals).sum(axis=1, keepdims=True) * normals)
        step = 0.05 * edge_m
        slope = (depth(vertices + step * normals) - depth(vertices - step * normals)) / (2 * step)
        move = np.clip(-depth(vertices) / np.minimum(slope, -0.2), -0.3 * edge_m, 0.3 * edge_m)
        vertices = vertices + move[:, None] * normals
    return vertices
