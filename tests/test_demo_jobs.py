"""Jobs of the demonstration, with a toy in the place of what is completed: stage, picture, truth, trials and frame."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from recorded_calls import Recorder, recorded
from toy_completions import EXTENTS, toy_completion, toy_errors, toy_grasps, toy_image, toy_item, toy_outcome

from gfp_grasp.camera import SensorModel, intrinsics
from gfp_grasp.captures import Capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.demo import jobs
from gfp_grasp.scenes import SceneObject, World
from gfp_grasp.transforms import apply_T, look_at, make_T
from gfp_grasp.types import SupportPlane, TrueObject


def true_box(name: str) -> TrueObject:
    completion = toy_completion((0.0, 0.0, 0.0))
    return TrueObject(name, "mug", completion.mesh, completion.collision, 0.2, 0.5)


@pytest.fixture
def truths() -> tuple[TrueObject, TrueObject]:
    return true_box("red"), true_box("blue")


@pytest.fixture
def stage(truths: tuple[TrueObject, ...]) -> World:
    poses = [make_T(t=np.array([x, 0.0, 0.05])) for x in (-0.1, 0.1)]
    return World([SceneObject.of(truth, T) for truth, T in zip(truths, poses, strict=True)])


@pytest.mark.parametrize(("num", "radius_m"), [(1, 0.06), (2, 0.2)])
def test_objects_are_put_apart_at_random_and_settle(
    num: int, radius_m: float, truths: tuple[TrueObject, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    poses = [make_T(t=np.array([0.2 * i, 0.0, 0.055])) for i in range(num)]
    place = recorded(monkeypatch, "gfp_grasp.demo.jobs.place_clutter", poses)
    monkeypatch.setattr("gfp_grasp.demo.jobs.load_asset", lambda source: source)
    rng = np.random.default_rng(0)
    stage, loaded = jobs.set_stage(truths[:num], rng)  # type: ignore[arg-type]
    assert loaded == truths[:num]
    assert place.only == ((truths[:num], rng), {"radius_m": radius_m, "gap_m": 0.03})
    assert list(stage.names) == ["red", "blue"][:num]
    assert stage.pose("red")[2, 3] == pytest.approx(0.05, abs=0.002)  # it has fallen by 5 mm


def test_picture_is_that_of_a_realsense_at_the_eye(stage: World, monkeypatch: pytest.MonkeyPatch) -> None:
    sensor = recorded(monkeypatch, "gfp_grasp.demo.jobs.apply_sensor", "noisy")
    rng, eye = np.random.default_rng(0), (0.4, -0.3, 0.3)
    image, geom = jobs.take_picture(stage, eye, rng)
    assert image == "noisy"
    (clean, model, drawn), _ = sensor.only
    assert (model, drawn) == (SensorModel.realsense(), rng)
    np.testing.assert_array_equal(clean.K, intrinsics(640, 480, 40.0))
    np.testing.assert_array_equal(clean.T_world_camera, look_at(eye, (0.0, 0.0, 0.06)))
    assert clean.depth_m.shape == geom.shape == (480, 640)
    assert stage.geoms("red")[geom[geom >= 0]].any()


def test_table_has_up_as_z_and_the_objects_middle_over_its_origin() -> None:
    support = SupportPlane(np.array([1.0, 0.0, 0.0]), -0.2)
    both = [toy_completion(place, up=(1.0, 0, 0), support=support) for place in ((0.0, 0.1, 0.3), (0.0, 0.3, 0.5))]
    T = jobs.table_frame(both)
    points = apply_T(T, np.array([[-0.2, 0.2, 0.4], [0.0, 0.2, 0.4]]))
    np.testing.assert_allclose(points, [[0, 0, 0], [0, 0, 0.2]], atol=1e-12)
    lone = toy_completion((0.0, 0.0, 0.4), support=None)
    np.testing.assert_allclose(jobs.table_frame([lone])[:3, 3], [0.0, 0.0, -0.35], atol=1e-12)


def test_truth_is_the_object_that_most_pixels_saw(stage: World, truths: tuple[TrueObject, ...]) -> None:
    red, blue = (int(np.flatnonzero(stage.geoms(name))[0]) for name in ("red", "blue"))
    table = int(np.flatnonzero(~(stage.geoms("red") | stage.geoms("blue")))[0])
    geom = np.full((24, 32), -1)
    mask = np.zeros((24, 32), dtype=bool)
    mask[0, :9] = True
    seen = toy_completion(view=toy_image(), mask=mask)
    for pixels, truth in (
        ([blue] * 3 + [red] * 2 + [-1] * 4, truths[1]),
        ([red] * 3 + [table] * 2 + [-1] * 4, truths[0]),
        ([red] * 2 + [table] * 2 + [-1] * 5, None),
        ([-1] * 9, None),
    ):
        geom[0, :9] = pixels
        assert jobs._truth_of(seen, stage, truths, geom) is truth
    assert jobs._truth_of(toy_completion(), stage, truths, geom) is None


@pytest.mark.parametrize("alone", [True, False])
def test_a_trial_is_filmed_only_where_that_is_asked_for_and_the_stage_is_put_back(
    alone: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    restore = Recorder()
    stage: Any = SimpleNamespace(names=["red"] if alone else ["red", "blue"], restore=restore)
    film = recorded(monkeypatch, "gfp_grasp.demo.jobs.filmed_trial", ("filmed", ["frame"]))
    trial = recorded(monkeypatch, "gfp_grasp.demo.jobs.run_trial", "tried")
    (grasp,) = toy_grasps(1)
    assert jobs._try(stage, grasp, "red", film=True) == ("filmed", ["frame"])
    assert jobs._try(stage, grasp, "red", film=False) == ("tried", [])
    assert film.only == ((stage, grasp), {"target": "red", "alone": alone})
    assert trial.only == ((stage, grasp), {"target": "red"})
    assert len(restore.calls) == 2


def test_names_are_unlike_those_before() -> None:
    items: list[Any] = []
    for _ in range(3):
        items.append(jobs._named(toy_item("mug"), items))
    assert [item.name for item in items] == ["mug", "mug-2", "mug-3"]


@pytest.mark.parametrize(("scale", "mass_kg"), [(0.1, 0.03), (1.0, 0.24), (2.0, 0.8)])
def test_a_completed_object_weighs_what_plastic_does_and_stands_on_the_table(scale: float, mass_kg: float) -> None:
    completion = toy_completion((0.3, 0.1, 0.03))  # reaches 2 cm into the table
    completion.mesh.vertices = (completion.mesh.vertices - (0.3, 0.1, 0.03)) * scale + (0.3, 0.1, 0.03)
    T = make_T(t=np.array([-0.3, 0.0, 0.0]))
    body = jobs._body("mug", completion, T)
    low = min(0.0, 0.03 - scale * EXTENTS[2] / 2)
    np.testing.assert_allclose(body.T_world_object, make_T(t=np.array([0.0, 0.1, 0.03 - low])), atol=1e-12)
    assert (body.name, body.friction) == ("mug", 0.7)
    assert body.mass_kg == pytest.approx(mass_kg)
    assert body.visual is not None
    np.testing.assert_allclose(body.visual.bounds.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(body.parts[0].vertices.mean(axis=0), [0, 0, -EXTENTS[2] / 4], atol=1e-12)


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    return recorded(monkeypatch, "gfp_grasp.demo.jobs.write_scene", "written")


def test_simulated_scene_tries_each_object_and_films_the_first(
    stage: World, truths: tuple[TrueObject, ...], written: Recorder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    completions = [toy_completion(category=name) for name in ("mug", "cup", "bottle")]
    of = dict(zip(map(id, completions), (truths[1], None, truths[1]), strict=True))
    image, geom, config = toy_image(), np.zeros((24, 32)), CompleteConfig(rival_share=0.5)
    set_stage = recorded(monkeypatch, "gfp_grasp.demo.jobs.set_stage", (stage, truths))
    picture = recorded(monkeypatch, "gfp_grasp.demo.jobs.take_picture", (image, geom))
    complete = recorded(monkeypatch, "gfp_grasp.demo.jobs.complete_scene", completions)
    monkeypatch.setattr("gfp_grasp.demo.jobs._truth_of", lambda completion, *_: of[id(completion)])
    plan = recorded(monkeypatch, "gfp_grasp.demo.jobs.plan_among", (toy_grasps(2), 0.5))
    tried = recorded(monkeypatch, "gfp_grasp.demo.jobs._try", (toy_outcome(), ["frame"]))
    errors = recorded(monkeypatch, "gfp_grasp.demo.jobs.completion_errors", toy_errors())
    made = jobs.simulated_scene("T", "text", "sources", eye=(1, 2, 3), folder=tmp_path, config=config, seed=7)  # type: ignore[arg-type]
    assert made == "written"
    assert set_stage.only[0][0] == "sources"
    assert picture.only[0][:2] == (stage, (1, 2, 3))
    assert set_stage.only[0][1] is picture.only[0][2] is errors.calls[0][1]["rng"]
    assert complete.only == ((image,), {"config": config, "seed": 7})
    assert all(call[0][1] is completions and call[1] == {"seed": 7} for call in plan.calls)
    assert [(call[0][2], call[1]) for call in tried.calls] == [("blue", {"film": True}), ("blue", {"film": False})]
    (title, text, items, folder), named = written.only
    assert (title, text, folder) == ("T", "text", tmp_path)
    assert named == {"image": image, "frames": ["frame"], "stages": {"true": stage}}
    assert [item.name for item in items] == ["blue", "cup", "blue-2"]
    assert [item.world for item in items] == ["true object", "", "true object"]
    assert [item.outcome is None for item in items] == [False, True, False]
    assert [item.grasp_s for item in items] == [0.5] * 3
    np.testing.assert_allclose(items[0].truth.bounds.mean(axis=0), [0.1, 0.0, 0.05], atol=1e-9)
    assert errors.calls[0][0] == (completions[0].mesh, items[0].truth)
    jobs.simulated_scene("T", "", "sources", eye=(1, 2, 3), folder=tmp_path)  # type: ignore[arg-type]
    assert complete.calls[1] == ((image,), {"config": None, "seed": 0})
    assert set_stage.calls[1][0][1].random() == np.random.default_rng(0).random()


def test_an_object_without_grasps_is_not_tried(
    stage: World, truths: tuple[TrueObject, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded(monkeypatch, "gfp_grasp.demo.jobs.plan_among", ((), 0.5))
    recorded(monkeypatch, "gfp_grasp.demo.jobs.completion_errors", toy_errors())
    rng, own = np.random.default_rng(0), toy_completion()
    item, film = jobs._grasped(own, [own], truths[0], stage, rng, seed=0, film=True)
    assert (item.name, item.outcome, film) == ("red", None, [])


def test_recorded_scene_tries_the_best_grasps_on_what_was_completed(
    written: Recorder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    completions = (
        toy_completion((0.3, 0.0, 0.05), up=(0.0, 0.0, 1.0)),
        toy_completion((0.5, 0.0, 0.05), category="cup"),
    )
    truth = trimesh.creation.box()
    capture = Capture("own", view=toy_image(), truth=truth)
    complete = recorded(monkeypatch, "gfp_grasp.demo.jobs.complete_capture", completions)
    planned = tuple(
        toy_item(name, num, completion=completion)
        for name, num, completion in zip(("mug-1", "cup-2"), (0, 3), completions, strict=True)
    )
    plan = recorded(monkeypatch, "gfp_grasp.demo.jobs.items_of", planned)
    tried = recorded(monkeypatch, "gfp_grasp.demo.jobs._try", (toy_outcome(), ["frame"]))
    config = CompleteConfig(rival_share=0.5)
    made = jobs.recorded_scene(capture, folder=tmp_path, category="mug", config=config, seed=7)
    assert made == "written"
    assert complete.only == ((capture,), {"category": "mug", "config": config, "seed": 7})
    assert plan.only == ((completions, truth), {"seed": 7})
    (stage, grasp, name), named = tried.only
    assert (list(stage.names), name, named) == (["mug-1", "cup-2"], "cup-2", {"film": True})
    best = planned[1].grasps[0]
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 3], best.T_world_gripper[:3, 3] - (0.4, 0.0, 0.0))
    assert (grasp.width_m, grasp.quality) == (best.width_m, best.quality)
    (title, text, items, folder), named = written.only
    assert (title, folder) == ("own", tmp_path)
    assert named == {"image": capture.view, "frames": ["frame"], "stages": {"completed": stage}}
    assert text.startswith("Up was taken as (0.00, 0.00, 1.00) in the frame of the recording. The truth is unknown")
    assert [(item.name, item.outcome is None, item.world) for item in items] == [
        ("mug-1", True, "completed parts"),
        ("cup-2", False, "completed parts"),
    ]
    assert stage.pose("cup-2")[0, 3] == pytest.approx(0.1, abs=0.002)
    jobs.recorded_scene(capture, folder=tmp_path)
    assert complete.calls[1] == ((capture,), {"category": None, "config": None, "seed": 0})
