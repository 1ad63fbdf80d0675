"""Bare points: their order, fewer of them, cells, and the axes of their neighbourhoods."""

import numpy as np
import pytest
from moments import assert_known
from tilted_table import UP

from gfp_grasp import clouds
from gfp_grasp.clouds import (
    _hashes,
    distinct_points,
    estimate_normals,
    local_axes,
    order_points,
    thin,
    thin_index,
    voxel_grid,
)
from gfp_grasp.transforms import rotation_between


def _sheet(count: int, seed: int = 0) -> np.ndarray:
    x, y = np.random.default_rng(seed).uniform(-0.1, 0.1, (2, count))
    return np.column_stack([x, 0.6 * y, 3 * x * x - 2 * x * y])


@pytest.mark.filterwarnings("error")
def test_hashes_are_those_by_which_every_published_cloud_was_thinned() -> None:
    points = np.array([[0.1, -0.2, 0.3], [0.0, -0.0, 5.0], [1e-300, 1e300, -1.0]])
    assert [hex(value) for value in _hashes(points, 0)] == [
        "0x3e696be31d8445f1",
        "0x3274000032740000",
        "0x63231a6bcf288b89",
    ]
    assert [hex(value) for value in _hashes(points, 7)] == [
        "0xe8f02dc7d407bbe1",
        "0xb313fc9761b67f44",
        "0xc3a53022d630339b",
    ]
    np.testing.assert_array_equal(_hashes(np.array([[0.0, -0.0, 5.0]]), 3), _hashes(np.array([[-0.0, 0.0, 5.0]]), 3))


@pytest.mark.parametrize("seed", [0, 5])
def test_too_many_points_are_thinned_by_their_own_hash(monkeypatch, seed: int) -> None:
    monkeypatch.setattr(clouds, "MAX_POINTS", 300)
    points = _sheet(2000)
    kept = order_points(points, seed=seed)
    assert_known(f"ordered {seed}", kept)
    assert 240 < len(kept) < 360
    np.testing.assert_array_equal(order_points(points[::-1], seed=seed), kept)
    assert len(order_points(points[:300])) == 300
    # Many copies of few points: each of them counts once.
    copies = np.repeat(_sheet(400), 10, axis=0)
    assert_known(f"ordered copies {seed}", order_points(copies, seed=seed))
    assert 230 < len(order_points(copies, seed=seed)) < 370
    assert clouds._share(300) == np.uint64(2**64 - 1)
    assert int(clouds._share(600)) == 2**63


def test_points_are_ordered_by_x_then_y_then_z_each_once() -> None:
    rows = [[1, 0, 0], [0, 2, 1], [0, 1, 3], [0, 1, 2], [1, 0, 0]]
    assert order_points(np.array(rows, dtype=float)).tolist() == [[0, 1, 2], [0, 1, 3], [0, 2, 1], [1, 0, 0]]
    assert distinct_points(np.array(rows, dtype=float)).tolist() == rows[:4]
    assert clouds.MAX_POINTS == 100_000


@pytest.mark.parametrize("count", [20, 150, 900])
def test_thinned_clouds_have_a_point_a_cell_near_the_count(count: int) -> None:
    points = _sheet(3000)
    chosen = thin_index(points, count)
    assert count <= len(chosen) <= 1.2 * count
    assert_known(f"thin {count}", np.sort(chosen))
    order = np.random.default_rng(1).permutation(len(points))
    assert {*order[thin_index(points[order], count)].tolist()} == {*chosen.tolist()}
    np.testing.assert_array_equal(thin(points, count), points[chosen])


def test_a_cloud_that_is_small_enough_stays_and_clumps_are_no_trouble() -> None:
    points = _sheet(50)
    assert thin_index(points, 50).tolist() == list(range(50))
    clumps = np.repeat(_sheet(12), 100, axis=0) + 1e-7 * np.random.default_rng(0).normal(size=(1200, 3))
    assert_known("thin clumps", thin(clumps, 40))
    line = np.zeros((1000, 3))
    line[:, 1] = np.linspace(0, 0.01, 1000) ** 2
    assert_known("thin line", thin(line, 60))
    assert len(thin(np.zeros((500, 3)), 20)) == 1


def test_of_two_points_that_are_equally_near_the_mean_the_first_in_space_is_taken() -> None:
    pairs = np.array([[0.0, 0, 0], [0.002, 0, 0], [0.5, 0, 0.001], [0.5, 0, 0], [1.0, 0.001, 0], [1.0, 0, 0]])
    assert thin(pairs[::-1], 3).tolist() == thin(pairs, 3).tolist() == [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]]


def test_cells_have_their_mean_and_each_point_its_cell() -> None:
    points = np.array([[0.0, 0, 0], [0.09, 0, 0], [0.11, 0, 0], [0.0, 0.25, 0.15], [0.05, 0.21, 0.19]])
    means, cell_of = voxel_grid(points, 0.1)
    assert cell_of[0] == cell_of[1]
    assert cell_of[3] == cell_of[4]
    assert len({*cell_of.tolist()}) == len(means) == 3
    np.testing.assert_allclose(means[cell_of[0]], [0.045, 0, 0])
    np.testing.assert_allclose(means[cell_of[4]], [0.025, 0.23, 0.17])
    assert_known("voxels", voxel_grid(_sheet(500), 0.013)[0])


def test_axes_and_normals_of_neighbourhoods_are_those_of_old() -> None:
    points = _sheet(400)
    sums, axes = local_axes(points, points[:40], num_neighbours=11)
    assert_known("local sums", sums)
    np.testing.assert_allclose(np.abs(np.linalg.det(axes)), 1.0)
    normals = estimate_normals(points, points[:40], np.array([0.1, 0.2, 5.0]))
    assert (normals[:, 2] > 0).all()
    assert_known("normals", normals)
    below = estimate_normals(points, points[:40], np.array([0.1, 0.2, -5.0]))
    np.testing.assert_allclose(below, -normals)
    free = estimate_normals(points, points[:40], None, num_neighbours=16)
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", free, normals)), 1.0)
    few, _ = local_axes(points[:5], points[:1], num_neighbours=16)
    centred = points[:5] - points[:5].mean(axis=0)
    np.testing.assert_allclose(few[0], np.linalg.eigvalsh(centred.T @ centred), atol=1e-12)


def test_of_two_points_as_near_their_mean_the_same_one_is_kept_whatever_the_order():
    cells = np.stack(np.meshgrid(*[np.arange(12)] * 3), axis=-1).reshape(-1, 3)
    points = np.concatenate([cells * 0.3 + 0.1, cells * 0.3 + (0.13, 0.14, 0.12)])
    count = int(len(cells) * 0.95)
    first = thin(points, count)
    assert len(first) < len(points)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(points))
        assert np.array_equal(thin(points[order], count), first)


def test_each_kept_point_is_the_nearest_to_the_mean_of_its_cell():
    near, far = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.5, 0.0, 0.0]]), np.array([[10.0, 10.0, 0.0]])
    assert thin(np.concatenate([near, far, near + np.array([0, 10.0, 0])]), 3).tolist() == [
        [0.2, 0, 0],
        [0.2, 10, 0],
        [10, 10, 0],
    ]


def test_normals_of_a_tilted_plane_are_its_own():
    rng = np.random.default_rng(4)
    R = rotation_between((0, 0, 1), UP)
    points = np.column_stack([rng.uniform(-1, 1, (500, 2)), np.zeros(500)]) @ R.T + 3.0
    for viewpoint, sign in ((points.mean(axis=0) + 2 * UP, 1), (points.mean(axis=0) - 2 * UP, -1)):
        assert np.allclose(estimate_normals(points, points[:50], viewpoint), sign * UP, atol=1e-9)
