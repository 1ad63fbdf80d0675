"""The frame in which an observation is worked on, and which of a completed surface was observed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.camera import cast_rays
from gfp_grasp.clouds import order_points
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import DepthImage, Detection, OrientedBox, PointCloud, SupportPlane

_LIFT_M = 0.0005  # a ray starts this far off its own surface


def level_frame(points: np.ndarray, up: np.ndarray, viewpoint: np.ndarray | None) -> np.ndarray:
    """T_world_level (4, 4): z up, origin at the points' centre, x towards the viewer.

    Without a viewpoint x is the horizontal direction in which the points are spread least.
    """
    up = up / np.linalg.norm(up)
    origin = points.mean(axis=0)
    x = _horizontal(points - origin, None if viewpoint is None else viewpoint - origin, up)
    return make_T(np.column_stack([x, np.cross(up, x), up]), origin)


def canonical_frame(detection: Detection, *, seed: int = 0) -> tuple[Detection, np.ndarray]:
    """The same detection in the level frame of its points.

    Returns:
        The detection, and T_world_canonical (4, 4).
    """
    points = order_points(detection.cloud.points, seed=seed)
    T = level_frame(points, detection.up, detection.cloud.viewpoint)
    detection = replace(detection, cloud=PointCloud(points, detection.cloud.viewpoint))
    return move_detection(detection, invert_T(T)), T


def move_detection(detection: Detection, T: np.ndarray) -> Detection:
    """The detection in another frame, T_new_old (4, 4); its points are ordered there."""
    viewpoint, view = detection.cloud.viewpoint, detection.view
    points = order_points(apply_T(T, detection.cloud.points))
    return replace(
        detection,
        cloud=PointCloud(points, None if viewpoint is None else apply_T(T, viewpoint)),
        up=T[:3, :3] @ detection.up,
        support=None if detection.support is None else move_support(detection.support, T),
        box=OrientedBox(T @ detection.box.T_world_box, detection.box.extents),
        view=None if view is None else move_view(view, T),
    )


def move_support(support: SupportPlane, T: np.ndarray) -> SupportPlane:
    """The plane in another frame, T_new_old (4, 4)."""
    normal = T[:3, :3] @ support.normal
    return SupportPlane(normal, support.height_m + float(normal @ T[:3, 3]))


def move_view(view: DepthImage, T: np.ndarray) -> DepthImage:
    """The picture with its camera's pose in another frame, T_new_old (4, 4)."""
    return DepthImage(view.depth_m, view.K, T @ view.T_world_camera)


def mark_observed(
    vertices: np.ndarray, faces: np.ndarray, detection: Detection, sigma_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which vertices were observed, and a standard deviation for each.

    Args:
        vertices: (v, 3) m, completed surface.
        faces: (f, 3).
        detection: What it was completed from.
        sigma_m: (v,) m from the deformation, NaN where it does not tell.

    Returns:
        Observed (v,) bool: in sight of the viewpoint (of nothing, where there is none) and within three sensor
        sigmas of a point, or two and a half spacings of the points where that is wider; and sigma (v,) m, which where
        nothing else is known grows by a tenth of the distance to the nearest point.
    """
    points = detection.cloud.points
    tree = KDTree(points)
    distance = tree.query(vertices)[0]
    spacing = float(np.median(tree.query(points[:: max(1, len(points) // 500)], k=min(2, len(points)))[0][:, -1]))
    observed = distance < max(3.0 * detection.sensor_sigma_m, 2.5 * spacing)
    if detection.cloud.viewpoint is not None:
        observed &= _in_sight(vertices, faces, detection.cloud.viewpoint)
    rough = np.hypot(detection.sensor_sigma_m, 0.1 * distance)
    return observed, np.where(np.isfinite(sigma_m), sigma_m, rough)


def _in_sight(vertices: np.ndarray, faces: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    normals = vertex_normals(vertices, faces)
    sight = viewpoint - vertices
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    facing = np.einsum("vi,vi->v", normals, sight) > 0
    hit, _, _ = cast_rays([(vertices, faces)], vertices + _LIFT_M * normals + _LIFT_M * sight, sight)
    return facing & ~np.isfinite(hit)


def _horizontal(centred: np.ndarray, sight: np.ndarray | None, up: np.ndarray) -> np.ndarray:
    flat = np.eye(3) - np.outer(up, up)
    if sight is not None:
        x = flat @ sight
        if np.linalg.norm(x) > 1e-3:
            return x / np.linalg.norm(x)
    _, vectors = np.linalg.eigh((centred @ flat).T @ (centred @ flat) + 1e3 * np.outer(up, up) * len(centred))
    x = vectors[:, 0]
    # The sign of an eigenvector is no property of the points: the side with the longer tail is.
    x = x * (np.sign(((centred @ x) ** 3).sum()) or 1.0)
    return x / np.linalg.norm(x)
