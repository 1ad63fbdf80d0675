"""Classes are known by prototypes: what scores follow from them, for whatever classes a library has."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gfp_grasp.detect import (
    Calibration,
    Prototypes,
    class_scores,
    classify,
    distance_in,
    look,
    mixture,
    scores_in,
    shares_in,
)
from gfp_grasp.detect import classifier as module
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.types import LIDAR, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
TABLE = SupportPlane(UP, 0.0)
CALIBRATION = Calibration(temperature=0.05, reach=0.3)


def _unit(rng: np.random.Generator, *shape: int) -> np.ndarray:
    vectors = rng.normal(size=shape)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _one(vector: np.ndarray) -> Prototypes:
    return mixture([vector[None]], [1.0])


def test_the_class_of_the_prototype_at_the_object_gets_the_score():
    a, b = np.eye(4)[:2]
    scores = class_scores(a, {"a": _one(a), "b": _one(b)}, CALIBRATION)
    floor = np.exp(-0.3 / 0.05)
    far = floor + np.exp(-1 / 0.05)
    assert scores["a"] == pytest.approx((1 + floor) / (1 + floor + far))
    assert sum(scores.values()) == pytest.approx(1.0)


def test_equal_prototypes_have_equal_scores():
    rng = np.random.default_rng(0)
    own = mixture([_unit(rng, 5, 8)], [1.0])
    scores = class_scores(_unit(rng, 8), {"a": own, "b": own, "c": own}, CALIBRATION)
    assert list(scores.values()) == pytest.approx([1 / 3] * 3)


def test_what_is_far_from_all_classes_gets_an_even_spread():
    prototypes = {"a": _one(np.eye(4)[0]), "b": _one(np.array([0.6, 0.8, 0, 0]))}
    scores = class_scores(-np.eye(4)[0], prototypes, CALIBRATION)
    assert scores["a"] == pytest.approx(0.5, abs=1e-5)


def test_the_order_of_prototypes_says_nothing():
    rng = np.random.default_rng(1)
    own, other, thing = _unit(rng, 6, 8), _unit(rng, 3, 8), _unit(rng, 8)
    first = class_scores(thing, {"a": mixture([own], [1.0]), "b": mixture([other], [1.0])}, CALIBRATION)
    turned = mixture([own[::-1]], [1.0])
    assert class_scores(thing, {"a": turned, "b": mixture([other], [1.0])}, CALIBRATION) == pytest.approx(first)


def test_subcategories_count_by_their_share():
    whole, part = np.eye(3)[:1], np.eye(3)[1:]
    own = mixture([whole, part], [0.8, 0.4])
    np.testing.assert_allclose(own.weights, [2 / 3, 1 / 6, 1 / 6])
    np.testing.assert_array_equal(own.vectors, np.eye(3))


class _Toy:
    def __init__(self, **values):
        self.__dict__.update(values)


def test_shares_within_a_class_go_by_prototypes_and_far_from_all_by_the_share_of_each(monkeypatch):
    axes = np.eye(4)
    card = {"prototypes_sha256": "this"}
    cups: Any = [
        _Toy(name="cup", spec=SimpleNamespace(share=0.8), prototypes=axes[:1], card=card),
        _Toy(name="cup.lidded", spec=SimpleNamespace(share=0.4), prototypes=axes[1:3], card=card),
    ]
    monkeypatch.setattr(module, "load_card", lambda: {"sha256": "this"})
    monkeypatch.setattr(module, "load_calibration", lambda: CALIBRATION)
    floor = np.exp(-0.3 / 0.05)
    lid = (1 / 6) ** 0.5 * (1 + np.exp(-1 / 0.05)) + floor / 3
    cup = (2 / 3) ** 0.5 * np.exp(-1 / 0.05) + floor * 2 / 3
    at_lid = np.array([0.0, 1.0, 0.0, 0.0])
    expected = {"cup": pytest.approx(cup / (lid + cup)), "cup.lidded": pytest.approx(lid / (lid + cup))}
    assert shares_in(at_lid, cups) == expected
    assert shares_in(-axes[:3].sum(axis=0) / 3**0.5, cups)["cup.lidded"] == pytest.approx(1 / 3, abs=1e-5)
    cups[1].card = {"prototypes_sha256": "another"}
    assert shares_in(at_lid, cups) == {"cup": pytest.approx(2 / 3), "cup.lidded": pytest.approx(1 / 3)}


def test_scores_of_the_others_keep_their_order_when_a_class_is_added():
    rng = np.random.default_rng(2)
    known = {name: mixture([_unit(rng, 4, 8)], [1.0]) for name in "abc"}
    thing = _unit(rng, 8)
    before = class_scores(thing, known, CALIBRATION)
    after = class_scores(thing, {**known, "new": _one(thing)}, CALIBRATION)
    assert after["new"] == max(after.values())
    for name in "ab":
        assert after[name] / after["c"] == pytest.approx(before[name] / before["c"])


def _standing_tube(rng: np.random.Generator) -> np.ndarray:
    angle, z = rng.uniform(0, np.pi, 900), rng.uniform(0.01, 0.12, 900)
    return np.column_stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), z])


def test_an_added_class_takes_part_without_training(tmp_path):
    points = _standing_tube(np.random.default_rng(2))
    shipped = PrimitiveLibrary.shipped()
    donor = shipped.primitive(shipped.categories[0])
    new = replace(
        donor, category="tube", spec=None, prototypes=look(points, UP, TABLE).embedding[None], card={**donor.card}
    )
    save_primitive(new, tmp_path)
    library = PrimitiveLibrary.with_shipped(tmp_path)
    scores = classify(points, UP, TABLE, library=library)
    assert set(scores) == {*shipped.categories, "tube"}
    assert scores["tube"] == max(scores.values()) > 0.5
    assert set(classify(points, UP, TABLE)) == set(shipped.categories)


def test_prototypes_of_another_network_are_refused_with_the_command_that_helps(tmp_path):
    shipped = PrimitiveLibrary.shipped()
    donor = shipped.primitive(shipped.categories[0])
    save_primitive(
        replace(donor, category="tube", spec=None, card={**donor.card, "prototypes_sha256": "0" * 64}), tmp_path
    )
    with pytest.raises(UnreadableFile, match="gps prototypes --gps"):
        classify(_standing_tube(np.random.default_rng(3)), UP, TABLE, library=PrimitiveLibrary(tmp_path))


def test_to_a_lidar_the_classes_are_those_of_its_own_network_and_those_that_do_not_ship(
    monkeypatch: pytest.MonkeyPatch, tmp_path
):
    """A car looks like one of the network's cars; cups take no part; a user's class is what nothing is like."""
    library = PrimitiveLibrary.shipped()
    card = {"config": {"channels": 4}, "metrics": {"temperature": 0.05, "reach": 0.3}}
    monkeypatch.setattr(module, "load_card", lambda weights="proposal": card)
    monkeypatch.setattr(module, "load_prototypes", lambda weights: {"car": np.eye(4)[:2], "bus": np.eye(4)[2:3]})
    scores = scores_in(np.eye(4)[1], library, LIDAR)
    assert set(scores) == {"car", "bus"}
    assert scores["car"] > 0.99
    assert distance_in(np.array([0.6, 0, 0.8, 0]), library, LIDAR) == pytest.approx(0.2)
    car = library.primitive("car")
    save_primitive(replace(car, category="tractor", spec=None), tmp_path)
    own = PrimitiveLibrary.with_shipped(tmp_path)
    scores = scores_in(np.eye(4)[3], own, LIDAR)
    assert list(scores.values()) == pytest.approx([1 / 3] * 3, abs=1e-4)
    assert scores_in(np.eye(4)[0], own, LIDAR)["tractor"] < 0.01
    shares = shares_in(np.eye(4)[0], library.members_of("car"), LIDAR)
    stated = np.array([p.spec.share for p in library.members_of("car")])
    assert list(shares.values()) == pytest.approx((stated / stated.sum()).tolist())
