"""Pictures: depth as colour, a completion over the truth, short clips, and a trial as a film."""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from gfp_grasp.camera import intrinsics, render_mesh_view, surface_normals
from gfp_grasp.envs import TrialSettings, run_trial, shade
from gfp_grasp.scenes import TARGET, World
from gfp_grasp.transforms import look_at, rotation_about
from gfp_grasp.types import DepthImage, Grasp, Outcome

# Near to far. Light grows evenly from one stop to the next, so that the order survives in grey.
_STOPS = np.array([(253, 231, 160), (246, 177, 97), (214, 98, 92), (140, 49, 111), (62, 26, 90), (16, 14, 42)], float)
_NOTHING = (205, 209, 214)
_FIRST_HUE, _GOLDEN_TURN = 0.8, (5**0.5 - 1) / 2  # the first is unlike the colours of seen and guessed surface
_OBJECT_SHARE = 0.65  # of an object's colour in its pixels

# The truth is dark and the completion light, so that the two are told apart in grey.
_RGB = ((0.20, 0.38, 0.62), (0.98, 0.68, 0.26))
_TABLE_RGB = (0.90, 0.91, 0.93)
# Camera frame: the lamp goes along, over the left shoulder, so that both looks are equally bright.
_LIGHT = np.array([-0.45, -0.6, -0.66]) / np.linalg.norm([-0.45, -0.6, -0.66])
_PANEL_PX, _SUPERSAMPLE = 300, 2
_FOV_DEG, _ELEVATION_RAD = 30.0, np.deg2rad(22.0)
_MARGIN = 1.02  # share of the sphere around both shapes that the camera has in view
_ASIDE_RAD = (0.0, np.deg2rad(100.0))
_FARTHEST_M = 10.0
_FROM_FRONT_LEFT = np.array([0.62, 0.62, 0.48]) / np.linalg.norm([0.62, 0.62, 0.48])
# The nearer surface counts for so much of a pixel and takes over within this depth, so that agreement does not flicker.
_NEARER, _AGREE_M = 0.72, 0.001


def write_depth(path: Path, depth_m: np.ndarray) -> None:
    """Write depth (h, w) m as a PNG: light is near, dark is far, grey came back with nothing."""
    seen = depth_m > 0
    low, high = np.quantile(depth_m[seen], [0.005, 0.995]) if seen.any() else (0.0, 1.0)
    share = np.clip((depth_m - low) / max(high - low, 1e-6), 0.0, 1.0) * (len(_STOPS) - 1)
    stops = np.arange(len(_STOPS))
    colour = np.stack([np.interp(share, stops, _STOPS[:, c]) for c in range(3)], axis=-1)
    colour[~seen] = _NOTHING
    Image.fromarray(colour.astype(np.uint8)).save(path, optimize=True)


def apart(num: int) -> np.ndarray:
    """(num, 3) uint8, neighbours in the list far apart from each other: hues turn by the golden ratio."""
    rows = [
        colorsys.hsv_to_rgb((_FIRST_HUE + i * _GOLDEN_TURN) % 1.0, 0.55 + 0.2 * (i % 2), 0.9 - 0.15 * (i % 3))
        for i in range(num)
    ]
    return (255 * np.array(rows).reshape(num, 3)).round().astype(np.uint8)


def paint_objects(depth_m: np.ndarray, masks: Sequence[np.ndarray]) -> np.ndarray:
    """(h, w, 3) uint8: depth (h, w) m in grey, near is light, and objects, masks (h, w) bool, in their own colours."""
    seen = depth_m > 0
    low, high = np.quantile(depth_m[seen], [0.005, 0.9]) if seen.any() else (0.0, 1.0)
    light = np.where(seen, 0.9 - 0.6 * np.clip((depth_m - low) / max(high - low, 1e-6), 0.0, 1.0), 0.1)
    picture = np.repeat(light[..., None], 3, axis=2)
    for mask, colour in zip(masks, apart(len(masks)), strict=True):
        picture[mask] = _OBJECT_SHARE * colour / 255 + (1 - _OBJECT_SHARE) * picture[mask]
    return (255 * picture).round().astype(np.uint8)


def write_clip(path: Path, frames: Sequence[np.ndarray], *, frame_ms: int = 80) -> None:
    """Write frames (h, w, 3) uint8 as a GIF that repeats; all frames share one palette, so nothing flickers."""
    palette = Image.fromarray(np.concatenate(frames[:: max(1, len(frames) // 6)])).quantize(128)
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [frame_ms] * (len(pictures) - 1) + [1200]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True)


def overlay(truth: trimesh.Trimesh, completed: trimesh.Trimesh | None, *, seen_from: np.ndarray) -> np.ndarray:
    """Picture (h, 2 h, 3) uint8 of truth and completion, both translucent.

    Args:
        truth: True mesh, world frame, z up, m, over a table at z = 0.
        completed: Completed mesh in the same frame; None shows the truth alone.
        seen_from: (3,) m, where the camera stood. The left half looks from there, the right half from 100 degrees
            aside.
    """
    meshes = [truth] if completed is None else [truth, completed]
    corners = np.concatenate([mesh.bounds for mesh in meshes])
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius_m = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0))) / 2
    distance_m = _MARGIN * radius_m / np.sin(np.deg2rad(_FOV_DEG) / 2)
    level = (np.asarray(seen_from, dtype=np.float64) - centre) * (1.0, 1.0, 0.0)
    towards = level / np.linalg.norm(level) if np.linalg.norm(level) > 1e-9 else np.array([1.0, 0.0, 0.0])
    panels = []
    for aside_rad in _ASIDE_RAD:
        turned = rotation_about((0.0, 0.0, 1.0), aside_rad) @ towards
        offset = np.cos(_ELEVATION_RAD) * turned + np.array([0.0, 0.0, np.sin(_ELEVATION_RAD)])
        panels.append(_panel(meshes, look_at(centre + distance_m * offset, centre)))
    return np.concatenate(panels, axis=1)


def shaded_panel(mesh: trimesh.Trimesh, *, framed: trimesh.Trimesh | None = None) -> np.ndarray:
    """Picture (h, h, 3) uint8 of one mesh on white, seen from its front and left, from a little above.

    Args:
        mesh: The mesh, z up, m.
        framed: What fills the picture; None for the mesh itself.
    """
    size = _SUPERSAMPLE * _PANEL_PX
    framed = framed or mesh
    centre, radius_m = framed.bounds.mean(axis=0), float(np.linalg.norm(framed.extents)) / 2
    distance_m = _MARGIN * radius_m / np.sin(np.deg2rad(_FOV_DEG) / 2)
    image, _ = render_mesh_view(
        [mesh],
        T_world_camera=look_at(centre + distance_m * _FROM_FRONT_LEFT, centre),
        K=intrinsics(size, size, _FOV_DEG),
        width=size,
        height=size,
        farthest_m=2 * distance_m,
    )
    colour = np.where(image.depth_m[..., None] > 0, _shaded(image, _RGB[1]), 1.0)
    return _shrunk(colour)


def _panel(meshes: Sequence[trimesh.Trimesh], T_world_camera: np.ndarray) -> np.ndarray:
    size = _SUPERSAMPLE * _PANEL_PX
    K = intrinsics(size, size, _FOV_DEG)

    def cast(seen: Sequence[trimesh.Trimesh], table_height: float | None = None) -> DepthImage:
        view = {"T_world_camera": T_world_camera, "K": K, "width": size, "height": size}
        return render_mesh_view(seen, **view, table_height=table_height, farthest_m=_FARTHEST_M)[0]

    table_m = _depth(cast([], table_height=0.0))
    colour = np.broadcast_to(np.array(_TABLE_RGB), (size, size, 3))
    layers = []
    for mesh, rgb in zip(meshes, _RGB, strict=False):
        image = cast([mesh])
        # What has sunk into the table is not seen, but for the thickness of a surface that lies on it.
        depth_m = np.where(_depth(image) > table_m + _AGREE_M, np.inf, _depth(image))
        layers.append((_shaded(image, rgb), depth_m))
        colour = np.where(np.isfinite(depth_m)[..., None], layers[-1][0], colour)
    if len(layers) == 2:
        (first, first_m), (second, second_m) = layers
        both = np.isfinite(first_m) & np.isfinite(second_m)
        ahead_m = np.where(both, first_m, 0.0) - np.where(both, second_m, 0.0)
        share = 0.5 + (_NEARER - 0.5) * np.tanh(ahead_m / _AGREE_M)[..., None]  # share of the second
        colour = np.where(both[..., None], share * second + (1 - share) * first, colour)
    return _shrunk(colour)


def _shrunk(colour: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of a picture of _SUPERSAMPLE times that size, colours in 0 .. 1."""
    small = colour.reshape(_PANEL_PX, _SUPERSAMPLE, _PANEL_PX, _SUPERSAMPLE, 3).mean(axis=(1, 3))
    return (255 * np.clip(small, 0.0, 1.0)).astype(np.uint8)


def _depth(image: DepthImage) -> np.ndarray:
    """(h, w) m, inf where nothing is seen."""
    return np.where(image.depth_m > 0, image.depth_m, np.inf)


def _shaded(image: DepthImage, rgb: tuple[float, float, float]) -> np.ndarray:
    """Colour (h, w, 3) by the angle to the lamp, as the environment's own pictures have it."""
    facing = np.clip(np.nan_to_num(surface_normals(image) @ _LIGHT, nan=0.5), 0.0, 1.0)
    return np.array(rgb) * (0.45 + 0.55 * facing)[..., None]


# 240 ms of simulation between two frames, which are shown for 80 ms each.
_COMMANDS_A_FRAME = 24
FRAME_PX = (400, 300)
# The camera looks down by this much, from the side of the front right. It has the object in view where it stands, and
# the whole gripper at the top of the lift.
_FRONT, _FILM_ELEVATION_RAD, _LOOK_AT_M = np.array([0.76, -0.65, 0.0]), np.deg2rad(20.0), 0.24
_ALONE_M, _CLUTTER_M = 0.92, 1.0
_FROM_THE_SIDE, _OBLIQUE_RAD, _UP = 0.5, np.deg2rad(55.0), np.array([0.0, 0.0, 1.0])


def filmed_trial(
    world: World,
    grasp: Grasp,
    settings: TrialSettings | None = None,
    *,
    target: str = TARGET,
    alone: bool,
    commands_a_frame: int = _COMMANDS_A_FRAME,
) -> tuple[Outcome, list[np.ndarray]]:
    """Run a trial as `gfp_grasp.envs.run_trial` does, and take pictures of it.

    Args:
        world: Objects at rest; left as the trial ends.
        grasp: Grasp in the world's frame.
        settings: Numbers of the trial.
        target: Name of the object.
        alone: Whether nothing else stands on the table: the camera is nearer then.
        commands_a_frame: Commands of the gripper between two pictures.

    Returns:
        The outcome, and frames (h, w, 3) uint8; the last frame shows how the trial ended.
    """
    width, height = FRAME_PX
    T_world_camera = film_camera(grasp, alone=alone)
    frames: list[np.ndarray] = []

    def shoot() -> None:
        frames.append(shade(world.model, world.data, width=width, height=height, T_world_camera=T_world_camera))

    on_step = every_nth(commands_a_frame, shoot)
    outcome = run_trial(world, grasp, settings, target=target, on_step=on_step)
    shoot()
    return outcome, frames


def every_nth(num: int, act: Callable[[], None]) -> Callable[[object], None]:
    """A function for `on_step` of `run_trial` that acts at its calls 0, num, 2 num and so on."""
    calls = 0

    def on_step(_: object) -> None:
        nonlocal calls
        if calls % num == 0:
            act()
        calls += 1

    return on_step


def film_camera(grasp: Grasp, *, alone: bool) -> np.ndarray:
    """T_world_camera (4, 4) that looks across the closing axis, so that both jaws show.

    A gripper that comes from the side is looked at obliquely from behind, so that neither it nor the object is hidden.
    """
    closing = grasp.T_world_gripper[:3, 1] * (1.0, 1.0, 0.0)
    behind = -grasp.T_world_gripper[:3, 2] * (1.0, 1.0, 0.0)
    if np.linalg.norm(behind) > _FROM_THE_SIDE:
        sides = [rotation_about(_UP, sign * _OBLIQUE_RAD) @ behind / np.linalg.norm(behind) for sign in (-1.0, 1.0)]
        towards = max(sides, key=lambda side: float(side @ _FRONT))
    else:  # the gripper comes from above, so that its jaws close nearly level
        across = np.cross((0.0, 0.0, 1.0), closing / np.linalg.norm(closing))
        towards = across if across @ _FRONT > 0 else -across
    level, height = np.cos(_FILM_ELEVATION_RAD) * towards, np.array([0.0, 0.0, np.sin(_FILM_ELEVATION_RAD)])
    target = np.array([0.0, 0.0, _LOOK_AT_M])
    return look_at(target + (_ALONE_M if alone else _CLUTTER_M) * (level + height), target)
