"""Whether hollow things are hollow in MuJoCo: a marble in a cup, a mug on a peg, a bottle on a table."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.camera import cast_rays
from gfp_grasp.collision.cavity import widest_gap
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.export import mass_properties
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import ConvexPart

_STEP_S = 0.0005
# MuJoCo's default of 0.02 s lets a falling marble sink by centimetres, through any floor.
_CONTACT_S = 0.002
_DROP_M = 0.02  # above the rim
_GRID = 40


@dataclass(frozen=True, eq=False)
class Inside:
    """The inside of an open vessel, z up.

    Attributes:
        middle: (3,) m, a place in it with much room around.
        floor_m: Height of the floor below that place.
        rim_m: Height of the highest point of the vessel.
    """

    middle: np.ndarray
    floor_m: float
    rim_m: float


def inside_of(mesh: trimesh.Trimesh) -> Inside | None:
    """The inside of a mesh that is open at its top; None where it is not.

    Args:
        mesh: Watertight, z up, m.
    """
    middle = widest_gap(mesh)
    if middle is None:
        return None
    turns = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    around = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(8)])
    up, *walls = _rays(mesh, np.tile(middle, (9, 1)), np.vstack([[0, 0, 1.0], around]))
    down = _rays(mesh, middle, np.array([[0, 0, -1.0]]))[0]
    if np.isfinite(up) or not np.isfinite([down, *walls]).all():
        return None
    return Inside(middle, float(middle[2] - down), float(mesh.bounds[1, 2]))


def drop_marble(
    parts: Sequence[ConvexPart], inside: Inside, *, radius_m: float = 0.006, seconds: float = 2.0
) -> np.ndarray:
    """Let a marble fall into convex parts that hang fixed in space, with nothing below.

    Args:
        parts: m, z up.
        inside: Over whose middle the marble starts, above the rim.
        radius_m: Of the marble.
        seconds: That are simulated.

    Returns:
        (3,) m, where its centre is then.
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
    """How far a thing that is put on a plane as it stands has tilted after some seconds.

    Args:
        mesh: Watertight, z up, m; its mass is that of a solid.
        parts: Its convex parts.
        seconds: That are simulated.
    """
    spec = _spec()
    lowest = min(float(part.vertices[:, 2].min()) for part in parts)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], pos=[0, 0, lowest - 1e-4])
    _add_thing(spec, mesh, parts)
    data = _run(spec, seconds)
    upright = np.array(data.body("thing").xmat).reshape(3, 3)[2, 2]
    return float(np.degrees(np.arccos(np.clip(upright, -1.0, 1.0))))


def handle_hole(mesh: trimesh.Trimesh, handle: np.ndarray) -> tuple[np.ndarray, np.ndarray, float] | None:
    """The hole between a handle and its mug, z up.

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
        middle: (3,) m, of the peg.
        through: (3,) unit, horizontal, along it.
        radius_m: Of the peg.
        seconds: That are simulated.
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
