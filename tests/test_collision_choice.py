"""Which parts a completed shape gets: levels to try, bounds that must be kept, and what CoACD is asked for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import AWAY, WEDGE, box_part, l_parts, l_shape
from test_collision_deformed import TEMPLATE, completed

from gfp_grasp.collision import CollisionConfig, choice, collision_of, convex_part
from gfp_grasp.collision.choice import _decomposed_or, _is_true, _levels
from gfp_grasp.collision.parts import volume_m3
from gfp_grasp.types import CollisionMesh, CompletedShape, GenericPrimitive

L = l_shape()
DIAGONAL_M = float(np.linalg.norm([0.1, 0.06, 0.02]))


def with_errors(errors_m: Sequence[Sequence[float]] | np.ndarray) -> GenericPrimitive:
    """The square cup with as many parts as there are errors, all but the first of them anywhere."""
    parts = tuple(box_part([i, 0, 0], [i + 1, 1, 1]) for i in range(len(errors_m)))
    return replace(TEMPLATE, parts=parts, part_errors_m=np.array(errors_m))


def found(made_by, error_m: tuple, **notes: float) -> CollisionMesh:
    return CollisionMesh(l_parts(), error_m, made_by, 0.0, notes)


P95_M = [0.02, 0.01, 0.006, 0.004, 0.003, 0.0025, 0.002, 0.0018, 0.0015, 0.0012, 0.001, 0.0009]
FINE = with_errors([[p95 / 3, p95] for p95 in P95_M])


@pytest.mark.parametrize(
    ("growth", "tolerance_m", "most", "tried"),
    [
        (1.0, 0.0041, 80, [4, 6, 9, 12]),
        (2.0, 0.0041, 80, [7, 10, 12]),
        (0.5, 0.0041, 80, [3, 4, 6, 9, 12]),
        (1.0, 0.0041, 9, [4, 6, 9]),
        (1.0, 0.05, 3, [1, 2, 3]),
        (1.0, 0.0001, 80, [12]),
        (1.0, 0.0041, 2, [2]),
    ],
)
def test_levels_are_tried_from_the_first_that_could_be_near_enough(growth, tolerance_m, most, tried):
    config = CollisionConfig(max_parts=most, tolerance_m=tolerance_m)
    assert _levels(FINE, growth * FINE.vertices + AWAY, config) == tried


@pytest.mark.parametrize(
    ("errors_mm", "most", "level"),
    [
        ([[1.0, 2.0], [0.2, 0.5], [0.105, 0.19], [0.1, 0.1]], 4, 3),
        ([[1.0, 2.0], [0.2, 0.5], [0.105, 0.21], [0.1, 0.1]], 4, 4),
        ([[1.0, 2.0], [0.2, 0.5], [0.115, 0.15], [0.1, 0.1]], 4, 4),
        ([[1.0, 2.0], [0.2, 0.5], [0.105, 0.19], [0.1, 0.1]], 2, 2),
        ([[0.1, 0.2], [0.1, 0.2]], 2, 1),
    ],
)
@pytest.mark.parametrize("size", [1.0, 30.0])
def test_without_a_tolerance_as_many_are_taken_as_make_a_difference(errors_mm, most: int, level: int, size: float):
    # Figures of a body of 0.2 m, and of one that is thirty times as large.
    shrink = size * 0.2 / float(np.linalg.norm(np.ptp(TEMPLATE.vertices, axis=0)))
    template = with_errors(1e-3 * size * np.array(errors_mm))
    template = replace(template, vertices=shrink * TEMPLATE.vertices)
    assert _levels(template, template.vertices, CollisionConfig(max_parts=most)) == [level]


def test_a_primitive_whose_levels_were_never_measured_gives_as_many_parts_as_there_may_be():
    for tolerance_m in (None, 0.01):
        assert _levels(TEMPLATE, TEMPLATE.vertices, CollisionConfig(max_parts=3, tolerance_m=tolerance_m)) == [3]


@pytest.mark.parametrize(("share", "is_true"), [(0.0099, True), (0.0101, False)])
def test_the_mean_error_may_be_a_hundredth_of_the_diagonal(share: float, is_true: bool):
    parts = found("carried", (share * DIAGONAL_M, 1.0, 1.0))
    assert _is_true(parts, completed(L, None), CollisionConfig()) is is_true


@pytest.mark.parametrize(("p95_m", "is_true"), [(0.0029, True), (0.0031, False)])
def test_a_tolerance_is_that_of_95_percent_and_nothing_else_counts(p95_m: float, is_true: bool):
    parts = found("coacd", (0.5, p95_m, 1.0))
    assert _is_true(parts, completed(L, None), CollisionConfig(tolerance_m=0.003)) is is_true


@pytest.mark.parametrize(("left_m", "is_true"), [(0.0161, True), (0.0159, False)])
def test_four_fifths_of_the_ball_must_fit_between_the_parts(left_m: float, is_true: bool):
    parts = found("carried", (1e-5, 1e-5, 1e-5), ball_m=0.02, ball_left_m=left_m)
    assert _is_true(parts, completed(L, None), CollisionConfig()) is is_true


def test_coacds_parts_of_what_no_primitive_explains_are_taken_as_they_are():
    parts = found("coacd", (1.0, 1.0, 1.0))
    assert _is_true(parts, completed(L, None), CollisionConfig())
    assert not _is_true(parts, completed(L, TEMPLATE), CollisionConfig())


@pytest.mark.parametrize(("fresh_m", "made_by"), [(0.02, "coacd"), (0.04, "carried")])
def test_of_two_that_miss_their_bound_the_nearer_on_average_is_given(monkeypatch, fresh_m: float, made_by: str):
    monkeypatch.setattr(choice, "decompose", lambda mesh, config: found("coacd", (fresh_m, 0.05, 0.06)))
    monkeypatch.setattr(choice, "matching_primitive", lambda primitive, count: primitive)
    monkeypatch.setattr(choice, "_ball", lambda *_: {})
    carried = found("carried", (0.03, 0.01, 0.02))
    with pytest.warns(RuntimeWarning, match="miss the mesh"):
        better = _decomposed_or(carried, completed(L, TEMPLATE), CollisionConfig())
    assert better.made_by == made_by


def test_coacd_is_asked_for_the_budget_and_tells_of_the_parts_it_replaces(monkeypatch):
    asked = []

    def three(mesh, config):
        asked.append(config)
        return found("coacd", (1e-6, 2e-6, 3e-6))

    monkeypatch.setattr(choice, "decompose", three)
    config = CollisionConfig(max_parts=7, max_vertices_per_part=9)
    assert collision_of(completed(L, None), config=config).made_by == "coacd"
    assert (asked[0].max_convex_hull, asked[0].decimate, asked[0].max_ch_vertex) == (7, True, 9)
    collision_of(completed(L, None))
    assert (asked[1].max_convex_hull, asked[1].decimate) == (80, False)


def test_a_wedge_is_its_own_hull_and_a_dented_one_is_not(monkeypatch):
    monkeypatch.setattr(choice, "decompose", lambda mesh, config: found("coacd", (0.0, 0.0, 0.0)))
    wedge = convex_part(WEDGE + AWAY)
    assert wedge is not None
    assert collision_of(completed(wedge.to_trimesh(), None)).made_by == "hull"
    notch = trimesh.creation.box(bounds=np.add([[-1e-3, 0.01, -1e-3], [0.003, 0.02, 0.01]], AWAY))
    notched = trimesh.boolean.difference([wedge.to_trimesh(), notch])
    assert notched.volume / wedge.to_trimesh().volume == pytest.approx(1 - 0.003 * 0.01 * 0.01 / 3.6e-5)
    assert collision_of(completed(notched, None)).made_by == "coacd"


def test_notes_tell_the_level_what_was_dropped_and_the_room_that_is_left():
    parts = collision_of(completed(trimesh.Trimesh(TEMPLATE.vertices, TEMPLATE.faces, process=False), TEMPLATE))
    assert (parts.notes["level"], parts.notes["dropped"]) == (5, 0)
    assert parts.notes["ball_m"] == pytest.approx(0.036, rel=0.05)
    assert parts.notes["ball_left_m"] == pytest.approx(parts.notes["ball_m"], rel=1e-3)
    crumb = box_part([0, 0, 0], [1e-4, 1e-4, 1e-4])
    more = replace(TEMPLATE, parts=(*TEMPLATE.parts, crumb))
    parts = collision_of(completed(trimesh.Trimesh(more.vertices, more.faces, process=False), more))
    assert (parts.notes["level"], parts.notes["dropped"]) == (6, 1)


def test_cuts_are_made_where_they_are_asked_for_and_coacd_is_not(monkeypatch):
    def never(*_, **__):
        raise AssertionError("CoACD ran")

    monkeypatch.setattr(choice, "decompose", never)
    shape = CompletedShape(L, np.zeros(len(L.vertices), bool), np.zeros(len(L.vertices)))
    found = collision_of(shape, config=CollisionConfig(engine="cuts"))
    assert found.made_by == "cuts"
    assert sum(volume_m3(part) for part in found.parts) == pytest.approx(L.volume, rel=0.03)
    for made_by in ("classfree", "peer"):  # as they are made of what a network says
        assert collision_of(replace(shape, made_by=made_by)).made_by == "cuts"
    with pytest.raises(AssertionError, match="CoACD ran"):
        collision_of(shape)


def test_cuts_that_miss_the_mesh_say_by_how_much(monkeypatch):
    far = found("cuts", (0.02 * DIAGONAL_M, 0.05 * DIAGONAL_M, 0.1))
    monkeypatch.setattr(choice, "quick_parts", lambda mesh, config: far)
    shape = CompletedShape(L, np.zeros(len(L.vertices), bool), np.zeros(len(L.vertices)))
    with pytest.warns(RuntimeWarning, match="2 parts by plane cuts miss the mesh by 2.4 mm"):
        told = collision_of(shape, config=CollisionConfig(engine="cuts"))
    assert "5.9 mm for 95 %" in str(told.notes["warning"])
