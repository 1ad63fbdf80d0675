"""Whether the objects of a simulator's file stand still: how far they tilt and travel, and how deep they overlap."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from gfp_grasp.errors import InvalidOption, InvalidScene, UnreadableFile

SECONDS = 2.0
_DIVERGED = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
MOST_TILT_DEG, MOST_TRAVEL_M = 5.0, 0.005
_SPACE_M = 1.0  # of the floor below everything, beside what stands on it


@dataclass(frozen=True)
class BodyCheck:
    """How one free body behaved; tilt and way are infinite for all bodies of a scene whose simulation breaks down.

    Attributes:
        name: The body.
        tilt_deg: Angle between its upright before and after.
        travel_m: Way of its centre of mass and of the origin of its frame, whichever is longer.
        overlap_m: How deep it overlapped with anything at the start.
        neighbour_m: How deep it overlapped with another body that can move at the start.
    """

    name: str
    tilt_deg: float
    travel_m: float
    overlap_m: float
    neighbour_m: float = 0.0

    @property
    def stands(self) -> bool:
        """Whether it tilted by less than 5 degrees and travelled by less than 5 mm."""
        return self.tilt_deg < MOST_TILT_DEG and self.travel_m < MOST_TRAVEL_M


@dataclass(frozen=True, eq=False)
class SettledScene:
    """A simulator's scene after a time.

    Attributes:
        model: The scene.
        data: Its state after the time.
        checks: How its free bodies behaved.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    checks: tuple[BodyCheck, ...]


def check_file(path: str | Path, *, seconds: float = SECONDS) -> tuple[BodyCheck, ...]:
    """Load an MJCF or URDF file as it is, and see how its free bodies behave.

    A URDF knows no floor: its objects get one that touches their lowest point, and a root link that is fixed to nothing
    falls freely.

    Args:
        path: .xml or .urdf, anybody's.
        seconds: Simulated time, in the file's own options.

    Raises:
        UnreadableFile: MuJoCo does not read it; the message is MuJoCo's.
        InvalidScene: Nothing in it is free to move.
        InvalidOption: The time is not a finite positive number.
    """
    return settle_file(path, seconds=seconds).checks


def settle_file(path: str | Path, *, seconds: float = SECONDS) -> SettledScene:
    """The scene of a file after some seconds in its own options; see `check_file`."""
    path = Path(path)
    if not path.is_file():
        raise UnreadableFile(f"{path} is no file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        if path.suffix.lower() == ".urdf":
            _put_on_floor(spec, fixed=_has_world(path))
        model = spec.compile()
    except ValueError as error:
        raise UnreadableFile(f"MuJoCo does not read {path}: {error}") from error
    return _settled(model, seconds)


def check_model(model: mujoco.MjModel, *, seconds: float = SECONDS) -> tuple[BodyCheck, ...]:
    """How the free bodies of a model behave from its first state on; see `check_file`."""
    return _settled(model, seconds).checks


def _settled(model: mujoco.MjModel, seconds: float) -> SettledScene:
    if not 0.0 < seconds < np.inf:
        raise InvalidOption(f"seconds is {seconds!r}; a finite positive number is expected")
    free = [model.jnt_bodyid[j] for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    if not free:
        raise InvalidScene("no body of the scene has a free joint: nothing in it can stand or fall")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    overlap_m, neighbour_m = _overlaps_m(model, data)
    before = data.xmat.reshape(-1, 3, 3).copy(), data.xpos.copy(), data.xipos.copy()
    gravity = np.array(model.opt.gravity)
    up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
    sound = _simulated(model, data, seconds)
    found = []
    for body in free:
        turn = data.xmat[body].reshape(3, 3) @ before[0][body].T
        ways = (data.xpos[body] - before[1][body], data.xipos[body] - before[2][body])
        travel_m = max(float(np.linalg.norm(way)) for way in ways)
        tilt_deg = float(np.degrees(np.arccos(np.clip(up @ turn @ up, -1.0, 1.0))))
        if not sound:
            travel_m = tilt_deg = np.inf
        name = model.body(body).name or f"body {body}"
        found.append(BodyCheck(name, tilt_deg, travel_m, float(overlap_m[body]), float(neighbour_m[body])))
    return SettledScene(model, data, tuple(found))


def diverged(data: mujoco.MjData) -> bool:
    """Whether a number of the simulation was not finite; MuJoCo has then started anew."""
    return any(data.warning[kind].number for kind in _DIVERGED)


def _simulated(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> bool:
    """Simulate for a time, and say whether all numbers stayed finite; the first that does not ends it.

    MuJoCo resets a state that is not finite, and its time with it, and counts a warning.
    """
    while data.time < seconds:
        mujoco.mj_step(model, data)
        if diverged(data):
            return False
    return True


def _overlaps_m(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
    """Deepest overlap of each body (b,) with anything, m, and that with what is no part of the world."""
    deepest, with_others = np.zeros(model.nbody), np.zeros(model.nbody)
    for contact in data.contact:
        bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
        deepest[bodies] = np.maximum(deepest[bodies], -float(contact.dist))
        if model.body_weldid[bodies].all():
            with_others[bodies] = np.maximum(with_others[bodies], -float(contact.dist))
    return deepest, with_others


def _has_world(path: Path) -> bool:
    """Whether a URDF has a link "world", to which its other links may be fixed; MuJoCo takes it for its own."""
    text = path.read_text(encoding="utf-8", errors="replace")  # a parser would refuse prefixes that MuJoCo reads
    return re.search(r"<link\s[^>]*?\bname\s*=\s*[\"']world[\"']", text) is not None


def _put_on_floor(spec: mujoco.MjSpec, *, fixed: bool) -> None:
    """Put a floor below everything; links without a joint become free, unless they are fixed to a link "world"."""
    spec.compiler.fusestatic = False  # else a single link becomes a part of the world
    roots = [body for body in spec.bodies if body.parent is not None and body.parent.name == "world"]
    for body in roots:
        if not body.joints and not fixed:
            body.add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    lowest_m = min((float(_corners(model, data, g)[:, 2].min()) for g in solid), default=0.0)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[_SPACE_M, _SPACE_M, 0.1], pos=[0.0, 0.0, lowest_m])


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> np.ndarray:
    """World vertices (n, 3) m of a mesh's geom; of another shape, the corners of its box."""
    R, place = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    mesh = model.geom_dataid[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH and mesh >= 0:
        start = model.mesh_vertadr[mesh]
        return model.mesh_vert[start : start + model.mesh_vertnum[mesh]] @ R.T + place
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return (centre + signs * half) @ R.T + place
