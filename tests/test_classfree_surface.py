"""From distances to a surface: exact distances give the body, and points draw it to themselves where they are surer."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from seen_wedge import points_alone, seen

from gfp_grasp.classfree import REACH, Grid, grid_around
from gfp_grasp.classfree.surface import surface_from, with_thin_walls
from gfp_grasp.errors import NoSurface
from gfp_grasp.level import make_level_view
from gfp_grasp.meshes import sample_surface, vertex_normals
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.train.distances import signed_distances
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LevelView


def _case() -> tuple[LevelView, Grid, trimesh.Trimesh, np.ndarray]:
    """The view, its grid, the true mesh in the level frame and its distances in cells."""
    detection, mesh = seen()
    view = make_level_view(detection)
    grid = grid_around(view)
    mesh.apply_transform(invert_T(view.T_world_level))
    return view, grid, mesh, signed_distances(mesh, grid, reach=REACH)


def _unsure(grid: Grid, cells: float) -> np.ndarray:
    return np.full(grid.shape, np.log(cells))


def test_exact_distances_give_the_body() -> None:
    view, grid, mesh, distance = _case()
    found = surface_from(distance, _unsure(grid, 0.1), grid, view)
    made = trimesh.Trimesh(found.vertices, found.faces, process=False)
    assert made.is_volume
    assert made.volume == pytest.approx(mesh.volume, rel=0.02)
    rng = np.random.default_rng(0)
    samples, again = (visible_surface(mesh, 8192, rng) for _ in range(2))
    assert chamfer_m(visible_surface(made, 8192, rng), samples) < chamfer_m(again, samples) + 0.1 * grid.cell_m


def test_sigma_is_that_of_the_scale_where_no_point_is_near_and_less_where_points_are() -> None:
    view, grid, _, distance = _case()
    found = surface_from(distance, _unsure(grid, 0.5), grid, view)
    told_m = np.sqrt(2) * 0.5 * grid.cell_m
    far = np.linalg.norm(found.vertices[:, None] - view.dense_points[None], axis=2).min(axis=1) > 6 * grid.cell_m
    np.testing.assert_allclose(found.sigma_m[far], told_m)
    near = np.linalg.norm(found.vertices[:, None] - view.dense_points[None], axis=2).min(axis=1) < 0.5 * grid.cell_m
    assert far.sum() > 500
    assert near.sum() > 500
    assert np.median(found.sigma_m[near]) < view.sigma_m
    assert found.sigma_m.max() <= told_m + 1e-12


def test_points_draw_a_surface_that_is_not_sure_and_leave_one_that_is() -> None:
    view, grid, mesh, distance = _case()
    error = {}
    for cells in (0.01, 2.0):
        found = surface_from(distance - 0.6, _unsure(grid, cells), grid, view)
        samples, normals, _ = sample_surface(mesh, 60_000, np.random.default_rng(0))
        near = np.linalg.norm(found.vertices[:, None] - view.dense_points[None], axis=2).min(axis=1) < grid.cell_m
        place = KDTree(samples).query(found.vertices)[1]
        off = np.einsum("vi,vi->v", found.vertices - samples[place], normals[place]) / grid.cell_m
        error[cells] = float(np.median(off[near])), float(np.median(off[~near]))
    assert error[0.01] == pytest.approx((0.6, 0.6), abs=0.1)
    assert error[2.0][0] == pytest.approx(0.0, abs=0.1)
    assert error[2.0][1] == pytest.approx(0.6, abs=0.15)


@pytest.mark.parametrize("oriented", [True, False])
def test_points_on_one_side_of_a_wall_do_not_move_the_other(oriented: bool) -> None:
    view, grid, _, _ = _case()
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.03, 0.03, 31), np.linspace(0.01, 0.07, 31)))
    points = np.column_stack([np.zeros_like(y), y, z])
    normals = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    view = replace(view, dense_points=points, dense_normals=normals)
    view = view if oriented else replace(view, cloud=points_alone(seen()[0]).cloud)
    x = grid.middles()[:, 0].reshape(grid.shape) / grid.cell_m
    wall = np.abs(x + 1.2) - 0.9  # from -2.1 to -0.3 cells; what was seen says that it ends at 0
    found = surface_from(wall, _unsure(grid, 1.0), grid, view)
    inner = np.abs(found.vertices[:, 1]) < 0.02
    inner &= (found.vertices[:, 2] > 0.02) & (found.vertices[:, 2] < 0.06)
    front = inner & (vertex_normals(found.vertices, found.faces)[:, 0] > 0.9)
    back = inner & (vertex_normals(found.vertices, found.faces)[:, 0] < -0.9)
    assert np.abs(found.vertices[front, 0]).max() < 0.05 * grid.cell_m
    if oriented:
        np.testing.assert_allclose(found.vertices[back, 0], -2.1 * grid.cell_m, atol=1e-6)


def test_a_speck_is_left_out_a_cavity_is_filled_and_a_second_body_that_was_seen_stays() -> None:
    view, grid, _, distance = _case()
    with_speck = distance.copy()
    with_speck[2:4, 2:4, -4:-2] = -0.5
    inside = np.argwhere(distance < -3)
    assert len(inside)
    with_cavity = with_speck.copy()
    with_cavity[tuple(inside[len(inside) // 2])] = 0.5
    volumes = []
    for field in (distance, with_speck, with_cavity):
        found = surface_from(field, _unsure(grid, 0.01), grid, view)
        volumes.append(trimesh.Trimesh(found.vertices, found.faces, process=False).volume)
    np.testing.assert_allclose(volumes, volumes[0], rtol=1e-9)

    cut = distance.copy()
    level = round(grid.cells(np.array([[0, 0, 0.06]]))[0, 2])
    cut[:, :, level] = np.maximum(cut[:, :, level], 0.4)
    found = surface_from(cut, _unsure(grid, 0.01), grid, view)
    assert trimesh.Trimesh(found.vertices, found.faces, process=False).body_count == 2


def test_where_nothing_is_inside_there_is_no_surface() -> None:
    view, grid, _, _ = _case()
    with pytest.raises(NoSurface, match="one object"):
        surface_from(np.full(grid.shape, 0.3), _unsure(grid, 1.0), grid, view)


def test_exact_distances_of_a_moved_body_give_the_moved_surface() -> None:
    view, grid, _, distance = _case()
    there = Grid(tuple(np.add(grid.origin, [0.5, -0.25, 0.125])), grid.cell_m, grid.shape)
    offset = np.subtract(there.origin, grid.origin)
    moved = replace(
        view,
        dense_points=view.dense_points + offset,
        cloud=replace(view.cloud, points=view.cloud.points + offset),
    )
    a = surface_from(distance, _unsure(grid, 0.5), grid, view)
    b = surface_from(distance, _unsure(grid, 0.5), there, moved)
    np.testing.assert_allclose(b.vertices, a.vertices + offset, atol=1e-9)
    assert apply_T(np.eye(4), a.vertices).shape == b.vertices.shape


def test_a_wall_between_empty_cells_is_closed_along_any_axis() -> None:
    across = np.abs(np.arange(14.0) - 5) + 0.3
    for axis in range(3):
        distance = np.moveaxis(np.broadcast_to(across[:, None, None], (14, 9, 11)), 0, axis)
        sunk = np.moveaxis(with_thin_walls(distance), axis, 0)[:, 4, 5]
        # Three cells off a valley of 0.3 it is at 3.3, so it rises by 3; a cell aside, from 1.3, by 1 at least.
        np.testing.assert_allclose(sunk[4:7], [1.3 - 0.7 * 0.8, 0.3 - 0.7 * 2.8, 1.3 - 0.7 * 0.8])
        np.testing.assert_allclose(np.delete(sunk, [4, 5, 6]), np.delete(across, [4, 5, 6]))


def test_a_wall_that_is_there_and_a_side_of_something_solid_stay() -> None:
    cells = np.arange(14.0)
    for across in (np.abs(cells - 5) - 0.65, cells - 5.3, 6.1 - cells):
        distance = np.broadcast_to(across[:, None, None], (14, 9, 11))
        np.testing.assert_array_equal(with_thin_walls(distance), distance)


def test_a_hole_in_a_thin_wall_is_closed() -> None:
    view, grid, _, _ = _case()
    x, y, z = (grid.cells(grid.middles()) - (np.array(grid.shape) // 2)).T
    wall = np.maximum(np.abs(y) - 0.65, np.maximum(np.abs(x) - 12, np.abs(z) - 9))
    unsure = (np.hypot(x - 2, z) < 3) & (np.abs(y) < 4)
    whole, closed = (
        surface_from(np.clip(cells, -REACH, REACH).reshape(grid.shape), _unsure(grid, 0.01), grid, view)
        for cells in (wall, wall + 0.95 * unsure)
    )
    made = trimesh.Trimesh(closed.vertices, closed.faces, process=False)
    assert made.is_volume
    assert made.euler_number == 2  # that of a ball; a hole would make it 0
    as_seen = trimesh.Trimesh(whole.vertices, whole.faces, process=False)
    assert made.volume == pytest.approx(as_seen.volume, rel=0.03)
