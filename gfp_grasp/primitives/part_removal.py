"""The same body without a part: the vertices of the part go, and triangles close the holes that it leaves."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.errors import BuildFailed
from gfp_grasp.meshes import crossing_faces

_MAX_GROWTH = 5


def without_part(vertices: np.ndarray, faces: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a part off.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), closed.
        part: (v,) bool, the vertices of the part.

    Returns:
        Index of the vertices that stay (w,), and the faces (g, 3) over them: watertight, outward, without crossings.

    Raises:
        BuildFailed: No cut near the part leaves simple holes that triangles close cleanly.
    """
    for _ in range(_MAX_GROWTH + 1):
        faces_left = faces[~part[faces].any(axis=1)]
        loops = _loops(faces_left)
        if loops is not None:
            body = np.vstack([faces_left, *[_fill(vertices, loop) for loop in loops]])
            kept, inverse = np.unique(body, return_inverse=True)
            body = inverse.reshape(-1, 3)
            mesh = trimesh.Trimesh(vertices[kept], body, process=False)
            if mesh.is_volume and mesh.body_count == 1 and not len(crossing_faces(vertices[kept], body)):
                return kept, body
        part = part.copy()
        part[faces[part[faces].any(axis=1)]] = True  # one ring wider, and again
    raise BuildFailed("the part cannot be cut off cleanly: on the mean mesh it is attached too near to the rim or base")


def _loops(faces: np.ndarray) -> list[list[int]] | None:
    """Boundary loops, each in the order in which its edges run in the faces; None where loops touch."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = set(map(tuple, sides.tolist()))
    free = [(a, b) for a, b in there if (b, a) not in there]
    following = dict(free)
    if len(following) != len(free):
        return None
    loops = []
    while following:
        start, vertex = following.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            vertex = following.pop(vertex)
        loops.append(loop)
    return sorted(loops)


def _fill(vertices: np.ndarray, loop: list[int]) -> np.ndarray:
    """Triangles (n - 2, 3) of least area over a loop (Barequet and Sharir, CAGD 12, 1995), outward."""
    loop = loop[::-1]  # a hole is closed against the sense of its faces
    points = vertices[loop]
    count = len(loop)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), dtype=int)
    for span in range(2, count):
        for i in range(count - span):
            k = i + span
            j = np.arange(i + 1, k)
            area = np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, j] + cost[j, k] + area
            best = int(total.argmin())
            cost[i, k], middle[i, k] = total[best], j[best]
    triangles, open_spans = [], [(0, count - 1)]
    while open_spans:
        i, k = open_spans.pop()
        if k - i < 2:
            continue
        j = int(middle[i, k])
        triangles.append((loop[i], loop[j], loop[k]))
        open_spans += [(i, j), (j, k)]
    return np.array(triangles, dtype=np.int64)
