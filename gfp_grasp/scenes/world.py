"""Objects on a table under the gripper: placed apart from each other, compiled once, reset by copying a state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption, InvalidScene
from gfp_grasp.scenes.build import build_scene, compile_scene, save_scene
from gfp_grasp.scenes.objects import SceneObject
from gfp_grasp.transforms import make_T, quat_wxyz, rotation_about
from gfp_grasp.types import TrueObject

_TRIES = 2000


def place_clutter(
    objects: Sequence[TrueObject | trimesh.Trimesh],
    rng: np.random.Generator,
    *,
    radius_m: float = 0.22,
    gap_m: float = 0.01,
    table_height: float = 0.0,
    lying_share: float = 0.0,
) -> tuple[np.ndarray, ...]:
    """Random places and turns, no two objects closer than a gap, each resting on the table.

    Footprints are kept apart as circles, so that any turn is free. A lying object rests on its lowest point and may
    roll a little until the simulation has settled it.

    Args:
        objects: In their own frames, z up, base at z = 0.
        rng: Source of chance.
        radius_m: Footprints stay within this circle about the world's z axis; widened where they cannot.
        gap_m: Least distance between two footprints.
        table_height: z of the table's top, m.
        lying_share: Chance that an object is laid on its side.

    Returns:
        T_world_object (4, 4) of each.

    Raises:
        InvalidOption: A share outside 0 to 1, or sizes that are not positive.
        InvalidScene: They do not fit within twice the radius.
    """
    if not (0 <= lying_share <= 1 and radius_m > 0 and gap_m >= 0):
        raise InvalidOption(
            f"lying_share {lying_share} in 0..1, radius_m {radius_m} > 0, gap_m {gap_m} >= 0 are expected"
        )
    turned = [_turn(_vertices(thing), rng, lying_share) for thing in objects]
    for widen in np.linspace(1.0, 2.0, 6):
        centres = _scatter([footprint for _, footprint, _ in turned], rng, radius_m * widen, gap_m)
        if centres is not None:
            break
    else:
        raise InvalidScene(f"{len(objects)} objects do not fit on a circle of {2 * radius_m} m: take fewer or widen it")
    return tuple(
        make_T(R, [*(centre - middle), table_height - low])
        for (R, (middle, _), low), centre in zip(turned, centres, strict=True)
    )


def _vertices(thing: TrueObject | trimesh.Trimesh) -> np.ndarray:
    return np.asarray(thing.mesh.vertices if isinstance(thing, TrueObject) else thing.vertices)


def _turn(
    vertices: np.ndarray, rng: np.random.Generator, lying_share: float
) -> tuple[np.ndarray, tuple[np.ndarray, float], float]:
    """Rotation (3, 3), footprint circle (middle (2,), radius) and lowest z of the turned vertices."""
    R = rotation_about([0.0, 0.0, 1.0], rng.uniform(0, 2 * np.pi))
    if rng.random() < lying_share:
        R = R @ rotation_about([1.0, 0.0, 0.0], np.pi / 2) @ rotation_about([0.0, 0.0, 1.0], rng.uniform(0, 2 * np.pi))
    turned = vertices @ R.T
    middle = (turned[:, :2].min(axis=0) + turned[:, :2].max(axis=0)) / 2
    radius = float(np.linalg.norm(turned[:, :2] - middle, axis=1).max())
    return R, (middle, radius), float(turned[:, 2].min())


def _scatter(
    circles: Sequence[tuple[np.ndarray, float]], rng: np.random.Generator, radius_m: float, gap_m: float
) -> list[np.ndarray] | None:
    """Centres (2,) of circles that keep apart within radius_m, or None where chance found none."""
    order = np.argsort([-radius for _, radius in circles], kind="stable")
    placed: dict[int, np.ndarray] = {}
    for index in order:
        own = circles[index][1]
        room = max(radius_m - own, 0.0)
        for _ in range(_TRIES):
            angle, reach = rng.uniform(0, 2 * np.pi), room * np.sqrt(rng.random())
            centre = reach * np.array([np.cos(angle), np.sin(angle)])
            if all(np.linalg.norm(centre - at) >= own + circles[other][1] + gap_m for other, at in placed.items()):
                placed[int(index)] = centre
                break
        else:
            return None
    return [placed[index] for index in range(len(circles))]


# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false


_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
# Objects slower than this have come to rest; those that have not after _LONGEST_S are taken as they are.
_REST_MPS, _LONGEST_S, _CHECK_S = 1e-3, 2.0, 0.05


class World:
    """A compiled scene with the gripper, and a state to come back to.

    Attributes:
        model: The scene.
        data: State of the scene.
        objects: What was put into it, as it was given.
    """

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        """Compile the scene; the state to come back to is the one that the objects give.

        Raises:
            InvalidScene: MuJoCo refuses it.
        """
        self.objects = tuple(objects)
        self.model = compile_scene(build_scene(objects, gripper=True))
        self.data = mujoco.MjData(self.model)
        self._remember()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in their order."""
        return tuple(thing.name for thing in self.objects)

    def pose(self, name: str) -> np.ndarray:
        """T_world_object (4, 4) of an object as it is now.

        Raises:
            InvalidScene: There is no object of that name.
        """
        body = self._body(name)
        return make_T(self.data.xmat[body].reshape(3, 3), self.data.xpos[body])

    def geoms(self, name: str) -> np.ndarray:
        """(ngeom,) bool, the geoms of an object.

        Raises:
            InvalidScene: There is no object of that name.
        """
        return self.model.geom_bodyid == self._body(name)

    def set_mass_and_friction(self, name: str, mass_kg: float, friction: float) -> None:
        """Give an object another mass, spread as before, and another friction; settle or restore the world afterwards.

        Raises:
            InvalidScene: There is no object of that name.
        """
        body = self._body(name)
        ratio = mass_kg / self.model.body_mass[body]
        self.model.body_mass[body] *= ratio
        self.model.body_inertia[body] *= ratio
        self.model.geom_friction[self.geoms(name), 0] = friction
        mujoco.mj_setConst(self.model, self.data)

    def settle(self, T_world_object: Mapping[str, np.ndarray] | None = None) -> None:
        """Let all objects come to rest from the scene's start, and remember that state.

        Args:
            T_world_object: (4, 4) poses of objects, by name, that start elsewhere than in the scene.

        Raises:
            InvalidScene: There is no object of that name, or it is fixed.
        """
        mujoco.mj_resetData(self.model, self.data)
        joints = {thing.name: self.model.joint(f"{thing.name}_free") for thing in self.objects if not thing.fixed}
        for name, T in (T_world_object or {}).items():
            self._body(name)
            if name not in joints:
                raise InvalidScene(f"{name!r} is fixed: it stays where the scene has it")
            at = joints[name].qposadr[0]
            self.data.qpos[at : at + 3] = T[:3, 3]
            self.data.qpos[at + 3 : at + 7] = quat_wxyz(T[:3, :3])
        first = np.array([joint.dofadr[0] for joint in joints.values()], dtype=int)
        speeds = (first[:, None] + np.arange(6)).ravel()
        steps = round(_CHECK_S / self.model.opt.timestep)
        for _ in range(round(_LONGEST_S / _CHECK_S)):
            mujoco.mj_step(self.model, self.data, steps)
            if np.abs(self.data.qvel[speeds]).max(initial=0.0) < _REST_MPS:
                break
        self.data.qvel[speeds] = 0.0
        self._remember()

    def restore(self) -> None:
        """Go back to the state after the last settling, or to the scene's start where there was none."""
        self.resume(self._state)

    def snapshot(self) -> np.ndarray:
        """The state as it is now, for `resume`."""
        state = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        return state

    def resume(self, state: np.ndarray) -> None:
        """Go on from a state that `snapshot` gave; what `restore` goes back to stays what it was."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, state, _STATE)
        mujoco.mj_forward(self.model, self.data)

    def save(self, path: str | Path) -> None:
        """Write the scene, its objects at rest, as MJCF."""
        self.restore()
        at_rest = [replace(thing, T_world_object=self.pose(thing.name)) for thing in self.objects]
        save_scene(build_scene(at_rest, gripper=True), path)

    def _remember(self) -> None:
        mujoco.mj_forward(self.model, self.data)
        self._state = self.snapshot()

    def _body(self, name: str) -> int:
        if name not in self.names:
            raise InvalidScene(f"there is no object {name!r}; there are {', '.join(self.names) or 'none'}")
        return self.model.body(name).id
