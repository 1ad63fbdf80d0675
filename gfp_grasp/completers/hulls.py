"""Completions by the convex hull: of the observed points alone, and of the points with their mirror image."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import QhullError

from gfp_grasp.completers.unfitted import CompletionInParts, mark_shape
from gfp_grasp.completion import Completion
from gfp_grasp.errors import InvalidCloud
from gfp_grasp.types import CollisionMesh, ConvexPart, Detection

# The edges of a hull are split into pieces of this length, so that some of its vertices are seen and others are not.
_EDGE_M = 0.008
# Share of the points, at both edges of the silhouette together, that tell how deep the object's middle lies.
_SILHOUETTE_SHARE = 0.04
# Points with less spread than this across their plane, as a share of the spread along it, are flat but for rounding.
_FLAT = 1e-5
# A viewer whose level distance from the points is less than this looks from straight above.
_ABOVE_M = 1e-6


def complete_as_observed(detection: Detection) -> Completion:
    """Convex hull of the observed points.

    Raises:
        InvalidCloud: The points lie on a plane or a line.
    """
    return _complete_by_hull(np.asarray(detection.cloud.points), detection)


def complete_by_mirror(detection: Detection) -> Completion:
    """Convex hull of the observed points and their mirror image.

    Raises:
        InvalidCloud: The points lie on a plane or a line, or the cloud has no viewpoint.
    """
    return _complete_by_hull(mirror_cloud(detection), detection)


def mirror_cloud(detection: Detection) -> np.ndarray:
    """The observed points and then their mirror image, (2n, 3) m.

    The mirror is a plane along up that faces the camera. It stands at the depth of the silhouette's edges, which is the
    middle of a round or boxy object, or at the middle depth of what was seen, whichever is deeper.

    Raises:
        InvalidCloud: The cloud has no viewpoint.
    """
    points, up = np.asarray(detection.cloud.points), detection.up
    if detection.cloud.viewpoint is None:
        raise InvalidCloud("the mirror completer needs the cloud's viewpoint: give where the camera stood")
    away = points.mean(axis=0) - detection.cloud.viewpoint
    away = away - (away @ up) * up
    if np.linalg.norm(away) < _ABOVE_M:  # any plane along up will do
        away = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    away = away / np.linalg.norm(away)
    depth, across = points @ away, points @ np.cross(up, away)
    low, high = np.quantile(across, [_SILHOUETTE_SHARE / 2, 1 - _SILHOUETTE_SHARE / 2])
    edge = float(np.mean([np.median(depth[across <= low]), np.median(depth[across >= high])]))
    middle = max(edge, float(np.mean(np.quantile(depth, [0.01, 0.99]))))
    mirrored = points - 2.0 * (depth - middle)[:, None] * away
    return np.concatenate([points, mirrored])


def _complete_by_hull(points: np.ndarray, detection: Detection) -> Completion:
    flat = f"{len(points)} points have no volume between them: a plane or a line has no hull"
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 4 or not spread[2] > _FLAT * spread[0]:
        raise InvalidCloud(flat)
    try:
        hull = trimesh.convex.convex_hull(points)
    except QhullError as error:
        raise InvalidCloud(flat) from error
    part = ConvexPart(np.asarray(hull.vertices), np.asarray(hull.faces))
    exact = CollisionMesh((part,), (0.0, 0.0, 0.0), "hull", 0.0)
    return CompletionInParts(mark_shape(_refine(hull), detection), detection, exact)


def _refine(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same solid, its edges split into pieces of at most _EDGE_M, without T-junctions."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.uint64))
    )
    fine = solid.refine_to_length(_EDGE_M).to_mesh64()
    refined = trimesh.Trimesh(fine.vert_properties[:, :3], fine.tri_verts.astype(np.int64), process=False)
    return refined if refined.is_volume else mesh
