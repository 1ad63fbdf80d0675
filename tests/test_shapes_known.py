"""Procedural shapes to the number: those of the committed figures, and the curves that they are made of."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.shapes.loft import inset, loft, rounded, rows, smoothstep, sweep, thinned
from gfp_grasp.shapes.vessel import Vessel

# Figures were measured on these shapes. Whoever changes a shape on purpose measures again and writes this file anew:
# a list of `measured` for each family.
KNOWN = json.loads((Path(__file__).parent / "known_shapes.json").read_text(encoding="utf-8"))
NUM_SEEDS = {"cup": 40, "mug": 30, "bottle": 60}


def measured(family: str, seed: int) -> list:
    """Kind, wall (mm), extents (mm), middle along x (mm), centre of mass (mm), volume (cm^3) and area (cm^2)."""
    shape = make_shape(family, seed)
    mesh = shape.mesh
    lengths = [shape.wall_m, *mesh.extents, mesh.bounds[:, 0].mean(), *mesh.center_mass]
    sizes = [*(1e3 * length for length in lengths), 1e6 * mesh.volume, 1e4 * mesh.area]
    return [shape.kind, *(round(float(size), 4) for size in sizes)]


@pytest.mark.parametrize("family", NUM_SEEDS)
def test_shapes_are_those_that_the_committed_figures_were_measured_on(family: str) -> None:
    for seed, known in zip(range(NUM_SEEDS[family]), KNOWN[family], strict=True):
        found = measured(family, seed)
        assert found[0] == known[0], f"{family} {seed}"
        np.testing.assert_allclose(found[1:], known[1:], rtol=1e-4, atol=2e-3, err_msg=f"{family} {seed}")


def test_every_kind_is_among_the_known_shapes() -> None:
    assert {family: len({row[0] for row in KNOWN[family]}) for family in NUM_SEEDS} == {
        "cup": 7,
        "mug": 4,
        "bottle": 10,
    }


def test_training_seeds_go_on_after_the_committed_ones() -> None:
    committed = split_seeds("cup", "train")
    assert split_seeds("cup", "train", 3) == committed[:3]
    assert split_seeds("cup", "train", len(committed) + 2) == (*committed, 1000, 1001)
    assert split_seeds("cup", "test", 1000) == split_seeds("cup", "test")


def test_smoothstep_is_level_at_both_ends() -> None:
    t = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 3.0])
    np.testing.assert_allclose(smoothstep(t), [0, 0, 0.15625, 0.5, 1, 1])


def test_a_rounded_right_angle_begins_its_arc_one_radius_before_the_corner() -> None:
    line = rounded([[0.0, 0.0], [2.0, 0.0], [2.0, 3.0]], [0.0, 0.5, 0.0], steps=5)
    np.testing.assert_allclose(line[[0, 1, 5, 6]], [[0, 0], [1.5, 0], [2, 0.5], [2, 3]], atol=1e-12)
    np.testing.assert_allclose(line[3], [1.875, 0.125], atol=1e-12)  # the middle of the Bezier arc


def test_a_radius_too_large_for_its_edges_takes_half_of_the_shorter() -> None:
    line = rounded([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]], [0.0, 9.0, 0.0], steps=3)
    np.testing.assert_allclose(line[1], [2.0 - 0.49, 0.0], atol=1e-12)
    np.testing.assert_allclose(line[3], [2.0, 0.49], atol=1e-12)


def test_a_corner_without_radius_stays() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.2], [2.0, 0.0]])
    np.testing.assert_array_equal(rounded(corners, [0, 0, 0]), corners)


def test_inset_of_a_slanted_wall_is_measured_across_the_wall() -> None:
    height = np.linspace(0.0, 1.0, 401)
    found = inset(2.0 + 0.75 * height, height, 0.04)
    middle = slice(50, -50)
    # A line of slope 0.75 moves sideways by the distance over the cosine of its angle: 0.04 * 1.25.
    np.testing.assert_allclose(found[middle], (2.0 + 0.75 * height - 0.05)[middle], atol=1e-4)


def test_thinning_keeps_corners_and_the_longest_step() -> None:
    x = np.linspace(0.0, 1.0, 101)
    bent = np.column_stack([x, np.where(x > 0.5, x - 0.5, 0.0)])
    assert thinned(bent, tolerance=1e-6, longest=10.0).tolist() == [0, 50, 100]
    steps = np.diff(x[thinned(bent, tolerance=1e-6, longest=0.2)])
    assert steps.max() <= 0.2
    assert 5 <= len(steps) <= 10
    assert thinned(bent, tolerance=0.3, longest=10.0).tolist() == [0, 100]


def test_a_loft_of_equal_ellipses_is_an_elliptic_cylinder() -> None:
    height = np.array([0.0, 0.0, 0.1, 0.1])
    mesh = loft(rows([1e-6, 0.03, 0.03, 1e-6], height, aspect=0.5), segments=96)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(np.pi * 0.03 * 0.015 * 0.1, rel=2e-3)
    np.testing.assert_allclose(mesh.extents, [0.06, 0.03, 0.1], rtol=2e-3)


def test_a_loft_of_a_high_power_is_nearly_a_box() -> None:
    mesh = loft(rows([1e-6, 0.03, 0.03, 1e-6], [0.0, 0.0, 0.1, 0.1], power=60.0), segments=120)
    assert mesh.volume == pytest.approx(0.06 * 0.06 * 0.1, rel=0.01)


def test_flutes_wave_as_often_and_as_deeply_as_asked() -> None:
    mesh = loft(rows([1e-6, 0.03, 0.03, 1e-6], [0.0, 0.0, 0.1, 0.1]), segments=240, flutes=(6, 0.1))
    ring = mesh.vertices[np.abs(mesh.vertices[:, 2] - 0.1) < 1e-9]
    radius = np.linalg.norm(ring[:, :2], axis=1)
    radius = radius[radius > 0.01]
    assert radius.max() == pytest.approx(0.033, rel=1e-3)
    assert radius.min() == pytest.approx(0.027, rel=1e-3)
    assert ((radius > np.roll(radius, 1)) & (radius >= np.roll(radius, -1))).sum() == 6


def test_a_sweep_along_a_line_is_a_flat_elliptic_bar() -> None:
    path = np.column_stack([np.linspace(0.1, 0.3, 9), np.zeros(9), np.full(9, 0.5)])
    bar = sweep(path, np.full(9, 0.02), np.full(9, 0.01), segments=96)
    assert bar.is_volume
    np.testing.assert_allclose(bar.bounds, [[0.1, -0.02, 0.49], [0.3, 0.02, 0.51]], atol=1e-5)
    assert bar.volume == pytest.approx(np.pi * 0.02 * 0.01 * 0.2, rel=3e-3)


def test_a_straight_vessel_has_its_wall_its_floor_and_its_dent() -> None:
    height = np.linspace(0.0, 0.1, 400)
    vessel = Vessel(height, np.full(400, 0.04), wall=0.004, floor=0.006, dent=0.002)
    mesh = vessel.mesh()
    assert mesh.is_volume
    up = _hits(mesh, (0.0, 0.0, -0.01), (0, 0, 1))
    np.testing.assert_allclose(up, [0.002, 0.006], atol=2e-4)
    across = _hits(mesh, (-0.1, 1e-4, 0.06), (1, 0, 0), axis=0)
    np.testing.assert_allclose(across, [-0.04, -0.036, 0.036, 0.04], atol=1e-4)
    assert mesh.bounds[1, 2] == pytest.approx(0.1 + 0.5 * 0.004, abs=1e-4)


def test_the_core_of_a_vessel_runs_within_its_wall() -> None:
    height = np.linspace(0.0, 0.1, 400)
    core = Vessel(height, np.full(400, 0.04), wall=0.004, floor=0.006).core(0.5)
    assert core.is_volume
    np.testing.assert_allclose(_hits(core, (-0.1, 1e-4, 0.06), (1, 0, 0), axis=0), [-0.038, 0.038], atol=1e-4)
    np.testing.assert_allclose(_hits(core, (0.0, 0.0, -0.01), (0, 0, 1)), [0.003, 0.11], atol=3e-4)


def _hits(mesh: trimesh.Trimesh, origin: tuple, direction: tuple, axis: int = 2) -> np.ndarray:
    """Sorted coordinates of the places where a ray meets the mesh."""
    start = np.asarray(origin, dtype=float) + 1.7e-5  # off the vertices
    places = mesh.ray.intersects_location(start[None], np.asarray(direction, dtype=float)[None])[0]
    return np.sort(places[:, axis])
