"""Distances that a network learns: exact for solids, and such that thin walls are still walls on the grid."""

import numpy as np
import pytest
import trimesh
from toy_bodies import l_body

from gfp_grasp.classfree import Grid
from gfp_grasp.meshes import surface_net
from gfp_grasp.shapes import make_mixture
from gfp_grasp.train.distances import THINNEST, _inside, signed_distances
from gfp_grasp.transforms import make_T, rotation_about

GRID = Grid((-0.031, -0.042, -0.017), 0.004, (40, 32, 40))


def _assert_nearly_all(found: np.ndarray, true: np.ndarray) -> None:
    """All but a few beside edges, whose nearest triangle has no sample near, are equal."""
    off = np.abs(found - true)
    assert (off < 1e-3).mean() > 0.998
    assert off.max() < 0.3


def test_distances_of_a_box_are_exact() -> None:
    low, high = np.array([0.011, -0.013, 0.007]), np.array([0.053, 0.041, 0.093])
    mesh = trimesh.creation.box(bounds=[low, high])
    found = signed_distances(mesh, GRID, reach=5.0)
    off = np.maximum(low - GRID.middles(), GRID.middles() - high)
    true = np.linalg.norm(np.maximum(off, 0), axis=1) + np.minimum(off.max(axis=1), 0)
    true = np.clip(true / GRID.cell_m, -5, 5).reshape(GRID.shape)
    near = np.abs(true) < 1.0
    assert near.sum() > 1000
    _assert_nearly_all(found[near], true[near])
    np.testing.assert_allclose(found, true, atol=0.6)
    assert np.abs(found - true).mean() < 0.01
    assert found.dtype == np.float32


@pytest.mark.parametrize("number", range(4))
def test_what_is_inside_is_what_rays_say(number: int) -> None:
    mesh = l_body() if number == 0 else make_mixture(("toy-like", "shell", "sweep")[number - 1], number)
    cell = float(mesh.extents.max()) / 36
    grid = Grid(tuple(mesh.bounds[0] - 2.37 * cell), cell, (40, 40, 40))
    found = _inside(grid.cells(np.asarray(mesh.vertices))[mesh.faces], grid.shape)
    chosen = np.random.default_rng(0).choice(found.size, 3000, replace=False)
    assert (found.ravel()[chosen] == mesh.contains(grid.middles()[chosen])).mean() > 0.999
    assert found.any()


@pytest.mark.parametrize("thick", [0.2, 0.9, 1.0, 2.0])
def test_a_thin_wall_is_made_so_thick_that_the_grid_shows_it(thick: float) -> None:
    wall_m = thick * GRID.cell_m
    mesh = trimesh.creation.box([0.09, 0.07, wall_m])
    R = rotation_about((1, 2, 0.5), 0.4)
    mesh.apply_transform(make_T(R))
    mesh.apply_translation([0.045, 0.02, 0.06])
    net = surface_net(signed_distances(mesh, GRID, reach=5.0), origin=np.array(GRID.origin), cell_m=GRID.cell_m)
    assert net.is_volume
    assert net.body_count == 1
    assert net.euler_number == 2  # without a hole
    expected_m = max(thick, THINNEST) * GRID.cell_m
    height = (np.asarray(net.vertices) - [0.045, 0.02, 0.06]) @ R[:, 2]
    assert np.quantile(height, 0.9) - np.quantile(height, 0.1) == pytest.approx(expected_m, rel=0.06)


def test_distances_are_those_of_the_body_whatever_the_grid() -> None:
    mesh = l_body()
    fine = Grid((-0.02, -0.04, -0.02), 0.002, (64, 48, 72))
    coarse = Grid(fine.origin, 0.004, (32, 24, 36))
    a, b = (signed_distances(mesh, grid, reach=5.0) for grid in (fine, coarse))
    same = np.abs(b) < 0.5
    assert same.sum() > 1000
    _assert_nearly_all(a[::2, ::2, ::2][same], 2 * b[same])
