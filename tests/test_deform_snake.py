"""The active contour, term by term: a plate of 60 mm by 40 mm whose upper side is drawn to points above it."""

import numpy as np
import pytest
from toy_bodies import dense_laplacian, slab

from gfp_grasp.deform import SnakeConfig, evolve
from gfp_grasp.errors import InvalidOption

PLATE = slab((0.06, 0.04, 0.012), edge_m=0.006)
VERTICES, FACES = np.asarray(PLATE.vertices), np.asarray(PLATE.faces)
# Of the upper side, what is not at its edge, where normals lean.
TOP = (VERTICES[:, 2] > 0.005) & (np.abs(VERTICES[:, :2]) < (0.029, 0.019)).all(axis=1)
UP = np.array([0.0, 0.0, 1.0])
UNIT_M = 0.03


def drawn(points, normals=UP, **config):
    """Displacement (v, 3) of the plate by one step of a contour without stiffness, unless config says otherwise."""
    points = np.asarray(points)
    config = {"steps": 1, "elastic": 0.0, "bending": 0.0, "smooth": 1, **config}
    normals = np.broadcast_to(normals, points.shape)
    return evolve(VERTICES, FACES, points, normals, unit_m=UNIT_M, config=SnakeConfig(**config)) - VERTICES


def over(offset, where=TOP):
    """One point for each vertex of the upper side, away from it by offset."""
    return VERTICES[where] + offset


def test_a_vertex_moves_to_the_height_of_its_point_along_its_own_normal_only():
    moved = drawn(over((0.0011, -0.0007, 0.002)))
    assert moved[TOP] == pytest.approx(np.tile([0, 0, 0.002], (TOP.sum(), 1)), abs=1e-9)
    assert moved[VERTICES[:, 2] < -0.005] == pytest.approx(0.0, abs=1e-12)  # the lower side faces the other way


def test_the_height_is_that_over_the_plane_of_the_point():
    lean = np.deg2rad(25)
    normal = np.array([0.0, np.sin(lean), np.cos(lean)])
    moved = drawn(over((0, 0, 0.003)), normal)
    assert moved[TOP, 2] == pytest.approx(np.full(TOP.sum(), 0.003 * np.cos(lean)))


def test_the_pull_is_weighed_and_steps_add_up():
    assert drawn(over((0, 0, 0.002)), pull=0.25)[TOP, 2] == pytest.approx(np.full(TOP.sum(), 0.0005))
    twice = drawn(over((0, 0, 0.002)), pull=0.25, steps=2)
    inner = TOP & (np.abs(VERTICES[:, :2]) < (0.02, 0.01)).all(axis=1)
    assert twice[inner, 2] == pytest.approx(np.full(inner.sum(), 0.0005 + 0.25 * 0.0015), rel=1e-3)


def test_a_tangential_share_pulls_along_the_surface_too():
    offset = np.array([0.0011, -0.0007, 0.002])
    moved = drawn(over(offset), tangential=0.5)
    assert moved[TOP] == pytest.approx(np.tile((0, 0, 0.002) + 0.5 * offset, (TOP.sum(), 1)), abs=1e-9)


def test_as_many_points_as_smooth_says_are_averaged():
    beside = np.array([[0.0003, 0, 0.001], [-0.0004, 0, 0.002], [0, 0.0005, 0.003]])
    points = np.concatenate([over(offset) for offset in beside])
    inner = TOP & (np.abs(VERTICES[:, :2]) < (0.02, 0.01)).all(axis=1)
    for smooth, height in ((1, 0.001), (2, 0.0015), (3, 0.002)):
        assert drawn(points, smooth=smooth)[inner, 2] == pytest.approx(np.full(inner.sum(), height))
    assert drawn(points[:3], smooth=8).shape == VERTICES.shape  # fewer points than it would average


@pytest.mark.parametrize(("height", "is_pulled"), [(0.0149, True), (0.0151, False)])
def test_no_point_beyond_half_a_unit_pulls(height, is_pulled):
    middle = [np.argmin(np.linalg.norm(VERTICES - [0, 0, 0.006], axis=1))]
    moved = drawn(over((0, 0, height)))
    assert moved[middle, 2] == pytest.approx([height if is_pulled else 0.0])


@pytest.mark.parametrize(("degrees", "is_pulled"), [(59, True), (61, False)])
def test_no_point_whose_normal_leans_by_more_than_60_degrees_pulls(degrees, is_pulled):
    lean = np.deg2rad(degrees)
    moved = drawn(over((0, 0, 0.002)), np.array([np.sin(lean), 0, np.cos(lean)]))
    assert (np.abs(moved[TOP, 2]) > 1e-6).all() == is_pulled


def test_a_point_that_faces_a_vertex_is_preferred_to_a_nearer_one_that_does_not():
    """Half a unit of distance weighs as much as a unit of difference between normals."""
    lean = np.deg2rad(50)
    leaning, flat = np.array([np.sin(lean), 0, np.cos(lean)]), UP
    points = np.concatenate([over((0, 0, 0.001)), over((0, 0, 0.008))])
    normals = np.repeat([leaning, flat], TOP.sum(), axis=0)
    assert 0.001 + 0.015 * 2 * np.sin(lean / 2) > 0.008
    moved = drawn(points, normals)
    assert moved[TOP, 2] == pytest.approx(np.full(TOP.sum(), 0.008))


def test_one_step_is_semi_implicit_with_elastic_and_bending_energy_of_the_displacement():
    """(1 + a L + b L'L) d = f, with f the pull of a contour without stiffness."""
    points = over((0, 0, 0.002))[::2]
    force = drawn(points)
    found = drawn(points, elastic=0.7, bending=2.0)
    L = dense_laplacian(FACES, len(VERTICES))
    assert (np.eye(len(L)) + 0.7 * L + 2.0 * L.T @ L) @ found == pytest.approx(force, abs=1e-12)


@pytest.mark.parametrize(
    "nonsense", [{"steps": 0}, {"smooth": 0}, {"elastic": -1.0}, {"bending": -1.0}, {"pull": -1.0}, {"reach": 0.0}]
)
def test_energies_that_mean_nothing_are_refused(nonsense):
    with pytest.raises(InvalidOption, match="must"):
        SnakeConfig(**nonsense)
