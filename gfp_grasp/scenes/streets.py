"""Streets: a road between kerbs, pavements and houses, with parked and moving vehicles and people, for a LiDAR.

The sensor's car stands at the origin of the world, on the right lane, and drives along x; the road is z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh

from gfp_grasp.camera import HDL_64, LidarModel, scan_meshes
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes.roadside import LONG_M, MEMBERS, RoadPlan, draw_roadside, is_free, member
from gfp_grasp.shapes import IN_STREETS, SPLITS, split_seeds
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import OrientedBox, RangeImage

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

_LANE_M, _PARKED_M = (3.0, 4.0), (2.1, 2.5)  # widths of a lane and of the strip for parking
_PAVEMENT_M, _KERB_M = (1.8, 4.0), (0.1, 0.16)
_EGO_M = 5.0  # nothing else stands as near to the sensor along the road
_APART_M = 0.35
_TRIES = 40
_YARD_M = (1.5, 9.0)  # how far behind the pavement things stand that are not on the road
_TURNED_RAD = (0.0, np.pi / 4, np.pi / 3, np.pi / 2)  # how a row of parked vehicles stands to the road
_IN_ROW = 0.7  # share of what stands in yards that belongs to a row


@dataclass(frozen=True, eq=False)
class StreetThing:
    """A vehicle or a person.

    Attributes:
        category: Class.
        mesh: World frame, m.
        box: x forward, z up.
    """

    category: str
    mesh: trimesh.Trimesh
    box: OrientedBox


@dataclass(frozen=True, eq=False)
class Street:
    """A street with what is on it.

    Attributes:
        things: Vehicles and people, whose boxes are the truth of a detection.
        surroundings: Kerbs, pavements, houses, walls, poles, signs, trees and bushes; world frame, m.
    """

    things: tuple[StreetThing, ...]
    surroundings: tuple[trimesh.Trimesh, ...]


def draw_street(rng: np.random.Generator, *, num_things: int = 20, split: str = "train") -> Street:
    """A street by chance.

    Args:
        rng: Source of chance.
        num_things: Vehicles and people; fewer where the street has no room.
        split: Split of the shapes that they are drawn from.

    Raises:
        InvalidOption: An unknown split, or a negative number.
    """
    if split not in SPLITS or num_things < 0:
        raise InvalidOption(
            f"num_things is {num_things}, split {split!r}; zero or more and one of {', '.join(SPLITS)} are expected"
        )
    lane, parked = rng.uniform(*_LANE_M), rng.uniform(*_PARKED_M)
    right, left = -lane / 2 - parked, lane * 1.5 + parked
    pavements = rng.uniform(*_PAVEMENT_M, size=2)
    backs = right - pavements[0], left + pavements[1]
    row, other_row = (
        (float(rng.uniform(*_YARD_M)), float(rng.choice(_TURNED_RAD) * rng.choice((-1, 1)))) for _ in range(2)
    )
    plan = RoadPlan(lane / 2, (right, left), backs, parked, rng.uniform(*_KERB_M), (row, other_row))
    taken: list[np.ndarray] = [np.array([[-_EGO_M, -lane / 2], [_EGO_M, lane / 2]])]
    things = []
    names = list(IN_STREETS)
    odds = np.array([IN_STREETS[name].share for name in names])
    for name in rng.choice(names, num_things, p=odds / odds.sum()):
        thing = _placed(str(name), str(rng.choice(IN_STREETS[name].places)), plan, rng, split, taken)
        if thing is not None:
            things.append(thing)
    return Street(tuple(things), tuple(draw_roadside(plan, rng, split, taken)))


def scan_street(
    street: Street, rng: np.random.Generator | None, *, lidar: LidarModel = HDL_64
) -> tuple[RangeImage, np.ndarray]:
    """One turn of the sensor.

    Returns:
        The scan, and for each shot the number (h, w) int32 of the thing that it met; -1 for anything else.
    """
    meshes = [thing.mesh for thing in street.things] + list(street.surroundings)
    T = make_T(None, (0.0, 0.0, lidar.height_m))
    image, index = scan_meshes(meshes, T_world_sensor=T, lidar=lidar, ground_m=0.0, rng=rng)
    return image, np.where(index < len(street.things), index, -1).astype(np.int32)


def compile_street(street: Street) -> mujoco.MjModel:
    """The street in MuJoCo, nothing of it moving: bodies `thing_0` on by their numbers, `road`, and the rest."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(name="road", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    named = [(f"thing_{i}", thing.mesh) for i, thing in enumerate(street.things)]
    for name, mesh in [*named, *((f"around_{i}", mesh) for i, mesh in enumerate(street.surroundings))]:
        middle = np.asarray(mesh.bounds).mean(axis=0)
        spec.add_mesh(
            name=name,
            uservert=(np.asarray(mesh.vertices) - middle).astype(np.float32).ravel(),
            userface=np.asarray(mesh.faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body = spec.worldbody.add_body(name=name, pos=middle)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, contype=0, conaffinity=0)
    return spec.compile()


def _placed(
    category: str, where: str, plan: RoadPlan, rng: np.random.Generator, split: str, taken: list[np.ndarray]
) -> StreetThing | None:
    """A member of a class, somewhere that is free; None where it finds no room."""
    mesh = member(category, int(rng.choice(split_seeds(category, split, MEMBERS))))
    low, high = np.asarray(mesh.bounds)
    extents, ahead = high - low, (low + high)[:2] / 2
    for _ in range(_TRIES):
        yaw, y, z = _lane_of(where, category, extents, plan, rng)
        R = rotation_about((0, 0, 1), yaw)
        centre = np.array([rng.uniform(-LONG_M, LONG_M) * rng.uniform(0.2, 1.0), y])
        half = np.abs(R[:2, :2]) @ extents[:2] / 2 + _APART_M
        box = np.stack([centre - half, centre + half])
        if not is_free(box, taken):
            continue
        taken.append(box)
        T = make_T(R, np.array([*(centre - R[:2, :2] @ ahead), z - low[2]]))
        placed = mesh.copy()
        placed.apply_transform(T)
        middle = np.array([*centre, z + extents[2] / 2])
        return StreetThing(category, placed, OrientedBox(make_T(R, middle), extents))
    return None


def _lane_of(
    where: str, category: str, extents: np.ndarray, plan: RoadPlan, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Heading, y and height of the ground of something; right is 0 and left 1."""
    side = int(rng.integers(2))
    along = np.pi * side + rng.normal(scale=0.05)
    if where == "parked":
        turned = np.pi * (rng.random() < 0.1)
        inwards = (-1) ** side * (extents[1] / 2 + rng.uniform(0.1, 0.4))
        return along + turned, plan.kerbs[side] + inwards, 0.0
    if where == "moving":
        lane = plan.middle + (-1) ** (side + 1) * rng.uniform(0.3, 0.7) * (plan.kerbs[1] - plan.middle - plan.parked_m)
        crossing = IN_STREETS[category].crosses
        return (rng.uniform(0, 2 * np.pi) if crossing else along), lane + rng.normal(scale=0.15), 0.0
    if where == "yard":
        behind, turn = plan.rows[side]
        if rng.random() < _IN_ROW:
            turned = along + turn + np.pi * rng.integers(2)
        else:
            behind, turned = rng.uniform(*_YARD_M), rng.uniform(0, 2 * np.pi)
        half = float(np.abs([np.sin(turned), np.cos(turned)]) @ extents[:2] / 2)
        return turned, plan.backs[side] - (-1) ** side * (half + behind), 0.0
    y = rng.uniform(min(plan.kerbs[side], plan.backs[side]), max(plan.kerbs[side], plan.backs[side]))
    return rng.uniform(0, 2 * np.pi), y, plan.kerb_m
