"""Boxes of traffic as seen from above, by hand."""

import numpy as np
import pytest

from gfp_grasp.detect import inside, iou_from_above, suppress

CAR = np.array([10.0, 5.0, 0.8, 4.0, 2.0, 1.6, 0.0])


def moved(box: np.ndarray, **changes: float) -> np.ndarray:
    names = ("x", "y", "z", "length", "width", "height", "yaw")
    return np.array([changes.get(name, value) for name, value in zip(names, box, strict=True)])


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (moved(CAR, z=7.0), 1.0),  # height does not count
        (moved(CAR, x=11.0), 6 / 10),
        (moved(CAR, yaw=np.pi / 2), 4 / 12),
        (moved(CAR, yaw=np.pi), 1.0),
        (moved(CAR, length=2.0, y=5.5), 3 / 9),
        (moved(CAR, x=14.5), 0.0),
    ],
)
def test_overlap_from_above(other: np.ndarray, expected: float):
    np.testing.assert_allclose(iou_from_above(CAR[None], other[None]), [[expected]], atol=1e-9)
    np.testing.assert_allclose(iou_from_above(other[None], CAR[None]), [[expected]], atol=1e-9)


def test_overlap_does_not_depend_on_where_the_street_lies():
    boxes = np.random.default_rng(0).uniform((0, 0, 0, 2, 1, 1, 0), (8, 8, 1, 5, 2, 2, 3), (6, 7))
    turn = 0.7
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = boxes.copy()
    turned[:, :2] = boxes[:, :2] @ R.T + (30.0, -4.0)
    turned[:, 6] += turn
    np.testing.assert_allclose(iou_from_above(turned, turned), iou_from_above(boxes, boxes), atol=1e-9)
    assert 0 < iou_from_above(boxes, boxes)[~np.eye(6, dtype=bool)].max() < 1


def test_the_best_of_boxes_that_overlap_is_kept():
    boxes = np.stack([moved(CAR, x=10.5), CAR, moved(CAR, x=30.0), moved(CAR, x=13.5)])
    assert suppress(boxes, np.array([0.6, 0.9, 0.2, 0.5]), iou=0.1, most=9).tolist() == [1, 3, 2]
    assert suppress(boxes, np.array([0.6, 0.9, 0.2, 0.5]), iou=0.05, most=9).tolist() == [1, 2]
    assert suppress(boxes, np.array([0.6, 0.9, 0.2, 0.5]), iou=0.1, most=1).tolist() == [1]
    assert suppress(np.empty((0, 7)), np.empty(0), iou=0.1, most=9).tolist() == []


def test_points_are_told_by_the_box_in_its_own_frame():
    box = moved(CAR, yaw=np.pi / 2)  # x from 9 to 11, y from 3 to 7
    points = np.array([[10.9, 6.9, 0.1], [11.2, 5.0, 0.8], [10.0, 7.1, 0.8], [10.0, 5.0, 1.7]])
    assert inside(points, box).tolist() == [True, False, False, False]
    assert inside(points, box, grow_m=0.15).tolist() == [True, False, True, True]
