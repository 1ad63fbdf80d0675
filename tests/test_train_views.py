"""Training views are the same for the same seed, and what is out of sight is no view."""

import numpy as np
import pytest
from moments import assert_known
from toy_bodies import l_body

from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train import ViewsConfig, across_edge, render_views, rest_rotation, shape_source
from gfp_grasp.train.views import _occlude, views_of_mesh
from gfp_grasp.types import RESTS


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


def test_a_resting_object_has_its_axis_where_its_rest_says():
    axis = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(rest_rotation("upright", 1.0) @ axis, axis)
    np.testing.assert_allclose(rest_rotation("upside_down") @ axis, -axis, atol=1e-12)
    np.testing.assert_allclose(rest_rotation("lying", 0.7) @ axis, [1, 0, 0], atol=1e-12)
    # The roll is about the object's own axis, before it lies down.
    np.testing.assert_allclose(rest_rotation("lying", np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_an_edge_runs_across_its_angle():
    across = across_edge((4, 5), np.pi / 2)
    np.testing.assert_allclose(across, np.repeat(np.arange(4.0)[:, None], 5, axis=1), atol=1e-12)
    np.testing.assert_allclose(across_edge((4, 5), 0.0)[2], np.arange(5.0))


@pytest.mark.parametrize(("size", "share"), [(1.0, 1.0), (1.0, 0.5), (9.0, 0.3)])
def test_views_of_a_mesh_are_those_that_the_shipped_networks_were_trained_on(size: float, share: float) -> None:
    """Poses, cameras, sensors and occluders are drawn as ever; what is large is seen from farther away."""
    mesh = l_body(0.03).apply_scale(size)
    config = ViewsConfig(width=80, height=60, num_points=150, fallen_share=share, hidden_share=share)
    source = ObjectSource("l", "l")
    views = views_of_mesh(source, mesh, np.random.default_rng(4), num_views=8, config=config)
    name = f"views {size} {share}"
    assert_known(f"{name}: poses", [view.T_world_object for view in views])
    assert_known(f"{name}: cameras", [view.viewpoint for view in views])
    assert_known(f"{name}: rests", [RESTS.index(view.resting) for view in views])
    assert_known(f"{name}: points", np.concatenate([view.points for view in views]), rel=1e-3)


@pytest.mark.parametrize("family", ["bottle", "cup", "mug"])
def test_views_of_the_first_three_classes_are_those_of_the_first_release(family: str) -> None:
    """What lies in the caches and what committed figures were measured on: these families fall in every way."""
    config = ViewsConfig(fallen_share=0.5)
    views = [v for seed in range(3) for v in render_views(shape_source(family, seed), num_views=3, config=config)]
    assert len(views) == 9
    assert_known(f"views of {family}: poses", [view.T_world_object for view in views])
    assert_known(f"views of {family}: cameras", [view.viewpoint for view in views])
    assert_known(f"views of {family}: rests", [RESTS.index(view.resting) for view in views])
    assert_known(f"views of {family}: points", np.concatenate([view.points for view in views]), rel=1e-3)
