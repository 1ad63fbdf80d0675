"""The detector of LiDAR scans, on simulated streets of the test split, whose boxes are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from gfp_grasp.camera import scan_meshes
from gfp_grasp.complete import complete_scene
from gfp_grasp.detect import detect_traffic, find_boxes, get_detector, inside, iou_from_above, thinned
from gfp_grasp.detect.pointrcnn import _with_own_points
from gfp_grasp.errors import InvalidView, NothingDetected
from gfp_grasp.scenes import draw_street, scan_street
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, RangeImage


@pytest.fixture(scope="module")
def street():
    rng = np.random.default_rng(11)
    drawn = draw_street(rng, num_things=24, split="test")
    image, index = scan_street(drawn, rng)
    boxes = np.array(
        [
            [*one.box.T_world_box[:3, 3], *one.box.extents, np.arctan2(*one.box.T_world_box[1::-1, 0])]
            for one in drawn.things
        ]
    )
    return SimpleNamespace(drawn=drawn, image=image, index=index, boxes=boxes)


def seen_points(image: RangeImage) -> np.ndarray:
    return image.points()[image.range_m > 0]


def test_cars_of_many_points_are_found_where_they_are(street):
    boxes, scores, names = find_boxes(seen_points(street.image))
    assert (np.diff(scores) <= 0).all()
    sure = scores > 0.5
    overlap = iou_from_above(boxes[sure], street.boxes)
    cars = [
        n for n, thing in enumerate(street.drawn.things) if thing.category == "car" and (street.index == n).sum() >= 200
    ]
    assert len(cars) >= 4
    assert np.mean([overlap[:, n].max() > 0.5 for n in cars]) >= 0.8
    named_cars = overlap[names[sure] == "car"]
    assert np.mean(named_cars.max(axis=1) > 0.5) >= 0.7
    assert iou_from_above(boxes, boxes)[~np.eye(len(boxes), dtype=bool)].max() <= 0.1


def test_a_detection_holds_the_returns_of_its_thing(street):
    found = detect_traffic(street.image)
    counts = [len(one.cloud.points) for one in found]
    assert counts == sorted(counts, reverse=True)
    assert min(counts) >= 30
    shares = []
    for one in found:
        assert one.mask is not None
        assert one.category == ""
        assert one.sensor.name == "lidar"
        assert one.support is not None
        assert abs(one.support.distances(one.cloud.points).min()) < 0.5
        own = street.index[one.mask]
        shares.append((own == np.bincount(own[own >= 0], minlength=1).argmax()).mean())
    assert np.median(shares) > 0.95
    by_name = get_detector("pointrcnn")(street.image, up=None)
    assert [len(one.cloud.points) for one in by_name] == counts


def test_a_scan_of_another_frame_has_the_same_things(street):
    T = make_T(rotation_about((0, 0, 1), 0.8), (100.0, -20.0, 5.0))
    moved = street.image.moved(T)
    found, same = detect_traffic(street.image), detect_traffic(moved, up=np.array([0.0, 0.0, 1.0]))
    assert len(found) == len(same) >= 8
    for one, other in zip(found, same, strict=True):
        np.testing.assert_allclose(apply_T(invert_T(T), other.cloud.points), one.cloud.points, atol=1e-6)


def test_an_empty_street_and_pictures_are_refused():
    empty, _ = scan_meshes([], T_world_sensor=make_T(None, (0.0, 0.0, 1.73)), ground_m=0.0)
    with pytest.raises(NothingDetected, match="neither vehicle nor person"):
        detect_traffic(empty)
    with pytest.raises(InvalidView, match="DepthImage; a gfp_grasp"):
        detect_traffic(DepthImage(np.ones((4, 4)), np.eye(3), np.eye(4)))  # pyright: ignore[reportArgumentType]
    boxes, scores, names = find_boxes(np.empty((0, 3)))
    assert boxes.shape == (0, 7)
    assert len(scores) == len(names) == 0


def test_what_belongs_to_the_sensor_s_own_vehicle_is_nothing():
    roof = np.random.default_rng(0).uniform((-1.4, -0.8, 0.4), (1.4, 0.8, 1.5), (500, 3))
    assert len(find_boxes(roof)[0]) == 0


def test_of_two_boxes_on_either_side_of_one_flank_the_better_is_kept():
    flank = np.column_stack([np.linspace(8, 12, 50), np.full(50, 3.0), np.full(50, 1.0)])
    end = np.column_stack([np.full(30, 30.0), np.linspace(-1, 1, 30), np.full(30, 1.0)])
    left = np.array([10.0, 3.95, 1.0, 4.2, 2.0, 1.6, 0.0])
    boxes = np.stack([left, left - (0, 1.9, 0, 0, 0, 0, 0), [31.0, 0.0, 1.0, 2.1, 2.1, 1.6, 0.0], left + 50])
    assert iou_from_above(boxes[:1], boxes[1:2])[0, 0] < 0.1
    assert _with_own_points(boxes, np.concatenate([flank, end])).tolist() == [True, False, True, False]


def test_one_point_of_each_decimetre_is_looked_at():
    points = np.array([[0.01, 0.01, 0.01], [0.04, 0.02, 0.09], [0.11, 0.01, 0.01], [-0.01, 0.01, 0.01]])
    assert sorted(thinned(points).tolist()) in ([0, 2, 3], [1, 2, 3])


def test_a_whole_scan_is_completed_by_default(street):
    """At least half of the clearly seen things come back near their true size."""
    scene = complete_scene(street.image)
    assert len(scene) >= 8
    right = 0
    for done in scene:
        middle = np.asarray(done.mesh.bounds).mean(axis=0)
        nearest = int(np.linalg.norm(street.boxes[:, :2] - middle[:2], axis=1).argmin())
        local = apply_T(invert_T(street.drawn.things[nearest].box.T_world_box), np.asarray(done.mesh.vertices))
        right += bool((np.abs(np.ptp(local, axis=0) / street.boxes[nearest, 3:6] - 1) < 0.25).all())
    assert right >= len(scene) / 2
    assert all(inside(np.asarray(done.mesh.bounds), np.array([0, 0, 0, 200, 200, 20, 0.0])).all() for done in scene)
