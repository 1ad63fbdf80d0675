"""Which vertices of a primitive make up each patch, and the length that all of the deformation is measured in."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import GenericPrimitive

NUM_PATCHES = 64
NUM_SOURCE = 64  # N, points of a patch of the primitive
_UNIT_SHARE = 0.3248  # of the primitive's size: 30 mm on the shipped cup, about the radius of its patches
_LEAST_EXTENT = 0.1  # of the diagonal: what is flatter has patches as large as if it were this thick


def patch_unit_m(primitive: GenericPrimitive) -> float:
    """The length, m, that is one unit to the networks and that all lengths of the deformation are shares of.

    It is a share of the size of the mean mesh, which is the geometric mean of its extents: about the radius of a patch,
    be it of something compact, long or flat. The shipped cup has 30 mm, a car has 0.75 m.
    """
    extents = np.ptp(primitive.vertices, axis=0)
    extents = np.maximum(extents, _LEAST_EXTENT * np.linalg.norm(extents))
    return _UNIT_SHARE * float(np.cbrt(extents.prod()))


@lru_cache(maxsize=32)
def patch_layout(primitive: GenericPrimitive) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (b, n) of each patch, its centre first, and blending weights: farthest-point centres on the mean."""
    vertices, normals = primitive.vertices, vertex_normals(primitive.vertices, primitive.faces)
    # Opposite walls are kept apart: a difference of normals of one unit counts like the patch unit.
    features = np.hstack([vertices, patch_unit_m(primitive) * normals])
    centres = [int(np.argmax(vertices[:, 2]))]
    distance = np.linalg.norm(features - features[centres[0]], axis=1)
    while len(centres) < min(NUM_PATCHES, len(vertices)):
        centres.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(features - features[centres[-1]], axis=1))
    count = min(NUM_SOURCE, len(vertices))
    reach, index = KDTree(features).query(features[centres], k=count)
    reach, index = np.reshape(reach, (-1, count)), np.reshape(index, (-1, count))
    if count < NUM_SOURCE:
        turn = np.arange(NUM_SOURCE) % count
        reach, index = reach[:, turn], index[:, turn]
    weights = np.exp(-((reach / (0.6 * reach[:, -1:] + 1e-12)) ** 2))
    return index, weights
