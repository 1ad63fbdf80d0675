"""Budgets of convex parts: trees of merges, few corners, tolerances, room for a ball."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from test_collision_deformed import CUP, FLOOR, HEIGHT, INNER, TEMPLATE, completed, primitive, tapered

from gfp_grasp.collision import CollisionConfig, collision_of, convex_part, deform_parts, hull
from gfp_grasp.collision.choice import _levels
from gfp_grasp.collision.convex import fewer_corners
from gfp_grasp.collision.fidelity import ball_radii_m, barycentric_hold, widest_gap
from gfp_grasp.collision.levels import groups_of, merge_tree
from gfp_grasp.collision.parts import PartFaces, volume_m3
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import CompletedShape, ConvexPart, FittedPrimitive, GenericPrimitive


def as_it_is(template: GenericPrimitive) -> CompletedShape:
    """A completed shape that is a primitive's own mean."""
    mesh = trimesh.Trimesh(template.vertices, template.faces, process=False)
    v, k = len(mesh.vertices), len(template.modes)
    fit = FittedPrimitive(template, np.eye(4), np.ones(3), np.zeros(k), 0.0)
    return CompletedShape(mesh=mesh, observed=np.ones(v, bool), sigma_m=np.ones(v), fit=fit, timings_s={})


def boxes_in_a_row(count: int) -> tuple[ConvexPart, ...]:
    row = [trimesh.creation.box(bounds=[[i, 0, 0], [i + 1, 1, 1 + 0.5 * (i >= count // 2)]]) for i in range(count)]
    return tuple(ConvexPart(box.vertices, box.faces) for box in row)


def test_boxes_of_one_height_are_merged_before_the_step_between_them():
    parts = boxes_in_a_row(6)
    merges = merge_tree(parts)
    assert merges.shape == (5, 2)
    assert groups_of(merges, 6, 2) == [[0, 1, 2], [3, 4, 5]]
    assert groups_of(merges, 6, 6) == [[i] for i in range(6)]
    assert groups_of(merges, 6, 1) == groups_of(merges, 6, 0) == [list(range(6))]


@pytest.mark.parametrize("count", range(1, 7))
def test_every_level_has_as_many_groups_as_asked_and_all_parts_once(count):
    groups = groups_of(merge_tree(boxes_in_a_row(6)), 6, count)
    assert len(groups) == count
    assert sorted(i for group in groups for i in group) == list(range(6))


def test_no_or_one_part_has_no_merges():
    assert merge_tree(()).shape == merge_tree(boxes_in_a_row(1)).shape == (0, 2)


@pytest.mark.parametrize("count", [4, 5, 12, 40])
def test_a_ball_of_few_corners_keeps_most_of_its_volume(count):
    ball = trimesh.creation.icosphere(subdivisions=3)
    kept = fewer_corners(np.asarray(ball.vertices), count)
    assert len(np.unique(kept, axis=0)) == count
    part = convex_part(kept)
    assert part is not None
    assert volume_m3(part) / ball.volume > {4: 0.08, 5: 0.1, 12: 0.5, 40: 0.8}[count]


def test_corners_in_one_plane_are_left_for_one_that_is_not():
    roof = np.array([[x, y, 0.0] for x in (0, 1) for y in (0, 1)] + [[0.5, 0.5, 0.01]])
    assert convex_part(fewer_corners(roof, 4)) is not None


@pytest.mark.parametrize(("parts", "vertices"), [(1, 4), (3, 4), (5, 5), (5, None), (64, 64)])
def test_a_budget_is_met_exactly(parts, vertices):
    config = CollisionConfig(max_parts=parts, max_vertices_per_part=vertices)
    found = deform_parts(TEMPLATE, tapered(CUP.vertices), count=config.max_parts, max_vertices=vertices)
    assert len(found) == min(parts, 5)
    assert all(len(part.vertices) <= (vertices or 1000) for part in found)


@pytest.mark.parametrize("category", ["cup", "mug", "bottle"])
def test_fewer_parts_of_a_shipped_primitive_are_farther_off(category):
    template = PrimitiveLibrary.shipped().primitive(category)
    assert len(template.part_errors_m) == len(template.parts) == len(template.part_merges) + 1
    few, many = (collision_of(as_it_is(template), config=CollisionConfig(max_parts=n)) for n in (24, 64))
    assert len(few.parts) <= 24
    assert len(many.parts) <= 64
    assert many.error_m[0] <= few.error_m[0] + 3e-5


def test_a_tolerance_takes_as_few_parts_as_keep_it():
    template = PrimitiveLibrary.shipped().primitive("mug")
    counts = []
    for tolerance_m in (0.004, 0.002):
        found = collision_of(as_it_is(template), config=CollisionConfig(max_parts=128, tolerance_m=tolerance_m))
        assert found.made_by == "carried"
        assert found.error_m[1] <= tolerance_m
        counts.append(len(found.parts))
    assert counts[0] < counts[1] < 128


def test_a_tolerance_that_nothing_meets_gives_the_best_with_a_warning(monkeypatch):
    def five_boxes(mesh, config):
        return replace(collision_of(completed(mesh, TEMPLATE)), error_m=(1e-3, 2e-3, 3e-3))

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", five_boxes)
    filled = primitive(CUP, (ConvexPart(CUP.convex_hull.vertices, CUP.convex_hull.faces),))
    with pytest.warns(
        RuntimeWarning, match=r"1.0 mm on average, 2.0 mm for 95 %; deformed parts miss .* leave 0% of the ball"
    ):
        found = collision_of(completed(CUP, filled), config=CollisionConfig(tolerance_m=1e-4))
    assert len(found.parts) == 5
    assert "warning" in found.notes


def test_the_widest_gap_of_a_cup_is_its_inside():
    centre = widest_gap(CUP)
    assert centre is not None
    assert np.abs(centre[:2]).max() < 0.004
    assert FLOOR + 0.03 < centre[2] < HEIGHT
    free, left = ball_radii_m(centre, CUP, PartFaces.of(TEMPLATE.parts))
    assert free == pytest.approx(left, abs=1e-6)
    assert free == pytest.approx(INNER, abs=0.004)


def test_a_convex_thing_has_no_gap():
    assert widest_gap(trimesh.creation.icosphere(subdivisions=3, radius=0.05)) is None


def test_a_place_moves_with_the_vertices_around_it():
    rng = np.random.default_rng(0)
    vertices, place = rng.normal(size=(200, 3)), np.array([0.1, -0.2, 0.3])
    index, weights = barycentric_hold(place, vertices)
    turn, shift = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([1.0, 2, 3])
    moved = (1.3 * vertices @ turn.T + shift)[index]
    np.testing.assert_allclose(weights @ moved, 1.3 * turn @ place + shift, atol=1e-9)


def test_a_filled_inside_is_no_true_set_of_parts_however_near_its_surface(monkeypatch):
    monkeypatch.setattr("gfp_grasp.collision.choice._ERROR_LIMIT", 1.0)
    called = []

    def five_boxes(mesh, config):
        called.append(config.max_convex_hull)
        return collision_of(completed(mesh, TEMPLATE))

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", five_boxes)
    filled = primitive(CUP, (ConvexPart(CUP.convex_hull.vertices, CUP.convex_hull.faces),))
    assert len(collision_of(completed(CUP, filled), config=CollisionConfig(max_parts=7)).parts) == 5
    assert called == [7]


def test_a_loose_tolerance_never_asks_coacd_where_a_finer_level_keeps_the_inside_free(monkeypatch):
    def refuse(mesh, config):
        raise AssertionError("CoACD was asked")

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", refuse)
    for category in ("cup", "mug"):
        found = collision_of(
            as_it_is(PrimitiveLibrary.shipped().primitive(category)), config=CollisionConfig(tolerance_m=0.05)
        )
        assert found.notes["ball_left_m"] > 0.8 * found.notes["ball_m"]  # type: ignore[operator]
        assert len(found.parts) < 40


def test_of_few_parts_as_many_are_taken_as_there_may_be_and_not_the_hull():
    for category in ("cup", "mug"):
        template = PrimitiveLibrary.shipped().primitive(category)
        for most in (6, 8, 16):
            assert _levels(template, template.vertices, CollisionConfig(max_parts=most)) == [most]


def test_coacds_parts_that_fill_the_inside_do_not_replace_hollow_ones(monkeypatch):
    def nearer_hull(mesh, config):
        return replace(hull(mesh), error_m=(1e-6, 2e-6, 3e-6), made_by="coacd")

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", nearer_hull)
    with pytest.warns(RuntimeWarning, match="CoACD's 1 parts miss.*leave 0% of the ball"):
        found = collision_of(completed(CUP, TEMPLATE), config=CollisionConfig(tolerance_m=1e-9))
    assert found.made_by == "carried"


def test_parts_that_meet_the_bound_win_whatever_their_mean(monkeypatch):
    def true_ones(mesh, config):
        return replace(collision_of(completed(mesh, TEMPLATE)), error_m=(1e-2, 1e-5, 1e-2), made_by="coacd")

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", true_ones)
    bulged = trimesh.Trimesh(tapered(CUP.vertices), CUP.faces, process=False)
    found = collision_of(completed(bulged, TEMPLATE), config=CollisionConfig(tolerance_m=1.1e-5, max_parts=2))
    assert found.made_by == "coacd"


def test_a_hull_that_misses_its_tolerance_says_so():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    with pytest.warns(RuntimeWarning, match="the hull misses? the mesh by|the hull miss"):
        collision_of(completed(ball, None), config=CollisionConfig(max_vertices_per_part=6, tolerance_m=0.001))


def test_numbers_of_numpy_are_numbers():
    config = CollisionConfig(max_parts=np.int64(3), tolerance_m=np.float32(0.01))  # type: ignore[arg-type]
    assert config.max_parts == 3


@pytest.mark.parametrize("options", [{"count": 0}, {"max_vertices": 3}])
def test_less_than_a_part_of_four_corners_is_refused(options):
    with pytest.raises(InvalidOption, match="at least one of four"):
        deform_parts(TEMPLATE, CUP.vertices, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"max_parts": 0},
        {"max_parts": 2.0},
        {"max_vertices_per_part": 3},
        {"tolerance_m": 0},
        {"tolerance_m": float("nan")},
        {"tolerance_m": "1"},
        {"engine": "vhacd"},
    ],
)
def test_nonsense_budgets_are_refused_by_name(options):
    with pytest.raises(InvalidOption, match=next(iter(options))):
        CollisionConfig(**options)
