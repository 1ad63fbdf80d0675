"""A small street, made by hand: three boxes on a road that a LiDAR saw, each completed as what it is."""

import numpy as np
import trimesh

from gfp_grasp.camera import LidarModel, scan_meshes
from gfp_grasp.completion import CompletedScene, Completion
from gfp_grasp.types import (
    LIDAR,
    CollisionMesh,
    CompletedShape,
    ConvexPart,
    Detection,
    OrientedBox,
    PointCloud,
    SupportPlane,
)

ROAD_M = -1.73
COARSE = LidarModel(elevation_deg=tuple(np.linspace(2, -24, 32).tolist()), columns=500)
# Class, size and middle of each: a car ahead to the left, another to the right, a person behind.
THINGS = (
    ("car", (4.0, 1.8, 1.6), (9.0, 3.0)),
    ("car", (4.0, 1.8, 1.6), (7.0, -5.0)),
    ("pedestrian", (0.6, 0.6, 1.8), (-6.0, 2.0)),
)


def toy_street(*, raised_m: float = 0.0) -> CompletedScene:
    """The scene; the road under the first box is so much higher than elsewhere."""
    floors = [ROAD_M + raised_m, ROAD_M, ROAD_M]
    boxes = [
        trimesh.creation.box(size).apply_translation((*place, floor + size[2] / 2))
        for (_, size, place), floor in zip(THINGS, floors, strict=True)
    ]
    scan, index = scan_meshes(boxes, T_world_sensor=np.eye(4), lidar=COARSE, ground_m=ROAD_M)
    made = []
    for number, ((category, size, _), box, floor) in enumerate(zip(THINGS, boxes, floors, strict=True)):
        mask = (index == number) & (scan.range_m > 0)
        mesh = box.subdivide().subdivide()
        towards = -mesh.bounds.mean(axis=0)
        shape = CompletedShape(
            mesh=mesh,
            observed=(np.asarray(mesh.vertices) - mesh.bounds.mean(axis=0)) @ towards > 0,
            sigma_m=np.full(len(mesh.vertices), 0.05),
            fit=None,
            timings_s={"register": 0.5},
        )
        detection = Detection(
            cloud=PointCloud(scan.points()[mask], np.zeros(3)),
            up=np.array([0.0, 0.0, 1.0]),
            category=category,
            scores={category: 0.9},
            support=SupportPlane(np.array([0.0, 0.0, 1.0]), floor),
            view=scan,
            mask=mask,
            sensor=LIDAR,
            box=OrientedBox(np.eye(4), np.array(size)),
        )
        completion = Completion(shape, detection)
        part = ConvexPart(box.vertices, box.faces)
        completion.__dict__["collision"] = CollisionMesh((part,), (0.0, 0.0, 0.0), "cuts", 0.0, {})
        made.append(completion)
    return CompletedScene(tuple(made), scan, made[1].detection.support)
