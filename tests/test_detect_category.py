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
from gfp_grasp.types import DepthImage, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
TABLE = SupportPlane(UP, 0.0)


def _view(mesh: trimesh.Trimesh, seed: int) -> PointCloud:
    """What a camera sees of a thing on the table, without what cannot be told from the table."""
    rng = np.random.default_rng(seed)
    image, index = render_mesh_view(
        [mesh],
        T_world_camera=sample_viewpoint(rng),
        K=intrinsics(160, 120, 35.0),
        width=160,
        height=120,
        table_height=0.0,
    )
    cloud = cloud_of(apply_sensor(image, SensorModel.gaussian(0.001), rng), index == 0)
    return PointCloud(cloud.points[cloud.points[:, 2] > 0.006], cloud.viewpoint)


@pytest.fixture(scope="module")
def bottle() -> PointCloud:
    return _view(make_shape("bottle", split_seeds("bottle", "test")[0]).mesh, 0)


def test_scores_are_probabilities_of_the_classes_of_the_library(bottle):
    scores = classify(bottle.points, UP, TABLE)
    assert tuple(scores) == PrimitiveLibrary.shipped().categories
    assert sum(scores.values()) == pytest.approx(1.0)
    assert min(scores.values()) >= 0


@pytest.mark.parametrize("known", [True, False])
def test_the_same_points_have_the_same_scores(bottle, known):
    eye = bottle.viewpoint if known else None
    assert classify(bottle.points, UP, TABLE, viewpoint=eye) == classify(bottle.points, UP, TABLE, viewpoint=eye)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("family", "alike"),
    [("cup", {"cup", "mug", "glass", "wine_glass"}), ("bottle", {"bottle", "flask", "jar", "spray_bottle"})],
)
def test_upright_test_shapes_are_named_or_taken_for_what_they_are_like(family, alike, known):
    named = []
    for k, seed in enumerate(split_seeds(family, "test")[:8]):
        view = _view(make_shape(family, seed).mesh, k)
        scores = classify(view.points, UP, TABLE, viewpoint=view.viewpoint if known else None)
        named.append(max(scores, key=lambda name: scores[name]))
    assert sum(name in alike for name in named) >= 6


@pytest.mark.parametrize(("known", "most"), [(True, 1e-3), (False, 0.15)])
def test_the_answer_moves_with_the_scene(bottle, known, most):
    T = make_T(rotation_about((1.0, 2.0, 0.5), 1.1), (0.4, -0.2, 0.7))
    normal = T[:3, :3] @ UP
    moved = SupportPlane(normal, float(normal @ T[:3, 3]))
    here = classify(bottle.points, UP, TABLE, viewpoint=bottle.viewpoint if known else None)
    eye = apply_T(T, bottle.viewpoint) if known else None
    there = classify(apply_T(T, bottle.points), normal, moved, viewpoint=eye)
    assert max(here, key=lambda n: here[n]) == max(there, key=lambda n: there[n])
    # Where nobody knows the viewpoint, the yaw that is left is not the same.
    assert max(abs(here[name] - there[name]) for name in here) < most


def test_weights_are_those_of_their_card():
    card = json.loads(data_file("weights", "proposal.json").read_text(encoding="utf-8"))
    assert hashlib.sha256(data_file("weights", "proposal.safetensors").read_bytes()).hexdigest() == card["sha256"]
    assert card["metrics"]["accuracy_by_rest"]["upright"] >= 0.9
    assert card["metrics"]["mean_top_score_foreign"] < card["metrics"]["mean_top_score"] - 0.2


@pytest.mark.parametrize("name", ["learn0", "learn20", "learn35", "test50"])
def test_labelled_objects_on_kinect_table_tops_are_matched(name):
    tables = [table for table in table_pictures(real_data.folder()) if table.name == f"table_{name}"]
    figures = match_pictures(tables, DETECTORS["tabletop"])
    assert figures["matched"] == figures["objects"] > 1


@pytest.mark.parametrize(("name", "right"), [("mug_red", {"mug"}), ("bottle_mustard", {"bottle", "spray_bottle"})])
def test_real_captures_are_one_object_of_the_right_class(name, right):
    path = real_data.folder() / "captures" / f"{name}.npz"
    figures = name_capture(path)
    assert figures["detections"] == 1
    assert figures["category"] in right
    with np.load(path) as capture:
        points = clean_cloud(capture["object_points_cam"])
        view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
    detection = detect_single(points, up=None, view=view)
    assert detection.category in right
    assert detection.support is not None
    alone = detect_single(points, up=None)  # no table: the direction is chosen by how it looks
    assert alone.support is None
    assert alone.up @ detection.up > np.cos(np.radians(40))
