"""How the classifier is calibrated and measured, and what a class is known by, to the number."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from moments import assert_known
from toy_examples import EXAMPLES, example

from gfp_grasp.detect import Calibration, EmbeddingNet, Prototypes, mixture
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import make_shape
from gfp_grasp.train import ClassifierConfig, calibration, classifier
from gfp_grasp.train.calibration import calibrate, embedded, measure
from gfp_grasp.train.classifier import (
    _loss,
    _member,
    _prototypes,
    _WithProxies,
    cluster,
    make_prototypes,
    with_prototypes,
)
from gfp_grasp.train.classifier_data import (
    Example,
)

LIBRARY = PrimitiveLibrary.shipped()


class _Still(EmbeddingNet):
    """Embeds nothing: the tests say what the embeddings are."""


def _bells() -> dict[str, Prototypes]:
    a, b = np.array([[1.0, 0, 0], [0.8, 0.6, 0]]), np.array([[0.0, 0, 1.0]])
    return {"a": mixture([a], [1.0]), "b": mixture([b], [1.0])}


def _unit(rows: list) -> np.ndarray:
    values = np.array(rows, dtype=float)
    return values / np.linalg.norm(values, axis=1, keepdims=True)


def test_temperature_and_reach_are_those_of_the_smallest_loss(monkeypatch) -> None:
    network = _Still(3, width=2)
    known = [example(k, name, answers=answers) for k, (name, answers) in enumerate(
        [("a", ("a",)), ("a", ("a",)), ("b", ("b",)), ("b", ("b", "a")), ("a", ("a",))])]  # fmt: skip
    unknown = [example(9, "other")] * 3
    near = _unit([[1, 0.2, 0.3], [0.5, 0.6, 0.5], [0.2, 0.3, 1], [0.7, 0, 0.6], [0.4, 0, 0.7]])
    far = _unit([[-1, 0.2, 0.3], [0.1, 0.9, 0.4], [0.6, -0.7, 0.2]])
    monkeypatch.setattr(calibration, "embedded", lambda network, examples, **_: near if len(examples) == 5 else far)
    found = calibrate(network, _bells(), known, unknown)
    assert_known("calibration", [found.temperature, found.reach])


def test_accuracy_is_of_what_is_accepted_of_what_was_taught_and_by_rest(monkeypatch) -> None:
    rests = ("upright", "lying", "upright", "lying")
    answers = (("a",), ("a",), ("b",), ("b",))
    accepted = (("a",), ("a", "b"), ("b",), ("b",))
    test = [
        Example(np.zeros((1, 3)), own[0], "", own, right, rest)
        for own, right, rest in zip(answers, accepted, rests, strict=True)
    ]
    known = _unit([[1, 0, 0], [0, 0, 1], [1, 0, 0.2], [0, 0, 1]])
    blind = _unit([[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]])
    outside = [example(1, "other")]

    def embedding(network, examples, *, table_known=True):
        if examples is outside:
            return _unit([[0.5, 0, 0.5]])
        return known if table_known else blind

    monkeypatch.setattr(calibration, "embedded", embedding)
    found = measure(_Still(3, width=2), _bells(), Calibration(0.1, 0.5), test, outside)
    scores = [float(str(found.pop(name))) for name in ("mean_top_score", "mean_top_score_foreign")]
    assert_known("top scores", scores, rel=1e-4)
    assert found == {
        "test_views": 4,
        "accuracy": 0.75,
        "accuracy_named_as_taught": 0.5,
        "accuracy_by_rest": {"lying": 1.0, "upright": 0.5},
        "accuracy_table_unknown": 0.25,
    }


def test_embeddings_of_examples_are_those_of_old() -> None:
    torch.manual_seed(0)
    network = EmbeddingNet(8, width=8).eval()
    assert_known("embedded", embedded(network, EXAMPLES), rel=1e-3)
    assert_known("embedded without a table", embedded(network, EXAMPLES, table_known=False), rel=1e-3)


def test_clusters_and_prototypes_are_those_of_old(monkeypatch) -> None:
    rng = np.random.default_rng(0)
    views = _unit(rng.normal(size=(90, 6)).tolist())
    assert_known("cluster", cluster(views))
    assert_known("cluster of four", cluster(views, count=4, seed=2))
    torch.manual_seed(0)
    network = EmbeddingNet(8, width=8).eval()
    mug = LIBRARY.primitive("mug")
    assert_known("prototypes", make_prototypes(mug, network=network, num_views=5, seed=1), rel=1e-3)
    meshes = [make_shape("mug", seed).mesh for seed in (0, 1)]
    assert_known("prototypes of meshes", make_prototypes(mug, meshes=meshes, network=network, num_views=3), rel=1e-3)
    member = _member(mug, 5)
    row = mug.coefficient_samples[5]
    np.testing.assert_allclose(member.vertices, mug.shape(row[:-3], np.exp(row[-3:])))
    monkeypatch.setattr(classifier, "make_prototypes", lambda primitive, *, meshes, seed: np.eye(2) * seed)
    made = with_prototypes(mug, seed=7)
    assert made.card["prototypes_sha256"] == mug.card["prototypes_sha256"]
    np.testing.assert_array_equal(made.prototypes, np.eye(2) * 7)


def test_prototypes_of_a_class_are_from_at_most_four_hundred_of_its_views(monkeypatch) -> None:
    monkeypatch.setattr(classifier, "embedded", lambda network, own: np.array([[e, 1.0] for e in own.points]))
    monkeypatch.setattr(classifier, "cluster", lambda views, *, seed: (views, seed)[0])
    rows: list = []
    monkeypatch.setattr(classifier, "embedded", lambda network, own: (rows.append(len(own)), np.ones((2, 2)))[1])
    many = [SimpleNamespace(category=name) for name in ["a"] * 400 + ["b"] * 401 + ["c"] * 3]
    found = _prototypes(EmbeddingNet(2, width=2), many, 0)  # pyright: ignore[reportArgumentType]
    assert (list(found), rows) == (["a", "b", "c"], [400, 201, 3])
    np.testing.assert_allclose(found["a"].weights, 0.5)


class _Along(EmbeddingNet):
    """Embeds everything along the first axis."""

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return torch.tensor([[1.0, 0.0]]).expand(len(features), 2)


def test_logits_of_a_class_gather_those_of_its_kinds_and_their_proxies() -> None:
    torch.manual_seed(1)
    config = ClassifierConfig(width=4, channels=2, proxies=2)
    network = _WithProxies(config, torch.tensor([0, 1, 0]))
    assert network.log_sharpness.item() == pytest.approx(2.7)
    assert network.proxies.shape == (3, 2, 2)
    angles = torch.tensor([[0.0, 0.3], [2.0, 2.5], [-1.0, -1.5]])
    network.proxies.data = 3 * torch.stack([angles.cos(), angles.sin()], dim=2)
    network.embedding = _Along(2, width=2)
    classes, kinds = network(torch.zeros(2, 5, 8))
    wanted = torch.logsumexp(math.exp(2.7) * angles.cos(), dim=1)
    torch.testing.assert_close(kinds[0], wanted)
    torch.testing.assert_close(classes[1], torch.stack([torch.logsumexp(wanted[[0, 2]], 0), wanted[1]]))


def test_the_loss_smooths_classes_and_asks_for_a_kind_only_where_it_is_known() -> None:
    classes, kinds = torch.tensor([[2.0, 0.0], [0.0, 1.0]]), torch.tensor([[1.0, 0, 0], [5.0, 0, 0]])
    target = torch.tensor([[1.0, 0.0], [0.5, 0.5]])
    value = _loss(lambda clouds: (classes, kinds), (torch.zeros(2), target, torch.tensor([0, -1])), ClassifierConfig())  # type: ignore[arg-type]
    smooth = 0.99 * target + 0.005
    by_class = -(smooth * classes.log_softmax(dim=1)).sum(dim=1).mean()
    by_kind = -kinds.log_softmax(dim=1)[0, 0]
    assert value.item() == pytest.approx((by_class + 0.2 * by_kind).item(), rel=1e-6)
