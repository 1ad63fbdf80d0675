"""Surfaces around where a field is negative: where they lie, and that they are closed whatever the field."""

from collections import defaultdict

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from gfp_grasp.meshes import crossing_faces, surface_net

ORIGIN, CELL_M = np.array([0.3, -0.2, 0.1]), 0.004


def _places(shape: tuple[int, int, int]) -> np.ndarray:
    return ORIGIN + CELL_M * np.moveaxis(np.indices(shape), 0, -1)


def _num_fans(mesh: trimesh.Trimesh) -> list[int]:
    """For each vertex, how many fans its faces make up: in a manifold, one."""
    links: dict[int, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
    for face in mesh.faces.tolist():
        for i in range(3):
            a, b, c = face[i], face[i - 2], face[i - 1]
            links[a][b].add(c)
            links[a][c].add(b)
    fans = []
    for around in links.values():
        left, count = set(around), 0
        while left:
            count, waiting = count + 1, [left.pop()]
            while waiting:
                new = around[waiting.pop()] & left
                left -= new
                waiting += new
        fans.append(count)
    return fans


def test_the_surface_of_a_distance_field_lies_where_it_is_zero() -> None:
    low, high = ORIGIN + np.array([0.0215, 0.0303, 0.0409]), ORIGIN + np.array([0.0907, 0.0651, 0.0783])
    off = np.maximum(low - _places((30, 22, 25)), _places((30, 22, 25)) - high)
    field = np.linalg.norm(np.maximum(off, 0), axis=-1) + np.minimum(off.max(axis=-1), 0)
    mesh = surface_net(field, origin=ORIGIN, cell_m=CELL_M)
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.bounds, [low, high], atol=1e-9)
    # Only the edges are rounded: by less than half a cell.
    assert np.prod(high - low) * 0.96 < mesh.volume < np.prod(high - low)
    inner = np.maximum(low - mesh.vertices, mesh.vertices - high).max(axis=1)
    assert inner.min() > -0.5 * CELL_M
    assert len(crossing_faces(mesh.vertices, mesh.faces)) == 0


@pytest.mark.parametrize("seed", range(60))
def test_every_field_has_a_watertight_surface_without_pinches(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = rng.normal(size=rng.integers(2, 12, 3))
    if seed % 2:
        field = ndimage.gaussian_filter(field, rng.uniform(0.3, 1.5))
    mesh = surface_net(field, origin=ORIGIN, cell_m=CELL_M)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    _, counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    assert (counts == 2).all()
    assert set(_num_fans(mesh)) == {1}
    assert mesh.volume > 0


def test_two_inner_corners_that_face_each_other_in_a_square_are_joined_and_those_of_a_cube_are_not() -> None:
    field = np.ones((4, 4, 4))
    field[1, 1, 1] = field[2, 2, 1] = -0.5
    assert surface_net(field, origin=ORIGIN, cell_m=CELL_M).body_count == 1
    field[2, 2, 1], field[2, 2, 2] = 1.0, -0.5
    apart = surface_net(field, origin=ORIGIN, cell_m=CELL_M)
    assert apart.body_count == 2
    assert apart.is_volume


def test_outside_corners_that_face_each_other_in_a_cube_are_two_hollows() -> None:
    field = np.full((6, 6, 6), -1.0)
    field[2, 2, 2] = field[3, 3, 3] = 0.5
    mesh = surface_net(field, origin=ORIGIN, cell_m=CELL_M)
    assert mesh.body_count == 3
    assert set(_num_fans(mesh)) == {1}


def test_beyond_the_grid_is_outside_and_where_nothing_is_inside_there_is_no_face() -> None:
    full = surface_net(np.full((3, 4, 5), -1.0), origin=ORIGIN, cell_m=CELL_M)
    np.testing.assert_allclose(full.bounds, ORIGIN + CELL_M * np.array([[-0.5, -0.5, -0.5], [2.5, 3.5, 4.5]]))
    assert full.is_volume
    assert len(surface_net(np.ones((3, 4, 5)), origin=ORIGIN, cell_m=CELL_M).faces) == 0
