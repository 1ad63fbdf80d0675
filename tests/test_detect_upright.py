"""Frames of sensors are told apart, up is guessed for an object without a table, and a wrong up is told."""

import warnings

import numpy as np
import pytest

from gfp_grasp.camera import camera_points, intrinsics, render_mesh_view, sensor_frame
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.detect import DetectConfig, detect_single, find_support
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import apply_T, look_at

FRAMES = {
    "opencv": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "ros": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
K = intrinsics(320, 240, 45.0)
NO_CLASS = DetectConfig(classify=False)


def seen(family: str, seed: int, elevation_deg: float, *, table_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a thing and of the table within table_m of it, in the camera's frame; T_world_camera; and up there."""
    mesh = make_shape(family, seed).mesh.copy()
    middle = np.array([0.0, 0.0, mesh.extents[2] / 2])
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    e, a = np.radians(elevation_deg), 0.7
    T = look_at(middle + 0.6 * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]), middle)
    image, index = render_mesh_view([mesh], T_world_camera=T, K=K, width=320, height=240, table_height=0.0)
    points = camera_points(image)
    on_table = (index == 1) & (np.linalg.norm(image.points()[..., :2], axis=-1) < table_m)
    points = points[(index == 0) | on_table]
    noise = np.random.default_rng(seed).normal(scale=0.0008, size=len(points))
    return points + noise[:, None] * (0, 0, 1), T, T[:3, :3].T @ (0.0, 0.0, 1.0)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_is_told_by_where_its_points_lie(frame: str) -> None:
    points, _, _ = seen("mug", 1, 30.0, table_m=0.15)
    found = sensor_frame(points @ FRAMES[frame].T)
    assert found is not None
    np.testing.assert_array_equal(found.R_frame_opencv, FRAMES[frame])


def test_points_around_the_origin_and_no_points_tell_no_frame() -> None:
    points = np.random.default_rng(0).normal(size=(500, 3))
    assert sensor_frame(points) is None
    assert sensor_frame(points - np.array([0, 9, 0])) is None
    assert sensor_frame(np.full((4, 3), np.nan)) is None
    strays = np.vstack([points + np.array([0, 0, 9]), [[0, 0, -1]]])
    assert sensor_frame(strays) is not None


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    ("family", "seed", "elevation_deg"), [("mug", 2, 50.0), ("bottle", 3, 22.0), ("cup", 2, 35.0), ("bottle", 2, 35.0)]
)
def test_up_of_an_object_alone_is_found_within_ten_degrees(
    frame: str, family: str, seed: int, elevation_deg: float
) -> None:
    points, _, up = seen(family, seed, elevation_deg, table_m=0.0)
    R = FRAMES[frame]
    with pytest.warns(UserWarning, match="up is guessed to be"):
        found = detect_single(points @ R.T, viewpoint=np.zeros(3), up=None, config=NO_CLASS)
    assert np.degrees(np.arccos(min(found.up @ (R @ up), 1.0))) < 10


@pytest.mark.parametrize("frame", FRAMES)
def test_up_of_an_object_on_its_table_is_the_table_s_normal(frame: str) -> None:
    points, _, up = seen("mug", 1, 30.0, table_m=0.15)
    R = FRAMES[frame]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = detect_single(points @ R.T, viewpoint=np.zeros(3), up=None, config=NO_CLASS)
    assert found.support is not None
    assert np.degrees(np.arccos(min(found.up @ (R @ up), 1.0))) < 0.5


@pytest.mark.parametrize(("family", "seed", "elevation_deg"), [("cup", 4, 22.0), ("cup", 2, 35.0), ("mug", 6, 22.0)])
def test_a_slab_of_a_round_wall_is_no_table(family: str, seed: int, elevation_deg: float) -> None:
    points, _, _ = seen(family, seed, elevation_deg, table_m=0.0)
    for R in FRAMES.values():
        assert find_support(points @ R.T, None, viewpoint=np.zeros(3)) is None


@pytest.mark.parametrize("viewpoint", [None, (0.0, 0.0, 0.0)])
def test_a_table_far_from_the_up_that_is_assumed_is_named(monkeypatch: pytest.MonkeyPatch, viewpoint) -> None:
    monkeypatch.setattr("gfp_grasp.complete._complete", lambda *_, **__: None)
    points, _, up = seen("mug", 1, 28.0, table_m=0.15)
    normal = rf"\(0.00, {up[1]:.2f}, {up[2]:.2f}\)"
    told = rf"(79|80)% of the points lie in one plane, whose normal {normal} is 118 degrees from up"
    with pytest.warns(UserWarning, match=told):
        complete_to_mesh(points, viewpoint=viewpoint)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        complete_to_mesh(points, viewpoint=viewpoint, up=up)
        complete_to_mesh(points, viewpoint=viewpoint, up=None)


@pytest.mark.parametrize("elevation_deg", [15.0, 60.0])
@pytest.mark.parametrize("table_m", [0.0, 0.15])
def test_a_level_table_or_none_at_all_is_not_named(
    monkeypatch: pytest.MonkeyPatch, elevation_deg: float, table_m: float
) -> None:
    monkeypatch.setattr("gfp_grasp.complete._complete", lambda *_, **__: None)
    points, T, _ = seen("bottle", 2, elevation_deg, table_m=table_m)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        complete_to_mesh(apply_T(T, points), viewpoint=T[:3, 3])
        complete_to_mesh(apply_T(T, points))
