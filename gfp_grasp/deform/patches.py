"""Patches that cover a primitive, and the template points that each of them sees."""

from __future__ import annotations

from dataclasses import dataclass, fields
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
_MIN_POINTS = 6  # a patch with fewer template points sees nothing
PULL_M = 0.003  # unit of what is left to deform: a good fit misses by about this much
_NEAR_M = 0.004
_MIN_NORMAL_COSINE = 0.5


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
        pull: (b, n, 8) what template points say of each S, see `_pull`.
        place: (b, 10) where the patch is, in the primitive's frame: its centre and the viewpoint's direction from it,
            its normal, and how many template points it sees, as a share of m. Direction zero: no viewpoint.
        frames: (b, 3, 3) columns are the patch's axes in the primitive's frame.
        weights: (b, n) weight of each point when patches are blended.
    """

    index: np.ndarray
    source: np.ndarray
    source_normals: np.ndarray
    template: np.ndarray
    template_normals: np.ndarray
    carried: np.ndarray
    pull: np.ndarray
    place: np.ndarray
    frames: np.ndarray
    weights: np.ndarray

    def seeing(self) -> Patches:
        """Those that see template points."""
        sees = self.place[:, -1] > 0
        return Patches(**{f.name: getattr(self, f.name)[sees] for f in fields(self)})


def make_patches(
    primitive: GenericPrimitive, vertices: np.ndarray, template: TemplatePoints, viewpoint: np.ndarray | None
) -> Patches:
    """Patches that cover the fitted primitive.

    Args:
        primitive: What was fitted.
        vertices: (v, 3) m, the fit in the primitive's frame (rigid, metric).
        template: T, in the same frame, at least one point.
        viewpoint: (3,) m, same frame, or None.
    """
    index, weights = patch_layout(primitive)
    normals = vertex_normals(vertices, primitive.faces)
    centre, axis = vertices[index[:, 0]], normals[index[:, 0]]
    frames = _frames(axis)
    # Walls apart: a template point belongs to a patch only if its normal agrees with the patch's. Of more than M near
    # ones some are drawn, always the same, so that T covers what S covers.
    drawn = np.random.default_rng(0).permutation(len(template.points))
    tree = KDTree(np.hstack([template.points, _NORMAL_LENGTH_M * template.normals])[drawn])
    reach = np.linalg.norm(vertices[index] - centre[:, None], axis=2).max(axis=1)
    inside = tree.query_ball_point(np.hstack([centre, _NORMAL_LENGTH_M * axis]), 1.2 * reach, return_sorted=True)
    near = np.zeros((len(index), NUM_TEMPLATE), dtype=np.int64)
    num_seen = np.zeros(len(index), dtype=np.int64)
    for i, found in enumerate(inside):
        if len(found) >= min(_MIN_POINTS, len(drawn)):
            num_seen[i] = min(len(found), NUM_TEMPLATE)
            # Fewer than M: they are repeated in turn, which a max-pool does not notice.
            near[i] = drawn[np.resize(np.asarray(found), NUM_TEMPLATE)]
    return Patches(
        index=index,
        source=np.einsum("bni,bij->bnj", vertices[index] - centre[:, None], frames) / UNIT_M,
        source_normals=np.einsum("bni,bij->bnj", normals[index], frames),
        template=np.einsum("bmi,bij->bmj", template.points[near] - centre[:, None], frames) / UNIT_M,
        template_normals=np.einsum("bmi,bij->bmj", template.normals[near], frames),
        carried=template.carried[near],
        pull=_pull(vertices, normals, template)[index],
        place=np.column_stack([centre / UNIT_M, _towards(viewpoint, centre), axis, num_seen / NUM_TEMPLATE]),
        frames=frames,
        weights=weights,
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
def patch_layout(primitive: GenericPrimitive) -> tuple[np.ndarray, np.ndarray]:
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


def _pull(vertices: np.ndarray, normals: np.ndarray, template: TemplatePoints) -> np.ndarray:
    """What the template says of every vertex, (v, 8): four numbers of observed points, the same of carried ones.

    Height of the nearest 4 and of the nearest 16 points over the vertex along its normal, in units of PULL_M, held to
    three; nearness of the first, 1 at no distance; share of the 16 whose normals agree. All zero where none agrees.
    """
    columns = []
    for carried in (False, True):
        own = template.carried == carried
        pull = np.zeros((len(vertices), 4))
        if own.any():
            points, facing = template.points[own], template.normals[own]
            count = min(16, len(points))
            tree = KDTree(np.hstack([points, _NORMAL_LENGTH_M * facing]))
            near = np.reshape(tree.query(np.hstack([vertices, _NORMAL_LENGTH_M * normals]), k=count)[1], (-1, count))
            gap = points[near] - vertices[:, None]
            agrees = np.einsum("vi,vki->vk", normals, facing[near]) > _MIN_NORMAL_COSINE
            # Over the plane of each point, so that a point beside the vertex says as much as one on it.
            height = np.einsum("vki,vki->vk", gap, facing[near]) * agrees
            few = np.cumsum(agrees, axis=1) <= 4
            distance = np.linalg.norm(np.where(agrees[..., None], gap, 1.0), axis=2).min(axis=1)
            pull[:, 0] = (height * few).sum(axis=1) / np.maximum((agrees & few).sum(axis=1), 1)
            pull[:, 1] = height.sum(axis=1) / np.maximum(agrees.sum(axis=1), 1)
            pull[:, :2] = np.clip(pull[:, :2] / PULL_M, -3.0, 3.0)
            pull[:, 2] = np.exp(-distance / _NEAR_M)
            pull[:, 3] = agrees.mean(axis=1)
        columns.append(pull)
    return np.hstack(columns)


def _towards(viewpoint: np.ndarray | None, centre: np.ndarray) -> np.ndarray:
    """(b, 3) unit directions from the centres to the viewpoint; zero without one."""
    if viewpoint is None:
        return np.zeros_like(centre)
    sight = viewpoint - centre
    return sight / (np.linalg.norm(sight, axis=1, keepdims=True) + 1e-12)


def _frames(axis: np.ndarray) -> np.ndarray:
    """(b, 3, 3) right-handed frames with z along axis and x as near the primitive's upright axis as it can be."""
    up = np.where(np.abs(axis[:, 2:]) < 0.95, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    x = up - np.einsum("bi,bi->b", up, axis)[:, None] * axis
    x /= np.linalg.norm(x, axis=1, keepdims=True) + 1e-12
    return np.stack([x, np.cross(axis, x), axis], axis=2)
