"""Procrustes alignment, one onto another and a class onto its mean."""

import numpy as np
import pytest

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.primitives.procrustes import align, centroid_size, generalized
from gfp_grasp.transforms import random_rotation, rotation_about

RNG = np.random.default_rng(3)


def test_known_similarity_is_recovered_exactly():
    points, R, t = RNG.normal(size=(40, 3)), random_rotation(RNG), np.array([0.3, -2.0, 1.0])
    found = align(points, 1.7 * points @ R.T + t)
    assert found.scale == pytest.approx(1.7, abs=1e-12)
    np.testing.assert_allclose(found.R, R, atol=1e-12)
    np.testing.assert_allclose(found.t, t, atol=1e-12)


def test_without_scaling_the_scale_is_one_and_the_rotation_is_still_right():
    points, R = RNG.normal(size=(40, 3)), random_rotation(RNG)
    found = align(points, 1.7 * points @ R.T, scaling=False)
    assert found.scale == 1.0
    np.testing.assert_allclose(found.R, R, atol=1e-12)


def test_mirror_image_is_never_matched_by_a_reflection():
    points = RNG.normal(size=(40, 3))
    found = align(points, points * [-1, 1, 1])
    assert np.linalg.det(found.R) == pytest.approx(1.0)


def test_flat_points_are_aligned_too():
    points = np.c_[RNG.normal(size=(20, 2)), np.zeros(20)]
    R = random_rotation(RNG)
    np.testing.assert_allclose(align(points, points @ R.T).apply(points), points @ R.T, atol=1e-12)


def test_with_an_axis_only_the_angle_about_it_is_found():
    points = RNG.normal(size=(40, 3))
    axis = np.array([0.0, 0.0, 1.0])
    R = rotation_about(axis, 2.5)
    np.testing.assert_allclose(align(points, points @ R.T, axis=axis).R, R, atol=1e-12)
    tilted = rotation_about([1, 0, 0], 0.2)
    np.testing.assert_allclose(align(points, points @ tilted.T, axis=axis).R @ axis, axis, atol=1e-12)


def test_weight_zero_takes_a_point_out():
    points, R = RNG.normal(size=(30, 3)), random_rotation(RNG)
    target = points @ R.T
    target[0] += 100.0
    np.testing.assert_allclose(align(points, target, weights=np.r_[0.0, np.ones(29)]).R, R, atol=1e-12)


def test_least_squares_optimum_beats_its_neighbours():
    source, target = RNG.normal(size=(30, 3)), RNG.normal(size=(30, 3))
    found = align(source, target)
    best = ((found.apply(source) - target) ** 2).sum()
    for _ in range(20):
        R = rotation_about(RNG.normal(size=3), 0.05) @ found.R
        assert ((found.scale * source @ R.T + found.t - target) ** 2).sum() >= best - 1e-12


@pytest.mark.parametrize(
    ("source", "target"),
    [
        (np.zeros((5, 3)), np.zeros((6, 3))),
        (np.zeros((2, 3)), np.zeros((2, 3))),
        (np.full((5, 3), np.nan), np.zeros((5, 3))),
        (np.ones((5, 3)), np.ones((5, 3))),
    ],
)
def test_points_that_cannot_be_aligned_are_refused(source, target):
    with pytest.raises(InvalidMesh):
        align(source, target)


def test_moved_copies_of_one_shape_fall_together_at_their_geometric_mean_size():
    shape = RNG.normal(size=(50, 3))
    scales = np.array([0.5, 1.0, 4.0])
    copies = np.stack([s * shape @ random_rotation(RNG).T + RNG.normal(size=3) for s in scales])
    result = generalized(copies)
    np.testing.assert_allclose(result.aligned, np.broadcast_to(result.mean, copies.shape), atol=1e-7)
    expected = centroid_size(shape) * np.exp(np.log(scales).mean())
    assert centroid_size(result.mean) == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose([move.scale for move in result.transforms], np.exp(np.log(scales).mean()) / scales)


def test_mean_of_noisy_copies_is_nearer_to_the_truth_than_any_copy():
    shape = RNG.normal(size=(60, 3))
    copies = shape + 0.1 * RNG.normal(size=(20, 60, 3))
    moved = np.stack([1.3 * c @ random_rotation(RNG).T for c in copies])
    result = generalized(moved)
    back = align(result.mean, shape)
    error = np.linalg.norm(back.apply(result.mean) - shape, axis=1).mean()
    assert error < 0.06
    assert error < min(np.linalg.norm(c - shape, axis=1).mean() for c in copies) / 2


def test_mean_does_not_depend_on_the_order_of_the_shapes_but_for_a_rotation():
    shapes = RNG.normal(size=(30, 3)) + 0.2 * RNG.normal(size=(6, 30, 3))
    first, second = generalized(shapes).mean, generalized(shapes[::-1]).mean
    np.testing.assert_allclose(align(second, first, scaling=False).apply(second), first, atol=1e-6)


def test_shapes_of_a_wrong_form_are_refused():
    with pytest.raises(InvalidMesh, match="shapes have shape"):
        generalized(np.zeros((4, 3)))
