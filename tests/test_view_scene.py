"""What the viewer shows of a recording and of an episode, and which points of a picture it keeps."""

import warnings
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from recorded_calls import recorded
from toy_completions import toy_completion, toy_image, toy_item
from toy_street import toy_street

from gfp_grasp.captures import Capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.view.scene import OTHER, SUPPORT, scene_cloud, scene_of_capture, scene_of_episode


def test_a_recording_is_completed_and_planned_with_every_option_and_its_warnings_are_notes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    up = (0.0, 1.0, 0.0)
    completions, calls = (toy_completion(up=up), toy_completion()), []

    def complete(*arguments: Any, **named: Any) -> Any:
        calls.append((arguments, named))
        for kind in (UserWarning, RuntimeWarning):
            warnings.warn(kind.__name__, kind, stacklevel=2)
        return completions

    truth = trimesh.creation.box()
    items = (toy_item("a", truth=truth), toy_item("b"))
    monkeypatch.setattr("gfp_grasp.view.scene.complete_capture", complete)
    plan = recorded(monkeypatch, "gfp_grasp.view.scene.items_of", items)
    capture = Capture("own", view=toy_image(), truth=truth)
    config = CompleteConfig(rival_share=0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        shown = scene_of_capture(capture, category="mug", config=config, seed=7)
    assert calls == [
        ((capture,), {"category": "mug", "detector": None, "sensor": "tabletop", "config": config, "seed": 7})
    ]
    assert plan.only == ((completions, truth), {"seed": 7})
    assert (shown.title, shown.items, shown.image, shown.truths) == ("own", items, capture.view, (truth,))
    np.testing.assert_array_equal(shown.up, up)
    assert (shown.notes, shown.facts) == (("UserWarning", "RuntimeWarning"), ())
    scene_of_capture(capture)
    assert calls[1][1] == {"category": None, "detector": None, "sensor": "tabletop", "config": None, "seed": 0}
    assert plan.calls[1][1] == {"seed": 0}


def test_a_scan_s_objects_have_names_and_no_grasps_are_planned_on_them(monkeypatch: pytest.MonkeyPatch) -> None:
    street = toy_street()
    recorded(monkeypatch, "gfp_grasp.view.scene.complete_capture", street)
    plan = recorded(monkeypatch, "gfp_grasp.view.scene.items_of", ())
    shown = scene_of_capture(Capture("scan.bin", points=np.eye(3)), sensor="lidar")
    assert [item.name for item in shown.items] == ["car", "car_2", "pedestrian"]
    assert shown.street is street
    assert shown.in_traffic
    assert not plan.calls
    recorded(monkeypatch, "gfp_grasp.view.scene.complete_capture", (street[2],))
    single = scene_of_capture(Capture("one.bin", points=np.eye(3)), sensor="lidar")
    assert [item.name for item in single.items] == ["pedestrian"]
    assert (single.street, single.in_traffic) == (None, True)


@pytest.mark.parametrize("completed", [True, False])
def test_an_episode_has_its_object_its_load_and_what_went_wrong(
    completed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = trimesh.creation.box()
    episode: Any = SimpleNamespace(
        true_mesh=lambda: truth,
        completion=toy_completion() if completed else None,
        truth=SimpleNamespace(name="red", category="mug" if completed else ""),
        randomisation=SimpleNamespace(mass_kg=0.1234, friction=0.567, grip_n=12.6),
        image=toy_image(),
        failure="" if completed else "too far",
        notes="one; two" if completed else "",
    )
    make = recorded(monkeypatch, "gfp_grasp.view.scene.make_item", "item")
    shown = scene_of_episode(episode, title="Episode 3", seed=3)
    assert (shown.title, shown.image, shown.truths) == ("Episode 3", episode.image, (truth,))
    np.testing.assert_array_equal(shown.up, [0.0, 0.0, 1.0])
    name = "red mug" if completed else "red"
    assert shown.facts == (("true object", name), ("mass, friction", "123 g, 0.57"), ("grip", "13 N"))
    assert shown.notes == (("one", "two") if completed else ("too far",))
    assert shown.items == (("item",) if completed else ())
    if completed:
        own = episode.completion
        assert make.only == (("red", own, (own,), truth), {"seed": 3})


def test_points_of_each_mask_have_its_number_and_those_near_the_support_are_its_own() -> None:
    image = toy_image(0.5)
    depth = image.depth_m.copy()
    depth[0, :3] = (0.0, 0.4965, 0.4955)  # no return; 3.5 and 4.5 mm above the support
    image = type(image)(depth, image.K, image.T_world_camera)
    masks = np.zeros((2, 24, 32), dtype=bool)
    masks[0, 5, 5:9], masks[1, 6, 5:7] = True, True
    completions = [toy_completion(view=image, mask=mask) for mask in masks]
    points, labels = scene_cloud(image, completions)
    assert len(points) == 24 * 32 - 1
    assert [(labels == number).sum() for number in (0, 1, OTHER)] == [4, 2, 1]
    assert (SUPPORT, OTHER) == (-1, -2)
    assert labels[:2].tolist() == [SUPPORT, OTHER]
    np.testing.assert_allclose(points[labels == 0], image.points()[masks[0]])
    coarse = [toy_completion(view=image, mask=masks[0], sensor_sigma_m=0.0016)]  # 3 sigmas are 4.8 mm
    assert scene_cloud(image, coarse)[1][:2].tolist() == [SUPPORT, SUPPORT]


def test_masks_of_another_picture_and_what_is_far_from_the_objects_are_left_out() -> None:
    image = toy_image(0.5)
    other = type(image)(np.ones((2, 2), np.float32), image.K, image.T_world_camera)
    completion = toy_completion(view=other, mask=np.ones((2, 2), dtype=bool))
    assert set(scene_cloud(image, [completion])[1]) == {SUPPORT}
    across = np.linalg.norm(image.points().reshape(-1, 3) - (0.6, 0.0, 0.05), axis=1)
    near, _ = scene_cloud(image, [toy_completion((0.6, 0.0, 0.05))])
    assert len(near) == (across < 0.7).sum()
    assert 0 < len(near) < 24 * 32


def test_without_a_completion_all_points_are_kept_and_belong_to_nothing() -> None:
    points, labels = scene_cloud(toy_image(5.0), [])
    assert len(points) == 24 * 32
    assert set(labels) == {OTHER}
    labels = scene_cloud(toy_image(0.5), [toy_completion(support=None)])[1]
    assert set(labels) == {OTHER}


@pytest.mark.parametrize(("most", "kept"), [(768, 768), (767, 384), (256, 256), (255, 192)])
def test_points_are_thinned_evenly(most: int, kept: int) -> None:
    image = toy_image(0.5)
    points, _ = scene_cloud(image, [], max_points=most)
    np.testing.assert_array_equal(points, image.points().reshape(-1, 3)[:: 768 // kept])
    big = type(image)(np.full((200, 301), 0.5, np.float32), image.K, image.T_world_camera)
    assert len(scene_cloud(big, [])[0]) == 20_067  # every third of 60 200
