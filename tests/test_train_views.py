"""Training views are the same for the same seed, and what is out of sight is no view."""

import numpy as np

from gfp_grasp.train.views import _occlude, render_views, shape_source


def test_views_of_a_shape_are_the_same_for_the_same_seed_and_hold_its_surface():
    first, again = (render_views(shape_source("cup", 7), num_views=2) for _ in range(2))
    assert len(first) == 2
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.points, b.points)
        assert a.points[:, 2].min() > -0.01  # the table is z = 0
        assert np.linalg.norm(a.viewpoint - a.points.mean(axis=0)) > 0.3


def test_an_occluder_leaves_half_at_least_and_nothing_of_nothing():
    mask = np.zeros((40, 40), dtype=bool)
    assert not _occlude(mask, np.random.default_rng(0)).any()
    mask[10:30, 10:30] = True
    kept = _occlude(mask, np.random.default_rng(0))
    assert not (kept & ~mask).any()
    assert 0.45 * mask.sum() < kept.sum() < 0.95 * mask.sum()
