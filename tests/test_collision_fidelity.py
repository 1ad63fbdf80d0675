"""How true parts are to a mesh: distances, volumes and room inside that are known in closed form."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, TURN, WEDGE, box_part, l_parts, l_shape, trough

from gfp_grasp.collision import convex_part, union_error_m
from gfp_grasp.collision.fidelity import ball_radii_m, volume_ratios, widest_gap
from gfp_grasp.collision.parts import PartFaces
from gfp_grasp.types import ConvexPart

MESH, PARTS = l_shape(), l_parts()
# The arm of 40 mm, 20 mm square: what is missing where only the bar stands. Distances to the bar grow along it.
_ARM_M2, _CAP_M2, _BAR_M2 = 4 * 0.02 * 0.04, 0.02**2, 4 * 0.1 * 0.02 + 2 * 0.02**2
_FAR_M2 = _ARM_M2 + _CAP_M2
_MEAN_M = (_ARM_M2 * 0.02 + _CAP_M2 * 0.04) / (_BAR_M2 - _CAP_M2 + _FAR_M2)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def moved(part: ConvexPart) -> ConvexPart:
    return ConvexPart(part.vertices @ TURN.T + AWAY, part.faces)


def test_parts_that_are_the_mesh_have_no_error_wherever_it_stands():
    there = trimesh.Trimesh(MESH.vertices @ TURN.T + AWAY, MESH.faces, process=False)
    for mesh, parts in ((MESH, PARTS), (there, tuple(map(moved, PARTS)))):
        mean, p95, largest = union_error_m(parts, mesh, rng=rng())
        assert mean < 2e-5
        assert p95 < 1e-4
        assert largest < 2e-3


def test_an_arm_that_no_part_covers_counts_by_its_distance():
    mean, p95, largest = union_error_m(PARTS[:1], MESH, count=4000, rng=rng())
    assert mean == pytest.approx(_MEAN_M / 2, rel=0.03)
    assert largest == pytest.approx(0.04, rel=0.01)
    share = 0.05 * (_BAR_M2 - _CAP_M2 + _FAR_M2)  # of the surface, the farthest: the cap and what is next to it
    assert p95 == pytest.approx(0.04 - (share - _CAP_M2) / (4 * 0.02), rel=0.03)


def test_an_arm_that_the_mesh_has_not_counts_by_its_distance():
    bar = trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.02, 0.02]]).subdivide().subdivide().subdivide()
    mean, p95, largest = union_error_m(PARTS, bar, count=4000, rng=rng())
    assert mean == pytest.approx(_MEAN_M / 2, rel=0.05)
    assert largest == pytest.approx(0.04, rel=0.01)
    assert 0.03 < p95 < 0.04


def test_the_faces_of_a_hairline_crack_are_no_surface():
    whole = trimesh.creation.box(bounds=[[0, 0, 0], [0.2, 0.02, 0.03]]).subdivide().subdivide().subdivide()
    cracked = [box_part([0.07 * i + 1e-4 * (i > 0), 0, 0], [min(0.07 * (i + 1), 0.2), 0.02, 0.03]) for i in range(3)]
    mean, p95, largest = union_error_m(cracked, whole, rng=rng())
    assert mean < 1e-5
    assert p95 < 2e-4
    assert largest < 2e-3


@pytest.mark.parametrize("step_m", [3e-4, -3e-4])
def test_a_part_that_is_a_little_thicker_or_thinner_than_the_mesh_counts_from_both_sides(step_m: float):
    bar = trimesh.creation.box(bounds=[[0, 0, 0], [0.2, 0.02, 0.03]]).subdivide().subdivide().subdivide()
    parts = [box_part([0, 0, 0], [0.1, 0.02, 0.03]), box_part([0.1, 0, 0], [0.2, 0.02, 0.03 + step_m])]
    mean, _, largest = union_error_m(parts, bar, count=8000, rng=rng())
    assert mean == pytest.approx(3e-4 * 0.1 * 0.02 / bar.area, rel=0.1)
    assert 2.9e-4 < largest < 1.5e-3


def test_a_slot_that_parts_leave_open_is_an_error_of_its_depth():
    block = trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.06, 0.04]]).subdivide().subdivide().subdivide()
    slotted = [box_part([0, 0, 0], [0.045, 0.06, 0.04]), box_part([0.055, 0, 0], [0.1, 0.06, 0.04])]
    mean, _, largest = union_error_m(slotted, block, rng=rng())
    assert largest == pytest.approx(0.005, rel=0.05)
    over_slot = 2 * 0.01 * (0.06 + 0.04) / block.area
    assert mean == pytest.approx(over_slot * 0.0025 / 2, rel=0.15)


def test_a_mesh_hidden_deep_within_its_parts_is_measured_to_their_outside():
    core = trimesh.creation.box((0.02, 0.03, 0.05))
    shells = [box_part([-0.05, -0.05, -0.05], [0.01, 0.05, 0.05]), box_part([-0.01, -0.05, -0.05], [0.05, 0.05, 0.05])]
    mean, _, _ = union_error_m(shells, core, rng=rng())
    assert mean > 0.02


def test_summed_and_united_volumes_of_overlapping_parts_are_known():
    wedge = convex_part(WEDGE)
    assert wedge is not None
    half = box_part([0, 0, 0], [0.03, 0.04, 0.05])  # holds three quarters of the wedge, and more
    body = trimesh.boolean.union([wedge.to_trimesh(), half.to_trimesh()])
    summed, union = volume_ratios([moved(wedge), moved(half)], body, count=40_000, rng=rng())
    assert summed == pytest.approx((wedge.to_trimesh().volume + half.to_trimesh().volume) / body.volume)
    assert union == pytest.approx(1, rel=0.005)
    assert volume_ratios([wedge, wedge], wedge.to_trimesh(), rng=rng()) == pytest.approx((2, 1))


TROUGH, WALLS = trough()


@pytest.mark.parametrize("turn", [np.eye(3), TURN])
def test_the_largest_ball_in_a_trough_touches_its_walls_and_its_floor(turn: np.ndarray):
    mesh = trimesh.Trimesh(TROUGH.vertices @ turn.T + AWAY, TROUGH.faces, process=False)
    centre = widest_gap(mesh)
    assert centre is not None
    place = (centre - AWAY) @ turn
    assert 0.017 < place[0] < 0.043
    assert place[1] == pytest.approx(0.02, abs=1e-3)
    assert 0.0185 < place[2] < 0.05
    walls = PartFaces.of([ConvexPart(part.vertices @ turn.T + AWAY, part.faces) for part in WALLS])
    free, left = ball_radii_m(centre, mesh, walls)
    assert free == pytest.approx(0.02, rel=0.003)
    assert left == pytest.approx(free, rel=1e-6)


def test_the_room_around_a_place_is_exact_however_coarse_the_triangles():
    coarse = trimesh.boolean.union([part.to_trimesh() for part in WALLS])
    assert len(coarse.faces) < 60
    walls = PartFaces.of(WALLS)
    places = [
        [0.01, 0.02, 0.03],
        [0.03, 0.033, 0.04],
        [0.03, 0.02, 0.004],
        [0.052, 0.004, 0.045],
        [0.052, 0.036, 0.005],
    ]
    for place, radius in zip(places, (0.01, 0.007, 0.004, 0.004, 0.004), strict=True):
        free, left = ball_radii_m(np.array(place), coarse, walls)
        assert free == pytest.approx(radius, abs=2e-9)  # Manifold hands out float32
        assert left == pytest.approx(radius, abs=2e-9)  # Manifold hands out float32
    filled = PartFaces.of([box_part([0, 0, 0], [0.06, 0.04, 0.05])])
    assert ball_radii_m(np.array([0.03, 0.02, 0.03]), coarse, filled)[1] == 0


def test_neither_a_convex_wedge_nor_a_dent_has_room():
    wedge = convex_part(WEDGE @ TURN.T)
    assert wedge is not None
    fine = wedge.to_trimesh().subdivide().subdivide().subdivide()
    assert widest_gap(fine) is None
    for depth, has_room in ((0.0032, False), (0.0045, True)):
        groove = trimesh.creation.cylinder(depth, 0.3, sections=24)
        block = trimesh.creation.box(bounds=[[0, -0.05, -0.05], [0.05, 0.05, 0.05]])
        dented = trimesh.boolean.difference([block, groove])
        while dented.edges_unique_length.max() > 0.012:
            dented = dented.subdivide()
        assert (widest_gap(dented) is not None) is has_room
