"""Depth of bare meshes by Embree's rays: no OpenGL, no simulator, both sides of every face are seen."""

from collections.abc import Sequence

import numpy as np
import trimesh

from gfp_grasp.camera.pinhole import pixel_rays
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import DepthImage

# Beyond this a desk-top depth camera returns nothing; it also ends the table, which is a whole plane.
FARTHEST_M = 3.0

_LIFT = 1 / 300  # a ray to the viewpoint starts this far off its own surface, as a share of the surface's diagonal


def render_mesh_view(
    meshes: Sequence[trimesh.Trimesh],
    *,
    T_world_camera: np.ndarray,
    K: np.ndarray,
    width: int,
    height: int,
    table_height: float | None = None,
    farthest_m: float = FARTHEST_M,
) -> tuple[DepthImage, np.ndarray]:
    """An ideal depth picture of meshes, and of a horizontal table under them.

    Args:
        meshes: World frame, m; open meshes are seen from both sides.
        T_world_camera: (4, 4), OpenCV camera.
        K: (3, 3) px.
        width: Columns.
        height: Rows.
        table_height: z of the table, m; None leaves it out.
        farthest_m: Nothing farther along the optical axis is returned.

    Returns:
        The picture, and index (h, w) int32 of the mesh that each pixel saw: len(meshes) is the table, -1 nothing.

    Raises:
        InvalidMesh: A vertex is not finite or a face index points outside (Embree would crash on it).
    """
    T_camera_world = invert_T(T_world_camera)
    rays = pixel_rays(K, width, height).reshape(-1, 3)
    seen = []
    for number, mesh in enumerate(meshes):
        vertices, faces = checked_mesh(mesh, number)
        seen.append((apply_T(T_camera_world, vertices), faces))
    depth, _, index = cast_rays(seen, np.zeros(3), rays)
    if table_height is not None:
        table = table_depth(rays, T_camera_world, table_height)
        index = np.where(table < depth, len(meshes), index)
        depth = np.minimum(depth, table)
    lost = depth > farthest_m
    depth, index = np.where(lost, 0.0, depth), np.where(lost, -1, index)
    image = DepthImage(depth.reshape(height, width), K, T_world_camera)
    return image, index.reshape(height, width).astype(np.int32)


def cast_rays(
    meshes: Sequence[tuple[np.ndarray, np.ndarray]], origins: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First hit of each ray on several meshes.

    Args:
        meshes: Vertices (v, 3) m and faces (f, 3) of each.
        origins: (r, 3) or (3,) m.
        directions: (r, 3), of any length.

    Returns:
        Distances (r,) in units of each direction's length, inf where nothing is hit; the face (r,) int that was hit,
        of its mesh, and the mesh (r,) int; both -1 where nothing is hit. Embree works in float32.
    """
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    directions = np.ascontiguousarray(directions, dtype=np.float32)
    origins = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), dtype=np.float32)
    scene = EmbreeScene(robust=True)  # without it rays slip through shared edges
    solid = [(number, vertices, faces) for number, (vertices, faces) in enumerate(meshes) if len(faces)]
    # Embree numbers its geometries in the order of their making and reads their memory later: they are kept.
    kept = [
        TriangleMesh(scene, np.ascontiguousarray(v, dtype=np.float32), np.ascontiguousarray(f, dtype=np.int32))
        for _, v, f in solid
    ]
    if not kept:
        nothing = np.full(len(directions), -1)
        return np.full(len(directions), np.inf), nothing, nothing.copy()
    hit = scene.run(origins, directions, query="INTERSECT", output=1)
    geometry, missed = hit["geomID"].astype(np.int64), hit["primID"] < 0
    numbers = np.array([number for number, _, _ in solid])
    mesh_of = np.where(missed, -1, numbers[np.where(missed, 0, geometry)])
    distance = np.where(missed, np.inf, hit["tfar"].astype(np.float64))
    return distance, np.where(missed, -1, hit["primID"]).astype(np.int64), mesh_of


def table_depth(rays: np.ndarray, T_camera_world: np.ndarray, table_height: float) -> np.ndarray:
    """How many of their own lengths (r,) rays (r, 3) of a camera go to the plane z = table_height; inf for a miss."""
    up = T_camera_world[:3, 2]
    offset = up @ T_camera_world[:3, 3] + table_height
    slope = rays @ up
    with np.errstate(divide="ignore"):
        depth = offset / slope
    return np.where((depth > 0) & np.isfinite(depth), depth, np.inf)


def checked_mesh(mesh: trimesh.Trimesh, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of a mesh that Embree can be given; its index is for the message."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if not np.isfinite(vertices).all():
        raise InvalidMesh(f"mesh {index} has vertices that are not finite: clean it before it is rendered")
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise InvalidMesh(f"mesh {index} has a face index outside its {len(vertices)} vertices")
    return vertices, faces


def visible_points(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray, viewpoint: np.ndarray
) -> np.ndarray:
    """Points of a mesh's surface that face a viewpoint and that nothing of the mesh hides from it.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), outward.
        points: (n, 3) m, on the surface.
        normals: (n, 3) unit, outward.
        viewpoint: (3,) m, same frame.

    Returns:
        (n,) bool.
    """
    lift_m = _LIFT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    sight = viewpoint - points
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    facing = np.flatnonzero(np.einsum("ni,ni->n", normals, sight) > 0)
    sight = sight[facing]
    hit, _, _ = cast_rays([(vertices, faces)], points[facing] + lift_m * normals[facing] + lift_m * sight, sight)
    visible = np.zeros(len(points), dtype=bool)
    visible[facing] = ~np.isfinite(hit)
    return visible
