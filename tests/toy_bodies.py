"""Bodies without any symmetry, fits of them that stand askew, and detections that are cut from them."""

import math
from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.level import make_level_view
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import (
    Detection,
    FittedPrimitive,
    GenericPrimitive,
    LevelView,
    OrientedBox,
    PointCloud,
    Symmetry,
)

T_WORLD_OBJECT = make_T(rotation_about((1.0, 2.0, 3.0), 1.1), (0.4, -0.7, 0.9))
NO_SYMMETRY = Symmetry(np.array([0.0, 0.0, 1.0]), 1)
ROUND = Symmetry(np.array([0.0, 0.0, 1.0]), math.inf)


def l_body(edge_m: float = 0.012) -> trimesh.Trimesh:
    """An L on end, off the origin, closed, no two of its axes alike; edges of at most edge_m."""
    upright = trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.03, 0.03, 0.1]])
    foot = trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.08, 0.03, 0.02]])
    return refined(trimesh.boolean.union([upright, foot], engine="manifold"), edge_m)


def slab(size=(0.12, 0.08, 0.002), edge_m: float = 0.01) -> trimesh.Trimesh:
    """A flat box about the origin."""
    return refined(trimesh.creation.box(size), edge_m)


def refined(mesh: trimesh.Trimesh, edge_m: float) -> trimesh.Trimesh:
    """The same solid with edges of at most edge_m, without T-junctions."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64))
    )
    fine = solid.refine_to_length(edge_m).to_mesh64()
    made = trimesh.Trimesh(fine.vert_properties[:, :3], fine.tri_verts.astype(np.int64), process=False)
    assert made.is_volume
    return made


def primitive_of(mesh: trimesh.Trimesh, *, symmetry: Symmetry = NO_SYMMETRY, regions=None) -> GenericPrimitive:
    """A primitive without modes whose mean is the mesh."""
    vertices = np.asarray(mesh.vertices)
    return GenericPrimitive(
        category="toy",
        vertices=vertices,
        faces=np.asarray(mesh.faces),
        modes=np.zeros((0, *vertices.shape)),
        explained=np.zeros(0),
        log_scale_cov=np.eye(3),
        coefficient_samples=np.zeros((0, 3)),
        symmetry=symmetry,
        up=np.array([0.0, 0.0, 1.0]),
        regions=np.zeros(len(vertices), np.uint8) if regions is None else regions,
    )


def fit_of(primitive: GenericPrimitive, T: np.ndarray = T_WORLD_OBJECT, scale=(1.0, 1.0, 1.0)) -> FittedPrimitive:
    """The primitive at a pose, its modes at their mean."""
    return FittedPrimitive(primitive, T, np.asarray(scale), np.zeros(len(primitive.modes)), 0.001)


def detection_of(points, viewpoint=None, *, T: np.ndarray = T_WORLD_OBJECT, sensor_sigma_m: float = 0.001) -> Detection:
    """A detection of points (n, 3) m and a viewpoint in the object's frame, put into the world by T."""
    points = apply_T(T, np.asarray(points))
    return Detection(
        cloud=PointCloud(points, None if viewpoint is None else apply_T(T, np.asarray(viewpoint))),
        up=T[:3, 2],
        support=None,
        category="toy",
        scores={"toy": 1.0},
        box=OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0)),
        sensor_sigma_m=sensor_sigma_m,
    )


def view_of(points, viewpoint=None, *, sensor_sigma_m: float = 0.001) -> LevelView:
    """What was seen of points (n, 3) m and a viewpoint in the object's frame, in the frame of `fit_of`."""
    view = make_level_view(detection_of(points, viewpoint, sensor_sigma_m=sensor_sigma_m))
    return moved_view(view, view.T_world_level)


def moved_view(view: LevelView, T: np.ndarray) -> LevelView:
    """A view in another frame, which is level no more and has no silhouette: the deformation does not ask."""
    place = view.viewpoint
    return replace(
        view,
        T_world_level=view.T_world_level @ invert_T(T),
        cloud=PointCloud(apply_T(T, view.cloud.points), None if place is None else apply_T(T, place)),
        dense_points=apply_T(T, view.dense_points),
        dense_normals=view.dense_normals @ T[:3, :3].T,
        points=apply_T(T, view.points),
        normals=view.normals @ T[:3, :3].T,
        silhouette=None,
    )


def dense_laplacian(faces, count) -> np.ndarray:
    """Each vertex minus the mean of its neighbours, edge by edge."""
    near = [set() for _ in range(count)]
    for a, b, c in faces:
        near[a] |= {b, c}
        near[b] |= {a, c}
        near[c] |= {a, b}
    L = np.eye(count)
    for i, others in enumerate(near):
        L[i, list(others)] -= 1 / len(others)
    return L
