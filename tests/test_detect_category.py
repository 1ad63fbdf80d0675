"""The classifier and its training: what does not change its answer, what it knows, and that it can be made again."""

import hashlib
import json

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.assets import data_file
from gfp_grasp.bench.detection import MATCH_IOU, best_iou, match_table, name_capture, name_views
from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.detect import classify, clean_cloud, detect_single
from gfp_grasp.errors import InvalidOption
from gfp_grasp.shapes import FAMILIES, make_shape, split_seeds
from gfp_grasp.train.classifier import ClassifierConfig, train_classifier
from gfp_grasp.train.classifier_data import VIEWS, _handle_is_seen, family_examples, foreign_examples
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
TABLE = SupportPlane(UP, 0.0)


def _view(mesh: trimesh.Trimesh, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image, index = render_mesh_view(
        [mesh],
        T_world_camera=sample_viewpoint(rng),
        K=intrinsics(160, 120, 35.0),
        width=160,
        height=120,
        table_height=0.0,
    )
    points = cloud_of(apply_sensor(image, SensorModel.gaussian(0.001), rng), index == 0).points
    return points[points[:, 2] > 0.006]


@pytest.fixture(scope="module")
def bottle() -> np.ndarray:
    return _view(make_shape("bottle", split_seeds("bottle", "test")[0]).mesh, 0)


def test_scores_are_probabilities_of_the_families(bottle):
    scores = classify(bottle, UP, TABLE)
    assert tuple(scores) == FAMILIES
    assert sum(scores.values()) == pytest.approx(1.0)
    assert min(scores.values()) >= 0


def test_the_same_points_have_the_same_scores(bottle):
    assert classify(bottle, UP, TABLE) == classify(bottle, UP, TABLE)


@pytest.mark.parametrize("family", ["cup", "bottle"])
def test_upright_test_shapes_are_named(family):
    shapes = [make_shape(family, seed) for seed in split_seeds(family, "test")[:8]]
    named = [max(s := classify(_view(shape.mesh, k), UP, TABLE), key=lambda n: s[n]) for k, shape in enumerate(shapes)]
    assert sum(name == family for name in named) >= 7


def test_the_answer_moves_with_the_scene(bottle):
    T = make_T(rotation_about((1.0, 2.0, 0.5), 1.1), (0.4, -0.2, 0.7))
    normal = T[:3, :3] @ UP
    here = classify(bottle, UP, TABLE)
    there = classify(apply_T(T, bottle), normal, SupportPlane(normal, float(normal @ T[:3, 3])))
    assert max(here, key=lambda n: here[n]) == max(there, key=lambda n: there[n])
    assert max(abs(here[name] - there[name]) for name in here) < 0.15  # the yaw that is left is not the same


def test_weights_are_those_of_their_card():
    card = json.loads(data_file("weights", "classifier.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(data_file("weights", "classifier.safetensors").read_bytes()).hexdigest() == card["sha256"]
    assert card["metrics"]["accuracy"] >= 0.9
    assert card["metrics"]["mean_top_score_foreign"] < card["metrics"]["mean_top_score"] - 0.2


def test_a_handle_behind_the_body_is_not_seen_and_one_at_the_side_is():
    seed = split_seeds("mug", "val")[0]
    mesh = make_shape("mug", seed).mesh
    points = np.asarray(mesh.vertices)
    assert _handle_is_seen(points, np.eye(4), seed)
    assert not _handle_is_seen(points[points[:, 0] < 0], np.eye(4), seed)


def test_cups_and_mugs_count_apart_only_where_a_handle_is_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "gfp_grasp.train.views.split_seeds", lambda family, split, limit: split_seeds(family, split)[:3]
    )
    examples = family_examples("val", num_views=2, folder=tmp_path)
    assert {e.answers for e in examples if e.category == "mug"} <= {("mug",), ("cup", "mug")}
    assert {e.answers for e in examples if e.category == "cup"} == {("cup",)}
    assert {e.accepted for e in examples if e.category == "cup"} == {("cup", "mug")}
    assert {e.answers for e in examples if e.category == "bottle"} == {("bottle",)}
    again = family_examples("val", num_views=2, folder=tmp_path)  # from the cache, which keeps float32
    np.testing.assert_allclose(again[0].points, examples[0].points, atol=1e-6)
    figures = name_views(examples)
    assert figures["views"] == len(examples)


@pytest.mark.slow
def test_training_runs_resumes_and_leaves_weights_with_a_card(tmp_path, monkeypatch):
    monkeypatch.setattr(
        "gfp_grasp.train.views.split_seeds", lambda family, split, limit: split_seeds(family, split)[:4]
    )
    config = ClassifierConfig(steps=6, batch=8, width=8, views=1, foreign=8)
    metrics = train_classifier(config, out=tmp_path / "out", cache=tmp_path)
    first = (tmp_path / "out" / "classifier.safetensors").read_bytes()
    assert metrics["test_views"]
    assert metrics == train_classifier(config, out=tmp_path / "out", cache=tmp_path)  # from the last checkpoint
    assert (tmp_path / "out" / "classifier.safetensors").read_bytes() == first


def test_foreign_things_stand_on_the_table_and_are_the_same_for_a_seed(tmp_path):
    examples = foreign_examples(12, seed=3, folder=tmp_path)
    assert len(examples) >= 10
    assert all(e.answers == () and np.median(e.points[:, 2]) > 0 for e in examples)
    assert max(len(e.points) for e in examples) <= VIEWS.num_points


def test_nonsense_in_a_training_config_is_refused():
    with pytest.raises(InvalidOption):
        ClassifierConfig(views=0)


@pytest.mark.parametrize("name", ["learn0", "learn20", "learn35", "test50"])
def test_labelled_objects_on_kinect_table_tops_are_matched(name):
    figures = match_table(real_data.folder() / "captures" / f"table_{name}.npz")
    assert figures["matched"] == figures["objects"]


def test_the_overlap_of_a_mask_with_nothing_is_zero():
    assert best_iou(np.ones((2, 2), bool), ()) == 0.0
    assert 0 < MATCH_IOU < 1


@pytest.mark.parametrize(("name", "category"), [("mug_red", "mug"), ("bottle_mustard", "bottle")])
def test_real_captures_are_one_object_of_the_right_class(name, category):
    path = real_data.folder() / "captures" / f"{name}.npz"
    figures = name_capture(path)
    assert figures["detections"] == 1
    assert figures["category"] == category
    with np.load(path) as capture:
        points = clean_cloud(capture["object_points_cam"])
        view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
    detection = detect_single(points, up=None, view=view)
    assert detection.category == category
    assert detection.support is not None
    alone = detect_single(points, up=None)  # no table: the direction is chosen by how it looks
    assert alone.support is None
    assert alone.up @ detection.up > np.cos(np.radians(40))
