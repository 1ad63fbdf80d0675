"""Patches that cover a primitive, and the template points that each of them sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.deform.template import TemplatePoints
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import GenericPrimitive

NUM_SOURCE = 64  # N, points of a patch of the primitive
NUM_TEMPLATE = 64  # M, template points that a patch sees
NUM_PATCHES = 64
UNIT_M = 0.03  # lengths enter the networks in units of this, about the radius of a patch
# Opposite walls are kept apart: a difference of normals of one unit counts like this distance.
_NORMAL_LENGTH_M = 0.03
_SEES_M = 0.04  # template points farther from a patch's centre than this are not its own
_MIN_POINTS = 6


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches in their own frames, b of them: origin at a vertex, z its normal, in units of UNIT_M.

    Attributes:
        index: (b, n) vertices of each patch.
        source: (b, n, 3) S.
        source_normals: (b, n, 3).
        template: (b, m, 3) T, repeated where fewer than m are near.
        template_normals: (b, m, 3).
        carried: (b, m) bool, template points that symmetry brought.
        frames: (b, 3, 3) columns are the patch's axes in the primitive's frame.
        weights: (b, n) weight of each point when patches are blended.
        num_seen: (b,) template points that are near each patch.
    """

    index: np.ndarray
    source: np.ndarray
    source_normals: np.ndarray
    template: np.ndarray
    template_normals: np.ndarray
    carried: np.ndarray
    frames: np.ndarray
    weights: np.ndarray
    num_seen: np.ndarray


def make_patches(primitive: GenericPrimitive, vertices: np.ndarray, template: TemplatePoints) -> Patches:
    """Patches of the fitted vertices (v, 3) m, primitive's frame; those that see fewer than 6 points are left out."""
    index, weights = _layout(primitive)
    normals = vertex_normals(vertices, primitive.faces)
    centre, axis = vertices[index[:, 0]], normals[index[:, 0]]
    frames = _frames(axis)
    # Walls apart: a template point belongs to a patch only if its normal agrees with the patch's.
    tree = KDTree(np.hstack([template.points, _NORMAL_LENGTH_M * template.normals]))
    count = min(NUM_TEMPLATE, len(template.points))
    distance, near = tree.query(np.hstack([centre, _NORMAL_LENGTH_M * axis]), k=count)
    distance, near = np.reshape(distance, (-1, count)), np.reshape(near, (-1, count))
    num_seen = (distance < _SEES_M).sum(axis=1)
    keep = num_seen >= min(_MIN_POINTS, count)
    index, weights, near, centre, frames, num_seen = (a[keep] for a in (index, weights, near, centre, frames, num_seen))
    # Fewer than M near: the nearest are repeated in turn, which a max-pool does not notice.
    turn = np.arange(NUM_TEMPLATE)[None] % num_seen[:, None]
    near = np.take_along_axis(near, turn, axis=1)
    return Patches(
        index=index,
        source=np.einsum("bni,bij->bnj", vertices[index] - centre[:, None], frames) / UNIT_M,
        source_normals=np.einsum("bni,bij->bnj", normals[index], frames),
        template=np.einsum("bmi,bij->bmj", template.points[near] - centre[:, None], frames) / UNIT_M,
        template_normals=np.einsum("bmi,bij->bmj", template.normals[near], frames),
        carried=template.carried[near],
        frames=frames,
        weights=weights,
        num_seen=num_seen,
    )


def blend(patches: Patches, moved: np.ndarray, num_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of the vertices from those of overlapping patches.

    Args:
        patches: As made.
        moved: (b, n, 3) displacement of each S, patch frame, in units of UNIT_M.
        num_vertices: v.

    Returns:
        Displacement (v, 3) m in the primitive's frame, zero where no patch reaches, and total weight (v,).
    """
    world = np.einsum("bnj,bij->bni", moved, patches.frames) * UNIT_M
    flat = patches.index.ravel()
    total = np.bincount(flat, patches.weights.ravel(), minlength=num_vertices)
    summed = [
        np.bincount(flat, (patches.weights * world[..., axis]).ravel(), minlength=num_vertices) for axis in range(3)
    ]
    return np.column_stack(summed) / np.maximum(total, 1e-9)[:, None], total


@lru_cache(maxsize=32)
def _layout(primitive: GenericPrimitive) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (b, n) of each patch, its centre first, and blending weights: farthest-point centres on the mean."""
    vertices, normals = primitive.vertices, vertex_normals(primitive.vertices, primitive.faces)
    features = np.hstack([vertices, _NORMAL_LENGTH_M * normals])
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


def _frames(axis: np.ndarray) -> np.ndarray:
    """(b, 3, 3) right-handed frames with z along axis and x as near the primitive's upright axis as it can be."""
    up = np.where(np.abs(axis[:, 2:]) < 0.95, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = up - np.einsum("bi,bi->b", up, axis)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True) + 1e-12
    return np.stack([x, np.cross(axis, x), axis], axis=2)
