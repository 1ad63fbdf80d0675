"""Far fewer faces for the same surface, within a bound: scans have millions, and most of them describe noise."""

from __future__ import annotations

import fast_simplification
import manifold3d
import numpy as np
import trimesh

from gfp_grasp.meshes.surface import neighbour_average

MOST_FACES = 100_000
# Shares of the diagonal: what the surface may move by in all, what evening out the noise may move a vertex by, and the
# tolerance with which vertices are left out, which the result exceeds by little.
MOST_MOVED, _EVENED, _THINNED = 0.002, 0.0005, 0.0005
_NUM_EVENINGS = 6  # fewer leave faces that the noise has folded over; more round off edges
_OPEN_FACES = 50_000  # of a mesh that is not closed


def simplified(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with far fewer faces.

    Noise is evened out first, without which the faces would fold over. Where the mesh is closed it stays closed, and
    its surface moves by about 1/1000 of its diagonal; else it is thinned to 50 000 faces by quadric errors (Garland and
    Heckbert, 1997).

    Args:
        mesh: Vertices joined, faces oriented alike.
    """
    vertices, faces = np.array(mesh.vertices, dtype=np.float64, order="C"), np.asarray(mesh.faces)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    vertices = _evened(vertices, faces, _EVENED * diagonal)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, faces.astype(np.uint64, order="C")))
    if solid.status() == manifold3d.Error.NoError and not solid.is_empty():
        raw = solid.simplify(_THINNED * diagonal).to_mesh64()
        return trimesh.Trimesh(
            np.asarray(raw.vert_properties)[:, :3], np.asarray(raw.tri_verts).astype(np.int64), process=False
        )
    middle = vertices.mean(axis=0)  # float32 is finest there
    thin, corners, *_ = fast_simplification.simplify(
        (vertices - middle).astype(np.float32), faces.astype(np.int32), target_count=min(_OPEN_FACES, len(faces) - 1)
    )
    return trimesh.Trimesh(thin.astype(np.float64) + middle, corners.astype(np.int64), process=False)


def _evened(vertices: np.ndarray, faces: np.ndarray, most_m: float) -> np.ndarray:
    """Vertices nearer to the middle of their neighbours, each moved by at most `most_m`."""
    average = neighbour_average(faces, len(vertices))
    even = vertices
    for _ in range(_NUM_EVENINGS):
        even = (even + average @ even) / 2
    moved = even - vertices
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return vertices + moved * np.minimum(1.0, most_m / np.maximum(length, most_m))
