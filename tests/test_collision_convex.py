"""Convex parts of points: known volumes, planes and corners of bodies that are alike from no two sides."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, SLOPE, TURN, WEDGE, WEDGE_M3, box_part

from gfp_grasp.collision import convex_part, parts_from_arrays, parts_to_arrays, within_bounds, within_parts
from gfp_grasp.collision.convex import convex_parts, fewer_corners, needed_corners
from gfp_grasp.collision.parts import PartFaces, volume_m3
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.types import CollisionMesh, ConvexPart


def wedge(T: np.ndarray | None = None) -> ConvexPart:
    part = convex_part(WEDGE + AWAY if T is None else WEDGE @ T.T + AWAY)
    assert part is not None
    return part


def test_a_wedge_of_many_points_is_its_six_corners_and_has_its_volume():
    rng = np.random.default_rng(0)
    within = rng.dirichlet(np.ones(6), 200) @ WEDGE
    part = convex_part(np.concatenate([within, WEDGE]) + AWAY)
    assert part is not None
    np.testing.assert_allclose(
        part.vertices[np.lexsort(part.vertices.T)], (WEDGE + AWAY)[np.lexsort(WEDGE.T)], atol=1e-12
    )
    assert volume_m3(part) == pytest.approx(WEDGE_M3)
    assert part.to_trimesh().volume == pytest.approx(WEDGE_M3)
    assert part.to_trimesh().is_convex


def test_heights_over_a_slope_are_known_from_both_sides():
    part = wedge(TURN)
    middle = np.array([0.03, 0.02, 0.015])
    steps = np.array([-0.002, 0.0, 0.001])
    points = (middle + steps[:, None] * SLOPE) @ TURN.T + AWAY
    np.testing.assert_allclose(PartFaces.of([part]).height(points, 0), steps, atol=1e-12)
    other = box_part([1, 1, 1], [1.1, 1.1, 1.1])
    for margin_m, inside in ((-0.0021, 0), (-0.0019, 1), (-1e-6, 1), (1e-6, 2), (9e-4, 2), (1.1e-3, 3)):
        found = within_parts(points, [other, part], margin_m=margin_m)
        np.testing.assert_array_equal(found, [[False, i < inside] for i in range(3)])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_margin_reaches_beyond_every_side_and_no_farther(axis: int, side: int):
    part = box_part([0.1, 0.2, 0.3], [0.2, 0.4, 0.6])
    point = np.array([[0.15, 0.3, 0.45]])
    point[0, axis] += side * (0.5 * np.ptp(part.vertices[:, axis]) + 0.001)
    assert within_parts(point, [part], margin_m=0.0011).all()
    assert not within_parts(point, [part], margin_m=0.0009).any()
    assert not within_parts(point, [part]).any()


def test_no_parts_hold_nothing():
    assert within_parts(np.zeros((3, 3)), []).shape == (3, 0)


def test_a_needle_face_has_no_say_in_what_lies_within():
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    a, b = (int(np.linalg.norm(box.vertices - [x, -0.05, -0.05], axis=1).argmin()) for x in (-0.05, 0.05))
    # It has next to no width and looks across the box: its plane would cut the box in half.
    needle = (box.vertices[a] + box.vertices[b]) / 2 + 1e-12 * np.array([0, 1, 1])
    part = ConvexPart(np.vstack([box.vertices, needle]), np.vstack([box.faces, [[a, b, 8], [b, a, 8]]]))
    inside = np.array([[0.0, 0.049, -0.02], [0.0, -0.02, 0.049], [0.05 - 1e-6, 0.0, 0.0]])
    assert within_parts(inside, [part]).all()
    assert within_parts(inside[:2], [part], margin_m=-9e-4).all()
    np.testing.assert_allclose(PartFaces.of([part]).height(inside, 0), [-0.001, -0.001, -1e-6], atol=1e-9)
    assert not within_parts(np.add(inside, [0.1, 0, 0]), [part]).any()


def test_crumbs_below_a_tenth_of_a_cubic_millimetre_are_dropped():
    cube = np.asarray(trimesh.creation.box((1, 1, 1)).vertices)
    assert convex_part(AWAY + 0.00045 * cube) is None
    assert convex_part(AWAY + 0.00048 * cube) is not None


@pytest.mark.parametrize(("thickness_m", "kept"), [(0.95e-4, False), (1.05e-4, True)])
def test_a_tilted_plate_is_kept_from_a_tenth_of_a_millimetre_on(thickness_m: float, kept: bool):
    plate = np.asarray(trimesh.creation.box((0.03, 0.02, thickness_m)).vertices)
    parts, dropped = convex_parts([plate @ TURN.T + AWAY])
    assert (len(parts), dropped) == ((1, 0) if kept else (0, 1))


def test_a_bump_within_the_tolerance_needs_no_corner_and_one_beyond_it_does():
    low, high = [0.025, 0, 0.00008 + 0.025], [0.025 + 0.00015, 0.001, 0]
    corners = np.asarray(trimesh.creation.box((0.05, 0.05, 0.05)).vertices)
    points = np.vstack([corners, low, high, [0.001, 0.002, 0.003]]) @ TURN.T + AWAY
    assert needed_corners(points, 1e-4).tolist() == [*range(8), 9]
    assert needed_corners(points, 1e-5).tolist() == [*range(10)]
    assert needed_corners(points, 1e-3).tolist() == [*range(8)]


@pytest.mark.parametrize("count", [4, 7, 12, 25, 60])
def test_few_corners_of_a_long_hull_are_all_different_and_reach_to_its_ends(count: int):
    ball = trimesh.creation.icosphere(subdivisions=3)
    corners = np.asarray(ball.vertices) * [0.2, 0.02, 0.01] @ TURN.T + AWAY
    kept = fewer_corners(corners, count)
    assert len(np.unique(kept, axis=0)) == count
    places = np.array([np.flatnonzero((corners == corner).all(axis=1))[0] for corner in kept])
    assert (np.diff(places) > 0).all()
    along = (kept - AWAY) @ TURN[:, 0]
    assert np.ptp(along) > 0.9 * 0.4


def test_of_a_bulging_box_the_corners_stay_when_few_may():
    box = trimesh.creation.box((0.06, 0.04, 0.03))
    faint = box.subdivide().subdivide()
    bulge = 1 + 1e-4 * (1 - (np.asarray(faint.vertices) / [0.03, 0.02, 0.015]) ** 2).sum(axis=1, keepdims=True)
    points = np.asarray(faint.vertices) * bulge
    kept = fewer_corners(points, 20)
    held = (np.linalg.norm(kept[None] - np.asarray(box.vertices)[:, None], axis=2) < 1e-9).any(axis=1)
    assert held.all()


def test_corners_that_all_lie_in_one_plane_give_way_to_the_one_farthest_from_it():
    rng = np.random.default_rng(3)
    ring = np.array([[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 6.28, 40)]) * 0.05
    points = np.vstack([ring, [0.001, 0, 0.0004], [0.0, 0, 0.0009]])[rng.permutation(42)] @ TURN.T + AWAY
    kept = fewer_corners(points, 5)
    height = (kept - AWAY) @ TURN[:, 2]
    assert height.max() == pytest.approx(0.0009)
    assert convex_part(kept) is not None


@pytest.mark.parametrize(
    "parts", [(), (box_part([0, 0, 0], [1, 2, 3]),), (wedge(TURN), box_part([0, 0, 0], [1, 2, 3]))]
)
def test_parts_come_out_of_their_arrays_as_they_went_in(parts: tuple[ConvexPart, ...]):
    arrays = parts_to_arrays(parts, prefix="a/")
    assert set(arrays) == {"a/sizes", "a/vertices", "a/faces"}
    assert arrays["a/sizes"].tolist() == [[len(part.vertices), len(part.faces)] for part in parts]
    back = parts_from_arrays(arrays, prefix="a/")
    assert len(back) == len(parts)
    for one, other in zip(parts, back, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.faces, other.faces)
    small = parts_to_arrays(parts, dtype=np.float32)
    assert small["part_vertices"].dtype == np.float32
    assert [len(part.vertices) for part in parts_from_arrays(small)] == [len(part.vertices) for part in parts]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"part_sizes": None}, "lack part_sizes"),
        ({"part_faces": None}, "lack part_faces"),
        ({"part_sizes": np.array([[8.0, 12.0]])}, "float64"),
        ({"part_vertices": np.zeros((8, 3), int)}, "int, float, int"),
        ({"part_faces": np.zeros((12, 3))}, "int, float, int"),
        ({"part_sizes": np.array([[8, 3]])}, "from 4 on"),
        ({"part_sizes": np.array([8, 12])}, "shape"),
        ({"part_sizes": np.array([[7, 12]])}, "are expected"),
        ({"part_sizes": np.array([[8, 11]])}, "are expected"),
        ({"part_vertices": np.full((8, 3), np.nan)}, "not finite"),
        ({"part_faces": np.full((12, 3), 8)}, "not there"),
        ({"part_faces": np.full((12, 3), -1)}, "not there"),
    ],
)
def test_arrays_that_are_no_convex_parts_are_refused(change: dict, said: str):
    arrays = {**parts_to_arrays([box_part([0, 0, 0], [1, 2, 3])]), **change}
    with pytest.raises(InvalidMesh, match=said):
        parts_from_arrays({name: array for name, array in arrays.items() if array is not None})


ACROSS = np.array([0.6, 0.8, 0.0])  # a bound that is aligned with no side
BOXES = (box_part([0.1, 0.0, 0.0], [0.2, 0.02, 0.03]), box_part([0.2, 0.0, 0.0], [0.25, 0.04, 0.03]))


def bounded(*planes: tuple[list[float] | np.ndarray, float], parts: tuple[ConvexPart, ...] = BOXES) -> CollisionMesh:
    collision = CollisionMesh(parts, (0.001, 0.002, 0.003), "cuts", 0.5, {"volume_ratio": 1.1})
    rows = [np.append(normal, offset) for normal, offset in planes]
    kept = within_bounds(collision, np.array(rows).reshape(-1, 4))
    assert (kept.error_m, kept.made_by, kept.seconds, kept.notes) == (
        (0.001, 0.002, 0.003),
        "cuts",
        0.5,
        collision.notes,
    )
    return kept


def test_parts_within_their_bounds_stay_themselves():
    for planes in ((), (([1.0, 0.0, 0.0], 0.25), (ACROSS, 0.19))):
        assert all(own is part for own, part in zip(bounded(*planes).parts, BOXES, strict=True))


def test_what_of_a_part_lies_beyond_is_put_into_the_plane():
    first, second = bounded(([1.0, 0.0, 0.0], 0.22)).parts
    assert first is BOXES[0]
    np.testing.assert_allclose(
        [second.vertices.min(axis=0), second.vertices.max(axis=0)], [[0.2, 0, 0], [0.22, 0.04, 0.03]]
    )
    assert volume_m3(second) == pytest.approx(0.02 * 0.04 * 0.03)
    assert second.to_trimesh().is_volume


def test_corners_move_along_the_normal_of_a_slanted_bound():
    (_, second) = bounded((ACROSS, 0.16)).parts
    corner = np.array([0.25, 0.04, 0.03]) - (0.6 * 0.25 + 0.8 * 0.04 - 0.16) * ACROSS
    assert np.linalg.norm(second.vertices - corner, axis=1).min() < 1e-12
    assert (second.vertices @ ACROSS).max() == pytest.approx(0.16)


def test_all_bounds_are_kept_to():
    first, second = bounded(([1.0, 0.0, 0.0], 0.23), ([0.0, -1.0, 0.0], -0.01), ([-1.0, 0.0, 0.0], -0.12)).parts
    np.testing.assert_allclose(
        [first.vertices.min(axis=0), first.vertices.max(axis=0)], [[0.12, 0.01, 0], [0.2, 0.02, 0.03]]
    )
    np.testing.assert_allclose(
        [second.vertices.min(axis=0), second.vertices.max(axis=0)], [[0.2, 0.01, 0], [0.23, 0.04, 0.03]]
    )


def test_a_part_of_which_nothing_solid_is_left_falls_away_unless_it_is_the_last():
    assert bounded(([1.0, 0.0, 0.0], 0.2)).parts == BOXES[:1]
    assert len(bounded(([1.0, 0.0, 0.0], 0.20005)).parts) == 1
    assert bounded(([1.0, 0.0, 0.0], 0.05)).parts == BOXES
