"""Plane cuts: an L falls into its two boxes, a trough stays hollow, and budgets are kept."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, WEDGE, WEDGE_M3, l_parts, l_shape, trough

from gfp_grasp.collision import cut_parts, within_parts
from gfp_grasp.collision.convex import convex_part
from gfp_grasp.collision.cutting import _measured, _solid
from gfp_grasp.collision.parts import volume_m3
from gfp_grasp.errors import InvalidMesh

TROUGH, WALLS = trough()


@pytest.mark.parametrize("offset", [np.zeros(3), AWAY])
def test_an_l_falls_into_few_parts_of_its_volume_wherever_it_stands(offset: np.ndarray):
    found = cut_parts(l_shape().apply_translation(offset))
    assert found.made_by == "cuts"
    assert len(found.parts) == 4
    assert found.notes["volume_ratio"] == pytest.approx(1.0203, abs=1e-3)
    assert found.notes["concavity_m"] == pytest.approx(0.000311, abs=2e-6)
    assert found.error_m[0] < 1e-4
    held = sum(volume_m3(part) for part in found.parts)
    assert held / l_shape().volume == pytest.approx(found.notes["volume_ratio"])


def test_a_trough_is_cut_into_parts_that_leave_it_hollow():
    found = cut_parts(TROUGH)
    assert len(found.parts) == 13
    assert found.notes["volume_ratio"] == pytest.approx(1.0708, abs=1e-3)
    assert found.notes["concavity_m"] <= 0.001  # pyright: ignore[reportOperatorIssue]
    middle = np.array([[x, y, z] for x in (0.015, 0.045) for y in (0.015, 0.025) for z in (0.01, 0.049)])
    assert not within_parts(middle, found.parts).any()
    assert within_parts(TROUGH.vertices, found.parts, margin_m=2e-5).any(axis=1).all()
    again = cut_parts(TROUGH)
    for one, other in zip(found.parts, again.parts, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


@pytest.mark.parametrize(("most", "count", "ratio"), [(1, 1, 1.8503), (2, 2, 1.8503), (5, 5, 1.6378), (8, 8, 1.4252)])
def test_cutting_stops_at_the_most_parts_that_there_may_be(most: int, count: int, ratio: float):
    found = cut_parts(TROUGH, max_parts=most)
    assert len(found.parts) == count
    assert found.notes["volume_ratio"] == pytest.approx(ratio, abs=1e-3)


@pytest.mark.parametrize(("depth_m", "is_cut"), [(0.0009, False), (0.0011, True)])
def test_a_pocket_is_left_where_it_is_no_deeper_than_the_bound(depth_m: float, is_cut: bool):
    block = trimesh.creation.box(bounds=[[0, 0, 0], [0.06, 0.04, 0.03]])
    pocket = trimesh.creation.box(bounds=[[0.02, 0.01, 0.03 - depth_m], [0.035, 0.02, 0.04]])
    dented = trimesh.boolean.difference([block, pocket])
    assert _measured(_solid(dented)).concavity_m == pytest.approx(depth_m, abs=1e-8)
    np.testing.assert_allclose(_measured(_solid(dented)).deepest[2], 0.03 - depth_m, atol=1e-8)
    found = cut_parts(dented)
    assert (len(found.parts) > 1) is is_cut
    assert found.notes["concavity_m"] <= 0.001  # pyright: ignore[reportOperatorIssue]
    assert len(cut_parts(dented, concavity_m=0.0012).parts) == 1


def test_an_l_has_no_vertex_below_its_hull_and_is_as_concave_as_it_leaves_its_hull_empty():
    # Its hull lacks the triangle over the inner corner; a sixth of the middle extent stands for the height of a chord.
    filled = 0.1 * 0.06 - 0.5 * 0.08 * 0.04
    empty = 1 - (0.1 * 0.02 + 0.04 * 0.02) / filled
    assert _measured(_solid(l_shape())).concavity_m == pytest.approx(empty * 0.06 / 6, rel=1e-4)
    assert _measured(_solid(l_parts()[0].to_trimesh())).concavity_m == pytest.approx(0, abs=1e-9)


def test_two_bodies_of_one_mesh_are_two_parts():
    boxes = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.02, 0.03, 0.01]]) for x in (0, 0.05)]
    found = cut_parts(trimesh.util.concatenate(boxes))  # pyright: ignore[reportArgumentType]
    assert len(found.parts) == 2
    assert found.notes["volume_ratio"] == pytest.approx(1, abs=1e-6)


def test_what_is_no_volume_is_refused():
    with pytest.raises(InvalidMesh, match="watertight"):
        cut_parts(trimesh.Trimesh(TROUGH.vertices, TROUGH.faces[1:], process=False))
    part = convex_part(WEDGE)
    assert part is not None
    (only,) = cut_parts(part.to_trimesh()).parts
    assert volume_m3(only) == pytest.approx(WEDGE_M3, rel=1e-4)
