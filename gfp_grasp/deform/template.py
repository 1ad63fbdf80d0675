"""Template points T: what was observed, and what the primitive's symmetry says of the hidden side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.clouds import estimate_normals, thin
from gfp_grasp.deform.layout import patch_unit_m
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import HANDLE, Detection, FittedPrimitive

# A mirrored point speaks only where nothing was observed, and near the fit: elsewhere the symmetry is broken. Both in
# units of `patch_unit_m`.
_SILENT = 0.2
_PLAUSIBLE = 0.4


@dataclass(frozen=True, eq=False)
class TemplatePoints:
    """Points that the deformation is drawn to.

    Attributes:
        points: (n, 3) m, in the primitive's frame (rigid, not scaled).
        normals: (n, 3) unit, outward.
        mirrored: (n,) bool, brought to the hidden side by symmetry.
    """

    points: np.ndarray
    normals: np.ndarray
    mirrored: np.ndarray


def template_points(
    fit: FittedPrimitive, detection: Detection, *, symmetry: bool = True, num_points: int = 1000
) -> TemplatePoints:
    """Observed points with normals in the fit's own frame, and their mirror images where nothing was seen.

    A round or oval body is its own mirror image in both upright planes through its axis; a handle only in its own
    plane, so points on a handle are never carried across to the body's other side.

    Args:
        fit: Registered primitive.
        detection: One object.
        symmetry: Carry points to the hidden side.
        num_points: About how many observed points are kept.
    """
    dense = thin(detection.cloud.points, 4000)
    seen = thin(dense, num_points)
    normals = estimate_normals(dense, seen, detection.cloud.viewpoint)
    R, t = fit.T_world_object[:3, :3], fit.T_world_object[:3, 3]
    points, normals = (seen - t) @ R, normals @ R
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    surface = KDTree(vertices)
    if detection.cloud.viewpoint is None:
        normals = _outward(points, normals, vertices, surface, fit.primitive.faces)
    images = [TemplatePoints(points, normals, np.zeros(len(points), dtype=bool))]
    if symmetry:
        on_handle = fit.primitive.regions[surface.query(points)[1]] == HANDLE
        images += _mirrored(points, normals, on_handle, fit, KDTree(points), surface)
    return TemplatePoints(
        np.concatenate([i.points for i in images]),
        np.concatenate([i.normals for i in images]),
        np.concatenate([i.mirrored for i in images]),
    )


def _mirrored(
    points: np.ndarray,
    normals: np.ndarray,
    on_handle: np.ndarray,
    fit: FittedPrimitive,
    seen: KDTree,
    surface: KDTree,
) -> list[TemplatePoints]:
    images, unit_m = [], patch_unit_m(fit.primitive)
    near_m = _PLAUSIBLE * unit_m + _vertex_spacing(surface)
    for signs, takes_handle in _mirrors(fit):
        moved, turned = points * signs, normals * signs
        keep = np.ones(len(points), dtype=bool) if takes_handle else ~on_handle
        keep &= seen.query(moved)[0] > _SILENT * unit_m
        distance, nearest = surface.query(moved)
        keep &= distance < near_m
        if not takes_handle:
            keep &= fit.primitive.regions[nearest] != HANDLE
        images.append(TemplatePoints(moved[keep], turned[keep], np.ones(int(keep.sum()), dtype=bool)))
    return images


def _mirrors(fit: FittedPrimitive) -> list[tuple[np.ndarray, bool]]:
    """Signs of (x, y, z) of each mirror image, and whether a handle keeps its place under it."""
    has_handle = bool((fit.primitive.regions == HANDLE).any())
    symmetry = fit.primitive.symmetry
    if has_handle:
        across = np.array([1.0, -1.0, 1.0])
        return [(across, True), (np.array([-1.0, 1.0, 1.0]), False), (np.array([-1.0, -1.0, 1.0]), False)]
    if symmetry.order >= 2:
        return [(np.array(s), True) for s in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0))]
    if symmetry.mirror_normal is not None:
        return [(1.0 - 2.0 * np.abs(np.rint(symmetry.mirror_normal)), True)]
    return []


def _vertex_spacing(surface: KDTree) -> float:
    return float(np.median(surface.query(surface.data, k=2)[0][:, 1]))


def _outward(
    points: np.ndarray, normals: np.ndarray, vertices: np.ndarray, surface: KDTree, faces: np.ndarray
) -> np.ndarray:
    """Signs of normals from the fit, where no viewpoint tells them."""
    fitted = vertex_normals(vertices, faces)[surface.query(points)[1]]
    return np.where(np.einsum("ni,ni->n", fitted, normals)[:, None] < 0, -normals, normals)
