"""Things in given boxes of a scan: which points are theirs, what they stand on, and that a street is completed."""

import numpy as np
import pytest

from gfp_grasp import complete_scene
from gfp_grasp.camera import HDL_64, range_image, scan_meshes
from gfp_grasp.detect import GivenBoxes
from gfp_grasp.errors import InvalidOption, InvalidView, NothingDetected
from gfp_grasp.scenes import draw_street, scan_street
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, OrientedBox, RangeImage

TILT = make_T(rotation_about((0, 1, 0), np.deg2rad(4)), (0.0, 0.0, 0.0))  # a road that goes down ahead
PLACES = [(9.0, 3.0, 0.4), (12.0, -3.5, 2.9), (60.0, 0.0, 0.0)]


@pytest.fixture(scope="module")
def scan() -> tuple[RangeImage, list[OrientedBox]]:
    """A car, a van and a car so far that no box of it holds 30 points, on a road with a slope."""
    meshes, boxes = [], []
    for number, (x, y, yaw) in enumerate(PLACES):
        mesh = make_shape("van" if number == 1 else "car", number).mesh.copy()
        middle = np.asarray(mesh.bounds).mean(axis=0)
        T = TILT @ make_T(rotation_about((0, 0, 1), yaw), (x, y, 0.0))
        boxes.append(OrientedBox(T @ make_T(None, middle), mesh.extents + 0.1))
        meshes.append(mesh.apply_transform(T))
    ground = draw_street(np.random.default_rng(0), num_things=0).surroundings
    slab = ground[0].copy().apply_transform(TILT)
    T_sensor = TILT @ make_T(None, (0, 0, HDL_64.height_m))
    road = OrientedBox(TILT, np.array([120.0, 40.0, 0.02]))
    import trimesh

    plane = trimesh.creation.box(road.extents).apply_transform(TILT @ make_T(None, (0, 0, -0.01)))
    image, _ = scan_meshes([*meshes, plane, slab], T_world_sensor=T_sensor, rng=np.random.default_rng(1))
    return image, boxes


def test_each_box_has_its_own_points_and_stands_on_the_road_below_it(scan):
    image, boxes = scan
    found = GivenBoxes(boxes)(image, up=None)
    assert len(found) == 2  # the far car has too few points
    for detection, box in zip(found, boxes[:2], strict=True):
        local = apply_T(invert_T(box.T_world_box), detection.cloud.points)
        assert (np.abs(local) <= box.extents / 2 + 1e-9).all()
        assert detection.support is not None
        np.testing.assert_allclose(detection.support.normal, TILT[:3, 2], atol=0.02)
        heights = detection.support.distances(detection.cloud.points)
        assert 0.05 < heights.min() < 0.3  # without the road
        foot = box.T_world_box[:3, 3] - box.extents[2] / 2 * TILT[:3, 2]
        assert detection.support.distances(foot[None])[0] == pytest.approx(-0.05, abs=0.08)
        assert detection.mask is not None
        assert detection.mask.sum() == len(detection.cloud.points)
        assert detection.view is image


def test_classes_may_be_given_with_the_boxes(scan):
    image, boxes = scan
    found = GivenBoxes(boxes, ["car", "", "bus"])(image, up=None)
    assert sorted(detection.category for detection in found) == ["", "car"]
    with pytest.raises(InvalidOption, match="1 categories for 3 boxes"):
        GivenBoxes(boxes, ["car"])


def test_boxes_elsewhere_and_pictures_are_refused(scan):
    image, boxes = scan
    far = [OrientedBox(make_T(None, (0.0, 0.0, 50.0)), np.ones(3))]
    with pytest.raises(NothingDetected, match="none of 1 boxes holds 30 points"):
        GivenBoxes(far)(image, up=None)
    picture = DepthImage(np.ones((4, 4)), np.eye(3), np.eye(4))
    with pytest.raises(InvalidView, match="DepthImage; a gfp_grasp"):
        GivenBoxes(boxes)(picture, up=None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidView, match="looks at depth pictures, not at scans"):
        complete_scene(image, detector="tabletop")


def test_a_street_is_completed_from_its_boxes():
    rng = np.random.default_rng(3)
    street = draw_street(rng, num_things=8)
    image, index = scan_street(street, rng)
    seen = [i for i in range(len(street.things)) if (index == i).sum() > 300][:3]
    boxes = [street.things[i].box for i in seen]
    scene = complete_scene(image, detector=GivenBoxes(boxes, [street.things[i].category for i in seen]))
    assert len(scene) == len(seen) >= 2
    assert scene.view is image
    for completion in scene:
        middle = completion.mesh.bounds.mean(axis=0)
        off_m = [np.linalg.norm((box.T_world_box[:3, 3] - middle)[:2]) for box in boxes]
        assert min(off_m) < 1.0
        nearest = boxes[int(np.argmin(off_m))]
        assert np.ptp(completion.mesh.vertices[:, 2]) == pytest.approx(nearest.extents[2], rel=0.2)
        assert completion.mesh.bounds[0, 2] == pytest.approx(0.0, abs=0.2)


def test_a_list_of_points_becomes_the_picture_that_it_came_from():
    ball = make_shape("car", 0).mesh.copy().apply_translation((12.0, 1.0, 0.0))
    T = make_T(None, (0.5, 0.0, 1.7))
    image, _ = scan_meshes([ball], T_world_sensor=T, ground_m=0.0)
    points = image.points().reshape(-1, 3)
    listed = points[np.isfinite(points).all(axis=1)][::-1]
    again = range_image(np.concatenate([listed, listed * 1.0 + 0.0]), T_world_sensor=T)
    np.testing.assert_allclose(again.range_m, image.range_m, atol=1e-4)
    behind = range_image(np.concatenate([listed, T[:3, 3] + 2 * (listed - T[:3, 3])]), T_world_sensor=T)
    np.testing.assert_allclose(behind.range_m, image.range_m, atol=1e-4)
