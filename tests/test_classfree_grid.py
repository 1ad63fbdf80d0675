"""What the class-free completion is told of each cell: points, free space, what is hidden, and the support."""

from dataclasses import replace

import numpy as np
import pytest
from seen_wedge import points_alone, seen, without_view

from gfp_grasp.camera import cast_rays, cloud_of
from gfp_grasp.classfree import NUM_CHANNELS, Grid, channels, grid_around
from gfp_grasp.level import make_level_view
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LIDAR, DepthImage, Detection, LevelView

POINTS, FREE, BESIDE, BEHIND, HEIGHT = range(NUM_CHANNELS)


def _told(detection: Detection) -> tuple[LevelView, Grid, np.ndarray]:
    view = make_level_view(detection)
    grid = grid_around(view)
    return view, grid, channels(view, grid)


def _true_range(view: LevelView, grid: Grid, mesh) -> tuple[np.ndarray, np.ndarray]:
    """Distance (n,) of the cells' middles from the viewpoint, and of what a ray to each meets first of the mesh."""
    assert view.viewpoint is not None
    middles = grid.middles()
    ways = middles - view.viewpoint
    vertices = apply_T(invert_T(view.T_world_level), np.asarray(mesh.vertices))
    met = cast_rays([(vertices, np.asarray(mesh.faces))], view.viewpoint, ways)[0]
    return np.linalg.norm(ways, axis=1), met * np.linalg.norm(ways, axis=1)


@pytest.mark.parametrize("told", [lambda detection: detection, without_view, points_alone])
def test_a_grid_holds_the_whole_thing_in_cells_whose_number_the_network_can_halve(told) -> None:
    detection, mesh = seen()
    view, grid, known = _told(told(detection))
    places = grid.cells(apply_T(invert_T(view.T_world_level), np.asarray(mesh.vertices)))
    assert (places > 0).all()
    assert (places < np.array(grid.shape) - 1).all()
    assert all(num % 8 == 0 for num in grid.shape)
    assert 110_000 < np.prod(grid.shape) <= 56**3
    assert known.shape == (NUM_CHANNELS, *grid.shape)
    assert known.dtype == np.float32


def test_middles_and_cells_are_each_others_inverse() -> None:
    grid = Grid((0.1, -0.2, 0.3), 0.01, (2, 3, 4))
    middles = grid.middles()
    np.testing.assert_allclose(middles.reshape(2, 3, 4, 3)[1, 2, 3], [0.11, -0.18, 0.33])
    np.testing.assert_allclose(grid.cells(middles).reshape(2, 3, 4, 3)[1, 2, 3], [1, 2, 3])


def test_free_is_what_lies_before_a_return_and_behind_is_what_the_thing_hides() -> None:
    detection, mesh = seen()
    view, grid, known = _told(detection)
    own, met = _true_range(view, grid, mesh)
    free, behind = known[FREE].ravel(), known[BEHIND].ravel()
    before, after = own < met - 2 * grid.cell_m, own > met + 2 * grid.cell_m
    before &= grid.middles()[:, 2] > 2 * grid.cell_m
    assert (free[before] > 0.2).mean() > 0.99
    assert (free[after] < 0.01).mean() > 0.97  # but for the pixels of the outline
    assert (behind[after] > 0.2).mean() > 0.97
    assert (behind[before] == 0).mean() > 0.99
    assert not known[BESIDE].any()
    exact = (own < met) & (own > met - 3 * grid.cell_m)
    exact &= np.isfinite(met)
    np.testing.assert_allclose(
        np.median(4 * free[exact] - (met - own)[exact] / grid.cell_m * _cosine(view, grid)[exact]), 0.0, atol=0.1
    )


def _cosine(view: LevelView, grid: Grid) -> np.ndarray:
    """Share (n,) of the distance from the camera that is along its optical axis."""
    assert view.silhouette is not None
    middles = grid.middles()
    _, depth = view.silhouette.view.project(middles)
    return depth / np.linalg.norm(middles - view.viewpoint, axis=1)


def test_an_occluder_and_what_sends_nothing_back_say_nothing() -> None:
    hidden, _ = seen(hidden=0.4)
    view, grid, known = _told(hidden)
    assert view.silhouette is not None
    pixels, range_m = view.silhouette.view.project(grid.middles())
    seen_m = view.silhouette.view.free_range_m
    column, row = np.rint(pixels).astype(int).T
    inside = (column >= 0) & (column < seen_m.shape[1]) & (row >= 0) & (row < seen_m.shape[0])
    board_m = seen_m[0, 0]
    board = np.flatnonzero(inside)[seen_m[row[inside], column[inside]] == board_m]
    board = board[range_m[board] > board_m]
    assert len(board) > 1000
    assert not known[1:4].reshape(3, -1)[:, board].any()

    lost, mesh = seen(lost=True)
    view, grid, known = _told(lost)
    _, met = _true_range(view, grid, mesh)
    beside = ~np.isfinite(met)
    assert (known[FREE].ravel()[beside] == 0).mean() > 0.95  # but for the pixels of the outline
    assert known[FREE].max() > 0.9


def _room(detection: Detection) -> np.ndarray:
    """(2, 3) m that a grid leaves below and above the points along each axis."""
    view = make_level_view(detection)
    grid = grid_around(view)
    low = view.dense_points.min(axis=0) - grid.origin
    high = np.array(grid.origin) + grid.cell_m * (np.array(grid.shape) - 1) - view.dense_points.max(axis=0)
    return np.stack([low, high])


def test_more_room_is_left_where_an_occluder_stands() -> None:
    more = _room(seen(hidden=0.4)[0]) > _room(seen()[0]) + 0.02
    np.testing.assert_array_equal(more, [[False, True, False], [False, False, False]])


def test_more_room_is_left_where_the_picture_ends() -> None:
    detection, _ = seen()
    assert isinstance(detection.view, DepthImage)
    assert detection.mask is not None
    rows = np.flatnonzero(detection.mask.any(axis=1))
    top = int(rows[0] + 0.3 * len(rows))
    K = detection.view.K - [[0, 0, 0], [0, 0, top], [0, 0, 0]]
    image = DepthImage(detection.view.depth_m[top:], K, detection.view.T_world_camera)
    mask = detection.mask[top:]
    cut = replace(detection, view=image, mask=mask, cloud=cloud_of(image, mask))
    more = _room(cut) > _room(without_view(cut)) + 0.02
    np.testing.assert_array_equal(more, [[False, False, False], [False, False, True]])


def test_beside_a_guessed_silhouette_is_another_thing_than_free() -> None:
    detection, mesh = seen()
    view, grid, known = _told(without_view(detection))
    own, met = _true_range(view, grid, mesh)
    assert known[BESIDE].ravel()[~np.isfinite(met)].mean() > 0.8
    assert known[FREE].ravel()[~np.isfinite(met)].mean() < 0.05
    before = own < met - 3 * grid.cell_m
    assert (known[FREE].ravel()[before & np.isfinite(met)] > 0.2).mean() > 0.95


def test_points_alone_tell_nothing_of_rays_and_of_no_support() -> None:
    _, _, known = _told(points_alone(seen()[0]))
    assert known[POINTS].max() > 0.5
    assert not known[1:].any()


def test_the_support_is_at_the_height_of_zero() -> None:
    _, grid, known = _told(seen()[0])
    z = grid.origin[2] + grid.cell_m * np.arange(grid.shape[2])
    np.testing.assert_allclose(
        known[HEIGHT], np.broadcast_to(np.clip(z / grid.cell_m / 4, -1, 1), grid.shape), atol=1e-6
    )
    assert -3 * grid.cell_m < z[0] < -grid.cell_m


def test_points_fall_into_the_cells_around_them() -> None:
    view, grid, known = _told(seen()[0])
    cells = grid.cells(view.cloud.points)
    nearest = known[POINTS][tuple(np.rint(cells).astype(int).T)]
    assert nearest.min() > 0
    wide = np.zeros(grid.shape, dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        wide[tuple((np.floor(cells).astype(int) + corner).T)] = True
    assert not known[POINTS][~wide].any()


def test_a_thing_of_another_size_fills_the_same_cells() -> None:
    _, grid, known = _told(seen()[0])
    detection = seen(3.0)[0]
    view = make_level_view(replace(detection, sensor=replace(detection.sensor, sigma_m=3 * detection.sensor.sigma_m)))
    large = grid_around(view)
    assert large.shape == grid.shape
    assert large.cell_m == pytest.approx(3 * grid.cell_m, rel=1e-6)
    assert np.abs(channels(view, large) - known).mean() < 1e-3


def test_no_cell_is_finer_than_the_noise() -> None:
    detection = replace(seen()[0], sensor_sigma_m=0.006)
    assert grid_around(make_level_view(detection)).cell_m == 0.006
    assert grid_around(make_level_view(replace(detection, sensor=LIDAR, sensor_sigma_m=0.02))).cell_m == 0.02
