"""Objects of one scene make way for each other: planes and depths known by hand, in a world whose up is tilted."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, TURN, trough
from toy_bodies import refined

from gfp_grasp.overlap import Apart, make_way
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import CompletedShape

T = make_T(TURN, AWAY)  # where the shapes below stand, on z = 0 of their frame
UP = TURN[:, 2]
FLOOR_M = float(UP @ AWAY)
SIGMA_M = 0.0015
HALF_M = 0.00005  # of the clearance
A = ([0.0, 0.0, 0.0], [0.06, 0.04, 0.1])
B = ([0.057, 0.005, 0.0], [0.1, 0.03, 0.05])  # 3 mm into A


def shape_of(mesh: trimesh.Trimesh, seen=None, T: np.ndarray = T) -> CompletedShape:
    """A shape of the world from a mesh of the frame T; seen tells of points in that frame which were seen."""
    vertices = np.asarray(mesh.vertices)
    observed = np.zeros(len(vertices), bool) if seen is None else seen(vertices)
    return CompletedShape(
        mesh=mesh.copy().apply_transform(T),
        observed=observed,
        sigma_m=np.full(len(vertices), 0.001),
        fit=None,
        timings_s={},
    )


def box(low, high, seen=None, T: np.ndarray = T, edge_m: float = 0.01) -> CompletedShape:
    return shape_of(refined(trimesh.creation.box(bounds=[low, high]), edge_m), seen, T)


def parted(*shapes: CompletedShape, floor_m: float | None = FLOOR_M) -> Apart:
    before = [shape.mesh.vertices.copy() for shape in shapes]
    apart = make_way(shapes, up=UP, floors_m=[floor_m] * len(shapes), sigma_m=SIGMA_M)
    for vertices, shape, own in zip(before, shapes, apart.shapes, strict=True):
        np.testing.assert_array_equal(shape.mesh.vertices, vertices)  # what came is left alone
        np.testing.assert_array_equal(own.mesh.faces, shape.mesh.faces)
        np.testing.assert_array_equal(own.observed, shape.observed)
        assert own.mesh.is_volume
    return apart


def extent(shape: CompletedShape) -> np.ndarray:
    """(2, 3) lowest and highest coordinates in the frame T."""
    own = (shape.mesh.vertices - AWAY) @ TURN
    return np.array([own.min(axis=0), own.max(axis=0)])


def plane(normal, offset: float) -> np.ndarray:
    """A half-space of the frame T as one of the world."""
    turned = TURN @ np.asarray(normal, dtype=float)
    return np.append(turned, offset + turned @ AWAY)


FLOOR = plane([0, 0, -1], 0.0)


def assert_unchanged(apart: Apart, *shapes: CompletedShape) -> None:
    assert all(own is shape for own, shape in zip(apart.shapes, shapes, strict=True))


def test_two_guessed_boxes_give_way_half_each():
    a, b = box(*A), box(*B)
    apart = parted(a, b)
    step_m = 0.0015 + HALF_M
    assert [(way.index, way.other, way.moved) for way in apart.gave_way] == [(0, 1, True), (1, 0, True)]
    assert [way.depth_m for way in apart.gave_way] == pytest.approx([step_m, step_m])
    assert [way.seen_m for way in apart.gave_way] == [0.0, 0.0]
    np.testing.assert_allclose(extent(apart.shapes[0]), [A[0], [0.06 - step_m, 0.04, 0.1]], atol=1e-9)
    np.testing.assert_allclose(extent(apart.shapes[1]), [[0.057 + step_m, 0.005, 0.0], B[1]], atol=1e-9)
    np.testing.assert_allclose(apart.bounds[0], [FLOOR, plane([1, 0, 0], 0.0585 - HALF_M)], atol=1e-7)
    np.testing.assert_allclose(apart.bounds[1], [FLOOR, plane([-1, 0, 0], -0.0585 - HALF_M)], atol=1e-7)
    assert apart.shapes[0].mesh.volume == pytest.approx((0.06 - step_m) * 0.04 * 0.1)


@pytest.mark.parametrize("order", [1, -1])
def test_guessed_surface_gives_way_before_seen_surface(order: int):
    seen, guessed = box(*A, seen=lambda v: v[:, 0] > 0.059), box(*B)
    apart = parted(*(seen, guessed)[::order])
    first, second = apart.shapes[::order]
    assert first is seen
    np.testing.assert_allclose(extent(second)[0], [0.06 + HALF_M, 0.005, 0.0], atol=1e-9)
    (way,) = apart.gave_way
    index = 1 if order == 1 else 0
    assert (way.index, way.other, way.seen_m, way.moved) == (index, 1 - index, 0.0, True)
    assert way.depth_m == pytest.approx(0.003 + HALF_M)
    np.testing.assert_allclose(apart.bounds[1 - index][1], plane([1, 0, 0], 0.06 - HALF_M), atol=1e-7)


def everywhere(vertices: np.ndarray) -> np.ndarray:
    return np.ones(len(vertices), bool)


@pytest.mark.parametrize(
    ("reach_m", "seen", "parts"), [(0.017, True, True), (0.022, True, False), (0.022, False, True)]
)
def test_seen_surface_moves_by_a_centimetre_at_most(reach_m: float, seen: bool, parts: bool):
    """A block reaches far into a trough from above, and a millimetre into its wall."""
    seen_where = everywhere if seen else None
    block = box([0.02, 0.01, 0.05 - reach_m], [0.061, 0.03, 0.11], seen_where, edge_m=0.002)
    shapes = shape_of(trough()[0], seen_where), block
    apart = parted(*shapes, floor_m=None)
    assert [way.moved for way in apart.gave_way] == ([True, True] if parts else [False])
    if not parts:
        assert_unchanged(apart, *shapes)
        (way,) = apart.gave_way
        assert (way.index, way.other, way.seen_m) == (0, 1, 0.0)
        assert 0.0005 < way.depth_m < 0.01
        return
    step_m = reach_m / 2 + HALF_M
    assert [way.depth_m for way in apart.gave_way] == pytest.approx([step_m, step_m])
    assert [way.seen_m for way in apart.gave_way] == pytest.approx([step_m, step_m] if seen else [0.0, 0.0])


def test_seen_surface_moves_as_far_as_two_things_overlap():
    shapes = box(*A, everywhere, edge_m=0.004), box([0.038, 0.005, 0.0], [0.12, 0.03, 0.05], everywhere, edge_m=0.004)
    step_m = 0.011 + HALF_M
    assert [way.seen_m for way in parted(*shapes).gave_way] == pytest.approx([step_m, step_m])


@pytest.mark.parametrize(("overlap_m", "parts"), [(0.0003, False), (0.0007, True)])
def test_half_a_millimetre_of_overlap_is_left(overlap_m: float, parts: bool):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    shapes = shape_of(ball), shape_of(ball.copy().apply_translation([0.06 - overlap_m, 0.0, 0.0]))
    apart = parted(*shapes, floor_m=None)
    assert_unchanged(apart, *shapes)  # neither step is worth a word
    assert apart.gave_way == []
    assert [len(own) for own in apart.bounds] == ([1, 1] if parts else [0, 0])
    if parts:
        np.testing.assert_allclose(apart.bounds[0][0], plane([1, 0, 0], 0.03 - overlap_m / 2 - HALF_M), atol=1e-3)


@pytest.mark.parametrize(("gap_m", "bounded"), [(0.0, True), (0.019, True), (0.021, False)])
def test_parts_of_near_objects_keep_to_a_plane_and_far_ones_are_free(gap_m: float, bounded: bool):
    level = np.eye(4)
    shapes = box(*A, T=level), box([0.06 + gap_m, 0.005, 0.0], [0.12, 0.03, 0.05], T=level)
    apart = make_way(shapes, up=level[2, :3], floors_m=[0.0] * len(shapes), sigma_m=SIGMA_M)
    assert_unchanged(apart, *shapes)
    assert apart.gave_way == []
    floor = [0.0, 0.0, -1.0, 0.0]
    for sign, own in zip((1, -1), apart.bounds, strict=True):
        *normal, offset = own[-1]
        np.testing.assert_allclose(own[0], floor, atol=1e-12)
        assert len(own) == (2 if bounded else 1)
        if bounded:
            assert normal == pytest.approx([sign, 0.0, 0.0])
            assert 0.06 - 2 * HALF_M < sign * offset < 0.06 + gap_m + 2 * HALF_M


def test_what_reaches_round_another_is_left_as_it_is():
    mesh, _ = trough()
    shapes = shape_of(mesh), box([0.02, 0.012, 0.001], [0.03, 0.02, 0.02], edge_m=0.002)
    apart = parted(*shapes, floor_m=None)
    assert_unchanged(apart, *shapes)
    assert apart.gave_way == []
    assert [own.shape for own in apart.bounds] == [(0, 4), (0, 4)]


@pytest.mark.parametrize("seen", [None, lambda vertices: vertices[:, 0] < 0.03])
def test_two_shapes_in_one_place_are_told_of_and_left(seen):
    shapes = box(*A, seen), box(*A, seen)
    apart = parted(*shapes)
    assert_unchanged(apart, *shapes)
    (way,) = apart.gave_way
    assert (way.index, way.other, way.seen_m, way.moved) == (0, 1, 0.0, False)
    assert way.depth_m == pytest.approx(0.001)


@pytest.mark.parametrize("low_m", [0.0, 0.03])
def test_one_thing_within_another_is_told_of_and_not_crushed(low_m: float):
    shapes = box(*A), box([0.02, 0.01, low_m], [0.03, 0.02, low_m + 0.02])
    apart = parted(*shapes)
    assert_unchanged(apart, *shapes)
    (way,) = apart.gave_way
    assert (way.index, way.other, way.moved) == (0, 1, False)
    assert way.depth_m > 0.009


@pytest.mark.parametrize(("end_m", "parts"), [(0.16, True), (0.0605, False)])
def test_an_object_of_which_nearly_all_is_in_another_stays(end_m: float, parts: bool):
    whole = box(*A, seen=everywhere)
    long = box([0.01, 0.002, 0.01], [end_m, 0.038, 0.09])
    (way,) = parted(whole, long).gave_way
    assert way.moved == parts
    assert (way.index, way.other) == ((1, 0) if parts else (0, 1))


def test_a_plate_that_a_plane_would_press_flat_stays():
    block = box([0.0, 0.0, 0.0], [0.06, 0.04, 0.0445], everywhere, edge_m=0.004)
    plate = box([0.03, 0.005, 0.04], [0.12, 0.03, 0.044], edge_m=0.004)
    apart = parted(block, plate)
    assert_unchanged(apart, block, plate)
    assert [way.moved for way in apart.gave_way] == [False]


@pytest.mark.parametrize("floor_m", [FLOOR_M, None])
def test_what_is_cut_from_above_stands_on_the_plane_as_on_a_floor(floor_m: float | None):
    below = box(*A, seen=everywhere)
    turn = make_T(rotation_about((0.3, 1.0, 0.0), np.radians(1.2)), (0.0, 0.0, 0.1003))
    upper = refined(trimesh.creation.box(bounds=[[0.01, 0.005, 0.0], [0.05, 0.03, 0.05]]), 0.01)
    bottom = upper.vertices[:, 2] == 0.0
    before = upper.apply_transform(turn).vertices[bottom, 2]
    assert before.min() < 0.0995
    assert before.max() > 0.1001  # not all of it is cut
    apart = parted(below, shape_of(upper), floor_m=floor_m)
    heights = (apart.shapes[1].mesh.vertices[bottom] - AWAY) @ UP
    assert heights == pytest.approx(0.1 + HALF_M, abs=1e-9)
    assert extent(apart.shapes[1])[1, 2] == pytest.approx(upper.vertices[:, 2].max(), abs=1e-6)


def test_a_level_plane_is_better_than_a_leaning_one_that_cuts_off_a_little_less():
    turn = make_T(rotation_about((0.3, 1.0, 0.0), np.radians(3.0)), (0.0, 0.0, 0.099))
    upper = refined(trimesh.creation.box(bounds=[[0.01, 0.005, 0.0], [0.05, 0.03, 0.05]]), 0.01)
    apart = parted(box(*A), shape_of(upper.apply_transform(turn), everywhere))
    np.testing.assert_allclose(apart.bounds[0][1, :3], UP, atol=1e-9)
    assert apart.bounds[0][1, 3] - FLOOR_M == pytest.approx(upper.vertices[:, 2].min() - HALF_M)


@pytest.mark.parametrize("order", [1, -1])
def test_a_side_of_either_hull_may_be_the_plane(order: int):
    turn = make_T(rotation_about((0.0, 0.0, 1.0), np.radians(20.0)), (0.027, 0.0, 0.0))
    block = refined(trimesh.creation.box(bounds=[[0.0, -0.05, -0.04], [0.07, 0.06, 0.05]]), 0.01).apply_transform(turn)
    ball = shape_of(trimesh.creation.icosphere(subdivisions=4, radius=0.03))
    apart = parted(*(ball, shape_of(block, everywhere))[::order], floor_m=None)
    normal = apart.bounds[::order][0][0, :3]
    np.testing.assert_allclose(TURN.T @ normal, turn[:3, 0], atol=1e-9)


def _uneven(lift_m: float) -> CompletedShape:
    """The box B, moved up, with a bottom that is 0.2 mm off level."""
    mesh = refined(trimesh.creation.box(bounds=B), 0.01)
    bottom = mesh.vertices[:, 2] == 0.0
    uneven = np.add(mesh.vertices, [0.0, 0.0, lift_m])
    uneven[bottom & (uneven[:, 1] > 0.02), 2] += 2e-4
    return shape_of(trimesh.Trimesh(uneven, mesh.faces, process=False))


@pytest.mark.parametrize(("floor_m", "least_m", "most_m"), [(FLOOR_M, 0.0, 0.0), (None, 0.0, 2e-4)])
def test_what_was_cut_stands_on_the_support_where_there_is_one(floor_m, least_m: float, most_m: float):
    uneven = _uneven(0.0)
    bottom = (uneven.mesh.vertices - AWAY) @ UP < 3e-4
    heights = (parted(box(*A), uneven, floor_m=floor_m).shapes[1].mesh.vertices[bottom] - AWAY) @ UP
    assert (heights.min(), heights.max()) == pytest.approx((least_m, most_m), abs=1e-9)


def test_an_object_on_another_that_a_third_cuts_is_not_drawn_down_to_the_support():
    carried = _uneven(0.05)
    apart = parted(carried, box([0.07, 0.0, 0.0], [0.099, 0.03, 0.05]), box(*A))
    assert {(way.index, way.other) for way in apart.gave_way} == {(0, 2), (2, 0)}
    assert extent(apart.shapes[0])[0, 2] == pytest.approx(0.05, abs=2e-4)


def test_each_object_keeps_to_the_planes_of_all_its_neighbours():
    row = [box([0.19 * i, 0.002 * i, 0.0], [0.19 * i + 0.2, 0.04, 0.05 + 0.01 * i]) for i in range(3)]
    apart = parted(*row, box([1.5, 0.0, 0.0], [1.55, 0.04, 0.05]))
    assert [len(own) for own in apart.bounds] == [2, 3, 2, 1]
    for shape, bounds in zip(apart.shapes, apart.bounds, strict=True):
        assert (shape.mesh.vertices @ bounds[:, :3].T - bounds[:, 3]).max() < 6e-5
        np.testing.assert_allclose(bounds[0], FLOOR, atol=1e-12)


def test_edges_that_cross_are_parted_by_a_plane_between_them():
    """A roof that lies on a keel: no side of either parts them, the level plane between their edges does."""
    edge = [[0, -0.02, 0], [0, 0.02, 0], [0, 0, 0.03], [0.1, -0.03, 0], [0.1, 0.02, 0], [0.1, 0, 0.03]]
    low = [[0.03, -0.04, 0.06], [0.07, -0.04, 0.06], [0.05, -0.04, 0.028]]
    low += [[0.03, 0.05, 0.06], [0.08, 0.05, 0.06], [0.05, 0.05, 0.028]]
    roof, keel = (trimesh.convex.convex_hull(np.array(corners)) for corners in (edge, low))
    turn = make_T(rotation_about((0.5, -0.3, 0.2), 0.6))  # so that the plane is not level
    shapes = [shape_of(refined(mesh, 0.004).apply_transform(turn)) for mesh in (roof, keel)]
    apart = parted(*shapes, floor_m=None)
    assert len(apart.gave_way) == 2
    assert max(way.depth_m for way in apart.gave_way) < 0.003  # a side of either would cut 17 mm
    normal = turn[:3, :3].T @ TURN.T @ apart.bounds[0][0, :3]
    assert normal[2] > 0.97


def test_flat_shapes_do_not_stop_a_scene():
    flat = trimesh.Trimesh(
        [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 0]],
        [[0, 1, 2], [1, 3, 2], [0, 2, 1], [1, 2, 3]],
        process=False,
    )
    apart = make_way([box(*A), shape_of(flat)], up=UP, floors_m=[None, None], sigma_m=SIGMA_M)
    np.testing.assert_allclose(extent(apart.shapes[1])[:, :2], [[0, 0], [0.1, 0.1]], atol=1e-9)


def test_one_shape_or_none_has_nobody_to_make_way_for():
    alone = box(*A)
    apart = parted(alone)
    assert_unchanged(apart, alone)
    np.testing.assert_allclose(apart.bounds, [[FLOOR]], atol=1e-12)
    nothing = parted()
    assert (nothing.shapes, nothing.bounds, nothing.gave_way) == ([], [], [])


def hollowed(shape: CompletedShape, depth_m: float) -> CompletedShape:
    """The shape with the inner part of its top so much lower, as a guess may have it."""
    own = (shape.mesh.vertices - AWAY) @ TURN
    top = own[:, 2] > own[:, 2].max() - 1e-9
    inner = top & (np.abs(own[:, :2]) < 0.035).all(axis=1)
    own[inner, 2] -= depth_m
    return shape_of(trimesh.Trimesh(own, shape.mesh.faces, process=False), lambda v: top & ~inner)


LOW = ([-0.08, -0.08, 0.0], [0.08, 0.08, 0.05])


def test_what_nobody_saw_of_a_carrier_comes_up_to_the_foot_of_what_stands_on_it() -> None:
    low, high = hollowed(box(*LOW), 0.012), box([-0.02, -0.03, 0.05], [0.02, 0.03, 0.12])
    apart = make_way([low, high], up=UP, floors_m=[FLOOR_M, FLOOR_M + 0.05], sigma_m=SIGMA_M)
    before, after = ((s.mesh.vertices - AWAY) @ TURN for s in (low, apart.shapes[0]))
    under = (np.abs(before[:, :2]) < (0.02 + 1e-9, 0.03 + 1e-9)).all(axis=1) & (before[:, 2] > 0.03)
    np.testing.assert_allclose(after[under, 2], 0.05, atol=2 * HALF_M)
    np.testing.assert_allclose(after[~under], before[~under], atol=2 * HALF_M)
    assert apart.shapes[0].mesh.is_volume
    np.testing.assert_allclose(extent(apart.shapes[1]), [[-0.02, -0.03, 0.05], [0.02, 0.03, 0.12]], atol=1e-4)


@pytest.mark.parametrize(
    ("depth_m", "foot_m", "seen"),
    [
        (0.012, 0.07, False),  # it hangs two centimetres above
        (0.045, 0.05, False),  # a hollow as deep as that is no guess at a flat top
        (0.012, 0.05, True),  # the hollow was seen
    ],
)
def test_a_carrier_stays_as_it_is(depth_m: float, foot_m: float, seen: bool) -> None:
    low, high = hollowed(box(*LOW), depth_m), box([-0.02, -0.03, foot_m], [0.02, 0.03, foot_m + 0.07])
    if seen:
        low = CompletedShape(low.mesh, np.ones(len(low.mesh.vertices), bool), low.sigma_m, None, {})
    apart = make_way([low, high], up=UP, floors_m=[FLOOR_M, FLOOR_M + foot_m], sigma_m=SIGMA_M)
    np.testing.assert_allclose(apart.shapes[0].mesh.vertices, low.mesh.vertices, atol=1e-9)


def test_two_that_are_stacked_meet_at_the_foot_of_the_upper_one_and_what_is_beside_them_stays() -> None:
    low = box([-0.08, -0.08, 0.0], [0.08, 0.08, 0.0522], lambda v: v[:, 2] > 0.05)
    high = box([-0.02, -0.03, 0.05], [0.02, 0.03, 0.12])
    beside = box([0.09, -0.03, 0.0], [0.13, 0.03, 0.055])
    floors_m = [FLOOR_M, FLOOR_M + 0.05, FLOOR_M]
    apart = make_way([low, high, beside], up=UP, floors_m=floors_m, sigma_m=SIGMA_M)
    tops = [extent(shape)[1, 2] for shape in apart.shapes]
    assert tops == pytest.approx([0.05, 0.12, 0.055], abs=2 * HALF_M)
    assert extent(apart.shapes[1])[0, 2] == pytest.approx(0.05, abs=2 * HALF_M)
    np.testing.assert_array_equal(apart.shapes[2].mesh.vertices, beside.mesh.vertices)
    (way,) = [way for way in apart.gave_way if way.index == 0]
    assert (way.other, way.moved) == (1, True)
    assert way.seen_m == pytest.approx(0.0022, abs=2 * HALF_M)
