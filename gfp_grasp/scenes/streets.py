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
from gfp_grasp.shapes import IN_STREETS, SPLITS, STREET_FURNITURE, make_shape, split_seeds
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import OrientedBox, RangeImage

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

_LONG_M = 60.0  # of the road, ahead and behind
_LANE_M, _PARKED_M = (3.0, 4.0), (2.1, 2.5)  # widths of a lane and of the strip for parking
_PAVEMENT_M, _KERB_M = (1.8, 4.0), (0.1, 0.16)
_EGO_M = 5.0  # nothing else stands as near to the sensor along the road
_APART_M = 0.35
_TRIES = 40
_MEMBERS = 40  # of each class, that streets are drawn from; ours


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


@dataclass(frozen=True)
class _Plan:
    """y of what runs along the road, m: its kerbs to the right and left, its middle, and the backs of the pavements."""

    middle: float
    kerbs: tuple[float, float]
    backs: tuple[float, float]
    parked_m: float
    kerb_m: float


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
    plan = _Plan(lane / 2, (right, left), (right - pavements[0], left + pavements[1]), parked, rng.uniform(*_KERB_M))
    taken: list[np.ndarray] = [np.array([[-_EGO_M, -lane / 2], [_EGO_M, lane / 2]])]
    things = []
    names = list(IN_STREETS)
    odds = np.array([IN_STREETS[name].share for name in names])
    for name in rng.choice(names, num_things, p=odds / odds.sum()):
        thing = _placed(str(name), str(rng.choice(IN_STREETS[name].places)), plan, rng, split, taken)
        if thing is not None:
            things.append(thing)
    return Street(tuple(things), tuple(_surroundings(plan, rng, split, taken)))


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
    category: str, where: str, plan: _Plan, rng: np.random.Generator, split: str, taken: list[np.ndarray]
) -> StreetThing | None:
    """A member of a class, somewhere that is free; None where it finds no room."""
    mesh = make_shape(category, int(rng.choice(split_seeds(category, split, _MEMBERS)))).mesh
    low, high = np.asarray(mesh.bounds)
    extents, ahead = high - low, (low + high)[:2] / 2
    for _ in range(_TRIES):
        yaw, y, z = _lane_of(where, category, extents, plan, rng)
        R = rotation_about((0, 0, 1), yaw)
        centre = np.array([rng.uniform(-_LONG_M, _LONG_M) * rng.uniform(0.2, 1.0), y])
        half = np.abs(R[:2, :2]) @ extents[:2] / 2 + _APART_M
        box = np.stack([centre - half, centre + half])
        if not _is_free(box, taken):
            continue
        taken.append(box)
        T = make_T(R, np.array([*(centre - R[:2, :2] @ ahead), z - low[2]]))
        placed = mesh.copy()
        placed.apply_transform(T)
        middle = np.array([*centre, z + extents[2] / 2])
        return StreetThing(category, placed, OrientedBox(make_T(R, middle), extents))
    return None


def _is_free(box: np.ndarray, taken: list[np.ndarray]) -> bool:
    """Whether a box (2, 2) m, its lower and upper corner, overlaps none of those that are taken."""
    return not any((box[0] < other[1]).all() and (other[0] < box[1]).all() for other in taken)


def _lane_of(
    where: str, category: str, extents: np.ndarray, plan: _Plan, rng: np.random.Generator
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
    y = rng.uniform(min(plan.kerbs[side], plan.backs[side]), max(plan.kerbs[side], plan.backs[side]))
    return rng.uniform(0, 2 * np.pi), y, plan.kerb_m


def _surroundings(plan: _Plan, rng: np.random.Generator, split: str, taken: list[np.ndarray]) -> list[trimesh.Trimesh]:
    found = []
    for side in range(2):
        kerb, back = plan.kerbs[side], plan.backs[side]
        low, high = sorted((kerb, back))
        found.append(_block([-_LONG_M, low, -0.5], [_LONG_M, high, plan.kerb_m]))
        found += _behind(back, (-1) ** (side + 1), rng)
        for _ in range(rng.poisson(6)):
            x, y = rng.uniform(-_LONG_M, _LONG_M), rng.uniform(low + 0.3, high - 0.3)
            found += _post(x, y, plan.kerb_m, rng, split, taken)
    return found


def _behind(back: float, outwards: int, rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Houses, walls and hedges behind a pavement, with gaps."""
    found, x = [], -_LONG_M
    while x < _LONG_M:
        long_m, kind = rng.uniform(4.0, 18.0), rng.random()
        start = back + outwards * rng.uniform(0.0, 5.0)
        if kind < 0.6:
            deep, high = rng.uniform(4.0, 10.0), rng.uniform(3.0, 14.0)
        elif kind < 0.8:
            deep, high = rng.uniform(0.2, 1.0), rng.uniform(0.6, 2.2)
        else:
            x += long_m
            continue
        end = start + outwards * deep
        found.append(_block([x, min(start, end), 0.0], [x + long_m, max(start, end), high]))
        x += long_m + rng.uniform(0.0, 4.0)
    return found


def _post(
    x: float, y: float, z: float, rng: np.random.Generator, split: str, taken: list[np.ndarray]
) -> list[trimesh.Trimesh]:
    """A pole, a tree, a bush, or a sign or cone, where nothing else stands."""
    reach = np.full(2, 0.5)
    box = np.stack([np.array([x, y]) - reach, np.array([x, y]) + reach])
    if not _is_free(box, taken):
        return []
    taken.append(box)
    kind = rng.random()
    if kind < 0.3:
        name = str(rng.choice(STREET_FURNITURE))
        mesh = make_shape(name, int(rng.choice(split_seeds(name, split, _MEMBERS)))).mesh.copy()
        mesh.apply_transform(make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), (x, y, z)))
        return [mesh]
    if kind < 0.55:
        return [_cylinder(x, y, z, rng.uniform(0.05, 0.15), rng.uniform(3.0, 8.0))]
    if kind < 0.85:
        high = rng.uniform(1.8, 3.5)
        crown = _lump(rng, rng.uniform(0.9, 2.2)).apply_translation((x, y, z + high + 0.8))
        return [_cylinder(x, y, z, rng.uniform(0.08, 0.3), high + 0.5), crown]
    size = rng.uniform(0.3, 0.8)
    return [_lump(rng, size).apply_translation((x, y, z + 0.7 * size))]


def _lump(rng: np.random.Generator, radius_m: float) -> trimesh.Trimesh:
    """Leaves, as a ball whose surface goes in and out."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    rough = rng.uniform(0.7, 1.15, (len(ball.vertices), 1))
    return trimesh.Trimesh(ball.vertices * rough * radius_m * rng.uniform(0.7, 1.2, 3), ball.faces, process=False)


def _cylinder(x: float, y: float, z: float, radius_m: float, height_m: float) -> trimesh.Trimesh:
    made = trimesh.creation.cylinder(radius_m, height_m, sections=16)
    return made.apply_translation((x, y, z + height_m / 2))


def _block(low: list[float], high: list[float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])
