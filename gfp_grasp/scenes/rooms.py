"""Rooms: things on a table, apart or piled up, with a floor, walls and other furniture around, for a depth camera.

Things are dropped and come to rest in MuJoCo as their convex hulls; the camera sees their true meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.errors import InvalidOption, InvalidScene
from gfp_grasp.scenes.check import diverged
from gfp_grasp.scenes.sources import shipped_families
from gfp_grasp.scenes.world import place_clutter
from gfp_grasp.shapes import SPLITS, make_assorted, make_shape, split_seeds
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import DepthImage

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

_LARGEST_M = 0.35  # extent of a thing on a table
_HULL_VERTICES = 40
_FRICTION = (0.8, 0.005, 0.001)  # sliding, and torsion and rolling in m
_FALL_S = 1.5
_STEP_S = 0.004
_BELOW_M = -0.03  # what has its middle lower than this has fallen off the table
_KINDS = {"train": range(1000), "val": range(1000, 2000), "test": range(2000, 3000)}  # of things of no class
_FARTHEST_M = 5.0
_TORN_M = 0.01  # a return this far off the true surface belongs to none


@dataclass(frozen=True, eq=False)
class Room:
    """Things at rest on a table whose top is z = 0, and what stands around it.

    Attributes:
        things: Meshes, world frame, m.
        furniture: Table, floor, walls and other boxes, world frame, m.
    """

    things: tuple[trimesh.Trimesh, ...]
    furniture: tuple[trimesh.Trimesh, ...]


def draw_things(rng: np.random.Generator, num_things: int, *, split: str = "train") -> tuple[trimesh.Trimesh, ...]:
    """Things for a room: members of every family, packets and books, and things of no class.

    Args:
        rng: Source of chance.
        num_things: Number of things.
        split: Split of the shapes that they are drawn from.

    Returns:
        Meshes, m, z up, resting on z = 0.

    Raises:
        InvalidOption: No things, or no such split.
    """
    if num_things < 1 or split not in SPLITS:
        raise InvalidOption(f"{num_things} things of split {split!r}: at least 1, of {', '.join(SPLITS)}, are expected")
    return tuple(_thing(rng, split) for _ in range(num_things))


def make_room(things: Sequence[trimesh.Trimesh], rng: np.random.Generator, *, piled: bool) -> Room:
    """Things at rest on a table, in a room of chance.

    Args:
        things: Meshes, m, z up, resting on z = 0.
        rng: Source of chance.
        piled: Whether they are dropped upon each other, and those that fall off the table are gone; else they stand or
            lie apart, as many as find a place.
    """
    size = np.append(rng.uniform((0.6, 0.45), (1.6, 1.0)), rng.uniform(0.01, 0.06))
    at_rest = _dropped(things, size, rng) if piled else _apart(things, size, rng)
    return Room(at_rest, _furniture(size, rng))


def draw_camera(
    room: Room, rng: np.random.Generator, *, distance_m: float, elevation_deg: tuple[float, float] = (15.0, 75.0)
) -> np.ndarray:
    """T_world_camera (4, 4) of a camera that looks at the things of a room from any side, a little rolled.

    Args:
        room: The room.
        rng: Source of chance.
        distance_m: From the camera to about the middle of the things.
        elevation_deg: Range of the camera's elevation.
    """
    middle = np.mean([thing.bounds.mean(axis=0) for thing in room.things], axis=0)
    aim = middle + np.append(rng.normal(scale=0.08 * distance_m, size=2), 0.0)
    camera = sample_viewpoint(rng, distance_m=distance_m, elevation_deg=elevation_deg, target=aim)
    return camera @ make_T(rotation_about((0, 0, 1), np.radians(rng.normal(scale=5.0))))


def view_room(
    room: Room,
    T_world_camera: np.ndarray,
    rng: np.random.Generator,
    *,
    sensor: SensorModel,
    fov_y_deg: float = 45.0,
    width: int = 320,
    height: int = 240,
) -> tuple[DepthImage, np.ndarray]:
    """A depth picture of a room.

    Args:
        room: The room.
        T_world_camera: (4, 4), OpenCV camera.
        rng: Source of the sensor's chance.
        sensor: What the sensor does to the picture.
        fov_y_deg: Vertical field of view.
        width: Columns.
        height: Rows.

    Returns:
        The picture, and labels (h, w) int32: 0 for background and for no return, k for the k-th thing.
    """
    ideal, index = render_mesh_view(
        [*room.things, *room.furniture],
        T_world_camera=T_world_camera,
        K=intrinsics(width, height, fov_y_deg),
        width=width,
        height=height,
        farthest_m=_FARTHEST_M,
    )
    seen = apply_sensor(ideal, sensor, rng)
    own = (seen.depth_m > 0) & (np.abs(seen.depth_m - ideal.depth_m) < _TORN_M)
    return seen, np.where(own & (index < len(room.things)), index + 1, 0).astype(np.int32)


def _thing(rng: np.random.Generator, split: str) -> trimesh.Trimesh:
    """A member of a family, a packet or book, or a thing of no class; z up, resting on z = 0."""
    chance = rng.random()
    if chance < 0.3:
        low = np.sort(rng.uniform(0, 1, 3)) ** 1.5
        mesh = trimesh.creation.box(np.array([0.012, 0.035, 0.06]) + low * np.array([0.08, 0.15, 0.25]))
        turn = rotation_about(np.eye(3)[rng.integers(3)], np.pi / 2)
        mesh.apply_transform(make_T(turn if rng.random() < 0.5 else None))
    elif chance < 0.7:
        kinds = _KINDS[split]
        mesh = make_assorted(int(rng.integers(kinds.start, kinds.stop)), int(rng.integers(1000)))
        mesh.apply_scale(rng.uniform(0.6, 1.0))
    else:
        families = shipped_families()
        family = families[int(rng.integers(len(families)))]
        mesh = make_shape(family, int(rng.choice(split_seeds(family, split)))).mesh.copy()
    mesh.apply_scale(min(1.0, _LARGEST_M / float(mesh.extents.max())))
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    return mesh


def _apart(
    things: Sequence[trimesh.Trimesh], size: np.ndarray, rng: np.random.Generator
) -> tuple[trimesh.Trimesh, ...]:
    """As many of the things as find a place beside each other."""
    gap_m = rng.choice([0.0, 0.004, 0.02])
    for count in range(len(things), 1, -1):
        with suppress(InvalidScene):
            poses = place_clutter(things[:count], rng, radius_m=0.4 * size[1], gap_m=gap_m, lying_share=0.25)
            return tuple(thing.copy().apply_transform(T) for thing, T in zip(things, poses, strict=False))
    return (things[0].copy(),)


def _dropped(
    things: Sequence[trimesh.Trimesh], size: np.ndarray, rng: np.random.Generator
) -> tuple[trimesh.Trimesh, ...]:
    """The things as they have come to rest on the table, one dropped after the other, those gone that fell off it."""
    spec = mujoco.MjSpec()
    spec.option.timestep = _STEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 5.0
    spec.memory = 2**27
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[size[0] / 2, size[1] / 2, 0.05],
        pos=[0, 0, -0.05],
        friction=_FRICTION,
    )
    reach_m, top = rng.uniform(0.02, 0.16), 0.0
    starts = []
    for number, thing in enumerate(things):
        centre = thing.bounds.mean(axis=0)
        R = _turn(rng)
        turned = (np.asarray(thing.vertices) - centre) @ R.T
        at = np.append(rng.normal(scale=reach_m, size=2), top + 0.005 - turned[:, 2].min())
        top = top + 0.005 + float(np.ptp(turned[:, 2]))
        T = make_T(R, at - R @ centre)
        starts.append(T)
        mesh = spec.add_mesh(name=f"hull_{number}", maxhullvert=_HULL_VERTICES)
        mesh.uservert = np.asarray(thing.convex_hull.vertices).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
        body = spec.worldbody.add_body(name=f"thing_{number}")
        body.add_freejoint()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{number}", density=400, friction=_FRICTION)
    model = spec.compile()
    data = mujoco.MjData(model)
    for number, T in enumerate(starts):
        data.qpos[7 * number : 7 * number + 3] = T[:3, 3]
        mujoco.mju_mat2Quat(data.qpos[7 * number + 3 : 7 * number + 7], T[:3, :3].ravel())
    mujoco.mj_step(model, data, nstep=round((_FALL_S + np.sqrt(2 * top / 9.81)) / _STEP_S))
    if diverged(data):
        return _apart(things, size, rng)
    rested = []
    for number, thing in enumerate(things):
        body = model.body(f"thing_{number}").id
        if data.xipos[body, 2] > _BELOW_M:
            rested.append(thing.copy().apply_transform(make_T(data.xmat[body].reshape(3, 3), data.xpos[body])))
    return tuple(rested) or _apart(things, size, rng)


def _turn(rng: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3): half of the things fall upright, a quarter on a side and a quarter anyhow."""
    yaw, roll = (rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)) for _ in range(2))
    way = rng.random()
    if way < 0.5:
        return yaw
    tilt = np.pi / 2 if way < 0.75 else rng.uniform(0, np.pi)
    return yaw @ rotation_about((1, 0, 0), tilt) @ roll


def _furniture(size: np.ndarray, rng: np.random.Generator) -> tuple[trimesh.Trimesh, ...]:
    """A table (or one without an end), a floor under it, up to two walls, up to two boxes as large as furniture."""
    endless = rng.random() < 0.25
    low = -rng.uniform(0.3, 0.9)
    parts = [_box((6.0, 6.0, 0.05) if endless else size, (0.0, 0.0, 0.0))]
    if rng.random() < 0.85:
        parts.append(_box((12.0, 12.0, 0.1), (0.0, 0.0, low)))
    for _ in range(int(rng.integers(3))):
        turn = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi))
        away = rng.uniform(0.5, 1.5) * float(np.linalg.norm(size[:2]))
        parts.append(_box((0.1, 8.0, 4.0), (away + 0.05, 0.0, 2.0), turn))
    for _ in range(int(rng.integers(3))):
        extents = rng.uniform((0.3, 0.3, 0.3), (1.0, 0.8, 1.1))
        turn = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi))
        away = 0.5 * float(np.linalg.norm(size[:2]) + np.linalg.norm(extents[:2])) + rng.uniform(0.0, 0.5)
        parts.append(_box(extents, (away, rng.uniform(-0.5, 0.5), low + extents[2]), turn))
    return tuple(parts)


def _box(
    extents: Sequence[float] | np.ndarray, top: Sequence[float], turn: np.ndarray | None = None
) -> trimesh.Trimesh:
    """A box (its extents, m) whose top has its middle at a place, both turned about the world's z axis."""
    size = np.asarray(extents)
    box = trimesh.creation.box(size)
    box.apply_translation(np.asarray(top) - (0.0, 0.0, size[2] / 2))
    return box.apply_transform(make_T(turn))
