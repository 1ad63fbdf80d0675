"""Patches of a primitive, and the template points T that each is drawn to: the observation and its mirror image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import FittedPrimitive, GenericPrimitive, LevelView

NUM_PATCHES = 64
NUM_SOURCE = 64  # N, points of a patch of the primitive
_UNIT_SHARE = 0.3248  # of the primitive's size: 30 mm on the shipped cup, about the radius of its patches


def patch_unit_m(primitive: GenericPrimitive) -> float:
    """The length, m, that is one unit to the networks and that all lengths of the deformation are shares of.

    It is a share of the primitive's size: about the radius of a patch, be it of something compact, long or flat. The
    shipped cup has 30 mm, a car has 0.75 m.
    """
    return _UNIT_SHARE * primitive.size_m


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


# A mirrored point is kept where it is at least this far from all observed points, and at most this far from the fit,
# beyond which the symmetry is broken; in units of `patch_unit_m`.
_SILENT = 0.2
_PLAUSIBLE = 0.4
# A part stands beside the axis when its centre is this far away from it; share of the diagonal.
_BESIDE = 0.05


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


def template_points(fit: FittedPrimitive, view: LevelView, *, symmetry: bool = True) -> TemplatePoints:
    """Observed points with normals in the fit's own frame, and their mirror images where nothing was seen.

    A round or oval body is its own mirror image in both upright planes through its axis; a part beside the axis, as a
    handle, only in its own plane, so points on it are never brought to the body's other side.

    Args:
        fit: Registered primitive.
        view: One object, in the frame of the fit.
        symmetry: Mirror points to the hidden side.
    """
    R, t = fit.T_world_object[:3, :3], fit.T_world_object[:3, 3]
    points, normals = (view.dense_points - t) @ R, view.dense_normals @ R
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    surface = KDTree(vertices)
    if not view.oriented:
        normals = _outward(points, normals, vertices, surface, fit.primitive.faces)
    images = [TemplatePoints(points, normals, np.zeros(len(points), dtype=bool))]
    if symmetry:
        regions = fit.primitive.regions[surface.query(points)[1]]
        images += _mirrored(points, normals, regions, fit, KDTree(points), surface)
    return TemplatePoints(
        np.concatenate([i.points for i in images]),
        np.concatenate([i.normals for i in images]),
        np.concatenate([i.mirrored for i in images]),
    )


def _mirrored(
    points: np.ndarray,
    normals: np.ndarray,
    regions: np.ndarray,
    fit: FittedPrimitive,
    seen: KDTree,
    surface: KDTree,
) -> list[TemplatePoints]:
    images, unit_m = [], patch_unit_m(fit.primitive)
    near_m = _PLAUSIBLE * unit_m + _vertex_spacing(surface)
    for move, stays in _mirrors(fit.primitive):
        moved, turned = points @ move.T, normals @ move.T
        keep = stays[regions] & (seen.query(moved)[0] > _SILENT * unit_m)
        distance, nearest = surface.query(moved)
        keep &= (distance < near_m) & stays[fit.primitive.regions[nearest]]
        images.append(TemplatePoints(moved[keep], turned[keep], np.ones(int(keep.sum()), dtype=bool)))
    return images


def _mirrors(primitive: GenericPrimitive) -> list[tuple[np.ndarray, np.ndarray]]:
    """Moves (3, 3) of the body onto itself, each with which regions (r,) bool keep their place under it."""
    centres = np.zeros((len(primitive.region_names), 3))
    for region in np.unique(primitive.regions[primitive.on_part]):
        centres[region] = primitive.vertices[primitive.regions == region].mean(axis=0) * [1, 1, 0]
    away_m = _BESIDE * float(np.linalg.norm(np.ptp(primitive.vertices, axis=0)))
    beside = centres[np.linalg.norm(centres, axis=1) > away_m]
    symmetry = primitive.symmetry
    if len(beside):
        across = _plane_of(beside[0], symmetry.mirror_normal, away_m)
        along = np.cross(across, [0.0, 0.0, 1.0])
        moves = [_reflection(across), _reflection(along), _reflection(across) @ _reflection(along)]
    elif symmetry.order >= 2:
        moves = [np.diag(signs) for signs in ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, 1.0))]
    else:
        moves = [] if symmetry.mirror_normal is None else [_reflection(symmetry.mirror_normal)]
    return [(move, np.linalg.norm(centres @ move.T - centres, axis=1) < away_m) for move in moves]


def _plane_of(centre: np.ndarray, mirror_normal: np.ndarray | None, away_m: float) -> np.ndarray:
    """Normal (3,) of the upright plane through the axis and a part: the class's own mirror plane where it holds it."""
    if mirror_normal is not None and abs(float(mirror_normal @ centre)) < away_m:
        return mirror_normal
    normal = np.cross([0.0, 0.0, 1.0], centre)
    return normal / np.linalg.norm(normal)


def _reflection(normal: np.ndarray) -> np.ndarray:
    return np.eye(3) - 2.0 * np.outer(normal, normal)


def _vertex_spacing(surface: KDTree) -> float:
    return float(np.median(surface.query(surface.data, k=2)[0][:, 1]))


def _outward(
    points: np.ndarray, normals: np.ndarray, vertices: np.ndarray, surface: KDTree, faces: np.ndarray
) -> np.ndarray:
    """Normals (n, 3) with the signs of the fit, where no viewpoint tells them."""
    fitted = vertex_normals(vertices, faces)[surface.query(points)[1]]
    return np.where(np.einsum("ni,ni->n", fitted, normals)[:, None] < 0, -normals, normals)
