"""What the proposal network learns from, how prototypes come about, and that training can be done again."""

import json

import numpy as np
import pytest
import torch

from gfp_grasp.detect import Look, ProposalNet, class_scores, mixture
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import make_assorted, make_shape, split_seeds
from gfp_grasp.train import Example, ProposalConfig, assorted_examples, class_examples, make_prototypes, train_proposal
from gfp_grasp.train.calibration import calibrate, embedded
from gfp_grasp.train.proposal_data import VIEWS, part_in_view
from gfp_grasp.train.prototypes import NUM_PROTOTYPES, cluster

CLASSES = ("bottle", "cup", "glass", "mug")


@pytest.fixture
def few_shapes(monkeypatch):
    monkeypatch.setattr(
        "gfp_grasp.train.views.split_seeds", lambda family, split, limit: split_seeds(family, split)[:3]
    )


@pytest.mark.parametrize("kind", range(24))
def test_an_assorted_thing_stands_on_the_table_and_is_the_same_for_its_numbers(kind):
    mesh, again, sibling = make_assorted(kind, 0), make_assorted(kind, 0), make_assorted(kind, 1)
    assert mesh.bounds[0, 2] == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(mesh.bounds.mean(axis=0)[:2], 0, atol=1e-9)
    assert mesh.is_volume
    np.testing.assert_array_equal(mesh.vertices, again.vertices)
    assert not np.allclose(mesh.extents, sibling.extents)
    assert 0.01 < mesh.extents.max() < 6


def test_members_of_a_kind_are_more_alike_than_kinds_of_one_maker():
    extents = np.log([[make_assorted(kind, member).extents for member in range(4)] for kind in range(0, 96, 12)])
    within = extents.std(axis=1).mean()
    assert extents.mean(axis=1).std(axis=0).mean() > 1.5 * within


def test_a_handle_behind_the_body_is_not_seen_and_one_at_the_side_is():
    mesh = make_shape("mug", split_seeds("mug", "val")[0]).mesh
    points, body_m = np.asarray(mesh.vertices), float(np.abs(mesh.vertices[:, 1]).max())
    assert part_in_view(points, np.eye(4), body_m)
    assert not part_in_view(points[points[:, 0] < 0], np.eye(4), body_m)


def test_cups_and_mugs_count_apart_only_where_a_handle_is_seen(tmp_path, few_shapes):
    def views(name: str) -> list[Example]:
        return class_examples(name, "val", num_views=2, classes=CLASSES, folder=tmp_path)

    cups, mugs, bottles = views("cup"), views("mug"), views("bottle")
    assert {e.answers for e in mugs} <= {("mug",), ("mug", "cup", "glass")}
    assert {(e.answers, e.accepted) for e in cups} == {(("cup",), ("cup", "mug", "glass"))}
    assert {e.accepted for e in bottles} == {("bottle",)}
    again = views("cup")  # from the cache, which keeps float32
    np.testing.assert_allclose(again[0].points, cups[0].points, atol=1e-6)


def test_the_points_of_an_example_fill_the_box_in_which_their_object_is_placed(tmp_path, few_shapes):
    for name in ("mug", "bottle"):
        examples = class_examples(name, "val", num_views=3, classes=CLASSES, folder=tmp_path)
        assert {e.resting for e in examples} >= {"upright"}
        for example in examples:
            placed = example.placed
            assert placed is not None
            local = (example.points - placed.centre) @ placed.R / placed.extents
            low, high = np.quantile(local, (0.05, 0.95), axis=0)  # without pixels that fly behind edges
            assert max(-low.min(), high.max()) < 0.58
            assert (high - low).max() > 0.6  # along one axis at least the box is filled
            assert np.linalg.norm(example.viewpoint - placed.centre) > 0.3


def test_assorted_views_are_of_their_own_kinds_and_above_the_table(tmp_path):
    examples = assorted_examples(0, 3, num_members=2, num_views=1, folder=tmp_path)
    assert {e.category for e in examples} == {"assorted-4", "assorted-5", "assorted-6"}
    assert {e.placed for e in examples} == {None}
    assert min(np.median(e.points[:, 2]) for e in examples) > 0
    assert max(len(e.points) for e in examples) < 2 * VIEWS.num_points


def test_large_things_are_seen_as_well_as_small_ones(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "gfp_grasp.train.views.split_seeds", lambda family, split, limit: split_seeds(family, split)[:1]
    )
    examples = class_examples("pedestrian", "val", num_views=3, classes=CLASSES, folder=tmp_path)
    assert len(examples) == 3
    for example in examples:
        assert example.placed is not None
        tall_m = example.placed.extents[2]
        assert tall_m > 0.8
        assert np.ptp(example.points, axis=0).max() > 0.3 * tall_m
        assert example.resting == "upright"


def test_clusters_are_the_middles_of_what_lies_together():
    rng = np.random.default_rng(0)
    middles = np.eye(6)[:3]
    views = np.repeat(middles, 40, axis=0) + rng.normal(scale=0.01, size=(120, 6))
    found = cluster(views / np.linalg.norm(views, axis=1, keepdims=True), count=3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    np.testing.assert_allclose(found[found.argmax(axis=0)[:3]], middles, atol=0.01)
    np.testing.assert_array_equal(cluster(views[:2]), views[:2])


def test_prototypes_are_unit_vectors_of_what_members_look_like():
    network = ProposalNet(8, width=8).eval()
    primitive = PrimitiveLibrary.shipped().primitive(CLASSES[0])
    few = make_prototypes(primitive, network=network, num_views=4)
    np.testing.assert_allclose(np.linalg.norm(few, axis=1), 1)
    assert len(few) <= NUM_PROTOTYPES
    np.testing.assert_array_equal(few, make_prototypes(primitive, network=network, num_views=4))


class _SizeOnly(ProposalNet):
    """Embeds a cloud as the angle that is the logarithm of its size."""

    def forward(self, features: torch.Tensor) -> Look[torch.Tensor]:
        angle, axes = features[:, 0, 10], torch.zeros(len(features), 3)
        return Look(torch.stack([angle.cos(), angle.sin()], dim=1), axes, axes, axes, axes, axes)


def _things(scale: float, name: str) -> list[Example]:
    points = scale * (np.random.default_rng(0).normal(size=(200, 3)) + np.array([0, 0, 4]))
    return [Example(points, np.array([9.0, 0.0, 9.0]), name, "", (name,), (name,), "upright", None)] * 4


def test_calibration_is_sure_of_what_is_told_apart_and_unsure_of_the_rest():
    network, known, unknown = _SizeOnly(2, width=2), _things(0.025, "a"), _things(0.6, "other")
    prototypes = {"a": mixture([np.array([[1.0, 0.0]])], [1.0]), "b": mixture([np.array([[0.0, 1.0]])], [1.0])}
    found = calibrate(network, prototypes, known, unknown)
    of_known = class_scores(embedded(network, known)[0], prototypes, found)
    of_unknown = class_scores(embedded(network, unknown)[0], prototypes, found)
    assert of_known["a"] > 0.95
    assert of_unknown["a"] == pytest.approx(0.5, abs=0.05)


@pytest.mark.slow
def test_training_runs_resumes_and_leaves_weights_with_a_card(tmp_path, few_shapes):
    config = ProposalConfig(steps=6, batch=8, width=8, channels=8, views=1, kinds=10, members=1)
    metrics = train_proposal(config, classes=CLASSES, out=tmp_path / "out", cache=tmp_path)
    first = (tmp_path / "out" / "proposal.safetensors").read_bytes()
    card = json.loads((tmp_path / "out" / "proposal.json").read_text(encoding="utf-8"))
    assert card["metrics"] == metrics
    assert card["data"]["classes"] == list(CLASSES)
    assert metrics["test_views"] == len(CLASSES) * 3 * 4
    assert {"accuracy", "temperature", "reach", "up_deg", "front_deg", "size_error"} < set(metrics)
    again = train_proposal(config, classes=CLASSES, out=tmp_path / "out", cache=tmp_path)  # from the last checkpoint
    assert metrics == again
    assert (tmp_path / "out" / "proposal.safetensors").read_bytes() == first


@pytest.mark.parametrize("wrong", [{"views": 0}, {"share": 1.0}, {"unknown_table": 1.5}, {"unknown_viewpoint": -0.5}])
def test_nonsense_in_a_training_config_is_refused(wrong):
    with pytest.raises(InvalidOption):
        ProposalConfig(**wrong)
