"""How benches view their objects: one standard protocol and three hard ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.camera import (
    SensorModel,
    apply_sensor,
    cast_rays,
    cloud_of,
    intrinsics,
    render_mesh_view,
    sample_viewpoint,
)
from gfp_grasp.train import across_edge, rest_rotation
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, PointCloud

PROTOCOLS = ("standard", "noisy", "fallen", "hidden")
# What the noisy protocol's sensor does: blobs without return, and a quarter of the silhouette lost.
_NOISY = SensorModel(sigma_m=0.003, hole_share=0.08, hole_radius_px=3.0, edge_lost_share=0.25)
_LIFT_M = 1e-4  # rays start this far off their own surface
_BOARD_M = 0.05  # how far in front of the object the board of the hidden protocol stands


@dataclass(frozen=True, eq=False)
class ObjectView:
    """One object as one camera saw it.

    Attributes:
        mesh: The true mesh, in the world's frame.
        T_world_object: (4, 4) pose of the object on the table.
        cloud: Points that the camera saw, with its viewpoint.
    """

    mesh: trimesh.Trimesh
    T_world_object: np.ndarray
    cloud: PointCloud


def view_object(
    mesh: trimesh.Trimesh, rng: np.random.Generator, *, protocol: str = "standard", noise_m: float = 0.001
) -> ObjectView:
    """Put an object on a table of any height, by any yaw, and look at it from 0.6 m, 240x320, 35 degrees field.

    Args:
        mesh: True mesh, z up, m.
        rng: Draws place, view and noise.
        protocol: "standard" (20 to 60 degrees up), "noisy" (5 to 80 degrees, 3 mm of noise and dropouts), "fallen"
            (lying by any roll, or upside down) or "hidden" (half of its pixels behind a nearer board, whose straight
            edge has any direction).
        noise_m: Standard deviation of the depth noise; "noisy" has its own.
    """
    height = float(rng.uniform(-0.3, 0.9))
    R = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi))
    if protocol == "fallen":
        R = R @ _fallen(rng)
    low = float((mesh.vertices @ R.T)[:, 2].min())
    T = make_T(R, (0.0, 0.0, height - low))
    placed = mesh.copy()
    placed.apply_transform(T)
    camera = sample_viewpoint(
        rng, elevation_deg=(5.0, 80.0) if protocol == "noisy" else (20.0, 60.0), target=placed.bounds.mean(axis=0)
    )
    K = intrinsics(320, 240, 35.0)
    image, index = render_mesh_view([placed], T_world_camera=camera, K=K, width=320, height=240, table_height=height)
    if protocol == "hidden":
        image, index = _behind_a_board(image, index, rng)
    image = apply_sensor(image, _NOISY if protocol == "noisy" else SensorModel.gaussian(noise_m), rng)
    return ObjectView(placed, T, cloud_of(image, (index == 0) & (image.depth_m > 0)))


def _fallen(rng: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3) that turns a standing object upside down or onto any side."""
    if rng.random() < 0.5:
        return rest_rotation("upside_down")
    return rest_rotation("lying", rng.uniform(0, 2 * np.pi))


def _behind_a_board(image: DepthImage, index: np.ndarray, rng: np.random.Generator) -> tuple[DepthImage, np.ndarray]:
    along = across_edge(index.shape, rng.uniform(0, 2 * np.pi))
    board = along < np.median(along[index == 0])
    depth = np.where(board, image.depth_m[index == 0].min() - _BOARD_M, image.depth_m)
    return DepthImage(depth.astype(np.float32), image.K, image.T_world_camera), np.where(board, 1, index)


def in_sight(mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    """(n,) bool, which points (n, 3) on a mesh's surface, with their normals, nothing hides from a viewpoint."""
    sight = viewpoint - points
    facing = np.einsum("ni,ni->n", sight, normals) > 0
    distance, _, _ = cast_rays([(np.asarray(mesh.vertices), np.asarray(mesh.faces))], points + _LIFT_M * normals, sight)
    return facing & ~np.isfinite(distance)


def extents_of(view: ObjectView) -> np.ndarray:
    """(3,) m, extents along the axes of the object as it stands."""
    upright = apply_T(invert_T(view.T_world_object), np.asarray(view.mesh.vertices))
    return np.ptp(upright, axis=0)
