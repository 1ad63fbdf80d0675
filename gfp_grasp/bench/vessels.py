"""Whether hollow things are hollow in MuJoCo: a marble falls in, a handle hangs on a peg, a foot stands on a plane."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.export import mass_properties
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import ConvexPart

_STEP_S = 0.0005
# MuJoCo's default of 0.02 s lets a falling marble sink by centimetres, through any floor.
_CONTACT_S = 0.002
_DROP_M = 0.02  # above the rim
_GRID = 40
# Cells of the map that is rained on; a wall thinner than a cell would leak.
_CELL_M, _MOST_CELLS = 0.001, 256
_FOUR = ndimage.generate_binary_structure(2, 1)


@dataclass(frozen=True, eq=False)
class Inside:
    """The inside of an open vessel, z up.

    Attributes:
        middle: (3,) m, halfway between floor and brim, where the opening leaves most room.
        floor_m: Height of the floor below that place.
        brim_m: Height up to which it would hold water.
        rim_m: Height of the highest point of the vessel.
        room_m: Radius of the largest ball that comes in from above and gets as deep as the middle.
    """

    middle: np.ndarray
    floor_m: float
    brim_m: float
    rim_m: float
    room_m: float


def inside_of(mesh: trimesh.Trimesh, *, least_depth_m: float = 0.015) -> Inside | None:
    """The inside of a mesh that is open at its top: where rain that falls on it would stay.

    Args:
        mesh: Watertight, z up, m.
        least_depth_m: A dent that holds less water than this is no inside.

    Returns:
        The largest one by the water that it holds; None where there is none.
    """
    low, high = np.array(mesh.bounds)
    cell = max(_CELL_M, float(np.ptp(mesh.bounds[:, :2], axis=0).max()) / _MOST_CELLS)
    xs, ys = (np.arange(low[axis] - 2 * cell, high[axis] + 2 * cell, cell) for axis in (0, 1))
    above = np.stack([*np.meshgrid(xs, ys, indexing="ij"), np.full((len(xs), len(ys)), high[2] + _DROP_M)], axis=-1)
    fall = _rays(mesh, above.reshape(-1, 3), np.tile([0, 0, -1.0], (len(xs) * len(ys), 1)))
    heights = np.where(np.isfinite(fall), high[2] + _DROP_M - fall, low[2]).reshape(above.shape[:2])
    water = _filled(heights)
    pools = np.asarray(ndimage.label(water - heights > least_depth_m / 2)[0])  # pyright: ignore[reportIndexIssue]
    volumes = np.bincount(pools.ravel(), (water - heights).ravel())
    for pool in 1 + np.argsort(volumes[1:])[::-1]:
        inner = pools == pool
        depth = float((water - heights)[inner].max())
        if depth < least_depth_m:
            continue
        brim = float(water[inner].max())
        room = cell * np.asarray(ndimage.distance_transform_edt(inner & (heights <= brim - depth / 2)))
        column = np.unravel_index(room.argmax(), room.shape)
        floor = float(heights[column])
        middle = np.array([*above[column][:2], (floor + brim) / 2])
        return Inside(middle, floor, brim, float(high[2]), float(room[column]))
    return None


def _filled(heights: np.ndarray) -> np.ndarray:
    """Height of the water on a map of heights (x, y) m after long rain, everything beyond the map being a drain."""
    water = np.full_like(heights, np.inf)
    water[[0, -1]], water[:, [0, -1]] = heights[[0, -1]], heights[:, [0, -1]]
    while True:
        # Water goes to four neighbours, not eight, so that walls one cell thick are tight.
        lower = np.maximum(heights, ndimage.minimum_filter(water, footprint=_FOUR, mode="nearest"))
        lower = np.minimum(lower, water)
        if np.array_equal(lower, water):
            return water
        water = lower


def drop_marble(
    parts: Sequence[ConvexPart], inside: Inside, *, radius_m: float = 0.006, seconds: float = 2.0
) -> np.ndarray:
    """Let a marble fall into convex parts that hang fixed in space, with nothing below.

    Args:
        parts: Convex parts, m, z up.
        inside: Inside of the vessel; the marble starts over its middle, above the rim.
        radius_m: Radius of the marble; one larger than inside.room_m does not get in.
        seconds: Time that is simulated, s.

    Returns:
        (3,) m, place of its centre at the end.
    """
    spec = _spec()
    _add_parts(spec, spec.worldbody, parts)
    start = [*inside.middle[:2], inside.rim_m + radius_m + _DROP_M]
    marble = spec.worldbody.add_body(name="marble", pos=start)
    marble.add_freejoint()
    marble.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius_m, 0, 0], density=2500.0)
    data = _run(spec, seconds)
    return np.array(data.body("marble").xpos)


def tilt_deg(mesh: trimesh.Trimesh, parts: Sequence[ConvexPart], *, seconds: float = 2.0) -> float:
    """Angle by which a thing that is put on a plane as it stands has tilted after some seconds.

    Args:
        mesh: Watertight, z up, m; its mass is that of a solid.
        parts: Its convex parts.
        seconds: Time that is simulated, s.
    """
    spec = _spec()
    lowest = min(float(part.vertices[:, 2].min()) for part in parts)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], pos=[0, 0, lowest - 1e-4])
    _add_thing(spec, mesh, parts)
    data = _run(spec, seconds)
    upright = np.array(data.body("thing").xmat).reshape(3, 3)[2, 2]
    return float(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))


def handle_hole(mesh: trimesh.Trimesh, handle: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """The hole between a handle and its body, z up.

    Args:
        mesh: Watertight, m.
        handle: (v,) bool, vertices of the handle.

    Returns:
        Its middle (3,) m, the horizontal direction (3,) through it, and the radius, m, of a rod that would touch; None
        where there is no hole.

    Raises:
        InvalidMesh: No vertex is of the handle.
    """
    if not handle.any():
        raise InvalidMesh("the mesh has no vertices of a handle")
    own, body = mesh.vertices[handle], mesh.vertices[~handle]
    out = own.mean(axis=0) - body.mean(axis=0)
    out = np.array([out[0], out[1], 0.0]) / np.linalg.norm(out[:2])
    through = np.cross([0, 0, 1.0], out)
    far, aside = own @ out, float(np.median(own @ through))
    low, high = own[:, 2].min(), own[:, 2].max()
    spots = np.stack(np.meshgrid(np.linspace(far.min() - 0.01, far.max(), _GRID), np.linspace(low, high, _GRID)), -1)
    places = np.array([f * out + aside * through + [0, 0, z] for f, z in spots.reshape(-1, 2)])
    free = np.ones(len(places), dtype=bool)
    for sign in (1.0, -1.0):
        free &= np.isinf(_rays(mesh, places, np.tile(sign * through, (len(places), 1))))
        for direction in (sign * out, np.array([0, 0, sign])):
            free &= np.isfinite(_rays(mesh, places, np.tile(direction, (len(places), 1))))
    if not free.any():
        return None
    flat = np.column_stack([out, [0, 0, 1.0]])
    room = KDTree(sample_surface(mesh, 20_000, np.random.default_rng(0))[0] @ flat).query(places @ flat)[0]
    best = int(np.where(free, room, -1.0).argmax())
    return places[best], through, float(room[best])


def hangs(
    mesh: trimesh.Trimesh,
    parts: Sequence[ConvexPart],
    middle: np.ndarray,
    through: np.ndarray,
    radius_m: float,
    *,
    seconds: float = 3.0,
) -> bool:
    """Whether a thing that is let go on a peg is still on it after some seconds.

    Args:
        mesh: Watertight, z up, m; its mass is that of a solid.
        parts: Its convex parts.
        middle: (3,) m, middle of the peg.
        through: (3,) unit, horizontal, direction of the peg.
        radius_m: Radius of the peg.
        seconds: Time that is simulated, s.
    """
    spec = _spec()
    reach = 3.0 * float(np.ptp(mesh.bounds, axis=0).max())
    ends = np.concatenate([middle - reach * through, middle + reach * through])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius_m, 0, 0], fromto=ends)
    _add_thing(spec, mesh, parts)
    data = _run(spec, seconds)
    return bool(data.body("thing").xipos[2] > middle[2] - reach)


def _rays(mesh: trimesh.Trimesh, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return cast_rays([(mesh.vertices, mesh.faces)], origins, directions)[0]


def _spec() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.option.timestep = _STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.default.geom.solref = [_CONTACT_S, 1.0]
    return spec


def _add_parts(spec: mujoco.MjSpec, body: mujoco.MjsBody, parts: Sequence[ConvexPart]) -> None:
    for index, part in enumerate(parts):
        spec.add_mesh(name=f"hull_{index}", uservert=part.vertices.ravel(), userface=part.faces.ravel())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{index}", mass=0.0)


def _add_thing(spec: mujoco.MjSpec, mesh: trimesh.Trimesh, parts: Sequence[ConvexPart]) -> None:
    weight = mass_properties(mesh)
    body = spec.worldbody.add_body(name="thing")
    body.add_freejoint()
    _add_parts(spec, body, parts)
    body.mass, body.ipos, body.explicitinertial = weight.mass_kg, weight.centre, True
    inertia = weight.inertia
    body.fullinertia = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]


def _run(spec: mujoco.MjSpec, seconds: float) -> mujoco.MjData:
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, round(seconds / _STEP_S))
    mujoco.mj_kinematics(model, data)
    return data
