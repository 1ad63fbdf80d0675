"""The bench of readiness, with completers whose answers are off by known amounts."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import box_part
from clocks import SteadyClock
from toy_completions import toy_image

from gfp_grasp.bench import ReadyConfig, bench_ready, ready, sights
from gfp_grasp.bench.ready import HIDDEN
from gfp_grasp.bench.ready_rows import SceneRow, ViewRow
from gfp_grasp.bench.sights import Sight, SightAnswer, answers_to, see_object, see_scene
from gfp_grasp.completers import CompletionInParts, Oracle
from gfp_grasp.completion import Completion
from gfp_grasp.errors import FitDiverged, InvalidMesh, InvalidOption, NothingDetected, UnknownCompleter
from gfp_grasp.metrics import visible_surface
from gfp_grasp.scenes import load_objects
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import CollisionMesh, CompletedShape, Detection, OrientedBox, PointCloud, SupportPlane

UP, ALONG = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
LOW, HIGH = np.array([0.1, -0.05, 0.0]), np.array([0.16, 0.03, 0.11])  # 60 x 80 x 110 mm, away from the origin


def box_completion(low: Any = LOW, high: Any = HIGH, *, turn: Any = None) -> Completion:
    """A box as a completion, nothing of it seen; turned about its middle by a rotation (3, 3)."""
    part, middle = box_part(list(low), list(high)), (np.asarray(low) + high) / 2
    if turn is not None:
        part = replace(part, vertices=(part.vertices - middle) @ turn.T + middle)
    mesh = trimesh.Trimesh(part.vertices, part.faces, process=False)
    cloud = PointCloud(np.random.default_rng(0).uniform(low, high, (50, 3)), np.array([0.7, 0.2, 0.5]))
    box = OrientedBox(np.eye(4), np.array([0.1, 0.2, 0.3]))
    detection = Detection(cloud, UP, SupportPlane(UP, 0.0), "", {}, box)
    shape = CompletedShape(mesh, np.zeros(8, dtype=bool), np.full(8, 0.001))
    return CompletionInParts(shape, detection, known_parts=CollisionMesh((part,), (0.0, 0.0, 0.0), "hull", 0.0))


def to_box_m(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distance (n,) of points outside of a box to it."""
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)


def on_box(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Many points of a box's surface."""
    mesh = trimesh.creation.box(bounds=[low, high])
    return trimesh.sample.sample_surface(mesh, 40_000, seed=1)[0]


def measured(completion: Completion) -> dict[str, Any]:
    """Figures of a completion whose truth is the box."""
    truth = visible_surface(trimesh.creation.box(bounds=[LOW, HIGH]), 8192, np.random.default_rng(1))
    return ready._figures(SightAnswer(completion, 0.25), truth, np.random.default_rng(2))


def test_the_distance_is_the_mean_of_both_ways_and_not_their_sum():
    low, high = LOW + UP * 0.3, HIGH + np.array([0.2, 0.1, 0.9])  # far away and larger, so that the ways differ
    to_answer, to_truth = (
        float(to_box_m(on_box(*a), *b).mean()) for a, b in (((LOW, HIGH), (low, high)), ((low, high), (LOW, HIGH)))
    )
    assert to_truth > 1.5 * to_answer
    figures = measured(box_completion(low, high))
    assert figures["chamfer_m"] == pytest.approx((to_answer + to_truth) / 2, rel=0.02)
    assert figures["seconds"] == 0.25


def test_the_truth_itself_is_as_far_as_two_samplings_of_it():
    assert 0.0001 < measured(box_completion())["chamfer_m"] < 0.002


def test_a_box_stands_and_one_on_its_edge_tips_onto_its_side():
    figures = measured(box_completion())
    assert (figures["stands"], figures["tilt_deg"]) == (True, pytest.approx(0.0, abs=0.1))
    leaning = measured(box_completion(turn=rotation_about((0, 1, 0), np.radians(40.0))))  # 29 degrees are its balance
    assert (leaning["stands"], leaning["tilt_deg"]) == (False, pytest.approx(50.0, abs=1.0))
    assert leaning["travel_m"] > 0.02


def test_a_floor_that_is_not_level_counts_as_tilt():
    up = rotation_about((0, 1, 0), np.radians(12.0)) @ UP  # what stands on this floor stands by 12 degrees askew
    turned = box_completion(turn=rotation_about((0, 1, 0), np.radians(12.0)))
    found = replace(turned.detection, up=up, support=SupportPlane(up, 0.0))
    figures = measured(replace(turned, detection=found))
    assert (figures["tilt_deg"], figures["stands"]) == (pytest.approx(12.0, abs=0.1), False)
    assert figures["travel_m"] < 0.001


def test_what_cannot_be_simulated_has_a_distance_and_says_why(monkeypatch):
    def refuse(*_, **__):
        raise InvalidMesh("a sliver")

    monkeypatch.setattr(ready, "check_file", refuse)
    figures = measured(box_completion())
    assert (figures["error"], "stands" in figures) == ("InvalidMesh", False)
    assert figures["chamfer_m"] < 0.002
    broken = SimpleNamespace(tilt_deg=np.inf, travel_m=np.inf, stands=False)
    monkeypatch.setattr(ready, "check_file", lambda *_, **__: (broken,))
    assert measured(box_completion())["error"] == "BrokeDown"
    assert ready._figures(SightAnswer(None, error="FitDiverged"), np.zeros((1, 3)), np.random.default_rng(0)) == {
        "error": "FitDiverged"
    }


def test_two_boxes_that_overlap_by_three_millimetres_do_so_until_the_scene_parts_them():
    beside = HIGH[0] - 0.003
    one, third = box_completion(), box_completion(LOW + 0.5 * ALONG, HIGH + 0.5 * ALONG)
    other = box_completion((beside, -0.02, 0.0), (beside + 0.05, 0.02, 0.07))
    answers = [SightAnswer(one), SightAnswer(third), SightAnswer(other)]
    row = ready._scene_row(4, "own", answers, toy_image())
    assert row.unparted_m == (pytest.approx(0.003, abs=1e-5), 0.0, pytest.approx(0.003, abs=1e-5))
    assert max(row.cuts_m) < 1e-5
    assert (row.scene, row.completer, row.objects, row.error) == (4, "own", 3, None)


def test_objects_without_a_completion_are_missing_from_their_scene():
    answers = [SightAnswer(box_completion()), SightAnswer(None, error="FitDiverged")]
    assert ready._scene_row(0, "own", answers, toy_image()) == SceneRow(
        scene=0, completer="own", objects=2, cuts_m=(0.0,), unparted_m=(0.0,), error="FitDiverged"
    )
    nothing = ready._scene_row(0, "own", answers[1:], toy_image())
    assert (nothing.cuts_m, nothing.error) == ((), "FitDiverged")


@pytest.fixture
def sight() -> Sight:
    source = load_objects("cup", limit=1)[0]
    return see_object(source, np.random.default_rng(3), hidden=0.0, noise_m=0.001)


def test_an_answer_is_timed_from_the_picture_to_the_parts(sight, monkeypatch):
    asked = []

    def complete(detection):
        asked.append(detection)
        return box_completion()

    monkeypatch.setattr(sights, "get_completer", lambda name: complete)
    monkeypatch.setattr(sights, "needs_class", lambda name: False)
    monkeypatch.setattr(sights, "time", SteadyClock(0.5))
    answers = answers_to(sight, ("a", "b"))
    assert [answer.seconds for answer in answers.values()] == [1.0, 1.0]  # half a second each to detect and complete
    assert asked[0] is asked[1]
    assert asked[0].view is sight.image
    assert (asked[0].mask == sight.mask).all()
    assert asked[0].category == ""
    monkeypatch.setattr(sights, "needs_class", lambda name: name == "b")
    answers_to(sight, ("a", "b"))
    assert [detection.category != "" for detection in asked[2:]] == [False, True]


def test_who_has_no_answer_says_why(sight, monkeypatch):
    def gives_up(detection):
        raise FitDiverged("nothing fits")

    def sees_nothing(*_, **__):
        raise NothingDetected("nothing")

    monkeypatch.setattr(sights, "get_completer", lambda name: gives_up)
    assert answers_to(sight, ("a",))["a"].error == "FitDiverged"
    monkeypatch.setattr(sights, "detect_single", sees_nothing)
    assert [answer.error for answer in answers_to(sight, ("a", "b")).values()] == ["NothingDetected"] * 2


def test_the_oracle_answers_with_the_truth_where_it_stands_and_has_no_time(sight):
    answer = answers_to(sight, ("oracle",))["oracle"]
    assert answer.completion is not None
    np.testing.assert_allclose(answer.completion.mesh.vertices, sight.mesh.vertices, atol=1e-9)
    parts = np.vstack([part.vertices for part in answer.completion.parts])
    np.testing.assert_allclose([parts.min(axis=0), parts.max(axis=0)], sight.mesh.bounds, atol=0.002)
    assert answer.seconds is None
    assert isinstance(sights.get_completer("oracle"), Oracle)


def test_more_of_the_same_object_is_hidden(sight):
    source = load_objects("cup", limit=1)[0]
    whole = int(sight.mask.sum())
    for hidden in HIDDEN[1:]:
        other = see_object(source, np.random.default_rng(3), hidden=hidden, noise_m=0.001)
        np.testing.assert_array_equal(other.mesh.vertices, sight.mesh.vertices)
        np.testing.assert_array_equal(other.image.T_world_camera, sight.image.T_world_camera)
        assert other.mask.sum() == pytest.approx((1 - hidden) * whole, rel=0.02)


def test_a_scene_has_three_to_five_objects_of_one_picture_largest_first():
    for seed in range(6):
        seen = see_scene(np.random.default_rng(seed), noise_m=0.001)
        assert 1 <= len(seen) <= 5
        sizes = [int(one.mask.sum()) for one in seen]
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[-1] >= 100
        assert all(one.image is seen[0].image for one in seen)
        assert not np.any(np.sum([one.mask for one in seen], axis=0) > 1)
        middles = [one.mesh.bounds.mean(axis=0)[:2] for one in seen]
        assert np.abs(middles).max() < 0.15


def view_row(**fields: Any) -> ViewRow:
    common = {"group": "procedural", "object": "a", "category": "", "view": 0, "hidden": 0.0, "completer": "own"}
    return ViewRow(**{**common, **fields})


def test_the_whole_bench_has_every_completer_on_every_view_and_scene(monkeypatch):
    asked = []

    def rows_of_job(job, *, completers, config):
        asked.append(job)
        if isinstance(job, int):
            return [SceneRow(scene=job, completer=name, objects=3, cuts_m=(0.0,) * 3) for name in completers]
        group, source, view = job
        return [view_row(group=group, object=source.name, view=view, completer=name) for name in completers]

    monkeypatch.setattr(ready, "_rows_of_job", rows_of_job)
    monkeypatch.setattr(ready, "load_objects", lambda objects: load_objects("cup", limit=2))
    report = bench_ready(completers=("mirror", "observed"), config=ReadyConfig(views=3, scenes=2))
    names = [source.name for source in load_objects("cup", limit=2)]
    assert [(job[1].name, job[2]) for job in asked[:3]] == [(names[0], 0), (names[1], 0), (names[0], 1)]
    assert asked[3:] == [0, 1]
    assert (len(report["trials"]), len(report["scenes"])) == (6, 4)
    figures = report["rows"]["procedural"]["mirror"]
    assert (figures["views"], figures["failed"], figures["scenes"], figures["objects"]) == (3, 3, 2, 6)
    settings = report["settings"]
    assert (settings["views"], settings["scenes"], settings["objects"]) == (3, 2, {"procedural": 2})
    assert json.loads(json.dumps(report)) == {**report, "scenes": json.loads(json.dumps(report["scenes"]))}


def test_meshes_of_a_folder_are_a_group_without_scenes(monkeypatch, tmp_path: Path):
    monkeypatch.setattr(
        ready, "_rows_of_job", lambda job, **_: [] if isinstance(job, int) else [view_row(group=job[0])]
    )
    (tmp_path / "meshes").mkdir()
    box = trimesh.creation.box(extents=(0.06, 0.08, 0.1))
    box.export(tmp_path / "meshes" / "spoon__own.ply")
    with pytest.raises(InvalidOption, match="has no mesh of bicycle, bottle, bowl"):
        bench_ready(tmp_path)
    box.export(tmp_path / "meshes" / "mug__own.ply")
    report = bench_ready(tmp_path, config=ReadyConfig(views=2, scenes=1))
    assert report["settings"]["objects"] == {"procedural": 2, "real": 1}
    assert list(report["rows"]) == ["procedural", "real"]
    assert "scenes" not in report["rows"]["real"]["own"]


@pytest.mark.parametrize("options", [{"views": 0}, {"scenes": 0}])
def test_a_bench_of_nothing_is_refused(options):
    with pytest.raises(InvalidOption, match="at least 1"):
        ReadyConfig(**options)


def test_an_unknown_completer_is_refused_before_anything_is_seen():
    with pytest.raises(UnknownCompleter, match="magic"):
        bench_ready(completers=("magic",))


@pytest.mark.slow
def test_a_users_own_completer_is_a_row_beside_the_truth():
    report = bench_ready(
        completers=("oracle", "own_completers:gives_up", "mirror"), config=ReadyConfig(views=1, scenes=1)
    )
    rows = report["rows"]["procedural"]
    assert rows["own_completers:gives_up"]["failed"] == 1
    assert rows["own_completers:gives_up"]["missing"] == rows["mirror"]["objects"] >= 3
    assert rows["own_completers:gives_up"]["cut_over_1_mm"] == 1.0
    assert rows["oracle"]["chamfer_median_mm"] < 1.5 < rows["mirror"]["chamfer_median_mm"]
    assert rows["oracle"]["unparted_most_mm"] < 0.5
    assert rows["oracle"]["seconds_median"] is None
    assert 0.0 < rows["mirror"]["seconds_median"] < 2.0
    assert list(rows["mirror"]["hidden"]) == ["30", "50", "70"]
