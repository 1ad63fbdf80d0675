"""Steps of a completion, each with what stands for the others: what it is told, what it chooses, how long it took."""

import warnings
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded_calls import Recorder, recorded
from toy_completions import toy_completion, toy_image
from toy_primitive import toy_cup_primitive

from gfp_grasp import complete as room
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.complete import CompleteConfig, Completion, complete_detection, complete_scene, complete_to_mesh
from gfp_grasp.detect import DetectConfig
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.level import level_frame
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import UNKNOWN, FittedPrimitive, get_sensor

SENSOR = replace(get_sensor("tabletop"), sigma_m=0.002)

POINTS = np.random.default_rng(0).uniform(-0.03, 0.03, (60, 3)) + np.array([0.2, 0.1, 0.35])


def test_defaults_of_a_completion_are_the_documented_ones() -> None:
    config = CompleteConfig()
    assert (config.rival_share, config.subcategories, config.optional_parts) == (0.1, True, "card")
    for share in (0.0, -0.1, 1.1):
        with pytest.raises(InvalidOption, match="rival_share"):
            CompleteConfig(rival_share=share)
    assert CompleteConfig(rival_share=1.0).rival_share == 1.0
    for rule in ("card", "seen", "always"):
        assert CompleteConfig(optional_parts=rule).optional_parts == rule
    with pytest.raises(InvalidOption, match="optional_parts"):
        CompleteConfig(optional_parts="never")


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """Stands for the detector of one object."""
    return recorded(monkeypatch, "gfp_grasp.complete.detect_single", "detection")


@pytest.fixture
def completed(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """Stands for all that follows the detection."""
    return recorded(monkeypatch, "gfp_grasp.complete._complete", "completion")


def test_a_cloud_is_looked_at_in_a_level_frame_with_all_that_is_known_of_it(
    found: Recorder, completed: Recorder
) -> None:
    up, eye, image = np.array([0.0, 0.6, 0.8]), np.array([0.5, -0.3, 0.9]), toy_image()
    mask = np.zeros((24, 32), dtype=bool)
    config = CompleteConfig(rival_share=0.5)
    told = {"view": image, "mask": mask, "category": "mug", "sensor": SENSOR}
    made = complete_to_mesh(POINTS, viewpoint=eye, up=2 * up, support_height=0.25, config=config, seed=7, **told)
    assert made == "completion"
    (points,), named = found.only
    T = completed.only[0][1]
    assert T[:3, 2] == pytest.approx(up)
    T_level_world = invert_T(T)
    np.testing.assert_allclose(np.sort(points, axis=0), np.sort(apply_T(T_level_world, POINTS), axis=0), atol=1e-12)
    np.testing.assert_allclose(named.pop("viewpoint"), apply_T(T_level_world, eye), atol=1e-12)
    assert named.pop("support_height") == pytest.approx(0.25 - up @ POINTS.mean(axis=0))
    np.testing.assert_allclose(named.pop("view").T_world_camera, T_level_world @ image.T_world_camera, atol=1e-12)
    sensor = DetectConfig(sensor=SENSOR, classify=False)
    assert named == {"mask": mask, "category": "mug", "config": sensor}
    (detection, _, own, seed), rest = completed.only
    assert (detection, own, seed, list(rest["timings_s"])) == ("detection", config, 7, ["detect"])


def test_without_up_a_cloud_is_looked_at_as_it_is(found: Recorder, completed: Recorder) -> None:
    complete_to_mesh(POINTS, viewpoint=(0.5, -0.3, 0.9), up=None, support_height=0.25, category="mug")
    (points,), named = found.only
    np.testing.assert_array_equal(np.sort(points, axis=0), np.sort(POINTS, axis=0))
    np.testing.assert_array_equal(named.pop("viewpoint"), (0.5, -0.3, 0.9))
    config = DetectConfig(classify=False)
    told = {"up": None, "support_height": 0.25, "view": None, "mask": None, "category": "mug", "config": config}
    assert named == told
    np.testing.assert_array_equal(completed.only[0][1], np.eye(4))


def test_nothing_is_known_where_nothing_is_said_and_up_is_z(found: Recorder, completed: Recorder) -> None:
    complete_to_mesh(POINTS)
    (_, T, config, seed), _ = completed.only
    np.testing.assert_allclose(T, level_frame(room.order_points(POINTS), np.array([0.0, 0.0, 1.0]), None))
    assert (config, seed) == (CompleteConfig(), 0)
    named = found.only[1]
    assert [named[key] for key in ("viewpoint", "support_height", "view", "mask", "category")] == [None] * 5
    complete_to_mesh(POINTS, view=toy_image())
    np.testing.assert_allclose(
        found.calls[1][1]["viewpoint"], apply_T(invert_T(completed.calls[1][0][1]), np.array([0.0, 0.0, 0.5]))
    )


@pytest.mark.parametrize("seed", [-1, 1.5, True, "0", None])
def test_a_seed_is_a_whole_number_from_0_on(seed: Any) -> None:
    with pytest.raises(InvalidOption, match="seed is"):
        complete_to_mesh(POINTS, seed=seed)
    with pytest.raises(InvalidOption, match="config is"):
        complete_scene(toy_image(), config={})  # type: ignore[arg-type]


def test_objects_of_a_scene_are_completed_one_by_one_and_those_that_fit_nothing_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    received: list[Any] = []

    def complete(detection: str, **named: Any) -> Completion:
        received.append((detection, named))
        if detection == "odd":
            raise FitDiverged("no start converged")
        return toy_completion((0.2 * (detection == "b"), 0.0, 0.05), category=detection)

    monkeypatch.setattr("gfp_grasp.complete.complete_detection", complete)
    monkeypatch.setattr("gfp_grasp.complete.get_detector", lambda detector: detector)
    stacked = recorded(monkeypatch, "gfp_grasp.complete.on_each_other", ["a", "odd", "b"])
    detect, config, image = Recorder(["found"]), CompleteConfig(rival_share=0.5), toy_image()
    with pytest.warns(UserWarning, match="an object was left out: no start converged"):
        made = complete_scene(image, up=(0.0, 2.0, 0.0), detector=detect, config=config, seed=7)
    assert [(completion.category, completion.mesh.centroid[0]) for completion in made] == [("a", 0.0), ("b", 0.2)]
    assert made.view is image
    assert stacked.only[0] == (["found"],)
    assert [name for name, _ in received] == ["a", "odd", "b"]
    monkeypatch.setattr("gfp_grasp.complete.on_each_other", tuple)
    assert all(named == {"config": config, "seed": 7} for _, named in received)
    np.testing.assert_array_equal(detect.only[1]["up"], (0.0, 1.0, 0.0))
    with pytest.warns(UserWarning, match="left out"), pytest.raises(FitDiverged, match="no object of the picture"):
        complete_scene(toy_image(), detector=Recorder(["odd"]))
    assert complete_scene(toy_image(), detector=Recorder([])).completions == ()


def test_a_detector_has_a_name_and_up_is_z_where_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    detect = Recorder([])
    asked = recorded(monkeypatch, "gfp_grasp.complete.get_detector", detect)
    complete_scene(toy_image())
    complete_scene(toy_image(), detector="own:find", up=None)
    assert [call[0] for call in asked.calls] == [("votes",), ("own:find",)]
    assert detect.calls[1][1] == {"up": None}
    np.testing.assert_array_equal(detect.calls[0][1]["up"], (0.0, 0.0, 1.0))


def test_a_detection_is_completed_where_it_is(completed: Recorder) -> None:
    detection, config = toy_completion().detection, CompleteConfig(rival_share=0.5)
    assert complete_detection(detection, config=config, seed=7) == "completion"
    complete_detection(detection)
    (first, T, own, seed), named = completed.calls[0]
    assert (first, own, seed, named) == (detection, config, 7, {"timings_s": {}})
    np.testing.assert_array_equal(T, np.eye(4))
    assert completed.calls[1][0][2:] == (CompleteConfig(), 0)


class Chain:
    """Stages in the place of the real ones; the answer is a toy cup that was moved, or a box of no class."""

    def __init__(self, patch: pytest.MonkeyPatch, *, sure: float = 1.0, fitted: bool = True) -> None:
        primitive = toy_cup_primitive()
        scored = toy_completion(scores={"mug": 0.512, "cup": 0.488})
        self.detection = scored.detection
        self.view = SimpleNamespace(T_world_level=make_T(t=np.array([0.1, 0.0, 0.0])))
        fit = FittedPrimitive(
            primitive, make_T(t=np.array([0.0, 0.2, 0.0])), np.ones(3), np.zeros(len(primitive.modes)), 0.001
        )
        self.shape = replace(scored.shape, fit=fit if fitted else None, note="a note")
        self.recognise = recorded(patch, "gfp_grasp.complete.recognise", self.detection)
        recorded(patch, "gfp_grasp.complete.sureness", sure)
        self.look = recorded(patch, "gfp_grasp.complete.make_level_view", self.view)
        self.answer = recorded(patch, "gfp_grasp.complete.answer", self.shape)

    def complete(self, config: CompleteConfig = CompleteConfig()) -> Completion:
        T_world_found = make_T(t=np.array([0.0, 0.0, 0.3]))
        return room._complete("found", T_world_found, config, 7, timings_s={"detect": 5.0})  # type: ignore[arg-type]


def test_stages_follow_each_other_and_the_answer_is_in_the_world_s_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(monkeypatch)
    config = CompleteConfig(collision=CollisionConfig(max_parts=7))
    made = chain.complete(config)
    assert chain.recognise.only == (("found", CompleteConfig().library), {})
    assert chain.look.only == ((chain.detection,), {"seed": 7})
    (view, detection, own, clock), named = chain.answer.only
    assert (view, detection, own, named) == (chain.view, chain.detection, config, {})
    np.testing.assert_allclose(made.mesh.vertices, chain.shape.mesh.vertices + np.array([0.1, 0.0, 0.3]))
    np.testing.assert_array_equal(made.mesh.faces, chain.shape.mesh.faces)
    np.testing.assert_allclose(made.T_world_object[:3, 3], (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(made.observed, chain.shape.observed)
    np.testing.assert_array_equal(made.sigma_m, chain.shape.sigma_m)
    np.testing.assert_allclose(made.detection.cloud.points[:, 2] - chain.detection.cloud.points[:, 2], 0.3)
    assert (made.collision_config, made.category, made.note) == (config.collision, "cup", "a note")
    assert made.timings_s is clock.laps
    assert list(made.timings_s) == ["detect", "level"]
    assert 5.0 < made.timings_s["detect"] < 6.0


@pytest.mark.parametrize(
    ("scores", "category"), [({"mug": 0.512, "cup": 0.488}, UNKNOWN), ({"mug": 1.0}, "mug"), ({}, "mug")]
)
def test_what_no_primitive_was_fitted_to_is_of_no_class_unless_its_class_was_given(
    scores: dict[str, float], category: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = Chain(monkeypatch, sure=0.2, fitted=False)
    recorded(monkeypatch, "gfp_grasp.complete.recognise", replace(chain.detection, scores=scores))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = chain.complete()
    assert (made.category, made.detection.category, made.scores) == (category, category, scores)


@pytest.mark.parametrize(("sure", "warned"), [(0.49, 1), (0.5, 0)])
def test_what_no_known_class_is_likely_for_is_completed_with_a_warning(
    sure: float, warned: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = Chain(monkeypatch, sure=sure)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        chain.complete()
    told = [str(warning.message) for warning in caught]
    words = "no known class is likely (mug 0.51, cup 0.49); the best is completed all the same"
    assert told == [words] * warned
