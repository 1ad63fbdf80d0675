"""Places of several objects on a table: apart, within a circle, turned at will, some on their side."""

import numpy as np
import pytest
import trimesh
from scene_things import box

from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import place_clutter
from gfp_grasp.scenes import world as scene_world
from gfp_grasp.transforms import apply_T


def wedge():
    """A body whose middle is far from its own axis."""
    mesh = box((0.1, 0.03, 0.05), (0.06, 0.01, 0.025))
    return mesh


def test_footprints_are_circles_about_the_middles_of_what_stands_there():
    """Bodies far off their axes: their boxes' middles keep apart, and stay within the circle."""
    meshes = [wedge(), wedge(), box((0.04, 0.04, 0.08), (0, 0, 0.04))]
    for seed in range(10):
        poses = place_clutter(meshes, np.random.default_rng(seed), radius_m=0.2, gap_m=0.02, table_height=0.3)
        circles = []
        for mesh, T in zip(meshes, poses, strict=True):
            stands = apply_T(T, mesh.vertices)
            assert stands[:, 2].min() == pytest.approx(0.3)
            np.testing.assert_allclose(T[:3, :3] @ (0, 0, 1), (0, 0, 1), atol=1e-12)
            middle = (stands.min(axis=0) + stands.max(axis=0))[:2] / 2
            circles.append((middle, np.linalg.norm(stands[:, :2] - middle, axis=1).max()))
        for i, (middle, radius) in enumerate(circles):
            assert np.linalg.norm(middle) + radius <= 0.2 + 1e-9
            for other, its in circles[:i]:
                assert np.linalg.norm(middle - other) >= radius + its + 0.02 - 1e-9


def test_the_circle_is_widened_where_they_do_not_fit_and_no_more_than_needed():
    meshes = [trimesh.creation.cylinder(0.05, 0.1) for _ in range(4)]
    for radius_m in (0.3, 0.11):
        poses = place_clutter(meshes, np.random.default_rng(1), radius_m=radius_m)
        reach = max(np.linalg.norm(T[:2, 3]) + 0.05 for T in poses)
        assert reach <= 2 * radius_m
        assert (reach > radius_m) == (radius_m < 0.2)


def test_places_are_even_over_the_disc_and_turns_over_the_circle():
    mesh = trimesh.creation.cylinder(0.01, 0.1)
    poses = np.stack([place_clutter([mesh], np.random.default_rng(i), radius_m=0.21)[0] for i in range(400)])
    reach = np.linalg.norm(poses[:, :2, 3], axis=1) / 0.2
    assert reach.max() <= 1
    assert (reach < np.sqrt(0.5)).mean() == pytest.approx(0.5, abs=0.08)  # half of the area
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    assert np.histogram(yaw, 4, (-np.pi, np.pi))[0].min() > 70
    assert np.abs(np.corrcoef(yaw, np.arctan2(poses[:, 1, 3], poses[:, 0, 3]))[0, 1]) < 0.15


def test_the_largest_is_placed_first():
    """The first draw of an angle and a reach is that of the largest, whatever the order."""
    circles = [(np.zeros(2), radius) for radius in (0.01, 0.05, 0.02)]
    centres = scene_world._scatter(circles, np.random.default_rng(4), 0.2, 0.0)
    rng = np.random.default_rng(4)
    angle, reach = rng.uniform(0, 2 * np.pi), 0.15 * np.sqrt(rng.random())
    assert centres is not None
    np.testing.assert_allclose(centres[1], reach * np.array([np.cos(angle), np.sin(angle)]))


def test_so_many_lie_on_their_side_as_are_asked_for():
    mesh = box((0.03, 0.04, 0.1), (0, 0, 0.05))
    for share in (0.0, 0.3, 1.0):
        lying = 0
        for seed in range(200):
            (T,) = place_clutter([mesh], np.random.default_rng(seed), lying_share=share)
            assert apply_T(T, mesh.vertices)[:, 2].min() == pytest.approx(0.0, abs=1e-12)
            axis = abs(T[2, 2])
            assert axis == pytest.approx(1.0) or axis == pytest.approx(0.0, abs=1e-12)
            lying += axis < 0.5
        assert lying / 200 == pytest.approx(share, abs=0.08)
    rolls = {round(float(scene_world._turn(mesh.vertices, np.random.default_rng(s), 1.0)[2]), 4) for s in range(20)}
    assert len(rolls) > 5  # lying things are rolled to any side


@pytest.mark.parametrize("knobs", [{"lying_share": 1.1}, {"lying_share": -0.1}, {"radius_m": 0.0}, {"gap_m": -0.01}])
def test_nonsense_placing_is_refused(knobs):
    with pytest.raises(InvalidOption, match=next(iter(knobs))):
        place_clutter([wedge()], np.random.default_rng(0), **knobs)
