"""Thresholds of completers, captures and scenes, a little to either side."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from bodies import box_part

from gfp_grasp.captures import read_capture
from gfp_grasp.completers import get_completer, mirror_cloud
from gfp_grasp.errors import InvalidCloud, InvalidScene, InvalidView
from gfp_grasp.scenes import Handles, SceneObject
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Detection, Grasp, OrientedBox, PointCloud, SupportPlane

UP = np.array([0.0, 0.0, 1.0])


def detection_of(points: np.ndarray, viewpoint: tuple[float, float, float]) -> Detection:
    box = OrientedBox(np.eye(4), np.ptp(points, axis=0))
    return Detection(PointCloud(points, np.array(viewpoint)), UP, SupportPlane(UP, 0.0), "cup", {"cup": 1.0}, box)


@pytest.mark.parametrize(("share", "flat"), [(0.8e-5, True), (1.3e-5, False)])
def test_points_are_flat_below_a_hundred_thousandth_of_their_spread(share, flat):
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * (0.05, 0.03, 0.05 * share)
    found = detection_of(corners, (0.0, 0.0, 1.0))
    if flat:
        with pytest.raises(InvalidCloud, match="no volume"):
            get_completer("observed")(found)
    else:
        assert get_completer("observed")(found).mesh.volume > 0


@pytest.mark.parametrize(("aside_m", "along"), [(0.8e-6, 1), (1.4e-6, 0)])
def test_a_viewer_within_a_micrometre_of_straight_above_has_no_side(aside_m, along):
    """From straight above the mirror stands across y, from aside it faces the viewer, here along x."""
    points = np.array([[-0.02, -0.03, 0.0], [0.02, 0.03, 0.0], [-0.02, 0.03, 0.1], [0.02, -0.03, 0.1]])
    images = mirror_cloud(detection_of(points, (aside_m, 0.0, 1.0)))[4:]
    moved = np.abs(images - points).max(axis=0) > 1e-9
    assert moved.tolist() == [axis == along for axis in range(3)]


@pytest.mark.parametrize(("stretch", "taken"), [(0.4e-4, True), (0.7e-4, False)])
def test_a_pose_of_a_recording_is_rigid_within_a_ten_thousandth(tmp_path: Path, stretch: float, taken: bool):
    T = np.diag([1.0 + stretch, 1.0, 1.0, 1.0])  # its square is off by twice as much
    np.savez(tmp_path / "a.npz", object_points_cam=np.ones((4, 3)), T_world_camera=T)
    if taken:
        assert read_capture(tmp_path / "a.npz").viewpoint is not None
    else:
        with pytest.raises(InvalidView, match="rigid"):
            read_capture(tmp_path / "a.npz")


@pytest.mark.parametrize(("skew", "taken"), [(0.8e-6, True), (1.4e-6, False)])
def test_a_pose_of_an_object_is_rigid_within_a_millionth(skew: float, taken: bool):
    T = make_T(None, (0, 0, 0.1)).copy()
    T[0, 1] = skew
    parts = (box_part([0, 0, 0], [0.1, 0.1, 0.1]),)
    if taken:
        assert SceneObject("a", parts, None, T, 0.2, 0.5).fixed is False
    else:
        with pytest.raises(InvalidScene, match="rigid"):
            SceneObject("a", parts, None, T, 0.2, 0.5)


@pytest.mark.parametrize(("beyond_m", "reached"), [(0.8e-6, True), (1.4e-6, False)])
def test_the_jaws_reach_their_stroke_and_a_micrometre(beyond_m: float, reached: bool):
    assert Handles.reaches(None, Grasp(np.eye(4), 0.08 + beyond_m)) == reached  # type: ignore[arg-type]
