"""A car's cloud from a LiDAR: checked, registered, deformed and marked, with a toy primitive for its class."""

import numpy as np
import pytest
import trimesh
from toy_car import LENGTH_M, car_primitive, scanned

from gfp_grasp import complete_to_mesh
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.errors import InvalidCloud
from gfp_grasp.meshes import sample_surface
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import TABLETOP

YAW_RAD = 2.2
T_WORLD_CAR = make_T(rotation_about((0, 0, 1), YAW_RAD), (12.0, -9.0, 0.0))  # 15 m away
TRUE_SCALE = np.array([1.1, 0.96, 1.04])


@pytest.fixture(scope="module")
def true_car() -> trimesh.Trimesh:
    primitive = car_primitive()
    vertices = primitive.shape(np.array([1.2, -0.8]), TRUE_SCALE)
    return trimesh.Trimesh(vertices, primitive.faces, process=False)


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> CompleteConfig:
    folder = tmp_path_factory.mktemp("gps")
    save_primitive(car_primitive(), folder)
    return CompleteConfig(library=PrimitiveLibrary(folder))


def test_car_at_fifteen_metres_is_completed_in_its_own_size(true_car, config) -> None:
    cloud, scan = scanned(true_car, T_WORLD_CAR)
    assert 300 < len(cloud.points) < 5000
    done = complete_to_mesh(
        cloud.points,
        viewpoint=cloud.viewpoint,
        view=scan,
        support_height=0.0,
        category="toy_car",
        sensor="lidar",
        config=config,
    )
    assert done.category == "toy_car"
    assert done.mesh.is_volume
    assert done.detection.sensor.name == "lidar"
    assert 0.007 < done.detection.sensor_sigma_m < 0.06
    truth = apply_T(T_WORLD_CAR, sample_surface(true_car, 4000, np.random.default_rng(0))[0])
    distance = np.abs(trimesh.proximity.signed_distance(done.mesh, truth))
    assert distance.mean() < 0.1
    assert done.mesh.bounds[0, 2] == pytest.approx(0.0, abs=0.08)
    extents = np.ptp(apply_T(np.linalg.inv(T_WORLD_CAR), np.asarray(done.mesh.vertices)), axis=0)
    assert extents == pytest.approx(np.ptp(true_car.vertices, axis=0), rel=0.12)
    assert 0.05 < done.observed.mean() < 0.7
    towards = np.asarray(done.mesh.vertices)[done.observed].mean(axis=0) - done.mesh.centroid
    assert towards @ (cloud.viewpoint - done.mesh.centroid) > 0  # what was observed is on the sensor's side
    assert np.median(done.sigma_m[~done.observed]) > np.median(done.sigma_m[done.observed])


def test_cloud_of_a_car_is_refused_as_a_tabletops_with_the_sensor_to_name(true_car, config) -> None:
    cloud, _ = scanned(true_car, T_WORLD_CAR)
    with pytest.raises(
        InvalidCloud, match=r"2 clusters, 1.88 m across.*if a LiDAR saw it, say so \(sensor=\"lidar\"\)"
    ):
        complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, category="toy_car", config=config)
    assert TABLETOP.largest_m < LENGTH_M
