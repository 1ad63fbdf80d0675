"""Support, clusters, the single object, boxes, noise and what is refused, on scenes whose truth is known."""

import time
import warnings

import numpy as np
import pytest
import torch
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view
from gfp_grasp.detect import (
    DetectConfig,
    clean_cloud,
    detect_objects,
    detect_single,
    estimate_sigma,
    find_support,
    label_points,
    upright_box,
)
from gfp_grasp.errors import InvalidCloud, InvalidOption, InvalidView, NothingDetected, TooFewPoints
from gfp_grasp.transforms import apply_T, look_at, make_T, random_rotation, rotation_about
from gfp_grasp.types import DepthImage, PointCloud, SensorProfile, SupportPlane, get_sensor

UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([0.5, -0.3, 0.5])


def _cylinder(x: float, y: float, *, radius=0.035, height=0.12, z=0.0) -> trimesh.Trimesh:
    mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=48)
    mesh.apply_translation([x, y, z + height / 2])
    return mesh


def _render(meshes, *, table_height: float | None = 0.0, eye=EYE) -> tuple[DepthImage, np.ndarray]:
    return render_mesh_view(
        meshes,
        T_world_camera=look_at(eye, (0.0, 0.0, (table_height or 0.0) + 0.04)),
        K=intrinsics(240, 180, 45.0),
        width=240,
        height=180,
        table_height=table_height,
    )


@pytest.fixture(scope="module")
def scene() -> tuple[DepthImage, np.ndarray]:
    image, index = _render([_cylinder(0.0, 0.0), _cylinder(0.05, 0.15, height=0.08), _cylinder(-0.15, 0.0, height=0.2)])
    return apply_sensor(image, SensorModel.gaussian(0.001), np.random.default_rng(0)), index


def _points(image: DepthImage) -> np.ndarray:
    points = image.points()
    return points[np.isfinite(points).all(axis=2)]


def test_the_table_is_found_within_a_millimetre_and_half_a_degree(scene):
    plane = find_support(_points(scene[0]), UP)
    assert plane is not None
    assert abs(plane.height_m) < 0.001
    assert plane.normal @ UP > np.cos(np.radians(0.5))


def test_the_table_turns_with_the_scene_and_is_found_without_up(scene):
    camera_from_world = np.linalg.inv(scene[0].T_world_camera)
    plane = find_support(apply_T(camera_from_world, _points(scene[0])), None)
    assert plane is not None
    np.testing.assert_allclose(plane.normal, camera_from_world[:3, 2], atol=0.01)


def test_the_same_cloud_has_the_same_table(scene):
    first, again = (find_support(_points(scene[0]), UP) for _ in range(2))
    assert first is not None
    assert again is not None
    assert first.height_m == again.height_m


@pytest.mark.parametrize(
    "mesh", [trimesh.creation.box((0.1, 0.15, 0.2)), _cylinder(0, 0), trimesh.creation.box((0.2, 0.1, 0.02))]
)
@pytest.mark.parametrize("up", [UP, None])
def test_an_object_alone_has_no_table(mesh, up):
    image, index = _render([mesh], table_height=None)
    local = apply_T(np.linalg.inv(image.T_world_camera), cloud_of(image, index == 0).points)
    assert find_support(local if up is None else cloud_of(image, index == 0).points, up) is None


def test_the_floor_of_a_cup_is_not_its_table():
    profile = [[0, 0], [0.035, 0], [0.04, 0.09], [0.037, 0.09], [0.032, 0.004], [0, 0.004]]
    image, index = _render([trimesh.creation.revolve(profile, sections=48)], eye=np.array([0.05, 0.1, 0.5]))
    assert find_support(cloud_of(image, index == 0).points, UP) is None


def test_a_box_top_is_not_the_table():
    image, _ = _render([trimesh.creation.box((0.3, 0.3, 0.1), transform=make_T(None, (0, 0, 0.05)))])
    plane = find_support(_points(image), UP)
    assert plane is not None
    assert abs(plane.height_m) < 0.002


def test_every_object_of_a_picture_is_found(scene):
    image, index = scene
    found = detect_objects(image)
    assert len(found) == 3
    for k in range(3):
        truth = index == k
        assert max((truth & d.mask).sum() / (truth | d.mask).sum() for d in found) > 0.85
    sizes = [len(d.cloud.points) for d in found]
    assert sizes == sorted(sizes, reverse=True)


def test_every_object_of_a_bare_cloud_is_found(scene):
    found = detect_objects(PointCloud(_points(scene[0]), EYE))
    assert len(found) == 3
    assert {d.view for d in found} == {None}


def test_a_box_on_a_slab_is_two_objects_and_a_cap_on_a_bottle_one():
    slab = trimesh.creation.box((0.2, 0.2, 0.04), transform=make_T(None, (0, 0, 0.02)))
    box = trimesh.creation.box((0.05, 0.08, 0.12), transform=make_T(None, (0.0, 0.0, 0.10)))
    assert len(detect_objects(_render([slab, box])[0])) == 2
    bottle, cap = _cylinder(0, 0, height=0.16), _cylinder(0, 0, radius=0.012, height=0.03, z=0.16)
    assert len(detect_objects(_render([bottle, cap])[0])) == 1


def test_labels_move_with_a_rigid_motion(scene):
    points = _points(scene[0])
    T = make_T(random_rotation(np.random.default_rng(1)), (0.3, -0.2, 0.1))
    plane = SupportPlane(UP, 0.0)
    normal = T[:3, :3] @ UP
    moved = SupportPlane(normal, float(normal @ T[:3, 3]))
    # The grid of cells does not turn along, so a few points at the rims may differ.
    same = label_points(points, plane) == label_points(apply_T(T, points), moved)
    assert same.mean() > 0.995


def test_nothing_on_a_table_is_said():
    with pytest.raises(NothingDetected, match=r"100% of the picture is one plane, .* as an empty table is"):
        detect_objects(_with_table_only())
    with pytest.raises(NothingDetected, match="no support plane"):
        detect_objects(_render([_cylinder(0, 0)], table_height=None)[0])


def _with_table_only() -> DepthImage:
    image, _ = _render([_cylinder(0, 0)])
    empty, _ = _render([_cylinder(5.0, 5.0)])
    # A thin crumb, below the least surface of an object, makes the plane a support without an object on it.
    depth = empty.depth_m.copy()
    depth[88:92, 118:122] = image.depth_m[88:92, 118:122]
    depth[85:95, 115:118] -= 0.03
    return DepthImage(depth, image.K, image.T_world_camera)


def test_table_around_a_single_object_is_taken_off():
    image, _ = _render([_cylinder(0.0, 0.0, z=0.37)], table_height=0.37)
    points = _points(image)
    near = points[np.linalg.norm(points[:, :2], axis=1) < 0.08]
    detection = detect_single(near, viewpoint=EYE, category="cup")
    assert detection.support is not None
    assert abs(detection.support.height_m - 0.37) < 0.002
    assert detection.cloud.points[:, 2].min() > 0.37
    assert detection.scores == {"cup": 1.0}


def test_a_given_support_height_is_kept():
    image, index = _render([_cylinder(0.0, 0.0, z=0.2)], table_height=0.2)
    detection = detect_single(cloud_of(image, index == 0).points, support_height=0.2, category="cup")
    assert detection.support is not None
    assert detection.support.height_m == 0.2


def test_a_view_without_mask_gets_the_pixels_of_the_points():
    image, index = _render([_cylinder(0.0, 0.0)])
    seen = index == 0
    detection = detect_single(cloud_of(image, seen).points, view=image, category="cup")
    assert detection.mask is not None
    assert (detection.mask & ~seen).sum() == 0
    assert detection.mask.sum() > 0.85 * seen.sum()
    assert detection.cloud.viewpoint is not None
    np.testing.assert_allclose(detection.cloud.viewpoint, EYE)


def test_a_mask_without_a_view_is_refused():
    with pytest.raises(InvalidView, match="without its view"):
        detect_single(np.random.default_rng(0).normal(size=(100, 3)), mask=np.ones((2, 2), bool))


def test_flying_pixels_are_taken_off():
    rng = np.random.default_rng(0)
    image, index = _render([_cylinder(0.0, 0.0)])
    body = cloud_of(image, index == 0).points
    flying = rng.uniform((-0.15, -0.15, 0.02), (0.15, 0.15, 0.25), size=(len(body) // 20, 3))
    detection = detect_single(np.vstack([body, flying]), support_height=0.0, category="cup")
    radius = np.linalg.norm(detection.cloud.points[:, :2], axis=1)
    assert np.quantile(radius, 0.99) < 0.04
    assert len(detection.cloud.points) > 0.9 * (body[:, 2] > 0.006).sum()


def test_two_clusters_warn_and_two_far_apart_are_refused():
    image, index = _render([_cylinder(0.0, 0.0), _cylinder(0.0, 0.14)])
    points = cloud_of(image, index <= 1).points
    with pytest.warns(UserWarning, match="2 clusters"):
        detection = detect_single(points, support_height=0.0, category="cup")
    assert np.ptp(detection.cloud.points[:, 1]) < 0.1
    apart = np.vstack([points, points + np.array([0.7, 0.0, 0.0])])
    with pytest.raises(InvalidCloud, match="clusters"):
        detect_single(apart, support_height=0.0, category="cup")


def test_a_giant_is_refused_with_a_hint_at_its_unit():
    points = trimesh.creation.box((2.0, 1.0, 1.0)).sample(40_000)
    with pytest.raises(InvalidCloud, match=r"at most 1.5 is expected: in inches .* in centimetres it would be 0.02 m"):
        detect_single(np.asarray(points), support_height=-1.0, category="cup")


def test_nothing_above_a_wrong_height_is_said():
    points = np.asarray(_cylinder(0, 0).sample(2000))
    with pytest.raises(
        NothingDetected, match="of the 2000 points hang together above the support: is its height right"
    ):
        detect_single(points, support_height=0.5, category="cup")


def test_five_million_points_take_less_than_four_seconds():
    rng = np.random.default_rng(0)
    body = np.tile(np.asarray(_cylinder(0, 0).sample(50_000)), (50, 1))
    table = np.column_stack([rng.uniform(-0.4, 0.4, (2_500_000, 2)), np.zeros(2_500_000)])
    cloud = np.vstack([body, table]) + rng.normal(scale=0.001, size=(5_000_000, 3))
    start = time.perf_counter()
    detection = detect_single(clean_cloud(cloud), category="bottle")
    assert time.perf_counter() - start < 4.0  # about half of one on an idle machine
    np.testing.assert_allclose(detection.box.extents, (0.07, 0.07, 0.12), atol=0.02)


def test_the_box_of_a_turned_box_is_that_box():
    extents = np.array([0.2, 0.1, 0.3])
    R = rotation_about(UP, 0.4)
    corners = trimesh.creation.box(extents).vertices @ R.T + (0.1, 0.2, 0.3)
    box = upright_box(corners, UP)
    np.testing.assert_allclose(box.extents, extents, atol=1e-9)
    np.testing.assert_allclose(box.T_world_box[:3, 3], (0.1, 0.2, 0.3), atol=1e-9)
    np.testing.assert_allclose(np.abs(box.T_world_box[:3, :3].T @ R), np.eye(3), atol=1e-9)
    assert np.linalg.det(box.T_world_box[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("up", [UP, np.array([0.3, -0.5, 0.8]), -UP])
def test_every_point_is_in_the_box_whose_z_is_up(up):
    up = up / np.linalg.norm(up)
    points = np.random.default_rng(0).normal(size=(200, 3))
    box = upright_box(points, up)
    local = (points - box.T_world_box[:3, 3]) @ box.T_world_box[:3, :3]
    assert (np.abs(local) <= box.extents / 2 + 1e-9).all()
    np.testing.assert_allclose(box.T_world_box[:3, 2], up, atol=1e-9)
    assert box.extents[0] >= box.extents[1]


@pytest.mark.parametrize("sigma_m", [0.001, 0.002, 0.004])
def test_noise_is_read_off_the_cloud(sigma_m):
    image, index = _render([_cylinder(0.0, 0.0)])
    noisy = apply_sensor(image, SensorModel.gaussian(sigma_m), np.random.default_rng(0))
    points = cloud_of(noisy, index == 0).points
    assert estimate_sigma(points, EYE) == pytest.approx(sigma_m, rel=0.35)


@pytest.mark.parametrize(
    "wrap",
    [
        lambda p: p.tolist(),
        lambda p: torch.tensor(p, requires_grad=True),
        lambda p: trimesh.PointCloud(p),
        lambda p: trimesh.Trimesh(p, np.zeros((0, 3), int), process=False),
        lambda p: PointCloud(p),
        lambda p: type("OpenLike", (), {"points": [tuple(row) for row in p]})(),
    ],
)
def test_every_kind_of_cloud_comes_out_as_float64(wrap):
    points = np.random.default_rng(0).normal(scale=0.05, size=(100, 3))
    out = clean_cloud(wrap(points))
    assert out.dtype == np.float64
    np.testing.assert_array_equal(out, points)


def test_rows_that_are_not_finite_are_dropped_and_counted():
    points = np.random.default_rng(0).normal(scale=0.05, size=(100, 3))
    points[3, 1], points[7, 0] = np.nan, np.inf
    with pytest.warns(UserWarning, match="2 of 100"):
        out = clean_cloud(points)
    np.testing.assert_array_equal(out, np.delete(points, [3, 7], axis=0))


@pytest.mark.parametrize("cloud", [[], np.zeros((0, 3)), np.full((50, 3), np.nan), np.zeros((5, 3)) + np.eye(5, 3)])
def test_too_few_points_are_refused(cloud):
    with pytest.raises(TooFewPoints):
        clean_cloud(cloud)


@pytest.mark.parametrize(
    ("cloud", "message"),
    [
        ("mug.ply", "str"),
        (None, "NoneType"),
        (np.zeros((10, 4)), r"\(10, 4\)"),
        (np.zeros((480, 640, 3)), "reshape"),
        ([["a", "b", "c"]] * 40, "numbers"),
        ([[1, 2], [3]], "array of numbers"),
        (np.ones((40, 3), dtype=complex), "complex"),
        (object(), "numbers"),
        (np.ones((40, 3)), "same point"),
        (np.linspace(0, 1, 50)[:, None] * (1.0, 2.0, 3.0), "line"),
        (np.random.default_rng(0).random((50, 3)) * (1, 1, 0), "plane"),
        (np.random.default_rng(0).random((50, 3)) * 90, "1000"),
    ],
)
def test_what_is_no_cloud_is_refused_by_name(cloud, message):
    with pytest.raises(InvalidCloud, match=message):
        clean_cloud(cloud)


def test_the_noisy_broad_side_of_a_flat_bottle_is_a_cloud():
    rng = np.random.default_rng(0)
    side = np.column_stack([rng.uniform(0, 0.1, 3000), rng.uniform(0, 0.2, 3000), rng.normal(scale=0.001, size=3000)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(clean_cloud(side)) == 3000


@pytest.mark.parametrize(
    "make",
    [
        lambda: DetectConfig(max_points=1),
        lambda: SensorProfile("backwards", sigma_m=0.1, farthest_m=1.0, scene_m=1.0, largest_m=1.0, smallest_m=0.01),
        lambda: SensorProfile("blind", sigma_m=0.001, farthest_m=0.0, scene_m=1.0, largest_m=1.0, smallest_m=0.01),
        lambda: get_sensor("sonar"),
    ],
)
def test_nonsense_in_a_config_is_refused(make):
    with pytest.raises(InvalidOption):
        make()
