"""One thing seen to either side of another: when its sides are joined, and when they are not."""

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from placed_boxes import box, together

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view
from gfp_grasp.detect.continuation import join_behind
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import TABLETOP, SupportPlane

EYE = np.array([0.1, -0.65, 0.7])
POST = ((0.05, 0.05, 0.16), (0.0, -0.05, 0.2), 0.0)
BAR = ((0.22, 0.05, 0.06), (0.0, 0.1, 0.2), 10.0)


def joined(things: Sequence[trimesh.Trimesh], split: Sequence[int], *, T=None) -> np.ndarray:
    """Numbers that the sides of things have afterwards: first the left ones of `split`, then the right ones."""
    T = np.eye(4) if T is None else T
    image, index = render_mesh_view(
        things,
        T_world_camera=look_at(EYE, (0.0, 0.0, 0.22)),
        K=intrinsics(320, 240, 45.0),
        width=320,
        height=240,
        table_height=0.2,
    )
    image = apply_sensor(image, SensorModel.gaussian(0.001), np.random.default_rng(0)).moved(T)
    normal = T[:3, 2]
    support = SupportPlane(normal, 0.2 + float(normal @ T[:3, 3]))
    points = image.points()
    depth = np.linalg.norm(points - image.viewpoint, axis=2)
    labels = np.where(index < len(things), index + 1, 0)
    middle = int(np.flatnonzero((index == 0).any(axis=0)).mean())  # of the first thing, which stands in front
    right = np.zeros_like(labels)
    for number in split:
        right[(index == number) & (np.arange(320) > middle)] = 10
    found = join_behind(labels + right, points, depth, support, sensor=TABLETOP, noise_growth=np.ones(depth.shape))
    numbers = [np.unique(found[(labels == n + 1) & (right == r)]) for r in (0, 10) for n in split]
    assert all(len(own) == 1 for own in numbers)
    assert (found[labels == 1] == 1).all()
    return np.array([own[0] for own in numbers])


@pytest.mark.parametrize("T", [np.eye(4), make_T(rotation_about((1, 0.4, -0.3), 1.9), (0.5, -0.2, 0.8))])
def test_a_bar_behind_a_post_is_one(T) -> None:
    left, right = joined([box(*POST), box(*BAR)], [1], T=T)
    assert left == right == 2


def test_two_boxes_of_unlike_height_are_two() -> None:
    low, high = box((0.08, 0.05, 0.06), (-0.07, 0.1, 0.2)), box((0.08, 0.05, 0.08), (0.07, 0.1, 0.2))
    both = together([low, high])
    left, right = joined([box(*POST), both], [1])
    assert left != right


def test_two_boxes_whose_faces_lie_in_two_planes_are_two() -> None:
    near, far = box((0.08, 0.05, 0.06), (-0.07, 0.06, 0.2)), box((0.08, 0.05, 0.06), (0.07, 0.13, 0.2))
    left, right = joined([box(*POST), together([near, far])], [1])
    assert left != right


def test_two_cups_of_one_height_are_two() -> None:
    cups = [trimesh.creation.cylinder(0.04, 0.1).apply_translation((x, 0.1, 0.25)) for x in (-0.055, 0.055)]
    left, right = joined([box(*POST), together(cups)], [1])
    assert left != right


def test_two_boxes_in_line_with_the_table_seen_between_them_are_two() -> None:
    pair = [box((0.08, 0.05, 0.06), (x, 0.1, 0.2)) for x in (-0.08, 0.08)]
    small = box((0.01, 0.01, 0.02), (0.0, -0.05, 0.2))  # hides nothing between them
    left, right = joined([small, together(pair)], [1])
    assert left != right


def test_what_would_be_too_long_for_an_object_is_two() -> None:
    left, right = joined([box(*POST), box((0.5, 0.05, 0.06), (0.0, 0.1, 0.2))], [1])
    assert left != right
