"""Means over the neighbours of each vertex, as sparse matrices."""

from __future__ import annotations

import numpy as np
from scipy import sparse


def neighbour_average(faces: np.ndarray, num_vertices: int) -> sparse.csr_matrix:
    """(v, v) matrix that takes vertices to the mean of their mesh neighbours; zero for a vertex without any.

    Args:
        faces: (f, 3).
        num_vertices: v.
    """
    rows = faces[:, [0, 1, 2, 1, 2, 0]].ravel()
    columns = faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    adjacency = sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(num_vertices, num_vertices))
    adjacency.data[:] = 1.0  # each edge was counted from both of its faces
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
    return sparse.csr_matrix(sparse.diags(1.0 / degree) @ adjacency)


def graph_laplacian(faces: np.ndarray, num_vertices: int) -> sparse.csr_matrix:
    """Random-walk graph Laplacian (v, v): each vertex minus the mean of its mesh neighbours.

    Args:
        faces: (f, 3).
        num_vertices: v.
    """
    return sparse.csr_matrix(sparse.eye(num_vertices) - neighbour_average(faces, num_vertices))
