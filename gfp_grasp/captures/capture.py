"""What a sensor recorded, and its completion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.captures.scans import is_scan, scan_of
from gfp_grasp.complete import CompleteConfig, Completion, complete_scene, complete_to_mesh
from gfp_grasp.detect import Detector
from gfp_grasp.errors import InvalidCloud, InvalidOption
from gfp_grasp.types import DepthImage, SensorProfile, get_sensor


@dataclass(frozen=True, eq=False)
class Capture:
    """What a sensor recorded: a depth picture, points of one object or of a whole LiDAR scan, or picture and points.

    All of it is in one frame, the world's; where the sensor's pose is not known that is the sensor's own frame.

    Attributes:
        name: Name of the file, without its folder.
        points: (n, 3) m, points of one object or a whole scan, NaN allowed; None where only a picture is known.
        view: The whole depth picture, or None.
        mask: (h, w) bool, the object's pixels in the view, or None.
        viewpoint: (3,) m, where the sensor stood, or None.
        up: (3,) normal of the support; None where it must be estimated.
        support_height: Height of the support along up, m, or None.
        truth: The true mesh in place, where somebody knows it: for measuring, never for completing.
        up_is_assumed: The recording does not say up; z was taken.
        notes: What else was taken for granted in reading it: the unit, the camera's axes. One sentence each.
    """

    name: str
    points: np.ndarray | None = None
    view: DepthImage | None = None
    mask: np.ndarray | None = None
    viewpoint: np.ndarray | None = None
    up: np.ndarray | None = None
    support_height: float | None = None
    truth: trimesh.Trimesh | None = None
    up_is_assumed: bool = False
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.points is None and self.view is None:
            raise InvalidCloud(f"{self.name} holds neither points of an object nor a depth picture")


def complete_capture(
    capture: Capture,
    *,
    category: str | None = None,
    detector: str | Detector | None = None,
    sensor: str | SensorProfile = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> Sequence[Completion]:
    """Complete the one object whose points are known, or else every object of the picture or of the whole scan.

    Points are a whole scan where a LiDAR saw them and they are wider than its profile's `largest_m` (25 m), or where a
    detector is named for them; they are then looked at as `gfp_grasp.camera.range_image` makes a view of them, from
    the viewpoint or else the origin. Up is then an axis of their frame under which a road lies, where it is not known.

    Args:
        capture: The recording.
        category: As complete_to_mesh takes it; a whole picture's objects are classified one by one.
        detector: Detector for the whole picture or scan, see `gfp_grasp.detect.get_detector`, even where the points
            of one object are known; None takes the default where they are not.
        sensor: As complete_to_mesh takes it.
        config: Switches.
        seed: Seed of every random choice.

    Returns:
        One completion, or the `CompletedScene` of a picture or a scan, in the frame of the recording, m.

    Raises:
        InvalidOption: A detector, and no picture or scan for it.
        InvalidView: A scan under no axis of which a road lies, while up is not known.
        GfpGraspError: As complete_to_mesh and complete_scene raise it.
    """
    profile = get_sensor(sensor)
    if capture.view is not None and (detector is not None or capture.points is None):
        return complete_scene(capture.view, up=capture.up, detector=detector, config=config, seed=seed)
    assert capture.points is not None
    if capture.view is None and (detector is not None or is_scan(capture.points, profile)):
        if profile.step_rad == 0:
            raise InvalidOption(
                f"detector {detector!r} looks for objects in a picture, and {capture.name} holds points only; if they "
                'are a whole LiDAR scan, say so (sensor="lidar")'
            )
        up = None if capture.up_is_assumed else capture.up
        scan, up = scan_of(capture.points, viewpoint=capture.viewpoint, up=up, sensor=profile)
        return complete_scene(scan, up=up, detector=detector, config=config, seed=seed)
    completion = complete_to_mesh(
        capture.points,
        viewpoint=capture.viewpoint,
        up=capture.up,
        support_height=capture.support_height,
        view=capture.view,
        mask=capture.mask,
        category=category,
        sensor=sensor,
        config=config,
        seed=seed,
    )
    return (completion,)
