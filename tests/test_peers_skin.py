"""From points, distances and fields to watertight meshes."""

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import NoSurface
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.peers import cell_middles
from gfp_grasp.peers.skin import outer_bodies, skin_of_distances, skin_of_points, surface_of_field


def on_ball(count: int, radius: float = 0.3) -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True)


def distance_of_ball(resolution: int, radius: float = 0.3) -> np.ndarray:
    """(x, y, z) signed distances in cells."""
    distance = np.linalg.norm(cell_middles(resolution), axis=1) - radius
    return resolution * distance.reshape(3 * (resolution,))


def test_points_all_around_become_a_solid_of_the_right_size() -> None:
    mesh = skin_of_points(on_ball(2048))
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.04)
    assert mesh.body_count == 1


def test_points_on_an_open_sheet_become_a_thin_wall() -> None:
    sheet = np.random.default_rng(0).uniform(-0.3, 0.3, (2048, 3)) * (1, 1, 0)
    mesh = skin_of_points(sheet)
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert mesh.volume / 0.6**2 < 0.02  # mean thickness
    assert chamfer_m(np.asarray(mesh.vertices), sheet) < 0.03


def test_a_vessel_stays_open() -> None:
    """A cup of two walls and a floor: its inside can be seen from above."""
    outer = trimesh.creation.cylinder(0.25, 0.6)
    inner = trimesh.creation.cylinder(0.22, 0.6)
    inner.apply_translation((0, 0, 0.03))
    cup = outer.difference(inner, engine="manifold")
    rng = np.random.default_rng(0)
    mesh = skin_of_points(visible_surface(cup, 2304, rng))
    assert mesh.is_volume
    assert mesh.volume < 0.5 * outer.volume
    there, here = (visible_surface(m, 4096, rng) for m in (cup, mesh))
    assert chamfer_m(here, there) < 0.035  # two samplings of the cup are 0.022 apart


def test_a_skin_turns_with_its_points() -> None:
    points = on_ball(1024) * (1.0, 0.5, 0.8)
    turned = points[:, [1, 0, 2]] * (1, -1, 1)
    a, b = skin_of_points(points), skin_of_points(turned)
    assert b.volume == pytest.approx(a.volume, rel=0.01)


def test_points_that_are_no_numbers_or_too_few_are_no_surface() -> None:
    with pytest.raises(NoSurface, match="3 finite points"):
        skin_of_points(np.vstack([np.full((50, 3), np.nan), np.zeros((3, 3))]))


def test_points_in_one_place_are_a_small_ball() -> None:
    mesh = skin_of_points(np.full((100, 3), 0.1))
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.centroid, 0.1, atol=1e-3)


def test_unsigned_distances_become_a_solid_of_the_right_size() -> None:
    mesh = skin_of_distances(np.abs(distance_of_ball(32)))
    assert mesh.is_volume
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.05)


def test_a_field_is_cut_where_it_is_zero() -> None:
    mesh = surface_of_field(distance_of_ball(40))
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=0.01)
    np.testing.assert_allclose(mesh.centroid, 0, atol=1e-6)


def test_crumbs_are_dropped_and_voids_are_filled() -> None:
    ball, crumb, void = (trimesh.creation.icosphere(3, radius) for radius in (0.3, 0.02, 0.1))
    crumb.apply_translation((0.45, 0, 0))
    void.invert()
    all_three = trimesh.util.concatenate([ball, crumb, void])
    assert isinstance(all_three, trimesh.Trimesh)
    kept = outer_bodies(all_three)
    assert kept.body_count == 1
    assert kept.volume == pytest.approx(ball.volume)


def test_a_field_that_is_outside_everywhere_has_no_surface() -> None:
    with pytest.raises(NoSurface, match="for empty"):
        surface_of_field(np.ones((8, 8, 8)))
    with pytest.raises(NoSurface, match="for empty"):
        skin_of_distances(np.full((8, 8, 8), 5.0))
