"""Plane cuts: an L falls into its two boxes, a trough stays hollow, and budgets are kept."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, WEDGE, WEDGE_M3, l_parts, l_shape, trough

from gfp_grasp.collision import CollisionConfig, convex_part, cut_parts, quick_parts, union_error_m, within_parts
from gfp_grasp.collision.cutting import _measured, _ranked, _solid
from gfp_grasp.collision.parts import volume_m3
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes import surface_net

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


def _dense_trough(cell_m: float = 0.0015) -> trimesh.Trimesh:
    """The trough as a completion without a class has it: thousands of small faces, of a grid."""
    low, high = TROUGH.bounds
    origin = low - 3.3 * cell_m
    shape = tuple(np.ceil((high - low) / cell_m).astype(int) + 7)
    places = origin + cell_m * np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3)
    distance = trimesh.proximity.signed_distance(TROUGH, places)
    return surface_net(-distance.reshape(shape), origin=origin, cell_m=cell_m)


def test_quick_parts_of_a_dense_trough_leave_it_hollow_and_state_their_error():
    mesh = _dense_trough()
    assert len(mesh.faces) > 5000
    found = quick_parts(mesh)
    assert found.made_by == "cuts"
    assert 5 <= len(found.parts) <= 24
    middle = np.array([[x, y, z] for x in (0.015, 0.045) for y in (0.015, 0.025) for z in (0.012, 0.045)])
    assert not within_parts(middle, found.parts).any()
    diagonal = float(np.linalg.norm(mesh.extents))
    assert found.error_m[0] < 0.006 * diagonal
    fine = union_error_m(found.parts, mesh, count=4000, rng=np.random.default_rng(1))
    assert found.error_m[0] == pytest.approx(fine[0], rel=0.2)
    assert found.error_m[1] == pytest.approx(fine[1], rel=0.5)
    assert found.notes["volume_ratio"] == pytest.approx(
        sum(volume_m3(part) for part in found.parts) / mesh.volume, rel=1e-6
    )
    again = quick_parts(mesh)
    for one, other in zip(found.parts, again.parts, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


def test_quick_parts_keep_their_budget_even_of_many_bodies():
    boxes = [trimesh.creation.box(bounds=[[x, y, 0], [x + 0.01, y + 0.013, 0.02]]) for x in np.arange(6) * 0.02
             for y in np.arange(5) * 0.02]  # fmt: skip
    crowd = trimesh.util.concatenate(boxes)
    assert isinstance(crowd, trimesh.Trimesh)
    assert len(quick_parts(crowd).parts) == 24
    few = quick_parts(crowd, config=CollisionConfig(max_parts=7, max_vertices_per_part=6))
    assert len(few.parts) == 7
    assert max(len(part.vertices) for part in few.parts) <= 6
    assert within_parts(crowd.vertices, quick_parts(crowd).parts, margin_m=1e-5).any(axis=1).all()


def test_a_tolerance_is_the_concavity_that_quick_parts_leave():
    loose, tight = (quick_parts(TROUGH, config=CollisionConfig(tolerance_m=m)) for m in (0.02, 0.002))
    assert len(loose.parts) < len(tight.parts)
    assert tight.notes["concavity_m"] <= 0.002  # pyright: ignore[reportOperatorIssue]
    assert tight.error_m[0] < loose.error_m[0]


def test_quick_parts_of_what_is_no_volume_are_refused():
    with pytest.raises(InvalidMesh, match="make_solid"):
        quick_parts(trimesh.Trimesh(TROUGH.vertices, TROUGH.faces[1:], process=False))


@pytest.mark.parametrize(("turn_deg", "ratio", "off_m"), [(0, 1.3, 0.008), (90, 1.8, 0.016)])
def test_quick_parts_leave_an_oval_pot_hollow_however_it_lies(turn_deg: float, ratio: float, off_m: float):
    """No single plane takes anything off the hull of a ring, and slices of it are as full as the whole."""
    outer, inner = (trimesh.creation.cylinder(radius=1, height=1, sections=64) for _ in range(2))
    outer.apply_scale([0.06, 0.05, 0.08])
    inner.apply_scale([0.055, 0.045, 0.08])
    inner.apply_translation([0, 0, 0.006])
    pot = trimesh.boolean.difference([outer, inner])
    pot.apply_transform(trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), [1, 0, 0]))
    found = quick_parts(pot)
    assert len(found.parts) <= 24
    assert found.notes["volume_ratio"] < ratio  # pyright: ignore[reportOperatorIssue]
    inside = np.array([[0.03, 0.005, -0.02], [-0.02, 0.01, 0.02], [0.004, -0.03, 0.03], [0, 0, 0]])
    turned = trimesh.transform_points(inside, trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), [1, 0, 0]))
    assert not within_parts(turned, found.parts).any()
    assert found.error_m[2] < off_m


def test_the_plane_that_leaves_the_least_is_taken_first_and_one_through_the_middle_of_a_ring():
    ell = _measured(_solid(l_shape()))
    low, high = ell.vertices.min(axis=0), ell.vertices.max(axis=0)
    planes = [(normal, float(normal @ (low + share * (high - low)))) for normal in np.eye(3) for share in (0.3, 0.5)]
    first = _ranked(ell, planes)[0]
    left = [_exact_m3(ell, *plane) for plane in planes]
    assert first == planes[int(np.argmin(left))]
    assert min(left) < 0.9 * ell.solid.hull().volume()
    ring = trimesh.creation.annulus(r_min=0.03, r_max=0.035, height=0.02, sections=48)
    normal, offset = _ranked(_measured(_solid(ring)), [(np.array([0.0, 0.0, 1.0]), 0.004)])[0]
    assert abs(normal[2]) < 1e-9
    assert offset == pytest.approx(0.0, abs=1e-9)


def _exact_m3(piece, normal: np.ndarray, offset: float) -> float:
    return sum(half.hull().volume() for half in piece.solid.split_by_plane(tuple(normal), offset))
