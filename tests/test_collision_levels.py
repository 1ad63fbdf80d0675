"""Which parts become one first, and how true each level is."""

import numpy as np
import pytest
import trimesh
from bodies import AWAY, TURN, box_part, l_parts, l_shape

from gfp_grasp.collision import decomposition, levels, part_levels
from gfp_grasp.collision.levels import groups_of, levels_of, merge_tree
from gfp_grasp.types import CollisionMesh, ConvexPart


def turned(parts: list[ConvexPart]) -> list[ConvexPart]:
    return [ConvexPart(part.vertices @ TURN.T + AWAY, part.faces) for part in parts]


def test_crumbs_far_apart_are_merged_after_neighbours_of_any_size():
    crumbs = [box_part([x, 0, 0], [x + 0.01, 0.01, 0.01]) for x in (-2.0, 2.5)]
    steps = [box_part([0, 0, 0], [1, 1, 1]), box_part([1, 0, 0], [2, 1, 1.4])]
    merges = merge_tree([crumbs[0], *steps, crumbs[1]])
    assert merges[0].tolist() == [1, 2]
    assert merge_tree([steps[0], crumbs[0], crumbs[1], steps[1]])[0].tolist() == [0, 3]


def test_of_neighbours_those_go_first_whose_hull_adds_least_to_both():
    # Two large boxes that add nothing, two small ones that add half of a cubic metre.
    parts = [
        box_part([0, 0, 0], [2, 2, 2]),
        box_part([2, 0, 0], [4, 2, 2]),
        box_part([4, 0, 0], [5, 1, 1]),
        box_part([5, 0, 0], [6, 1, 2]),
    ]
    merges = merge_tree(turned(parts))
    assert merges.tolist() == [[0, 1], [2, 3], [4, 5]]
    assert groups_of(merges, 4, 3) == [[0, 1], [2], [3]]
    assert groups_of(merges, 4, 2) == [[0, 1], [2, 3]]


def test_what_was_merged_weighs_with_its_own_volume():
    # After 0 and 1, their joint hull takes in 2 for nothing; the pair of 3 and 4 adds a little.
    parts = [
        box_part([0, 0, 0], [1, 1, 1]),
        box_part([1, 0, 0], [2, 1, 1]),
        box_part([2, 0, 0], [3, 1, 1]),
        box_part([3, 0, 0], [4, 0.3, 0.3]),
        box_part([4, 0, 0], [5, 0.3, 0.5]),
    ]
    assert merge_tree(turned(parts))[:2].tolist() == [[0, 1], [2, 5]]


def test_flat_parts_are_merged_like_any_other():
    flat = ConvexPart(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2]]))
    assert merge_tree([flat, box_part([0, 0, 0], [1, 1, 1])]).tolist() == [[0, 1]]


def test_every_level_has_its_error_and_the_finest_is_the_mesh():
    found = levels_of(l_parts(), l_shape())
    assert found.merges.tolist() == [[0, 1]]
    assert found.errors_m.shape == (2, 2)
    assert found.errors_m[1, 0] < 5e-5
    assert found.errors_m[0, 0] > 0.002
    assert found.errors_m[0, 1] > 0.015
    assert found.errors_m[1, 1] < 1e-4


def test_a_score_of_parts_is_kept_whole():
    rows = tuple(box_part([0.01 * i, 0, 0], [0.01 * (i + 1), 0.02 + 0.001 * i, 0.03]) for i in range(20))
    whole = trimesh.boolean.union([part.to_trimesh() for part in rows])
    found = levels_of(rows, whole)
    assert len(found.parts) == len(found.errors_m) == 20
    assert found.errors_m[19, 0] < 1e-4


def test_no_level_has_more_parts_or_corners_than_a_primitive_may(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(levels, "_MOST", 3)
    ball = trimesh.creation.icosphere(subdivisions=3)
    whole = trimesh.util.concatenate([part.to_trimesh() for part in l_parts()])
    parts = [ConvexPart(ball.vertices * 0.01 + [0.05 * i, 0.01, 0.01], ball.faces) for i in range(2)]
    found = levels_of((*l_parts(), *parts), whole)  # pyright: ignore[reportArgumentType]
    assert len(found.parts) == 3
    assert len(found.errors_m) == 3
    ones = levels_of(tuple(parts[:1]), ball)
    assert len(ones.parts[0].vertices) == 96


@pytest.mark.parametrize(("counts", "asked"), [((32, 99), [0.02]), ((31, 40), [0.02, 0.01]), ((2, 3), [0.02, 0.01])])
def test_a_template_of_few_parts_is_cut_more_finely(monkeypatch: pytest.MonkeyPatch, counts: tuple, asked: list):
    thresholds = []

    def some(mesh, config):
        thresholds.append(config.threshold)
        count = counts[len(thresholds) - 1]
        return CollisionMesh(tuple(box_part([i, 0, 0], [i + 1, 1, 1]) for i in range(count)), (1, 1, 1), "coacd", 0.0)

    monkeypatch.setattr(decomposition, "decompose", some)
    monkeypatch.setattr(decomposition, "levels_of", lambda parts, mesh: parts)
    found = part_levels(l_shape())
    assert thresholds == asked
    assert len(found) == counts[len(asked) - 1]  # pyright: ignore[reportArgumentType]
