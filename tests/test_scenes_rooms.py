"""Rooms of chance: what is in them, at rest, and what a camera sees of it."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest
import trimesh

from gfp_grasp.camera import SensorModel
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import Room, draw_camera, draw_things, make_room, view_room


def boxes(*extents: tuple[float, float, float]) -> list[trimesh.Trimesh]:
    made = [trimesh.creation.box(size) for size in extents]
    return [box.apply_translation([0, 0, -box.bounds[0, 2]]) for box in made]


def test_things_are_the_same_for_a_seed_and_stand_on_z_0() -> None:
    first, again = (draw_things(np.random.default_rng(4), 12) for _ in range(2))
    assert [len(a.vertices) for a in first] == [len(b.vertices) for b in again]
    assert all(abs(thing.bounds[0, 2]) < 1e-9 and 0.01 < thing.extents.max() <= 0.35 + 1e-9 for thing in first)
    other = draw_things(np.random.default_rng(4), 12, split="test")
    assert any(
        len(a.vertices) != len(b.vertices) or not np.allclose(a.bounds, b.bounds)
        for a, b in zip(first, other, strict=False)
    )


@pytest.mark.parametrize(("count", "split"), [(0, "train"), (3, "holdout")])
def test_no_things_or_no_such_split_is_refused(count: int, split: str) -> None:
    with pytest.raises(InvalidOption, match=f"{count} things of split '{split}': at least 1, of train, val, test"):
        draw_things(np.random.default_rng(0), count, split=split)


def test_things_that_are_dropped_come_to_rest_on_each_other_and_on_the_table() -> None:
    things = boxes((0.2, 0.16, 0.05), (0.18, 0.14, 0.04), (0.16, 0.12, 0.03))
    room = make_room(things, np.random.default_rng(5), piled=True)
    assert len(room.things) == 3
    assert room.things[0].volume == pytest.approx(0.2 * 0.16 * 0.05)
    assert min(thing.bounds[0, 2] for thing in room.things) == pytest.approx(0.0, abs=1e-3)
    # Three boxes from 3 to 5 cm thick cannot all lie beside each other within the circle that they are dropped into.
    assert max(thing.bounds[1, 2] for thing in room.things) > 0.055


def test_things_that_stand_apart_do_not_touch() -> None:
    room = make_room(boxes((0.1, 0.06, 0.05), (0.08, 0.04, 0.09)), np.random.default_rng(1), piled=False)
    first, second = (trimesh.proximity.ProximityQuery(thing) for thing in room.things)
    assert first.signed_distance(room.things[1].vertices).max() < 0
    assert second.signed_distance(room.things[0].vertices).max() < 0
    assert all(thing.bounds[0, 2] == pytest.approx(0.0) for thing in room.things)


def test_things_that_find_no_place_beside_the_others_are_left_out() -> None:
    room = make_room(boxes(*[(0.3, 0.3, 0.02)] * 12), np.random.default_rng(2), piled=False)
    assert 1 <= len(room.things) < 12


def test_labels_of_a_view_are_the_things_where_something_came_back() -> None:
    near, far = boxes((0.1, 0.1, 0.06), (0.1, 0.1, 0.12))
    far.apply_translation([0.0, 0.3, 0.0])
    table = trimesh.creation.box((1.0, 1.2, 0.02)).apply_translation([0, 0, -0.01])
    floor = trimesh.creation.box((9.0, 9.0, 0.02)).apply_translation([0, 0, -0.7])
    room = Room((near, far), (table, floor))
    rng = np.random.default_rng(3)
    camera = draw_camera(room, rng, distance_m=0.9, elevation_deg=(30.0, 40.0))
    middle = np.array([0.0, 0.15, 0.045])  # of the two boxes' middles
    assert np.linalg.norm(camera[:3, 3] - middle) == pytest.approx(0.9, abs=0.25)
    image, labels = view_room(room, camera, rng, sensor=SensorModel.kinect())
    points = image.points()
    assert set(np.unique(labels)) == {0, 1, 2}
    assert labels.shape == (240, 320)
    for number, thing in enumerate(room.things, start=1):
        own = points[labels == number]
        # A return is up to 10 mm off the surface that its ray meets.
        assert (own > thing.bounds[0] - 0.015).all()
        assert (own < thing.bounds[1] + 0.015).all()
    assert not (image.depth_m[labels > 0] == 0).any()
    assert (points[..., 2] < -0.6).any()  # the floor is seen beyond the table


def test_a_room_that_the_simulator_cannot_drop_is_laid_out_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    step = mujoco.mj_step

    def diverges(model, data, nstep=1):
        data.qvel[:] = np.nan
        step(model, data, 2)

    monkeypatch.setattr(mujoco, "mj_step", diverges)
    room = make_room(boxes((0.1, 0.06, 0.05), (0.08, 0.04, 0.09)), np.random.default_rng(1), piled=True)
    assert len(room.things) == 2
    assert all(thing.bounds[0, 2] == pytest.approx(0.0) for thing in room.things)
