"""What the surroundings of a point look like: the axes of its neighbourhood, and the normal among them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree


def local_axes(cloud: np.ndarray, at: np.ndarray, *, num_neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """Principal axes of the nearest points of a cloud.

    Args:
        cloud: (n, 3) m.
        at: (m, 3) m, where to look.
        num_neighbours: Points of a neighbourhood; all of them where the cloud has fewer.

    Returns:
        Sums of squares (m, 3) m^2 along the axes, smallest first, about the neighbourhood's mean; and the axes
        (m, 3, 3) as columns, of which the first is the normal of a flat neighbourhood.
    """
    neighbours = cloud[KDTree(cloud).query(at, k=min(num_neighbours, len(cloud)))[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))


def estimate_normals(
    cloud: np.ndarray, at: np.ndarray, viewpoint: np.ndarray | None, *, num_neighbours: int = 16
) -> np.ndarray:
    """Unit normals of a cloud.

    Args:
        cloud: (n, 3) m.
        at: (m, 3) m, where normals are wanted.
        viewpoint: (3,) m, which the normals face; None leaves their sign open.
        num_neighbours: Points of a neighbourhood.

    Returns:
        (m, 3).
    """
    normals = local_axes(cloud, at, num_neighbours=num_neighbours)[1][:, :, 0]
    if viewpoint is not None:
        away = np.einsum("ni,ni->n", normals, viewpoint - at) < 0
        normals = np.where(away[:, None], -normals, normals)
    return normals
