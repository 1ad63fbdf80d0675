"""Views as examples: what class each is taught as, what it may be taken for, and how its object lies."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import Family, foreign_kinds, get_family, make_shape
from gfp_grasp.shapes.assorted import _MAKERS
from gfp_grasp.train import View, assorted_examples, class_examples
from gfp_grasp.train import proposal_data as module
from gfp_grasp.train.proposal_data import VIEWS, _order, part_in_view
from gfp_grasp.train.views import config_id
from gfp_grasp.transforms import apply_T, make_T, rotation_about

EYE = np.array([0.4, 0.0, 0.3])


def test_a_handle_is_seen_by_fifteen_points_three_millimetres_beyond_the_body() -> None:
    T = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 0.2], [0, 0, 1, 0], [0, 0, 0, 1]])
    local = np.zeros((40, 3))
    for count, reach, seen in ((15, 0.0431, True), (14, 0.0431, False), (15, 0.0429, False)):
        local[:, 0], local[:count, 0] = 0.0, reach
        assert part_in_view(local @ T[:3, :3].T + T[:3, 3], T, 0.04) is seen


LYING = make_T(rotation_about((0, 1, 0), np.pi / 2), (0.2, -0.1, 0.05))


@pytest.fixture
def mug_views(tmp_path: Path, monkeypatch) -> list:
    """Views of a mug from all sides, from behind its handle, and from behind as a file, and what was asked for."""
    asked: list = []
    mesh = make_shape("mug", 4).mesh
    path = tmp_path / "some.ply"
    mesh.export(path)

    def views(category, split, **knobs):
        asked.append((category, split, knobs))
        points = np.asarray(mesh.vertices)
        own = ObjectSource("mug-4", "mug", family="mug", seed=4)
        file = ObjectSource("some", "mug", path=path)
        behind = points[points[:, 0] < 0]
        return [
            View(source, apply_T(LYING, seen), EYE, LYING, "lying")
            for source, seen in ((own, points), (own, behind), (file, behind))
        ]

    monkeypatch.setattr(module, "cached_views", views)
    return asked


def test_examples_of_a_class_know_their_kind_and_what_they_may_be_taken_for(mug_views: list, tmp_path: Path) -> None:
    classes = ("bottle", "mug", "cup")
    found = class_examples(
        "mug", "val", num_views=2, classes=classes, limit=3, data=tmp_path, workers=2, folder=tmp_path
    )
    knobs = {
        "num_views": 2,
        "limit": 3,
        "folder": tmp_path,
        "workers": 2,
        "config": VIEWS,
        "data": tmp_path,
        "progress": None,
    }
    assert mug_views == [("mug", "val", knobs)]
    kind = make_shape("mug", 4).kind
    assert [(e.category, e.subcategory, e.answers, e.accepted, e.resting) for e in found] == [
        ("mug", kind, ("mug",), ("mug",), "lying"),
        ("mug", kind, ("mug", "cup"), ("mug", "cup"), "lying"),
        ("mug", "", ("mug",), ("mug", "cup"), "lying"),
    ]
    assert all(e.viewpoint is EYE for e in found)


def test_examples_of_a_class_know_where_their_object_lies(mug_views: list) -> None:
    low, high = make_shape("mug", 4).mesh.bounds
    for example in class_examples("mug", "val", num_views=2, classes=("mug",)):
        placed = example.placed
        assert placed is not None
        np.testing.assert_array_equal(placed.R, LYING[:3, :3])
        np.testing.assert_allclose(placed.extents, high - low, atol=1e-6)
        x, y, z = (low + high) / 2  # its z axis lies along x, its x axis points down
        np.testing.assert_allclose(placed.centre, [0.2 + z, -0.1 + y, 0.05 - x], atol=1e-6)
        assert placed.order == 1


def test_a_class_is_only_alike_to_classes_that_there_are(mug_views: list) -> None:
    accepted = {
        classes: [e.accepted for e in class_examples("mug", "val", num_views=2, classes=classes)]
        for classes in (("cup", "mug", "teapot"), ("bottle", "mug"), ())
    }
    either, alone = ("mug", "cup"), ("mug",)
    assert list(accepted.values()) == [[alone, either, either], [alone] * 3, [alone] * 3]


def test_a_class_of_files_that_is_no_family_is_alike_to_none(tmp_path: Path, monkeypatch) -> None:
    trimesh.creation.box((0.1, 0.2, 0.3)).export(tmp_path / "one.ply")
    source = ObjectSource("one", "drill", path=tmp_path / "one.ply")
    view = View(source, np.zeros((3, 3)), EYE, np.eye(4), "upright")
    monkeypatch.setattr(module, "cached_views", lambda *_, **__: [view])
    (example,) = class_examples("drill", "val", num_views=1, classes=("drill", "cup", "mug"), data=tmp_path)
    assert (example.subcategory, example.answers, example.accepted) == ("", ("drill",), ("drill",))
    assert example.placed is not None
    np.testing.assert_allclose(example.placed.extents, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(example.placed.centre, [0, 0, 0.15], atol=1e-9)
    assert example.placed.order == 1


@pytest.mark.parametrize("classes", [("mug", "cup", "pot", "pan"), ("mug", "cup", "pan")])
def test_a_kind_that_is_a_member_of_other_classes_as_well_may_be_named_so(
    mug_views: list, monkeypatch, classes: tuple[str, ...]
) -> None:
    kind = make_shape("mug", 4).kind

    def family(name: str) -> Family:
        return replace(get_family(name), also={kind: ("pot", "pitcher", "pan"), "other": ("bottle",)})

    monkeypatch.setattr(module, "get_family", family)
    module._anatomy.cache_clear()
    found = class_examples("mug", "val", num_views=2, classes=classes)
    module._anatomy.cache_clear()
    also = tuple(name for name in ("pot", "pan") if name in classes)
    assert [e.answers for e in found] == [("mug", *also), ("mug", "cup"), ("mug",)]
    # A handle is in sight, so that it is no cup; behind it nobody can tell; of a file no kind is known.
    assert [e.accepted for e in found] == [("mug", *also), ("mug", "cup"), ("mug", "cup")]


def test_a_kind_without_a_handle_may_be_named_as_what_it_is_and_what_it_is_alike(monkeypatch) -> None:
    shape = make_shape("cup", 3)
    assert not shape.has_handle
    source = ObjectSource("cup-3", "cup", family="cup", seed=3)
    view = View(source, np.asarray(shape.mesh.vertices), EYE, np.eye(4), "upright")
    monkeypatch.setattr(module, "cached_views", lambda *_, **__: [view])
    monkeypatch.setattr(
        module, "get_family", lambda name: replace(get_family(name), also={shape.kind: ("mug", "bottle")})
    )
    module._anatomy.cache_clear()
    (found,) = class_examples("cup", "val", num_views=1, classes=("bottle", "cup", "mug"))
    module._anatomy.cache_clear()
    assert found.answers == found.accepted == ("cup", "mug", "bottle")  # mug, its like, is named once


@pytest.mark.parametrize(
    ("family", "kind", "order"),
    [("cup", "tapered", math.inf), ("cup", "square", 4), ("mug", "ear", 1), ("cup", "?", 1)],
)
def test_the_symmetry_of_a_kind_is_that_of_its_members(family: str, kind: str, order: float) -> None:
    assert _order(family, kind) == order


def test_kinds_that_could_be_taken_for_no_family_are_every_maker_of_five() -> None:
    assert foreign_kinds(0, 7) == (4, 5, 6, 7, 10, 16, 17)
    assert foreign_kinds(7, 3) == (7, 10, 16)
    assert foreign_kinds(2000, 4) == (2002, 2008, 2009, 2010)
    assert foreign_kinds(5, 0) == ()
    makers = [_MAKERS[kind % len(_MAKERS)].__name__ for kind in foreign_kinds(0, 60)]
    assert {name: makers.count(name) for name in makers} == dict.fromkeys(
        ("_ball", "_rod", "_cone", "_heap", "_slab"), 12
    )


def test_other_things_are_rendered_once_for_their_numbers(tmp_path: Path, monkeypatch) -> None:
    made: list = []

    def views(source, mesh, rng, *, num_views, config):
        made.append((source.name, source.category, len(mesh.vertices), rng.integers(10**6), num_views, config))
        points = np.full((3, 3), float(len(made)))
        return [View(source, points, np.array([0.0, 1.0, len(made)]), np.eye(4), "upside_down")] * num_views

    monkeypatch.setattr(module, "views_of_mesh", views)
    for _ in range(2):
        found = assorted_examples(7, 2, num_members=2, num_views=2, folder=tmp_path)
    numbers = ((7, 1), (7, 1), (7, 2), (7, 2), (10, 3), (10, 3), (10, 4), (10, 4))
    assert [(e.category, e.points[0, 0], *e.viewpoint) for e in found] == [
        (f"assorted-{kind}", value, 0.0, 1.0, value) for kind, value in numbers
    ]
    assert {(e.subcategory, e.answers == e.accepted == (e.category,), e.resting, e.placed) for e in found} == {
        ("", True, "upside_down", None)
    }
    assert [(row[0], row[1], row[4], row[5]) for row in made] == [
        (f"assorted-{kind}", f"assorted-{kind}", 2, VIEWS) for kind in (7, 10) for member in (0, 1)
    ]
    assert made[3][3] == np.random.default_rng([10, 1]).integers(10**6)
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.npz")}
    assert f"assorted/00010_001_2_{config_id(VIEWS)}.npz" in names
