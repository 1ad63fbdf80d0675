"""Which plane of a cloud is the support: known planes, and planes that only one rule refuses."""

import numpy as np
import pytest

from gfp_grasp.detect import find_support, warn_of_a_plane_aside
from gfp_grasp.transforms import apply_T, make_T, rotation_about

UP = np.array([0.0, 0.0, 1.0])
SPACING_M = 0.005


def _grid(low: tuple[float, float], high: tuple[float, float], spacing_m: float = SPACING_M) -> np.ndarray:
    """Points (n, 3) m of a level rectangle at z = 0."""
    x, y = np.meshgrid(np.arange(low[0], high[0], spacing_m), np.arange(low[1], high[1], spacing_m))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def _walls(low: tuple[float, float], high: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
    """Points (n, 3) m of the four upright sides of a box."""
    x, y, heights = (np.arange(*ends, SPACING_M) for ends in ((low[0], high[0]), (low[1], high[1]), z))
    outline = [(a, b) for a in x for b in (low[1], high[1])] + [(a, b) for b in y for a in (low[0], high[0])]
    return np.array([(*place, height) for place in outline for height in heights])


TABLE = _grid((-0.25, -0.3), (0.35, 0.3))
THING = _walls((0.0, 0.05), (0.08, 0.17), (0.01, 0.1))


def _tilted(degrees: float) -> np.ndarray:
    axis = np.array([0.8, 0.6, 0.0])
    return make_T(rotation_about(axis, np.radians(degrees)), (0.1, -0.2, 0.37))


def test_a_tilted_table_is_found_exactly_with_its_normal_and_height() -> None:
    T = _tilted(11.0)
    plane = find_support(apply_T(T, np.vstack([TABLE, THING])), UP)
    assert plane is not None
    # The lowest row of the thing, 1 cm over the table, is no inlier.
    np.testing.assert_allclose(plane.normal, T[:3, 2], atol=1e-9)
    assert plane.height_m == pytest.approx(T[:3, 2] @ T[:3, 3], abs=1e-9)


@pytest.mark.parametrize(("degrees", "is_found"), [(19.0, True), (21.0, False)])
def test_a_table_may_tilt_by_twenty_degrees_against_up(degrees: float, is_found: bool) -> None:
    plane = find_support(apply_T(_tilted(degrees), np.vstack([TABLE, THING])), UP)
    assert (plane is not None) == is_found


def test_up_is_a_direction_of_any_length_and_orientation() -> None:
    T = make_T(rotation_about((1.0, -2.0, 0.5), 2.1), (0.1, 0.2, -0.3))
    plane = find_support(apply_T(T, np.vstack([TABLE, THING])), T[:3, 2] * 3.0)
    assert plane is not None
    np.testing.assert_allclose(plane.normal, T[:3, 2], atol=1e-9)


def test_a_thing_sampled_a_hundred_times_as_densely_does_not_hide_the_table() -> None:
    coarse = _grid((-0.3, -0.3), (0.3, 0.3), spacing_m=0.008)
    rng = np.random.default_rng(0)
    dense = THING[rng.integers(len(THING), size=100_000)] + rng.normal(scale=0.001, size=(100_000, 3))
    plane = find_support(np.vstack([coarse, dense]), UP)
    assert plane is not None
    assert abs(plane.height_m) < 0.001


def test_a_ledge_with_most_things_beside_it_is_not_the_table() -> None:
    ledge = _grid((0.0, 0.0), (0.2, 0.2)) + 0.3 * UP
    on_it = _walls((0.05, 0.05), (0.07, 0.07), (0.32, 0.37))
    beside = [_walls((x, 0.0), (x + 0.1, 0.2), (0.34, 0.6)) for x in (-0.3, 0.4)]
    alone = find_support(np.vstack([ledge, on_it]), UP)
    assert alone is not None
    assert alone.height_m == pytest.approx(0.3)
    assert find_support(np.vstack([ledge, on_it, *beside]), UP) is None


def test_a_slice_of_a_cone_is_no_table_though_it_reaches_beyond_what_is_above() -> None:
    """Its surface rises by 45 degrees: nothing but the direction of its normals speaks against the slice."""
    height = np.arange(0.0, 0.08, 0.0025)
    turns = [np.linspace(0, 2 * np.pi, int(2 * np.pi * (0.12 - z) / 0.0035), endpoint=False) for z in height]
    cone = np.vstack(
        [
            np.column_stack([(0.12 - z) * np.cos(t), (0.12 - z) * np.sin(t), np.full(len(t), z)])
            for z, t in zip(height, turns, strict=True)
        ]
    )
    assert find_support(cone, UP) is None
    assert find_support(np.vstack([cone, _grid((-0.2, -0.2), (0.2, 0.2))]), UP) is not None


def test_a_plane_with_things_below_it_is_not_the_table() -> None:
    shelf = _grid((-0.2, -0.2), (0.2, 0.2)) + 0.3 * UP
    on_it = _walls((0.0, 0.0), (0.06, 0.08), (0.315, 0.4))
    under_it = _walls((-0.1, -0.1), (-0.06, -0.04), (0.24, 0.285))  # a tenth of what is on it and above
    assert find_support(np.vstack([shelf, on_it]), UP) is not None
    assert find_support(np.vstack([shelf, on_it, under_it]), UP) is None


def test_a_plane_as_small_as_what_stands_on_it_is_not_the_table() -> None:
    body = _walls((0.0, 0.0), (0.2, 0.2), (0.02, 0.15))
    assert find_support(np.vstack([_grid((-0.005, -0.005), (0.21, 0.21)), body]), UP) is None  # 1.1 times the area
    assert find_support(np.vstack([_grid((-0.02, -0.02), (0.225, 0.225)), body]), UP) is not None  # 1.4 times


def test_an_empty_table_is_no_support() -> None:
    assert find_support(TABLE, UP) is None
    assert find_support(np.zeros((0, 3)), UP) is None


def test_without_up_the_plane_faces_the_viewpoint() -> None:
    points = np.vstack([TABLE, THING])
    plane = find_support(points, None, viewpoint=np.array([0.4, 0.1, 0.6]))
    assert plane is not None
    np.testing.assert_allclose(plane.normal, UP, atol=1e-9)
    # From below everything on the table is behind it.
    assert find_support(points, None, viewpoint=np.array([0.4, 0.1, -0.6])) is None


def test_without_up_and_viewpoint_the_frame_is_a_cameras() -> None:
    T_camera_table = make_T(rotation_about((1.0, 0.0, 0.0), np.radians(125.0)), (0.05, 0.1, 0.7))  # looks down by 35
    plane = find_support(apply_T(T_camera_table, np.vstack([TABLE, THING])), None)
    assert plane is not None
    np.testing.assert_allclose(plane.normal, T_camera_table[:3, 2], atol=1e-9)
    assert plane.normal[1] < 0


def test_a_lid_that_its_pot_goes_on_below_is_no_table_and_one_beside_a_floor_is() -> None:
    lid, knob = _grid((-0.1, -0.08), (0.11, 0.09)) + 0.2 * UP, _walls((0.0, 0.0), (0.03, 0.04), (0.21, 0.25))
    pot = _walls((-0.12, -0.1), (0.13, 0.11), (0.0, 0.19))
    assert find_support(np.vstack([lid, knob, pot]), UP) is None
    table = find_support(np.vstack([lid, knob]), UP)
    assert table is not None
    assert table.height_m == pytest.approx(0.2, abs=1e-9)
    # A shoulder about the lid, with three quarters of its points, is a body's where it is near.
    side = _grid((0.115, -0.08), (0.145, 0.09))
    shoulder = np.vstack(
        [side + shift for shift in ([0, 0, 0], [0, 0, -0.02], [0, 0, -0.04], [-0.25, 0, 0], [-0.25, 0, -0.02])]
    )
    assert find_support(np.vstack([lid, knob, shoulder + 0.16 * UP]), UP) is None
    assert find_support(np.vstack([lid, knob, shoulder - 0.2 * UP]), UP) is not None
    floor = _grid((0.11, -0.2), (0.25, 0.2)) - 0.5 * UP  # three quarters as many points as the lid has
    table = find_support(np.vstack([lid, knob, floor]), UP)
    assert table is not None
    assert table.height_m == pytest.approx(0.2, abs=1e-9)


@pytest.mark.parametrize("width_m", [0.002, 0.004, 0.02])
def test_a_speck_of_points_has_no_plane_aside_of_up(width_m, recwarn):
    """A flat upright patch, of which one point or a few are left on the grid."""
    across, along = np.random.default_rng(0).uniform(0, width_m, (2, 60))
    patch = np.column_stack([0.3 + across, np.full(60, 0.2), 0.5 + along])
    warn_of_a_plane_aside(patch, UP, viewpoint=np.array([0.0, -1.0, 0.5]))
    assert not recwarn.list
