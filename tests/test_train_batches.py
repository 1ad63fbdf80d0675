"""What the classifier sees in training, number by number, and how it is calibrated and measured."""

from pathlib import Path

import numpy as np
import pytest
import torch
from moments import assert_known
from toy_examples import EXAMPLES, OTHERS

from gfp_grasp.detect import POOL_POINTS
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import make_shape
from gfp_grasp.train import ClassifierConfig, alike_in, assorted_examples, class_examples
from gfp_grasp.train import classifier_data as module
from gfp_grasp.train.classifier_data import (
    VIEWS,
    Example,
    _is_usable,
    above_table,
    augmented_batches,
    make_targets,
    part_in_view,
)
from gfp_grasp.train.views import View, config_id

LIBRARY = PrimitiveLibrary.shipped()


def test_a_view_needs_thirty_points_above_the_table() -> None:
    points = np.zeros((60, 3))
    for count, usable in ((29, False), (30, True)):
        points[:count, 2] = 0.05
        points[count:, 2] = 0.001
        example = Example(points.copy(), "a", "", ("a",), ("a",), "upright")
        assert _is_usable(example) is usable
        assert len(above_table(example)) == count
    flat = Example(np.zeros((5, 3)), "a", "", ("a",), ("a",), "upright")
    assert len(above_table(flat)) == 5


def test_targets_number_classes_and_kinds_in_their_order(tmp_path: Path) -> None:
    low = Example(np.zeros((40, 3)), "cup", "flat", ("cup",), ("cup",), "upright")
    targets = make_targets([*EXAMPLES, low], OTHERS, ClassifierConfig(), tmp_path)
    assert targets.num_views == 5
    assert targets.classes.tolist() == [
        [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1],
    ]  # fmt: skip
    assert targets.kind.tolist() == [0, -1, 1, 2, 0, 3, 4]
    assert targets.class_of.tolist() == [0, 1, 0, 2, 3]
    assert targets.pool.shape == (7, POOL_POINTS, 6)
    assert targets.pool.dtype == torch.float32
    assert_known("pool", targets.pool.numpy())


def test_clouds_are_computed_once_for_the_same_examples_and_seed(tmp_path: Path) -> None:
    first = make_targets(EXAMPLES, OTHERS, ClassifierConfig(), tmp_path).pool
    (file,) = tmp_path.glob("pool_*.npy")
    assert len(file.stem) == len("pool_") + 16
    np.save(file, np.load(file) + 1)
    assert torch.equal(make_targets(EXAMPLES, OTHERS, ClassifierConfig(), tmp_path).pool, first + 1)
    assert not torch.equal(make_targets(EXAMPLES, OTHERS, ClassifierConfig(seed=1), tmp_path).pool, first + 1)
    make_targets(EXAMPLES[1:], OTHERS, ClassifierConfig(), tmp_path)
    assert len(list(tmp_path.glob("pool_*.npy"))) == 3


@pytest.mark.parametrize("unknown_table", [0.0, 1.0, 0.3])
def test_clouds_are_turned_stretched_cropped_and_thinned_as_ever(tmp_path: Path, unknown_table: float) -> None:
    targets = make_targets(EXAMPLES, OTHERS, ClassifierConfig(), tmp_path)
    config = ClassifierConfig(batch=5, share=0.61, unknown_table=unknown_table)
    stream = augmented_batches(targets, config)(torch.Generator().manual_seed(2))
    batches = [next(stream) for _ in range(9)]
    assert_known(
        f"augmented clouds {unknown_table}", torch.stack([clouds for clouds, _, _ in batches]).numpy(), rel=1e-4
    )
    assert_known(f"augmented kinds {unknown_table}", torch.stack([kind for _, _, kind in batches]).numpy())
    for clouds, classes, kind in batches:
        assert (clouds.shape, clouds.dtype) == ((5, 256, 8), torch.float32)
        # Three of five are views of classes, each at most once.
        assert (classes[:3, :2].sum(dim=1) == 1).all()
        assert (kind[3:] >= 3).all()


def test_few_views_of_classes_are_a_batch_of_fewer(tmp_path: Path) -> None:
    targets = make_targets(EXAMPLES[:2], OTHERS, ClassifierConfig(), tmp_path)
    stream = augmented_batches(targets, ClassifierConfig(batch=10, share=0.5))(torch.Generator().manual_seed(0))
    assert len(next(stream)[0]) == 2 + 5


@pytest.mark.parametrize(
    "knobs", [{"width": 1}, {"kinds": 1}, {"share": 0.01}, {"unknown_table": 0.0}, {"unknown_table": 1.0}]
)
def test_a_config_at_the_edge_is_one(knobs: dict) -> None:
    assert ClassifierConfig(**knobs)


@pytest.mark.parametrize("name", ["width", "channels", "views", "kinds", "members", "proxies", "steps"])
def test_a_config_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(InvalidOption):
        ClassifierConfig(**{name: 0})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("knobs", [{"share": 0.0}, {"share": 1.0}, {"unknown_table": -0.1}])
def test_shares_that_are_none_are_refused(knobs: dict) -> None:
    with pytest.raises(InvalidOption):
        ClassifierConfig(**knobs)


def test_a_handle_is_seen_by_fifteen_points_three_millimetres_beyond_the_body() -> None:
    T = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 0.2], [0, 0, 1, 0], [0, 0, 0, 1]])
    local = np.zeros((40, 3))
    for count, reach, seen in ((15, 0.0431, True), (14, 0.0431, False), (15, 0.0429, False)):
        local[:, 0], local[:count, 0] = 0.0, reach
        assert part_in_view(local @ T[:3, :3].T + T[:3, 3], T, 0.04) is seen


def test_examples_of_a_class_know_their_kind_and_what_they_may_be_taken_for(tmp_path: Path, monkeypatch) -> None:
    asked: list = []

    def views(category, split, **knobs):
        asked.append((category, split, knobs))
        points = np.asarray(make_shape("mug", 4).mesh.vertices)
        behind = points[points[:, 0] < 0]
        own = ObjectSource("mug-4", "mug", family="mug", seed=4)
        file = ObjectSource("some", "mug", path=tmp_path / "some.ply")
        return [
            View(source, seen, np.zeros(3), np.eye(4), "lying")
            for source, seen in ((own, points), (own, behind), (file, behind))
        ]

    monkeypatch.setattr(module, "cached_views", views)
    found = class_examples(
        "mug", "val", num_views=2, alike=("cup",), limit=3, data=tmp_path, workers=2, folder=tmp_path
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
    assert asked == [("mug", "val", knobs)]
    kind = make_shape("mug", 4).kind
    assert [(e.category, e.subcategory, e.answers, e.accepted, e.resting) for e in found] == [
        ("mug", kind, ("mug",), ("mug",), "lying"),
        ("mug", kind, ("mug", "cup"), ("mug", "cup"), "lying"),
        ("mug", "", ("mug",), ("mug", "cup"), "lying"),
    ]


def test_classes_are_alike_where_their_card_says_so() -> None:
    assert alike_in(("cup", "bottle", "mug"), "mug") == ("cup",)
    assert alike_in(("bottle", "mug"), "mug") == ()
    assert alike_in(("cup", "mug"), "teapot") == ()


def test_other_things_are_rendered_once_for_their_numbers(tmp_path: Path, monkeypatch) -> None:
    made: list = []

    def views(source, mesh, rng, *, num_views, config):
        made.append((source.name, source.category, len(mesh.vertices), rng.integers(10**6), num_views, config))
        points = np.full((3, 3), float(len(made)))
        return [View(source, points, np.zeros(3), np.eye(4), "upside_down")] * num_views

    monkeypatch.setattr(module, "views_of_mesh", views)
    for _ in range(2):
        found = assorted_examples([3, 8], num_members=2, num_views=2, folder=tmp_path)
    assert [(e.category, float(e.points[0, 0])) for e in found] == [
        (f"assorted-{kind}", value) for kind, value in ((3, 1), (3, 1), (3, 2), (3, 2), (8, 3), (8, 3), (8, 4), (8, 4))
    ]
    assert {(e.subcategory, e.answers == e.accepted == (e.category,), e.resting) for e in found} == {
        ("", True, "upside_down")
    }
    assert [(row[0], row[1], row[4], row[5]) for row in made] == [
        (f"assorted-{kind}-{member}", f"assorted-{kind}", 2, VIEWS) for kind in (3, 8) for member in (0, 1)
    ]
    assert made[3][3] == np.random.default_rng([8, 1]).integers(10**6)
    names = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.npz")}
    assert f"assorted/00008_001_2_{config_id(VIEWS)}.npz" in names
