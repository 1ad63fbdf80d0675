"""A car-like body of 4 m with modes, and what a LiDAR sees of it: for things far larger than a table holds."""

from functools import lru_cache

import numpy as np
import trimesh

from gfp_grasp.camera import cast_rays
from gfp_grasp.transforms import apply_T, make_T
from gfp_grasp.types import OUTSIDE, GenericPrimitive, PointCloud, RangeImage, Symmetry

LENGTH_M = 4.0


@lru_cache(maxsize=1)
def car_primitive() -> GenericPrimitive:
    """A box with a cabin behind its middle; its modes raise the cabin, and lengthen the hood against the tail."""
    body = trimesh.creation.box(bounds=[[-2.0, -0.85, 0.2], [2.0, 0.85, 0.8]])
    cabin = trimesh.creation.box(bounds=[[-1.4, -0.7, 0.7], [0.7, 0.7, 1.45]])
    mesh = _refined(trimesh.boolean.union([body, cabin], engine="manifold"), 0.35)
    vertices = np.asarray(mesh.vertices) - [0.0, 0.0, 0.2]
    x, _, z = vertices.T
    modes = np.zeros((2, len(vertices), 3))
    modes[0, :, 2] = 0.08 * np.clip((z - 0.6) / 0.65, 0.0, 1.0)
    modes[1, :, 0] = 0.1 * np.cos(np.pi * x / 4.0)
    rng = np.random.default_rng(0)
    return GenericPrimitive(
        category="toy_car",
        vertices=vertices,
        faces=np.asarray(mesh.faces),
        modes=modes,
        explained=np.array([0.6, 0.4]),
        log_scale_cov=np.diag([0.1, 0.05, 0.06]) ** 2,
        coefficient_samples=rng.normal(size=(40, 5)) * [1.0, 1.0, 0.1, 0.05, 0.06],
        symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), 1, np.array([0.0, 1.0, 0.0])),
        up=np.array([0.0, 0.0, 1.0]),
        regions=np.full(len(vertices), OUTSIDE, dtype=np.uint8),
        licence="made for tests",
    )


def scanned(mesh: trimesh.Trimesh, T_world_object: np.ndarray, *, seed: int = 0) -> tuple[PointCloud, RangeImage]:
    """Points of a mesh, and the scan, of 64 rings at 1.73 m above z = 0, with 2 cm of noise and the road in view."""
    rings = np.radians(np.linspace(2.0, -24.8, 64))
    sensor = make_T(None, (0.0, 0.0, 1.73))
    shape = (64, 2250)
    empty = RangeImage(np.zeros(shape), rings, np.pi, sensor)
    row, column = np.indices(shape)
    ends = empty.unproject(np.stack([column, row], axis=-1), np.ones(shape)).reshape(-1, 3)
    rays = ends - empty.viewpoint
    vertices = apply_T(T_world_object, np.asarray(mesh.vertices))
    hit, _, _ = cast_rays([(vertices, np.asarray(mesh.faces))], empty.viewpoint, rays)
    with np.errstate(divide="ignore"):
        road = np.where(rays[:, 2] < 0, -1.73 / rays[:, 2], np.inf)
    seen = np.minimum(hit, np.where(road < 60.0, road, np.inf))
    noisy = seen + np.random.default_rng(seed).normal(scale=0.02, size=len(seen))
    scan = RangeImage(np.where(np.isfinite(seen), noisy, 0.0).reshape(shape), rings, np.pi, sensor)
    points = scan.points().reshape(-1, 3)[hit < road]
    return PointCloud(points, scan.viewpoint), scan


def _refined(mesh: trimesh.Trimesh, edge_m: float) -> trimesh.Trimesh:
    """The same solid with edges of at most edge_m, without T-junctions."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64))
    )
    fine = solid.refine_to_length(edge_m).to_mesh64()
    return trimesh.Trimesh(fine.vert_properties[:, :3], fine.tri_verts.astype(np.int64), process=False)
