"""Starts of vehicles along the sides of what a LiDAR saw of them."""

import numpy as np
import pytest

from gfp_grasp.level import make_level_view
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register.corners import corner_starts, side_direction
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, Detection, OrientedBox, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
T_CAR = make_T(rotation_about((0, 0, 1), 0.5), (12.0, 2.0, 0.0))
EYE = np.array([0.0, 0.0, 1.7])


def faces(*, side: bool) -> np.ndarray:
    """(n, 3) m, world: the back of a car 4.2 by 1.8 by 1.5 m with many points, and its right side with few."""
    rng = np.random.default_rng(0)
    back = np.column_stack([np.full(300, -2.1), rng.uniform(-0.9, 0.9, 300), rng.uniform(0.2, 1.5, 300)])
    flank = np.column_stack([rng.uniform(-2.1, 2.1, 60), np.full(60, -0.9), rng.uniform(0.2, 1.4, 60)])
    points = np.concatenate([back, flank]) if side else back
    return apply_T(T_CAR, points + 0.01 * rng.normal(size=points.shape))


def starts(points: np.ndarray):
    support, box = SupportPlane(UP, 0.0), OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0))
    view = make_level_view(Detection(PointCloud(points, EYE), UP, support, "", {}, box, sensor=LIDAR))
    primitive = PrimitiveLibrary.shipped().primitive("car")
    bounds = []
    for state in corner_starts(primitive, view):
        world = apply_T(view.T_world_level, state.world(primitive.vertices))
        forward = invert_T(T_CAR)[:3, :3] @ view.T_world_level[:3, :3] @ state.R[:, 0]
        local = apply_T(invert_T(T_CAR), world)
        turned = round(float(np.degrees(np.arctan2(forward[1], forward[0]))))
        bounds.append((turned, np.stack([local.min(axis=0), local.max(axis=0)])))
    return bounds


def test_the_direction_of_two_sides_is_that_of_a_corner():
    """Few points of a long side count as much as many of a short one."""
    level = (faces(side=True) - T_CAR[:3, 3])[:, :2]
    assert side_direction(level) == pytest.approx(0.5, abs=0.04)
    turned = level @ rotation_about((0, 0, 1), 0.9)[:2, :2].T
    assert side_direction(turned) == pytest.approx(1.4, abs=0.04)


def test_a_corner_gives_starts_that_fill_both_sides_their_front_each_way():
    found = starts(faces(side=True))
    assert sorted(abs(turned) // 10 * 10 for turned, _ in found)[0] == 0
    assert len({round(turned / 90) % 4 for turned, _ in found}) == 4
    along = [bounds for turned, bounds in found if abs(turned) < 10 or abs(turned) > 170]
    assert len(along) == 2
    for low, high in along:
        np.testing.assert_allclose(low, [-2.1, -0.9, 0.0], atol=0.15)
        np.testing.assert_allclose(high[1:], [0.9, 1.5], atol=0.15)
        assert high[0] == pytest.approx(2.1, abs=0.4)  # few points tell where the far end is


def test_a_side_that_was_not_seen_goes_on_away_from_the_sensor():
    """Of the back alone: a car as wide as it, whose back it is, as long as cars of that width are."""
    found = starts(faces(side=False))
    along = [bounds for turned, bounds in found if abs(turned) < 15 or abs(turned) > 165]
    assert len(along) == 2
    for low, high in along:
        assert low[0] == pytest.approx(-2.1, abs=0.15)
        assert 3.6 < high[0] - low[0] < 4.6
        assert high[1] - low[1] == pytest.approx(1.8, abs=0.15)
