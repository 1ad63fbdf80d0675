"""Scans of single things in traffic: where they are met, how much of them, and what hides a part."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train import ScansConfig, scan_of
from gfp_grasp.train.views import views_of_mesh
from gfp_grasp.transforms import apply_T, invert_T

WHOLE = ScansConfig(distance_m=(10.0, 10.001), height_m=(1.7, 1.701), hidden_share=0.0, lost_share=0.0)


def brick() -> trimesh.Trimesh:
    """4 by 1.6 by 1.5 m, on the ground, its front end thinner."""
    body = trimesh.creation.box(bounds=[[-2.0, -0.8, 0.0], [1.0, 0.8, 1.5]])
    nose = trimesh.creation.box(bounds=[[0.9, -0.8, 0.0], [2.0, 0.8, 0.8]])
    return trimesh.boolean.union([body, nose])


def scan(seed: int = 0, config: ScansConfig = WHOLE):
    taken = scan_of(brick(), np.random.default_rng(seed), config)
    assert taken is not None
    return taken


def test_points_lie_on_the_thing_where_its_pose_says():
    for seed in range(6):
        points, eye, T = scan(seed)
        local = apply_T(invert_T(T), points)
        _, off_m, _ = trimesh.proximity.closest_point(brick(), local)
        assert np.median(off_m) < 0.03
        assert np.quantile(off_m, 0.99) < 0.15  # noise along a ray that grazes
        assert np.ptp(local[:, 2]) > 0.6
        nearest_m = np.linalg.norm((points - eye)[:, :2], axis=1).min()
        assert 9.0 < nearest_m < 12.5  # from the nearest side, whatever way it is turned
        assert eye[2] == pytest.approx(1.7, abs=0.01)


def test_only_the_sides_that_face_the_sensor_are_met():
    points, eye, T = scan(1)
    middle = apply_T(T, np.array([[0.0, 0.0, 0.75]]))[0]
    towards = (eye - middle)[:2] / np.linalg.norm((eye - middle)[:2])
    assert ((points - middle)[:, :2] @ towards).min() > -2.3
    assert ((points - middle)[:, :2] @ towards).mean() > 0.1


def test_far_things_have_fewer_points_and_too_few_give_none():
    how = {"hidden_share": 0.0, "lost_share": 0.0, "num_points": 100_000}
    near, far = (scan(2, ScansConfig(distance_m=(d, d + 0.001), **how)) for d in (8.0, 24.0))
    reach_m = np.hypot(2.0, 0.8)
    assert len(near[0]) / len(far[0]) == pytest.approx(((24 + reach_m) / (8 + reach_m)) ** 2, rel=0.25)
    assert scan_of(brick(), np.random.default_rng(0), ScansConfig(distance_m=(119.0, 119.5))) is None


def test_what_is_hidden_lies_beyond_an_edge():
    hidden = replace(WHOLE, hidden_share=1.0, num_points=100_000)
    whole = replace(WHOLE, num_points=100_000)
    shares = [len(scan(seed, hidden)[0]) / len(scan(seed, whole)[0]) for seed in range(12)]
    assert 0.35 < min(shares) < 0.6 < max(shares) < 0.95


def test_views_of_a_mesh_are_scans_where_scans_are_asked_for():
    views = views_of_mesh(ObjectSource("x", "brick"), brick(), np.random.default_rng(0), num_views=3, config=WHOLE)
    assert [view.resting for view in views] == ["upright"] * 3
    assert min(np.linalg.norm(view.viewpoint[:2]) for view in views) > 10


def test_shares_out_of_range_are_refused():
    with pytest.raises(InvalidOption, match="hidden_share"):
        ScansConfig(hidden_share=1.2)
