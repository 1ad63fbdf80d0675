"""A car's cloud from a LiDAR: checked, registered, deformed and marked, with a toy primitive for its class."""

import numpy as np
import pytest
import trimesh
from toy_car import LENGTH_M, car_primitive, scanned

from gfp_grasp import complete_to_mesh
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.detect import DetectConfig, detect_single
from gfp_grasp.errors import InvalidCloud
from gfp_grasp.meshes import sample_surface
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, TABLETOP

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


def test_a_side_of_which_few_rings_came_back_stays_a_part_of_the_car() -> None:
    """A back with returns every 7 cm, a dark flank with some every 35 cm, at 14 m; a pole 3 m behind it is apart."""

    def places(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)

    back = places(np.array([14.0]), np.arange(-0.8, 0.81, 0.07), np.arange(0.3, 1.5, 0.07))
    flank = places(np.arange(14.3, 18.0, 0.35), np.array([-0.8]), np.arange(0.4, 1.4, 0.35))
    pole = places(np.array([21.0]), np.array([-0.8]), np.arange(0.3, 2.0, 0.05))
    points, config = np.concatenate([back, flank, pole]), DetectConfig(sensor=LIDAR, classify=False)
    with pytest.warns(UserWarning, match="hang apart"):
        found = detect_single(
            points, viewpoint=np.array([0, 0, 1.73]), up=np.array([0, 0, 1.0]), support_height=0.0, config=config
        )
    assert len(found.cloud.points) == len(back) + len(flank)
    assert np.ptp(found.cloud.points[:, 0]) == pytest.approx(np.ptp(flank[:, 0]) + 0.3)
