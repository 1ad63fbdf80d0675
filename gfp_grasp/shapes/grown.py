"""Closed meshes of even edges, grown around bones."""

from __future__ import annotations

from collections.abc import Callable

import manifold3d
import numpy as np
import trimesh

from gfp_grasp.meshes import neighbour_average, vertex_normals
from gfp_grasp.shapes.bones import Bones

_EVENING_ROUNDS = 8


def grown(bones: Bones, *, edge_m: float, fillet_m: float) -> trimesh.Trimesh:
    """Closed mesh of even edges around bones, their sections smoothly united.

    Args:
        bones: By name.
        edge_m: Length of the mesh's edges.
        fillet_m: Reach of the smooth union (negative log of the summed exp of distances).
    """

    def depth(points: np.ndarray) -> np.ndarray:
        apart = np.stack([off - radius for off, radius in (bone.nearness(points) for bone in bones.values())])
        nearest = apart.min(axis=0)
        return fillet_m * np.log(np.exp((nearest - apart) / fillet_m).sum(axis=0)) - nearest

    corners = np.concatenate([bone.corners() for bone in bones.values()])
    low, high = corners.min(axis=0) - edge_m, corners.max(axis=0) + edge_m
    mesh = _level(depth, [*low, *high], edge_m)
    vertices = _evened(np.array(mesh.vertices), mesh.faces, depth, edge_m)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


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
    mean = neighbour_average(faces, len(vertices))
    for _ in range(_EVENING_ROUNDS):
        normals = vertex_normals(vertices, faces)
        pull = mean @ vertices - vertices
        vertices = vertices + 0.6 * (pull - (pull * normals).sum(axis=1, keepdims=True) * normals)
        step = 0.05 * edge_m
        slope = (depth(vertices + step * normals) - depth(vertices - step * normals)) / (2 * step)
        move = np.clip(-depth(vertices) / np.minimum(slope, -0.2), -0.3 * edge_m, 0.3 * edge_m)
        vertices = vertices + move[:, None] * normals
    return vertices
