"""The shipped classifier: what does not change its answer, and what it knows."""

import hashlib
import json

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.assets import data_file
from gfp_grasp.bench.detection import name_capture
from gfp_grasp.bench.finding import match_pictures, table_pictures
from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.detect import DETECTORS, classify, clean_cloud, detect_single
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import make_shape, split_seeds
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


def test_scores_are_probabilities_of_the_classes_of_the_library(bottle):
    scores = classify(bottle, UP, TABLE)
    assert tuple(scores) == PrimitiveLibrary.shipped().categories
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


@pytest.mark.parametrize("name", ["learn0", "learn20", "learn35", "test50"])
def test_labelled_objects_on_kinect_table_tops_are_matched(name):
    tables = [table for table in table_pictures(real_data.folder()) if table.name == f"table_{name}"]
    figures = match_pictures(tables, DETECTORS["tabletop"])
    assert figures["matched"] == figures["objects"] > 1


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
