"""Objects that stand on other objects: the plane that each of them stands on."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from placed_boxes import box

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view
from gfp_grasp.detect import DetectConfig, make_detection, on_each_other
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import Detection, SupportPlane

TOP_M = 0.3
TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), TOP_M)


def detections(things: Sequence[trimesh.Trimesh], *, T=None, sigma_m: float = 0.001) -> tuple[Detection, ...]:
    """Detections of things by their true masks, in a world that T has moved."""
    T = np.eye(4) if T is None else T
    image, index = render_mesh_view(
        things,
        T_world_camera=look_at((0.1, -0.65, 0.8), (0.0, 0.0, TOP_M + 0.05)),
        K=intrinsics(320, 240, 45.0),
        width=320,
        height=240,
        table_height=TOP_M,
    )
    image = apply_sensor(image, SensorModel.gaussian(sigma_m), np.random.default_rng(0)).moved(T)
    up = T[:3, 2]
    support = SupportPlane(up, TABLE.height_m + float(up @ T[:3, 3]))
    points = image.points()
    return tuple(
        make_detection(points[mask], up=up, support=support, view=image, mask=mask, config=DetectConfig(classify=False))
        for mask in ((index == k) & (image.depth_m > 0) for k in range(len(things)))
    )


def heights_m(found: Sequence[Detection]) -> list[float]:
    """Height of each object's support above the table's plane."""
    base = min(d.support.height_m for d in found if d.support is not None)
    return [d.support.height_m - base for d in found if d.support is not None]


@pytest.mark.parametrize("T", [np.eye(4), make_T(rotation_about((1, 0.4, -0.3), 1.9), (0.5, -0.2, 0.8))])
def test_a_box_on_a_box_stands_on_its_top_and_a_third_on_that(T) -> None:
    low, middle = box((0.24, 0.2, 0.06), (0.0, 0.0, TOP_M)), box((0.16, 0.12, 0.04), (0.02, 0.01, TOP_M + 0.06), 25)
    high, aside = box((0.06, 0.05, 0.09), (0.0, 0.0, TOP_M + 0.1)), box((0.05, 0.05, 0.08), (-0.22, 0.0, TOP_M))
    found = on_each_other(detections((low, middle, high, aside), T=T))
    assert heights_m(found) == pytest.approx([0.0, 0.06, 0.1, 0.0], abs=0.003)


def test_what_is_hidden_below_by_something_in_front_stands_on_the_table() -> None:
    front, behind = box((0.3, 0.04, 0.1), (0.0, -0.1, TOP_M)), box((0.1, 0.1, 0.2), (0.0, 0.08, TOP_M))
    assert heights_m(on_each_other(detections((front, behind)))) == [0.0, 0.0]


def test_what_leans_on_another_thing_and_meets_the_table_stands_on_the_table() -> None:
    wall = box((0.2, 0.06, 0.12), (0.0, 0.08, TOP_M))
    leaning = trimesh.creation.box((0.1, 0.015, 0.16))
    leaning.apply_transform(make_T(rotation_about((1, 0, 0), -0.5), (0.0, -0.01, TOP_M + 0.073)))
    assert heights_m(on_each_other(detections((wall, leaning)))) == [0.0, 0.0]


def test_detections_without_picture_mask_or_support_stay_as_they_are() -> None:
    low, high = box((0.24, 0.2, 0.06), (0.0, 0.0, TOP_M)), box((0.1, 0.12, 0.1), (0.0, 0.0, TOP_M + 0.06))
    whole = detections((low, high))
    assert heights_m(on_each_other(whole)) == pytest.approx([0.0, 0.06], abs=0.003)
    for fields in ({"mask": None, "view": None}, {"support": None}):
        bare = tuple(replace(d, **fields) for d in whole)
        assert all(a is b for a, b in zip(bare, on_each_other(bare), strict=True))
    assert on_each_other(whole[1:]) == whole[1:]
