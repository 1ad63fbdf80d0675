"""When two pieces of surface are one object: each rule on either side of its bound, all others kept out of the way."""

import numpy as np
import pytest

from gfp_grasp.detect.clusters import _give_back
from gfp_grasp.detect.merging import merge_pieces
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import TABLETOP, SupportPlane

TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def _walls(box: Box, count: int = 14) -> np.ndarray:
    """Points (n, 3) m on the four upright sides of a box from its low to its high corner."""
    low, high = (np.array(corner) for corner in box)
    t = np.linspace(0.0, 1.0, count)
    unit = np.array(
        [
            [a, b, z]
            for a, b in [*((s, 0) for s in t), *((s, 1) for s in t), *((0, s) for s in t), *((1, s) for s in t)]
            for z in t
        ]
    )
    return low + unit * (high - low)


def _group(*boxes: Box, areas: tuple[float, ...], T: np.ndarray | None = None) -> list[int]:
    """Object of each box, whose surfaces (cm^2) are given whatever their size."""
    walls = [_walls(box) for box in boxes]
    pieces = np.concatenate([np.full(len(points), k + 1) for k, points in enumerate(walls)])
    area_m2 = np.concatenate([np.full(len(p), 1e-4 * area / len(p)) for p, area in zip(walls, areas, strict=True)])
    points, support = np.vstack(walls), TABLE
    if T is not None:
        points, support = apply_T(T, points), SupportPlane(T[:3, 2], float(T[:3, 2] @ T[:3, 3]))
    return merge_pieces(pieces, points, support, area_m2, sensor=TABLETOP).tolist()


def _are_one(piece: Box, other: Box, areas: tuple[float, float]) -> bool:
    group = _group(piece, other, areas=areas)
    assert group[0] == 0
    move = make_T(rotation_about((1.0, -2.0, 0.5), 2.1), (0.3, 0.1, -0.2))
    assert _group(piece, other, areas=areas, T=move) == group  # in any frame
    return group[1] == group[2]


BODY: Box = ((0.0, 0.0, 0.0), (0.1, 0.08, 0.1))


def _beside(gap: float, low: float, high: float, width: float = 0.05, depth: float = 0.05) -> Box:
    """A piece that begins `gap` beyond the body along x, from one height to another."""
    return (0.1 + gap, 0.0, low), (0.1 + gap + width, depth, high)


@pytest.mark.parametrize(("low", "one"), [(0.02, True), (0.01, False)])
def test_what_floats_near_by_is_held_by_the_larger(low: float, one: bool) -> None:
    assert _are_one(_beside(0.01, low, 0.06), BODY, (40.0, 100.0)) == one


@pytest.mark.parametrize(("area", "one"), [(45.0, True), (55.0, False)])
def test_what_floats_belongs_to_what_is_twice_as_large(area: float, one: bool) -> None:
    assert _are_one(_beside(0.01, 0.02, 0.06), BODY, (area, 100.0)) == one


def test_what_floats_and_ends_at_the_same_height_may_be_of_any_size() -> None:
    assert _are_one(_beside(0.01, 0.02, 0.095), BODY, (95.0, 100.0))
    assert not _are_one(_beside(0.01, 0.02, 0.08), BODY, (95.0, 100.0))


@pytest.mark.parametrize(("gap", "one"), [(0.012, True), (0.018, False)])
def test_what_floats_is_held_over_fifteen_millimetres_at_most(gap: float, one: bool) -> None:
    assert _are_one(_beside(gap, 0.02, 0.06), BODY, (40.0, 100.0)) == one


@pytest.mark.parametrize(("area", "one"), [(13.0, True), (17.0, False)])
def test_a_crumb_that_touches_belongs_to_its_neighbour(area: float, one: bool) -> None:
    assert _are_one(_beside(0.003, 0.0, 0.06), BODY, (area, 100.0)) == one


@pytest.mark.parametrize(("area", "one"), [(28.0, True), (32.0, False)])
def test_a_thin_piece_that_touches_may_be_twice_as_large(area: float, one: bool) -> None:
    assert _are_one(_beside(0.003, 0.0, 0.06, depth=0.02), BODY, (area, 100.0)) == one
    assert not _are_one(_beside(0.003, 0.0, 0.06, depth=0.03), BODY, (area, 100.0))


def test_a_crumb_that_does_not_touch_stands_by_itself() -> None:
    assert _are_one(_beside(0.004, 0.0, 0.06), BODY, (10.0, 100.0))
    assert not _are_one(_beside(0.007, 0.0, 0.06), BODY, (10.0, 100.0))


def test_what_lies_within_the_outline_of_the_other_is_part_of_it() -> None:
    inside: Box = ((0.01, 0.01, 0.0), (0.05, 0.05, 0.05))
    across: Box = ((0.06, 0.01, 0.0), (0.17, 0.05, 0.05))  # less than half of its points are over the body
    assert _are_one(inside, BODY, (90.0, 100.0))
    assert not _are_one(across, BODY, (90.0, 100.0))


def test_with_tops_at_one_height_a_wall_may_lie_a_centimetre_beyond_the_outline() -> None:
    def beyond(high: float) -> Box:
        return (0.0, 0.08, 0.0), (0.1, 0.088, high)

    long: Box = ((0.0, 0.0, 0.0), (0.16, 0.08, 0.1))  # not compact together
    assert _are_one(beyond(0.1), long, (90.0, 100.0))
    assert not _are_one(beyond(0.08), long, (90.0, 100.0))


@pytest.mark.parametrize(
    ("cap", "area", "one"),
    [
        (((0.005, 0.005, 0.125), (0.075, 0.075, 0.15)), 25.0, True),
        (((0.005, 0.005, 0.125), (0.075, 0.075, 0.15)), 35.0, False),  # too large for a cap
        (((0.005, 0.005, 0.14), (0.075, 0.075, 0.16)), 25.0, False),  # too far above
        (((0.07, 0.005, 0.125), (0.17, 0.075, 0.15)), 25.0, False),  # beside what it stands on
    ],
)
def test_a_cap_is_small_near_and_above_its_bottle(cap: Box, area: float, one: bool) -> None:
    bottle: Box = ((0.0, 0.0, 0.0), (0.08, 0.08, 0.12))
    assert _are_one(cap, bottle, (area, 100.0)) == one


def test_on_something_wider_than_tall_there_is_no_cap() -> None:
    cap: Box = ((0.005, 0.005, 0.104), (0.055, 0.055, 0.12))
    assert _are_one(cap, ((0.0, 0.0, 0.0), (0.06, 0.06, 0.1)), (25.0, 100.0))
    assert not _are_one(cap, ((0.0, 0.0, 0.0), (0.11, 0.06, 0.1)), (25.0, 100.0))


@pytest.mark.parametrize(
    ("gap", "top", "width", "one"),
    [
        (0.05, 0.1, 0.1, True),
        (0.065, 0.1, 0.1, False),  # too far apart
        (0.05, 0.085, 0.1, False),  # not one rim
        (0.05, 0.095, 0.1, True),
        (0.05, 0.1, 0.05, False),  # length over width is 1.5
    ],
)
def test_two_sides_of_one_rim_make_up_a_compact_outline(gap: float, top: float, width: float, one: bool) -> None:
    near: Box = ((0.0, 0.0, 0.0), (0.012, width, 0.1))
    far: Box = ((0.012 + gap, 0.0, 0.0), (0.024 + gap, width, top))
    assert _are_one(near, far, (90.0, 100.0)) == one


@pytest.mark.parametrize(("width", "one"), [(0.17, True), (0.21, False)])
def test_nothing_is_merged_into_more_than_thirty_centimetres(width: float, one: bool) -> None:
    assert _are_one(_beside(0.01, 0.02, 0.06, width=width), BODY, (40.0, 100.0)) == one


def test_a_piece_joins_what_it_grew_into_and_the_nearest_wins() -> None:
    mug, handle, crumb = BODY, _beside(0.01, 0.02, 0.06, width=0.03), _beside(0.043, 0.02, 0.05, width=0.01)
    assert _group(mug, handle, crumb, areas=(100.0, 30.0, 2.0)) == [0, 1, 1, 1]
    left: Box = ((-0.12, 0.0, 0.0), (-0.02, 0.08, 0.1))  # 20 mm from the body
    between: Box = ((-0.016, 0.0, 0.02), (-0.012, 0.05, 0.06))  # 4 mm from the left one, 12 from the body
    assert _group(BODY, left, between, areas=(100.0, 90.0, 2.0))[3] == 2


def test_no_pieces_are_no_objects() -> None:
    assert merge_pieces(np.zeros(3, int), np.zeros((3, 3)), TABLE, np.ones(3), sensor=TABLETOP).tolist() == [0]


def test_pixels_of_a_crease_join_the_nearest_piece_that_is_near_in_space_too() -> None:
    pieces = np.array([[1, 0, 0, 0, 2]])
    above = np.array([[True, True, True, False, True]])
    points = np.zeros((1, 5, 3))
    points[0, :, 0] = [0.0, 0.001, 0.1, 0.1, 0.1]
    assert _give_back(pieces, above, points, 0.015).tolist() == [[1, 1, 0, 0, 2]]
    assert _give_back(pieces, above, points, 0.2).tolist()[0][2] > 0
    assert _give_back(0 * pieces, above, points, 0.2).tolist() == [[0, 0, 0, 0, 0]]
