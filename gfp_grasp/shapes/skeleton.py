"""Closed meshes that bones bend: all members of a family bent from one mesh share its vertices and faces.

Each vertex follows the bones near it (linear blend skinning).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse.linalg import splu

from gfp_grasp.meshes import crossing_faces
from gfp_grasp.shapes.bones import Bones

# Bones pull with this power of their nearness in radii: at an elbow the bend then spreads over about a diameter.
_POWER = 7.0
# Vertices at a crossing give way this many times before the whole has to.
_MENDING_ROUNDS = 5
# Mending goes on while it leaves less than this share of the crossings.
_WORTH_MENDING = 0.8
# A member gives way in so many steps, counting the first one, which gives nothing.
_TRIES = 6


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A mesh and its bones.

    Attributes:
        bones: By name.
        vertices: (v, 3) m before bending.
        faces: (f, 3), closed.
        weights: (v, b), the share of each bone in each vertex; rows sum to one.
    """

    bones: Bones
    vertices: np.ndarray
    faces: np.ndarray
    weights: np.ndarray

    @classmethod
    def of(cls, mesh: trimesh.Trimesh, bones: Bones, *, spread_m: float = 0.0) -> Skeleton:
        """The skeleton of a closed mesh around its bones.

        Args:
            mesh: Closed.
            bones: By name.
            spread_m: Weights spread along edges about as far, so that slivers of a union move as one.
        """
        vertices = np.array(mesh.vertices)
        near = [off / radius for off, radius in (bone.nearness(vertices) for bone in bones.values())]
        pull = np.maximum(np.stack(near, axis=1), 0.05) ** -_POWER
        weights = pull / pull.sum(axis=1, keepdims=True)
        if spread_m > 0:
            near = _near(vertices, np.array(mesh.faces), spread_m)
            own = 1 + np.asarray(near.sum(axis=1)).ravel()
            weights = splu((sparse.diags(own) - near).tocsc()).solve(weights)
        return cls(dict(bones), vertices, np.array(mesh.faces), weights)

    def bent(self, moves: Mapping[str, np.ndarray], *, vertices: np.ndarray | None = None) -> trimesh.Trimesh:
        """The mesh with each bone moved by its map (linear blend skinning).

        Args:
            moves: (3, 4) for each bone, or (v, 3, 4): one for each vertex.
            vertices: (v, 3) m, instead of the skeleton's own: bulges that the bones carry along.
        """
        vertices = self.vertices if vertices is None else vertices
        return trimesh.Trimesh(_through(self._blended(moves), vertices), self.faces, process=False)

    def mended(self, moves: Mapping[str, np.ndarray]) -> trimesh.Trimesh:
        """The bent mesh; where its faces cross, neighbours move ever more as one."""
        maps = self._blended(moves)
        near = _near(self.vertices, self.faces, 1.0)
        near = sparse.diags(1 / np.asarray(near.sum(axis=1)).ravel()) @ near
        crossing, fewest = np.zeros(len(self.vertices), dtype=bool), np.inf
        for _ in range(_MENDING_ROUNDS):
            places = _through(maps, self.vertices)
            pairs = crossing_faces(places, self.faces)
            if len(pairs) == 0 or len(pairs) > _WORTH_MENDING * fewest:
                break
            fewest = len(pairs)
            crossing[self.faces[pairs.ravel()]] = True
            for _ in range(2):
                maps[crossing] = (near[crossing] @ maps.reshape(-1, 12)).reshape(-1, 3, 4)
        return trimesh.Trimesh(_through(maps, self.vertices), self.faces, process=False)

    def _blended(self, moves: Mapping[str, np.ndarray]) -> np.ndarray:
        """Map (v, 3, 4) of each vertex."""
        same = [i for i, name in enumerate(self.bones) if moves[name].ndim == 2]
        maps = np.stack([moves[name] for name in self.bones if moves[name].ndim == 2])
        blended = np.einsum("vb,bij->vij", self.weights[:, same], maps, optimize=True)
        for i, name in enumerate(self.bones):
            if moves[name].ndim == 3:
                blended += self.weights[:, i, None, None] * moves[name]
        return blended


def _near(vertices: np.ndarray, faces: np.ndarray, reach_m: float) -> sparse.csr_matrix:
    """Nearness (v, v) of vertices that share an edge: (reach_m over its length) squared."""
    i, j = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    length = np.maximum(np.linalg.norm(vertices[i] - vertices[j], axis=1), 1e-4)
    return sparse.csr_matrix(((reach_m / length) ** 2, (i, j)), shape=2 * (len(vertices),))


def _through(maps: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 3), each moved by its own map (n, 3, 4)."""
    return np.einsum("vij,vj->vi", maps[:, :, :3], points) + maps[:, :, 3]


def first_clean(bend: Callable[[float], trimesh.Trimesh]) -> trimesh.Trimesh:
    """The first mesh without crossing faces as `bend` gives way, from 0 (as wanted) to 1 (as safe as can be)."""
    for give in np.linspace(0, 1, _TRIES):
        mesh = bend(float(give))
        if mesh.volume > 0 and len(crossing_faces(mesh.vertices, mesh.faces)) == 0:
            break
    return mesh
