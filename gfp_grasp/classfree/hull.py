"""Convex hulls of what was seen: the completion that claims nothing."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial import QhullError

from gfp_grasp.errors import InvalidCloud
from gfp_grasp.level import mark_observed
from gfp_grasp.types import CompletedShape, LevelView

# The edges of a hull are split into pieces of this length, so that some of its vertices are seen and others are not.
_EDGE_M = 0.008
_MOST_EDGES = 60.0  # along its longest side: what is larger gets longer pieces
# Points with less spread than this across their plane, as a share of the spread along it, are flat but for rounding.
_FLAT = 1e-5
_THIN = 2.0  # standard deviations of the noise that a flat cloud is made thick by, to either side


def complete_hull(view: LevelView) -> CompletedShape:
    """The hull of the points; what is flat gets the thickness that the noise leaves open. It never fails."""
    points = view.cloud.points
    try:
        hull = hull_of(points)
    except InvalidCloud:
        thick = _THIN * view.sigma_m * np.concatenate([np.eye(3), -np.eye(3)])
        hull = hull_of((points[:, None] + thick).reshape(-1, 3))
    mesh = refined(hull)
    unknown = np.full(len(mesh.vertices), np.nan)
    observed, sigma_m = mark_observed(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), view.cloud, sensor_sigma_m=view.sigma_m, sigma_m=unknown
    )
    return CompletedShape(mesh, observed, sigma_m, made_by="hull")


def hull_of(points: np.ndarray) -> trimesh.Trimesh:
    """Convex hull of points (n, 3) m.

    Raises:
        InvalidCloud: The points lie on a plane or a line.
    """
    flat = f"{len(points)} points have no volume between them: a plane or a line has no hull"
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 4 or not spread[2] > _FLAT * spread[0]:
        raise InvalidCloud(flat)
    try:
        return trimesh.convex.convex_hull(points)
    except QhullError as error:
        raise InvalidCloud(flat) from error


def refined(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same solid, its edges split into short pieces, without T-junctions."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.uint64))
    )
    fine = solid.refine_to_length(max(_EDGE_M, float(mesh.extents.max()) / _MOST_EDGES)).to_mesh64()
    split = trimesh.Trimesh(fine.vert_properties[:, :3], fine.tri_verts.astype(np.int64), process=False)
    return split if split.is_volume else mesh
