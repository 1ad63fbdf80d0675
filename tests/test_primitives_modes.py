"""Mean, scales and modes of members that correspond and whose spread is known, and which members are outliers."""

import numpy as np
import pytest

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.primitives.procrustes import shape_model


def test_modes_of_scaled_copies_are_none_and_their_scales_are_found():
    rng = np.random.default_rng(0)
    shape, weights = rng.normal(size=(80, 3)), rng.uniform(1, 2, 80)
    scale = np.exp(0.2 * rng.normal(size=(10, 3)))
    model = shape_model(shape * scale[:, None], weights)
    assert model.variance_m2 < 1e-16
    np.testing.assert_allclose(model.log_scale, np.log(scale) - np.log(scale).mean(axis=0), atol=1e-9)
    assert len(model.modes) == 0


def test_known_modes_are_recovered_with_unit_deviation():
    rng = np.random.default_rng(1)
    mean, weights = 0.05 * rng.normal(size=(200, 3)), np.ones(200)
    axes = np.linalg.qr(rng.normal(size=(600, 2)))[0].T.reshape(2, 200, 3)
    scores = rng.normal(size=(400, 2)) * [0.02, 0.01]
    members = mean + np.tensordot(scores, axes, 1)
    model = shape_model(members, weights, outlier_beyond=10.0)
    assert len(model.modes) == 2
    np.testing.assert_allclose(model.coefficients.std(axis=0, ddof=1), 1.0, atol=1e-6)
    rebuilt = (model.mean + np.tensordot(model.coefficients, model.modes, 1)) * np.exp(model.log_scale)[:, None]
    np.testing.assert_allclose(rebuilt, members, atol=1e-4)
    assert model.explained[0] == pytest.approx(0.8, abs=0.05)


def test_outlier_bends_neither_mean_nor_main_modes_but_is_expressed():
    rng = np.random.default_rng(2)
    mean = 0.05 * rng.normal(size=(100, 3))
    usual = mean + 0.001 * rng.normal(size=(30, 1, 1)) * rng.normal(size=(100, 3))
    odd = mean + 0.02 * rng.normal(size=(1, 100, 3))
    model = shape_model(np.concatenate([usual, odd]), np.ones(100))
    np.testing.assert_array_equal(np.flatnonzero(model.outlier), [30])
    assert np.linalg.norm(model.mean - mean, axis=1).mean() < 0.0005
    rebuilt = (model.mean + np.tensordot(model.coefficients[30], model.modes, 1)) * np.exp(model.log_scale[30])
    assert np.linalg.norm(rebuilt - odd[0], axis=1).mean() < 0.001


def _members_of_known_spread(deviations, count=60, seed=3):
    """Members about one mean, along orthogonal axes, of known standard deviations; their scales cannot tell them."""
    rng = np.random.default_rng(seed)
    mean = 0.05 * rng.normal(size=(150, 3))
    rows = [mean[:, k] / np.linalg.norm(mean[:, k]) for k in range(3)]
    basis = np.zeros((3, 450))
    for k in range(3):
        basis[k].reshape(150, 3)[:, k] = rows[k]
    free = rng.normal(size=(len(deviations), 450))
    free -= free @ basis.T @ basis  # what no change of scale explains
    axes = np.linalg.qr(free.T)[0].T
    scores = rng.normal(size=(count, len(deviations)))
    scores -= scores.mean(axis=0)
    scores = np.linalg.qr(scores)[0] * np.sqrt(count - 1) * deviations
    return mean, (mean + (scores @ axes).reshape(count, 150, 3))


@pytest.mark.parametrize(("variance", "kept"), [(0.55, 1), (0.8, 2), (0.95, 3), (1.0, 4)])
def test_fewest_modes_that_explain_the_variance_are_kept(variance, kept):
    # Shares of the variance: 16, 8, 3 and 1 of 28.
    mean, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0]))
    model = shape_model(members, np.ones(150), variance=variance, outlier_beyond=10.0)
    assert len(model.modes) == kept
    np.testing.assert_allclose(model.explained, np.array([16, 8, 3, 1])[:kept] / 28, rtol=0.02)
    np.testing.assert_allclose(model.mean, mean, atol=1e-5)
    assert model.variance_m2 == pytest.approx(28e-6 / 150, rel=0.01)
    # One standard deviation each, and the free sign is fixed.
    sizes = np.sqrt((model.modes**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(sizes, 0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0])[:kept], rtol=0.02)
    assert (model.modes.sum(axis=(1, 2)) > 0).all()


def test_there_are_no_more_modes_than_asked_for_and_none_without_variance():
    _, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0]))
    assert len(shape_model(members, np.ones(150), variance=1.0, max_modes=2, outlier_beyond=10.0).modes) == 2
    _, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 1e-5]))
    assert len(shape_model(members, np.ones(150), variance=1.0, outlier_beyond=10.0).modes) == 2  # a millionth


def test_a_member_beyond_two_and_a_half_medians_is_an_outlier():
    mean, members = _members_of_known_spread(0.001 * np.ones(40), count=41)
    distance = np.linalg.norm(members - mean, axis=(1, 2))
    for factor, odd in ((2.2, False), (2.9, True)):
        stretched = members.copy()
        stretched[5] = mean + (members[5] - mean) * factor * np.median(distance) / distance[5]
        assert shape_model(stretched, np.ones(150)).outlier[5] == odd


def test_members_turned_over_are_refused():
    rng = np.random.default_rng(0)
    shape = rng.normal(size=(50, 3))
    with pytest.raises(InvalidMesh, match="turned over"):
        shape_model(np.stack([shape, shape, shape * [1, 1, -1]]), np.ones(50))


def test_one_member_makes_no_class():
    with pytest.raises(InvalidMesh, match="at least two"):
        shape_model(np.zeros((1, 5, 3)), np.ones(5))


def test_members_that_walk_have_one_scale_along_the_way_and_across_it():
    rng = np.random.default_rng(0)
    shape, step = rng.normal(size=(200, 3)) * [0.05, 1, 1], rng.normal(size=200)
    sizes = np.array([0.7, 1.0, 1.0, 1.0 / 0.7])
    strides = np.array([0.0, -1.0, 1.0, 0.0])
    members = np.stack([size * (shape + np.outer(s * step, [1, 0, 0])) for size, s in zip(sizes, strides, strict=True)])
    model = shape_model(members, np.ones(200))
    np.testing.assert_allclose(model.log_scale, np.repeat(np.log(sizes)[:, None], 3, axis=1), atol=1e-6)
    assert len(model.modes) == 1
