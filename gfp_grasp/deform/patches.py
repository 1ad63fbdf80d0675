"""Patches that cover a primitive, and the template points that each of them sees."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.deform.template import TemplatePoints, patch_layout, patch_unit_m
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import GenericPrimitive

NUM_TEMPLATE = 64  # M, template points that a patch sees
NUM_RESIDUALS = 8  # numbers that say how far the template points lie from a source point
NUM_POSE_FEATURES = 10  # numbers that say where a patch is
# Unit of what is left to deform, as a share of the patch unit: a good fit misses by about this much.
MISFIT_SHARE = 0.1
_MIN_POINTS = 6  # a patch with fewer template points sees nothing
_NEAR_SHARE = 4 / 30  # of the patch unit, a template point is near its vertex
_MIN_NORMAL_COSINE = 0.5
_LEAF = 32  # points in a leaf: many, as the tree is asked for sixteen in six dimensions


@dataclass(frozen=True, eq=False)
class Patches:
    """Patches in their own frames, b of them: origin at a vertex, z its normal, in units of unit_m.

    Attributes:
        index: (b, n) vertices of each patch.
        source: (b, n, 3) S.
        source_normals: (b, n, 3).
        template: (b, m, 3) T, repeated where fewer than m are near.
        template_normals: (b, m, 3).
        mirrored: (b, m) bool, template points that symmetry brought.
        residuals: (b, n, 8) how far the template points lie from each S, see `_residuals`.
        pose_features: (b, 10) where the patch is, in the primitive's frame: its centre and the viewpoint's direction
            from it, its normal, and how many template points it sees, as a share of m. Direction zero: no viewpoint.
        frames: (b, 3, 3) columns are the patch's axes in the primitive's frame.
        weights: (b, n) weight of each point when patches are blended.
        unit_m: The length that is 1 in the patches, see `patch_unit_m`.
    """

    index: np.ndarray
    source: np.ndarray
    source_normals: np.ndarray
    template: np.ndarray
    template_normals: np.ndarray
    mirrored: np.ndarray
    residuals: np.ndarray
    pose_features: np.ndarray
    frames: np.ndarray
    weights: np.ndarray
    unit_m: float

    def seeing(self) -> Patches:
        """Those that see template points."""
        sees = self.pose_features[:, -1] > 0
        return replace(self, **{f.name: getattr(self, f.name)[sees] for f in fields(self) if f.name != "unit_m"})


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
    unit_m = patch_unit_m(primitive)
    normals = vertex_normals(vertices, primitive.faces)
    centre, axis = vertices[index[:, 0]], normals[index[:, 0]]
    frames = _frames(axis)
    # Normals count like distances, which keeps opposite walls apart. Where more than M points are near, some are drawn,
    # always the same ones, so that T covers what S covers.
    drawn = np.random.default_rng(0).permutation(len(template.points))
    tree = KDTree(np.hstack([template.points, unit_m * template.normals])[drawn])
    reach = np.linalg.norm(vertices[index] - centre[:, None], axis=2).max(axis=1)
    inside = tree.query_ball_point(np.hstack([centre, unit_m * axis]), 1.2 * reach, return_sorted=True)
    near = np.zeros((len(index), NUM_TEMPLATE), dtype=np.int64)
    num_seen = np.zeros(len(index), dtype=np.int64)
    for i, found in enumerate(inside):
        if len(found) >= min(_MIN_POINTS, len(drawn)):
            num_seen[i] = min(len(found), NUM_TEMPLATE)
            # Fewer than M: they are repeated in turn, which a max-pool does not notice.
            near[i] = drawn[np.resize(np.asarray(found), NUM_TEMPLATE)]
    return Patches(
        index=index,
        source=np.einsum("bni,bij->bnj", vertices[index] - centre[:, None], frames) / unit_m,
        source_normals=np.einsum("bni,bij->bnj", normals[index], frames),
        template=np.einsum("bmi,bij->bmj", template.points[near] - centre[:, None], frames) / unit_m,
        template_normals=np.einsum("bmi,bij->bmj", template.normals[near], frames),
        mirrored=template.mirrored[near],
        residuals=_residuals(vertices, normals, template, unit_m)[index],
        pose_features=np.column_stack([centre / unit_m, _towards(viewpoint, centre), axis, num_seen / NUM_TEMPLATE]),
        frames=frames,
        weights=weights,
        unit_m=unit_m,
    )


def blend(patches: Patches, moved: np.ndarray, num_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of the vertices from those of overlapping patches.

    Args:
        patches: As made.
        moved: (b, n, 3) displacement of each S, patch frame, in the patches' unit.
        num_vertices: v.

    Returns:
        Displacement (v, 3) m in the primitive's frame, zero where no patch reaches, and the total weight (v,).
    """
    world = np.einsum("bnj,bij->bni", moved, patches.frames) * patches.unit_m
    flat = patches.index.ravel()
    total = np.bincount(flat, patches.weights.ravel(), minlength=num_vertices)
    summed = [
        np.bincount(flat, (patches.weights * world[..., axis]).ravel(), minlength=num_vertices) for axis in range(3)
    ]
    return np.column_stack(summed) / np.maximum(total, 1e-9)[:, None], total


def _residuals(vertices: np.ndarray, normals: np.ndarray, template: TemplatePoints, unit_m: float) -> np.ndarray:
    """Point-to-plane residuals of every vertex, (v, 8): four numbers of observed points, the same of mirrored ones.

    Mean height of the nearest 4 and of the nearest 16 points over the vertex, each along its own normal, in units of
    the misfit (MISFIT_SHARE of the patch unit), held to three; nearness of the nearest, 1 at no distance; share of the
    16 whose normals agree. Points whose normals do not agree count for nothing; all four are zero where none agrees.
    """
    columns = []
    for mirrored in (False, True):
        own = template.mirrored == mirrored
        found = np.zeros((len(vertices), 4))
        if own.any():
            points, facing = template.points[own], template.normals[own]
            count = min(16, len(points))
            tree = KDTree(np.hstack([points, unit_m * facing]), leafsize=_LEAF)
            near = np.reshape(tree.query(np.hstack([vertices, unit_m * normals]), k=count)[1], (-1, count))
            gap = points[near] - vertices[:, None]
            agrees = np.einsum("vi,vki->vk", normals, facing[near]) > _MIN_NORMAL_COSINE
            # The height over the plane of each point: a point beside the vertex says as much as one above it.
            height = np.einsum("vki,vki->vk", gap, facing[near]) * agrees
            few = np.cumsum(agrees, axis=1) <= 4
            distance = np.where(agrees, np.linalg.norm(gap, axis=2), np.inf).min(axis=1)
            found[:, 0] = (height * few).sum(axis=1) / np.maximum((agrees & few).sum(axis=1), 1)
            found[:, 1] = height.sum(axis=1) / np.maximum(agrees.sum(axis=1), 1)
            found[:, :2] = np.clip(found[:, :2] / (MISFIT_SHARE * unit_m), -3.0, 3.0)
            found[:, 2] = np.exp(-distance / (_NEAR_SHARE * unit_m))
            found[:, 3] = agrees.mean(axis=1)
        columns.append(found)
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
