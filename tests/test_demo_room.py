"""The demonstration's room: what is in view, what its objects are compared with, and its scene in the simulator."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest
from PIL import Image
from toy_completions import toy_item

from gfp_grasp.demo import room as room_module
from gfp_grasp.demo.demo_scene import pick_objects
from gfp_grasp.demo.room import room_scene
from gfp_grasp.scenes import Room
from gfp_grasp.types import DepthImage


def test_room_has_a_table_at_0_a_floor_a_lower_table_and_a_wall() -> None:
    table, floor, second, wall = room_module._furniture()
    assert [box.bounds[1, 2] for box in (table, floor, second)] == pytest.approx([0.0, -0.72, -0.1])
    assert wall.bounds[1, 2] > 2.0
    assert second.bounds[1, 0] < table.bounds[0, 0]  # there is a gap between the tables


def test_a_room_becomes_one_scene_that_stands_and_each_object_is_compared_with_what_its_pixels_saw(tmp_path) -> None:
    made = room_scene("T", "text", pick_objects((("mug", 2), ("cup", 9))), folder=tmp_path)
    assert (made.title, made.text) == ("T", "text")
    assert list(made.pictures) == ["depth.png", "standing.png"]
    assert made.pictures["standing.png"].startswith("scene_completed.xml after two seconds in MuJoCo")
    assert "2 of 2 objects stand" in made.pictures["standing.png"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene_completed.xml"))
    assert model.njnt == len(made.items) == 2
    for item in made.items:
        assert item.errors is not None
        assert item.truth is not None
        assert item.errors.cd_m < 0.012
        assert np.linalg.norm(item.completion.mesh.bounds.mean(axis=0) - item.truth.bounds.mean(axis=0)) < 0.015
    picture = np.asarray(Image.open(tmp_path / "standing.png"))
    assert picture.shape == (360, 480, 3)
    saturation = np.ptp(picture.astype(int), axis=2)
    assert 0.01 < (saturation > 40).mean() < 0.4  # objects are coloured, the floor is grey


def test_an_object_most_of_whose_pixels_saw_no_thing_has_no_truth() -> None:
    item = toy_item("first")
    view = DepthImage(np.ones((4, 6), np.float32), np.array([[5.0, 0, 3], [0, 5, 2], [0, 0, 1]]), np.eye(4))
    mask = np.zeros((4, 6), dtype=bool)
    mask[1, 1:5] = True
    labels = np.zeros((4, 6), dtype=np.int32)
    labels[1, 1] = 1
    object.__setattr__(item.completion.detection, "view", view)
    object.__setattr__(item.completion.detection, "mask", mask)
    room = Room((item.completion.mesh,), ())
    assert room_module._compared(item, room, labels, np.random.default_rng(0)).truth is None
    labels[1, 2:4] = 1
    assert room_module._compared(item, room, labels, np.random.default_rng(0)).truth is room.things[0]
