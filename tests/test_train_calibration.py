"""How the classifier is calibrated and measured, and what a class is known by, to the number."""

import hashlib
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from moments import assert_known
from toy_examples import EXAMPLES, example

from gfp_grasp.detect import Calibration, Look, ProposalNet, Prototypes, look, mixture
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import make_shape
from gfp_grasp.train import (
    Example,
    ProposalConfig,
    above_table,
    calibration,
    make_prototypes,
    proposal,
    prototypes,
    with_prototypes,
)
from gfp_grasp.train.calibration import calibrate, embedded, measure
from gfp_grasp.train.proposal import _loss, _pose_loss, _prototypes, _WithProxies
from gfp_grasp.train.proposal_data import TABLE, UP, VIEWS
from gfp_grasp.train.prototypes import _member, cluster
from gfp_grasp.train.views import views_of_mesh

LIBRARY = PrimitiveLibrary.shipped()


class _Still(ProposalNet):
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
        Example(np.zeros((1, 3)), np.ones(3), own[0], "", own, right, rest, None)
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
    network = ProposalNet(8, width=8).eval()
    found = embedded(network, EXAMPLES)
    assert found.shape == (5, 8)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-6)
    for view in EXAMPLES:  # each alone is sampled as it is in use
        seen = look(above_table(view), UP, TABLE, viewpoint=view.viewpoint, network=network)
        np.testing.assert_allclose(embedded(network, [view])[0], seen.embedding, atol=1e-5)
    assert_known("embedded", found, rel=1e-3)
    assert_known("embedded without a table", embedded(network, EXAMPLES, table_known=False), rel=1e-3)


def test_only_where_the_table_is_unknown_it_does_not_matter_how_high_things_are() -> None:
    torch.manual_seed(0)
    network = ProposalNet(8, width=8).eval()
    low = [example(seed, "cup", low=0.01) for seed in range(3)]
    rise = np.array([0.0, 0.0, 0.2])
    high = [replace(view, points=view.points + rise, viewpoint=view.viewpoint + rise) for view in low]
    known, blind = (
        np.linalg.norm(embedded(network, low, table_known=t) - embedded(network, high, table_known=t), axis=1)
        for t in (True, False)
    )
    assert known.min() > 0.03
    assert blind.max() < 1e-5


def test_clusters_and_prototypes_are_those_of_old() -> None:
    rng = np.random.default_rng(0)
    views = _unit(rng.normal(size=(90, 6)).tolist())
    assert_known("cluster", cluster(views))
    assert_known("cluster of four", cluster(views, count=4, seed=2))
    torch.manual_seed(0)
    network = ProposalNet(8, width=8).eval()
    mug = LIBRARY.primitive("mug")
    assert_known("prototypes", make_prototypes(mug, network=network, num_views=5, seed=1), rel=1e-3)
    meshes = [make_shape("mug", seed).mesh for seed in (0, 1)]
    assert_known("prototypes of meshes", make_prototypes(mug, meshes=meshes, network=network, num_views=3), rel=1e-3)
    member = _member(mug, 5)
    row = mug.coefficient_samples[5]
    np.testing.assert_allclose(member.vertices, mug.shape(row[:-3], np.exp(row[-3:])))


@pytest.mark.parametrize(
    ("rests", "commonest"),
    [
        ({"upright": 1.0}, "upright"),
        ({"upright": 0.97, "upside_down": 0.03}, "upright"),
        ({"upright": 0.3, "lying": 0.7}, "lying"),
        ({"upside_down": 0.01, "lying": 0.09, "upright": 0.9}, "upright"),
    ],
)
@pytest.mark.parametrize("from_meshes", [False, True])
def test_prototypes_are_of_members_as_they_rest_and_of_no_others(
    monkeypatch, rests: dict[str, float], commonest: str, from_meshes: bool
) -> None:
    shown: list[str] = []

    def views(*args, **knobs):
        found = views_of_mesh(*args, **knobs)
        shown.extend(view.resting for view in found)
        return found

    monkeypatch.setattr(prototypes, "views_of_mesh", views)
    monkeypatch.setattr(prototypes, "VIEWS", replace(VIEWS, fallen_share=0.3, width=80, height=60, hidden_share=0.0))
    mug = LIBRARY.primitive("mug")
    mug = replace(mug, spec=replace(mug.spec, rests=rests))
    meshes = [make_shape("mug", seed).mesh for seed in (0, 1)] if from_meshes else None
    make_prototypes(mug, meshes=meshes, network=ProposalNet(8, width=8).eval(), num_views=24)
    assert len(shown) == 24
    assert set(shown) == set(rests)
    assert max(rests, key=shown.count) == commonest


def test_a_card_names_the_weights_that_its_prototypes_are_of(monkeypatch, tmp_path: Path) -> None:
    (tmp_path / "proposal.safetensors").write_bytes(b"weights")
    asked: list = []

    def made(primitive, *, meshes, seed):
        asked.append((primitive.name, meshes, seed))
        return np.eye(2) * seed

    monkeypatch.setattr(prototypes, "make_prototypes", made)
    monkeypatch.setattr(prototypes, "data_file", lambda folder, name: {"weights": tmp_path}[folder] / name)
    mug = LIBRARY.primitive("mug")
    found = with_prototypes(mug, meshes=[], seed=7)
    assert asked == [("mug", [], 7)]
    assert found.card == {**mug.card, "prototypes_sha256": hashlib.sha256(b"weights").hexdigest()}
    np.testing.assert_array_equal(found.prototypes, np.eye(2) * 7)


def test_prototypes_of_the_shipped_classes_are_of_the_shipped_weights(monkeypatch) -> None:
    monkeypatch.setattr(prototypes, "make_prototypes", lambda primitive, *, meshes, seed: np.eye(2))
    mug = LIBRARY.primitive("mug")
    assert with_prototypes(mug).card["prototypes_sha256"] == mug.card["prototypes_sha256"]


def test_prototypes_of_a_class_are_from_at_most_four_hundred_of_its_views(monkeypatch) -> None:
    monkeypatch.setattr(proposal, "cluster", lambda views, *, seed: (views, seed)[0])
    rows: list = []
    monkeypatch.setattr(proposal, "embedded", lambda network, own: (rows.append(len(own)), np.ones((2, 2)))[1])
    many = [SimpleNamespace(category=name) for name in ["a"] * 400 + ["b"] * 401 + ["c"] * 3]
    found = _prototypes(ProposalNet(2, width=2), many, 0)  # pyright: ignore[reportArgumentType]
    assert (list(found), rows) == (["a", "b", "c"], [400, 201, 3])
    np.testing.assert_allclose(found["a"].weights, 0.5)


def _look(embedding: torch.Tensor) -> Look[torch.Tensor]:
    axes = torch.zeros(len(embedding), 3)
    return Look(embedding, axes, axes, axes, axes, axes)


class _Along(ProposalNet):
    """Embeds everything along the first axis."""

    def forward(self, features: torch.Tensor) -> Look[torch.Tensor]:
        return _look(torch.tensor([[1.0, 0.0]]).expand(len(features), 2))


def test_logits_of_a_class_gather_those_of_its_kinds_and_their_proxies() -> None:
    torch.manual_seed(1)
    config = ProposalConfig(width=4, channels=2, proxies=2)
    network = _WithProxies(config, torch.tensor([0, 1, 0]))
    assert network.log_sharpness.item() == pytest.approx(2.7)
    assert network.proxies.shape == (3, 2, 2)
    angles = torch.tensor([[0.0, 0.3], [2.0, 2.5], [-1.0, -1.5]])
    network.proxies.data = 3 * torch.stack([angles.cos(), angles.sin()], dim=2)
    network.network = _Along(2, width=2)
    classes, kinds, seen = network(torch.zeros(2, 5, 12))
    wanted = torch.logsumexp(math.exp(2.7) * angles.cos(), dim=1)
    torch.testing.assert_close(kinds[0], wanted)
    torch.testing.assert_close(classes[1], torch.stack([torch.logsumexp(wanted[[0, 2]], 0), wanted[1]]))
    torch.testing.assert_close(seen.embedding, torch.tensor([[1.0, 0.0]] * 2))


@pytest.mark.parametrize("pose_weight", [0.0, 0.5, 2.0])
def test_the_loss_smooths_classes_asks_for_a_kind_only_where_it_is_known_and_adds_the_pose(pose_weight: float) -> None:
    classes, kinds = torch.tensor([[2.0, 0.0], [0.0, 1.0]]), torch.tensor([[1.0, 0, 0], [5.0, 0, 0]])
    target = torch.tensor([[1.0, 0.0], [0.5, 0.5]])
    seen = _look(torch.eye(2))
    truth = torch.tensor([0, 2]), torch.ones(2, 6, 3), torch.rand(2, 3, 3)
    batch = torch.zeros(2), target, torch.tensor([0, -1]), *truth
    value = _loss(lambda clouds: (classes, kinds, seen), batch, ProposalConfig(pose_weight=pose_weight))  # type: ignore[arg-type]
    smooth = 0.99 * target + 0.005
    by_class = -(smooth * classes.log_softmax(dim=1)).sum(dim=1).mean()
    by_kind = -kinds.log_softmax(dim=1)[0, 0]
    wanted = by_class + 0.2 * by_kind + pose_weight * _pose_loss(seen, *truth)
    assert value.item() == pytest.approx(wanted.item(), rel=1e-6)
