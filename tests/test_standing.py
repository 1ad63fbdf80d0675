"""Surfaces that stand: known heights of uneven bodies, feet that grow no more than they must, turns onto a side.

Most bodies are fine meshes, moved away from the origin, of which no two sides are alike.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay
from toy_bodies import l_body, refined
from toy_wedge import toy_evidence

from gfp_grasp.deform import stand_on, stood
from gfp_grasp.deform.shape import _stood_again
from gfp_grasp.deform.standing import _centre_of_mass, _margin_m
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import TABLETOP

SIGMA_M = TABLETOP.sigma_m
FOOT_M = SIGMA_M / 3
FINE_M = 1e-4  # a sensor whose feet are thin
AWAY = np.array([0.3, -0.2, 0.0])
Arrays = tuple[np.ndarray, np.ndarray]


def arrays(mesh: trimesh.Trimesh, *, lift_m: float = 0.0) -> Arrays:
    return np.asarray(mesh.vertices) + AWAY + [0.0, 0.0, lift_m], np.asarray(mesh.faces)


def box(low: list[float], high: list[float], edge_m: float = 0.005) -> trimesh.Trimesh:
    return refined(trimesh.creation.box(bounds=[low, high]), edge_m)


def leaning(shift_m: float, *, foot_m: float = 0.02, height_m: float = 0.03, edge_m: float = 0.005) -> Arrays:
    """A box, 30 mm wide, whose top is shifted along x."""
    mesh = box([0.0, 0.0, 0.0], [foot_m, 0.03, height_m], edge_m)
    vertices, faces = arrays(mesh)
    return vertices + np.outer(vertices[:, 2] / height_m, [shift_m, 0.0, 0.0]), faces


def tilted(degrees: float) -> Arrays:
    """The L on the edge of its short bar, which is far from its centre of mass; its lowest point is at 0."""
    vertices, faces = arrays(l_body(0.006))
    vertices = vertices @ rotation_about((0.1, 1.0, 0.0), np.radians(degrees)).T
    return vertices - [0.0, 0.0, vertices[:, 2].min()], faces


def rests(vertices: np.ndarray, faces: np.ndarray, floor_m: float = 0.0) -> bool:
    """Whether the centre of mass is above what touches the floor, by other means than the package's."""
    feet = vertices[np.abs(vertices[:, 2] - floor_m) < 1e-9, :2]
    centre = trimesh.Trimesh(vertices, faces, process=False).center_mass
    return len(feet) > 2 and bool(Delaunay(feet).find_simplex(centre[:2]) >= 0)


@pytest.mark.parametrize(
    ("floor_seen", "lift_m", "floor_m"),
    [
        (True, 19.9 * SIGMA_M, 0.0),
        (True, 20.1 * SIGMA_M, 20.1 * SIGMA_M),
        (True, -0.004, 0.0),
        (False, 0.005, 0.005),
        (False, -0.004, -0.004),
    ],
)
def test_a_body_reaches_the_support_that_was_seen_and_else_stands_on_its_lowest_point(floor_seen, lift_m, floor_m):
    vertices, faces = arrays(l_body(), lift_m=lift_m)
    found = stood(vertices, faces, toy_evidence(vertices, floor_seen=floor_seen))
    bottom = vertices[:, 2] < lift_m + 1e-9
    assert found[bottom, 2] == pytest.approx(floor_m, abs=1e-12)
    np.testing.assert_array_equal(found[:, :2], vertices[:, :2])
    np.testing.assert_allclose(found[~bottom, 2], np.maximum(vertices[~bottom, 2], floor_m))
    assert rests(found, faces, floor_m)


def test_an_uneven_bottom_becomes_flat_up_to_a_third_of_the_noise_and_no_higher():
    vertices, faces = arrays(l_body())
    bottom = np.flatnonzero(vertices[:, 2] == 0.0)
    uneven = np.random.default_rng(0).uniform(0.0, 2 * FOOT_M, len(bottom))
    uneven[0] = 0.0
    vertices[bottom, 2] = uneven
    found = stand_on(vertices, faces, 0.0, sigma_m=SIGMA_M)
    np.testing.assert_array_equal(found[bottom, 2], np.where(uneven < FOOT_M, 0.0, uneven))
    assert 0.3 < (uneven < FOOT_M).mean() < 0.7


@pytest.mark.parametrize(("normal_z", "joins"), [(-0.28, False), (-0.32, True)])
def test_a_flank_that_faces_down_enough_is_part_of_the_foot(normal_z: float, joins: bool):
    mesh = box([0.0, 0.0, 0.0], [0.2, 0.3, 0.1])
    vertices, faces = arrays(mesh)
    flank = (np.asarray(mesh.vertices)[:, 0] == 0.2) & (np.abs(np.asarray(mesh.vertices)[:, 1] - 0.15) < 0.1)
    slope = -normal_z / np.sqrt(1 - normal_z**2)
    vertices += np.outer(vertices[:, 2] * (vertices[:, 0] - AWAY[0]) / 0.2, [slope, 0.0, 0.0])
    low = flank & (vertices[:, 2] > 0.0) & (vertices[:, 2] < 0.009)
    assert low.sum() > 10
    found = stand_on(vertices, faces, 0.0, sigma_m=0.03)  # a foot of 10 mm
    np.testing.assert_array_equal(found[low, 2], np.where(joins, 0.0, vertices[low, 2]))


def test_what_faces_up_stays_a_third_of_the_noise_above_the_floor():
    mesh = box([0.0, 0.0, 0.0], [0.2, 0.3, 0.001], 0.02)
    vertices, faces = arrays(mesh)
    top = vertices[:, 2] > 0.0
    found = stand_on(vertices, faces, 0.0, sigma_m=0.03)
    within = top & (np.abs(vertices[:, :2] - AWAY[:2] - [0.1, 0.15]) < [0.09, 0.14]).all(axis=1)
    assert found[within, 2] == pytest.approx(0.01)
    assert (found[~top, 2] == 0.0).all()


def test_what_lay_below_the_floor_lies_on_it():
    vertices, faces = arrays(l_body(), lift_m=-0.025)  # the foot's upper side, too
    found = stand_on(vertices, faces, 0.0, sigma_m=SIGMA_M)
    assert found[:, 2].min() == 0.0
    above = vertices[:, 2] > 0.0
    np.testing.assert_array_equal(found[above], vertices[above])
    bar = (vertices[:, 0] > AWAY[0] + 0.04) & (vertices[:, 0] < AWAY[0] + 0.07) & (vertices[:, 2] > -0.0051)
    inner = bar & (np.abs(vertices[:, 1] - AWAY[1] - 0.005) < 0.02)
    assert inner.any()
    assert found[inner, 2] == pytest.approx(SIGMA_M / 3)


@pytest.mark.parametrize(("margin", "stands"), [(1.1, True), (0.9, False)])
def test_the_centre_of_mass_must_be_as_far_within_the_foot_as_the_noise(margin: float, stands: bool):
    vertices, faces = leaning(0.02 - 2 * margin * SIGMA_M)
    found = stand_on(vertices, faces, 0.0, sigma_m=SIGMA_M)
    assert bool((found == vertices).all()) == stands
    assert rests(found, faces)


def test_a_foot_grows_no_more_than_it_must_and_the_body_above_stays():
    vertices, faces = leaning(0.05, height_m=0.06, edge_m=0.002)
    assert not rests(vertices, faces)
    found = stand_on(vertices, faces, 0.0, sigma_m=SIGMA_M)
    assert rests(found, faces)
    moved = found[:, 2] != vertices[:, 2]
    assert 32 * FOOT_M < vertices[moved & (found[:, 2] == 0.0), 2].max() < 64 * FOOT_M
    np.testing.assert_array_equal(found[:, :2], vertices[:, :2])
    assert not moved[vertices[:, 2] > 64 * FOOT_M].any()


def test_a_small_foot_grows_before_the_body_is_turned():
    vertices, faces = tilted(3.0)  # the centre of mass is above what lies 3 mm high
    found = stand_on(vertices, faces, 0.0, sigma_m=SIGMA_M)
    np.testing.assert_array_equal(found[:, :2], vertices[:, :2])
    assert rests(found, faces)
    assert 4 * FOOT_M < vertices[found[:, 2] == 0.0, 2].max() < 8 * FOOT_M


@pytest.mark.parametrize(("degrees", "floor_m"), [(3.0, 0.0), (4.8, 0.4)])
def test_a_body_that_would_topple_is_turned_onto_the_side_that_it_would_roll_to(degrees: float, floor_m: float):
    vertices, faces = tilted(degrees)
    vertices = np.add(vertices, [0.0, 0.0, floor_m])
    found = stand_on(vertices, faces, floor_m, sigma_m=FINE_M)
    upright, _ = arrays(l_body(0.006))
    np.testing.assert_allclose(found[:, 2] - floor_m, upright[:, 2], atol=1e-5)
    # The turn is the shortest, about the centre of mass.
    back = upright - _centre_of_mass(upright, faces)
    np.testing.assert_allclose(found - _centre_of_mass(found, faces), back, atol=2e-5)
    np.testing.assert_allclose(
        _centre_of_mass(found, faces)[:2], trimesh.Trimesh(vertices, faces, process=False).center_mass[:2], atol=2e-5
    )


def test_a_body_that_leans_by_more_than_five_degrees_or_may_not_be_turned_grows_a_foot():
    for degrees, sigma_m, turn in ((5.2, SIGMA_M, True), (3.0, FINE_M, False)):
        vertices, faces = tilted(degrees)
        found = stand_on(vertices, faces, 0.0, sigma_m=sigma_m, turn=turn)
        np.testing.assert_array_equal(found[:, :2], vertices[:, :2])
        assert rests(found, faces)


@pytest.mark.parametrize("side", [1, -1])
def test_a_keel_falls_onto_its_nearer_side(side: int):
    section = np.array([[-0.05, np.tan(np.radians(4.0)) * 0.05], [0.0, 0.0], [0.05, np.tan(np.radians(1.5)) * 0.05]])
    ring = np.vstack([section, [0.05, 0.04], [-0.05, 0.04]])
    corners = np.array([[side * x, y, z] for y in (0.0, 0.03) for x, z in ring])
    hull = trimesh.convex.convex_hull(corners)
    vertices, faces = arrays(hull)
    found = stand_on(vertices, faces, 0.0, sigma_m=FINE_M)
    x = side * (vertices[:, 0] - AWAY[0])
    low = vertices[:, 2] < 0.01
    assert found[low & (x > -0.01), 2] == pytest.approx(0.0, abs=1e-12)
    left = 0.05 / np.cos(np.radians(4.0)) * np.sin(np.radians(5.5))
    assert found[low & (x < -0.01), 2] == pytest.approx(left, abs=1e-6)


def test_what_no_foot_holds_stays_as_it_is():
    vertices, faces = leaning(0.06, height_m=0.1)  # its centre of mass is beyond its own bottom
    np.testing.assert_allclose(stand_on(vertices, faces, 0.0, sigma_m=1e-5), vertices, atol=1e-12)
    lifted = np.add(vertices, [0.0, 0.0, 0.01])
    found = stand_on(lifted, faces, 0.01, sigma_m=1e-5)
    np.testing.assert_allclose(found, lifted, atol=1e-12)


def test_the_centre_of_mass_is_that_of_the_solid_wherever_it_is():
    mesh = l_body()
    vertices, faces = arrays(mesh, lift_m=7.0)
    by_hand = (1.5e-4 * np.array([0.015, 0.005, 0.05]) + 5e-5 * np.array([0.055, 0.005, 0.01])) / 2e-4
    np.testing.assert_allclose(_centre_of_mass(vertices, faces), by_hand + AWAY + [0, 0, 7.0], atol=1e-9)


def test_a_margin_is_the_way_to_the_nearest_edge():
    ground = np.add(AWAY[:2], [[0, 0], [0.06, 0], [0.06, 0.02], [0, 0.02], [0.03, 0.01]])
    for place, margin_m in (([0.05, 0.013], 0.007), ([0.057, 0.01], 0.003), ([0.062, 0.01], -0.002)):
        assert _margin_m(ground, AWAY[:2] + place) == pytest.approx(margin_m)
    for too_few in (ground[:0], ground[:1], ground[:2], np.linspace(ground[0], ground[2], 5)):
        assert _margin_m(too_few, ground[0]) == -np.inf


def on_four_legs() -> Arrays:
    """A table of 2 by 1 m on four legs, one of which is 40 mm short and 50 mm to the side of the centre of mass."""
    top = trimesh.creation.box(bounds=[[-1.05, -0.5, 0.2], [0.95, 0.5, 0.7]])
    legs = [
        trimesh.creation.box(bounds=[[x - 0.1, y - 0.1, 0.04 * (x > 0 and y > 0)], [x + 0.1, y + 0.1, 0.2]])
        for x in (-0.8, 0.8)
        for y in (-0.4, 0.4)
    ]
    together = trimesh.util.concatenate([top, *legs])
    assert isinstance(together, trimesh.Trimesh)
    return np.asarray(together.vertices), np.asarray(together.faces)


def test_a_foot_grows_until_the_centre_of_mass_lies_as_far_within_it_as_is_asked_for():
    vertices, faces = on_four_legs()
    bottom = vertices[:, 2] < 0.05
    three = stand_on(vertices, faces, 0.0, sigma_m=0.02)
    assert three[bottom, 2].max() == pytest.approx(0.04)
    four = stand_on(vertices, faces, 0.0, sigma_m=0.02, margin_m=0.2)
    np.testing.assert_array_equal(four[bottom, 2], 0.0)
    feet = four[four[:, 2] < 1e-9, :2]
    assert _margin_m(feet, _centre_of_mass(four, faces)[:2]) > 0.2


def test_what_the_damping_left_above_the_support_is_brought_down_where_it_is_little_for_the_body(monkeypatch):
    vertices, faces = arrays(l_body(), lift_m=0.0)
    size_m = np.ptp(vertices, axis=0).max()
    view = toy_evidence(vertices, floor_seen=True)
    for missing_m, brought in ((0.02 * size_m, True), (0.04 * size_m, False)):
        lifted = vertices + np.array([0.0, 0.0, missing_m])
        monkeypatch.setattr("gfp_grasp.deform.shape.stood", lambda *_: vertices)
        np.testing.assert_allclose(_stood_again(lifted, faces, view), vertices if brought else lifted, atol=1e-12)
