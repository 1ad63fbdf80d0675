"""Pictures and films: colours, sizes and cameras have known values."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from recorded_calls import Recorder, recorded
from toy_completions import toy_outcome

from gfp_grasp.drawing import filmed_trial, overlay, write_clip, write_depth
from gfp_grasp.drawing.pictures import film_camera
from gfp_grasp.envs import TrialSettings
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp

KNOWN = Path(__file__).with_name("known_charts") / "overlay.png"
NEAR, FAR, NOTHING = (253, 231, 160), (16, 14, 42), (205, 209, 214)


def picture_of(depth_m: np.ndarray, path: Path) -> np.ndarray:
    write_depth(path, depth_m)
    return np.asarray(Image.open(path))


def test_depth_runs_through_six_colours_from_the_nearest_to_the_farthest(tmp_path: Path) -> None:
    between = np.linspace(0.4, 0.8, 6)
    depth = np.concatenate([np.full(200, 0.4), between, np.full(200, 0.8), [0.0]])[None]
    (row,) = picture_of(depth, tmp_path / "a.png")
    stops = [NEAR, (246, 177, 97), (214, 98, 92), (140, 49, 111), (62, 26, 90), FAR]
    np.testing.assert_allclose(row[200:206].astype(int), stops, atol=1)
    np.testing.assert_array_equal(row[-1], NOTHING)


def test_half_a_percent_at_either_end_is_as_light_or_as_dark_as_can_be(tmp_path: Path) -> None:
    (row,) = picture_of(np.linspace(0.5, 1.5, 1001)[None], tmp_path / "a.png")
    light, dark = (row == NEAR).all(axis=1), (row == FAR).all(axis=1)
    assert np.flatnonzero(light).tolist() == [0, 1, 2, 3, 4, 5]
    assert dark[-6:].all()
    assert row[-12, 0] > FAR[0]


def test_a_picture_of_one_depth_is_near_all_over(tmp_path: Path) -> None:
    np.testing.assert_array_equal(picture_of(np.full((2, 3), 0.7), tmp_path / "a.png")[0, 0], NEAR)


def test_the_last_frame_of_a_clip_lingers(tmp_path: Path) -> None:
    frames = [np.full((8, 10, 3), 30 * k, np.uint8) for k in range(4)]
    for durations, named in (([80, 80, 80, 1200], {}), ([50, 50, 50, 1200], {"frame_ms": 50})):
        write_clip(tmp_path / "clip.gif", frames, **named)
        with Image.open(tmp_path / "clip.gif") as clip:
            seen = []
            for k in range(4):
                clip.seek(k)
                seen.append(clip.info["duration"])
        assert seen == durations


def test_colours_of_a_clip_are_shared_and_not_mixed_of_dots(tmp_path: Path) -> None:
    rows = np.linspace(0, 255, 200).astype(np.uint8)
    frame = np.repeat(np.repeat(rows[:, None, None], 20, axis=1), 3, axis=2)
    write_clip(tmp_path / "clip.gif", [frame, frame[::-1]])
    with Image.open(tmp_path / "clip.gif") as clip:
        seen = np.asarray(clip.convert("RGB"))
    assert (seen == seen[:, :1]).all()
    assert len(np.unique(seen[:, 0], axis=0)) == 64


def overlaid() -> np.ndarray:
    """A block, and a taller and wider one beside it that reaches into the table."""
    truth = trimesh.creation.box(bounds=((-0.03, -0.02, 0.0), (0.03, 0.04, 0.08)))
    completed = trimesh.creation.box(bounds=((-0.03, -0.0195, -0.02), (0.05, 0.03, 0.10)))
    return overlay(truth, completed, seen_from=np.array([0.4, -0.3, 0.3]))


def test_overlay_is_the_known_picture() -> None:
    known = np.asarray(Image.open(KNOWN)).astype(int)
    assert np.abs(overlaid().astype(int) - known).mean() < 0.1


def test_a_shape_seen_from_right_above_is_looked_at_from_the_front() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    ball.apply_translation((0.0, 0.0, 0.05))
    above, front = (overlay(ball, None, seen_from=np.array(eye)) for eye in ((0.0, 0.0, 0.5), (0.5, 0.0, 0.05)))
    np.testing.assert_array_equal(above, front)
    row = front[150, :300].astype(int)
    blue = np.flatnonzero(row[:, 2] - row[:, 0] > 25)
    # The camera has the ball around the corners of its box in view, and 2 % more.
    angle = np.arcsin(np.sin(np.radians(15)) / (1.02 * 3**0.5))
    assert np.ptp(blue) == pytest.approx(2 * 150 * np.tan(angle) / np.tan(np.radians(15)), abs=3)


def grasp_along(approach: tuple[float, float, float], closing: tuple[float, float, float]) -> Grasp:
    return Grasp(make_T(np.column_stack([np.cross(closing, approach), closing, approach]), (0.1, 0.2, 0.1)), 0.06)


DOWN = (0.0, 0.0, -1.0)
LEVEL, HEIGHT = np.cos(np.radians(20)), np.sin(np.radians(20))


@pytest.mark.parametrize(
    ("approach", "closing", "towards"),
    [
        (DOWN, (1.0, 0.0, 0.0), (0.0, -1.0)),  # across the jaws, on the side of the front
        (DOWN, (0.0, 1.0, 0.0), (1.0, 0.0)),
        (DOWN, (0.0, -1.0, 0.0), (1.0, 0.0)),
        ((0.6, 0.0, -0.8), (0.0, 1.0, 0.0), None),  # from the side: obliquely from behind
        ((0.48, 0.0, -((1 - 0.48**2) ** 0.5)), (0.0, 1.0, 0.0), (1.0, 0.0)),  # steep still
        ((-((1 - 0.28**2) ** 0.5), 0.0, 0.28), (0.28, 0.0, (1 - 0.28**2) ** 0.5), None),
    ],
)
def test_the_camera_of_a_film_stands_where_both_jaws_show(
    approach: tuple[float, float, float], closing: tuple[float, float, float], towards: tuple[float, float] | None
) -> None:
    for alone, distance_m in ((True, 0.92), (False, 1.0)):
        camera = film_camera(grasp_along(approach, closing), alone=alone)
        level = (camera[:3, 3] - (0.0, 0.0, 0.24)) / distance_m
        assert level[2] == pytest.approx(HEIGHT)
        np.testing.assert_allclose(camera[:3, 2], -np.array(level) / np.linalg.norm(level), atol=1e-9)
        if towards is not None:
            np.testing.assert_allclose(level[:2], LEVEL * np.array(towards), atol=1e-9)
        else:
            behind = -np.sign(approach[0]) * np.array([1.0, 0.0])
            assert level[:2] @ behind == pytest.approx(LEVEL * np.cos(np.radians(55)))
            assert level[1] < 0


@pytest.fixture
def shots(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    return recorded(monkeypatch, "gfp_grasp.drawing.pictures.shade", "frame")


@pytest.mark.parametrize(("named", "num"), [({}, 3), ({"commands_a_frame": 10}, 5)])
def test_a_film_has_a_frame_every_few_commands_and_one_of_the_end(
    named: dict[str, Any], num: int, shots: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    class World:
        model, data = "model", "data"

    received = []

    def trial(*arguments: object, on_step: Any, **more: object) -> object:
        received.append((arguments, more))
        for step in range(33):
            on_step(step)
        return outcome

    outcome = toy_outcome()
    monkeypatch.setattr("gfp_grasp.drawing.pictures.run_trial", trial)
    grasp, settings, world = grasp_along(DOWN, (1.0, 0.0, 0.0)), TrialSettings(), World()
    made = filmed_trial(world, grasp, settings, target="cup", alone=False, **named)  # pyright: ignore[reportArgumentType]
    assert made == (outcome, ["frame"] * num)
    assert received == [((world, grasp, settings), {"target": "cup"})]
    arguments, look = shots.calls[0]
    camera = look.pop("T_world_camera")
    np.testing.assert_array_equal(camera, film_camera(grasp, alone=False))
    assert (arguments, look) == (("model", "data"), {"width": 400, "height": 300})


if __name__ == "__main__":
    Image.fromarray(overlaid()).save(KNOWN, optimize=True)
