"""A body without any symmetry as a camera sees it on a table, with and without a board before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from toy_bodies import l_body

from gfp_grasp.camera import cloud_of, intrinsics, render_mesh_view
from gfp_grasp.transforms import apply_T, look_at, make_T, rotation_about
from gfp_grasp.types import DepthImage, Detection, OrientedBox, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
K = intrinsics(160, 120, 35.0)


def body(scale: float = 1.0) -> trimesh.Trimesh:
    """The L on end, turned about z and away from the origin, on z = 0."""
    mesh = l_body().apply_scale(scale)
    mesh.apply_transform(make_T(rotation_about(UP, 0.7), scale * np.array([0.2, -0.1, 0.0])))
    return mesh


def seen(
    scale: float = 1.0, *, hidden: float = 0.0, lost: bool = False, moved: np.ndarray | None = None
) -> tuple[Detection, trimesh.Trimesh]:
    """The body without noise, and the true mesh.

    Args:
        scale: Of all lengths.
        hidden: Share of the picture's columns, from the left of the body on, that a board hides.
        lost: Whether nothing comes back beside the body.
        moved: Pose (4, 4) of the table's frame in the world.
    """
    mesh = body(scale)
    target = mesh.bounds.mean(axis=0)
    camera = look_at(target + scale * np.array([0.35, 0.25, 0.3]), target)
    image, index = render_mesh_view([mesh], T_world_camera=camera, K=K, width=160, height=120, table_height=0.0)
    depth, columns = np.array(image.depth_m), np.flatnonzero((index == 0).any(axis=0))
    if hidden:
        edge = int(columns[0] + hidden * len(columns))
        depth[:, :edge] = depth[index == 0].min() - 0.05 * scale
        index[:, :edge] = 1
    if lost:
        depth[index != 0] = 0.0
    image = DepthImage(depth, K, camera)
    mask = index == 0
    cloud = cloud_of(image, mask)
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    T = np.eye(4) if moved is None else moved
    assert cloud.viewpoint is not None
    mesh.apply_transform(T)
    return Detection(
        cloud=PointCloud(apply_T(T, cloud.points), apply_T(T, cloud.viewpoint)),
        up=T[:3, 2],
        support=SupportPlane(T[:3, 2], float(T[:3, 2] @ T[:3, 3])),
        category="",
        scores={},
        box=OrientedBox(T @ make_T(None, (low + high) / 2), high - low),
        view=image.moved(T),
        mask=mask,
        sensor_sigma_m=0.0005 * scale,
    ), mesh


def without_view(detection: Detection) -> Detection:
    """The same, of which the points and the viewpoint alone are known."""
    return replace(detection, view=None, mask=None)


def points_alone(detection: Detection) -> Detection:
    """The same, of which nothing but the points is known."""
    return replace(without_view(detection), cloud=PointCloud(detection.cloud.points), support=None)
