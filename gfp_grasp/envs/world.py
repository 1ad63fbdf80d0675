"""One object, alone or among others, on a table under the gripper: compiled once, reset by copying state."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from gfp_grasp.scenes import SceneObject
from gfp_grasp.scenes.build import build_scene, compile_scene
from gfp_grasp.transforms import make_T, quat_wxyz
from gfp_grasp.types import ConvexPart, TrueObject

TARGET = "object"
# An object that moves slower than this has come to rest; one that has not after _LONGEST_S is taken as it is.
_REST_MPS, _LONGEST_S = 1e-3, 2.0
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


class World:
    """A compiled scene with one object, and a state to come back to.

    Attributes:
        model: The scene.
        data: Its state.
    """

    def __init__(self, scene_object: SceneObject, others: Sequence[SceneObject] = ()) -> None:
        self.model = compile_scene(build_scene([scene_object, *others], gripper=True))
        self.data = mujoco.MjData(self.model)
        self._body = self.model.body(TARGET).id
        self._state = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        self._remember()

    @classmethod
    def of_truth(
        cls, truth: TrueObject, T_world_object: np.ndarray | None = None, others: Sequence[SceneObject] = ()
    ) -> World:
        """The world as it is; the object at the table's centre or elsewhere, others where they stand."""
        return cls(SceneObject.of(truth, np.eye(4) if T_world_object is None else T_world_object, name=TARGET), others)

    @classmethod
    def of_parts(
        cls, parts: tuple[ConvexPart, ...], mass_kg: float, friction: float, others: Sequence[SceneObject] = ()
    ) -> World:
        """The world as it was completed: convex parts, world frame, lifted out of the table if they reach into it."""
        points = np.concatenate([part.vertices for part in parts])
        centre = points.mean(axis=0)
        local = tuple(ConvexPart(part.vertices - centre, part.faces) for part in parts)
        sunk = min(0.0, float(points[:, 2].min()))
        return cls(SceneObject(TARGET, local, None, make_T(t=centre - (0.0, 0.0, sunk)), mass_kg, friction), others)

    def shows_target(self, geom: np.ndarray) -> np.ndarray:
        """Which pixels of geom ids, of any shape, are the object."""
        body = np.append(self.model.geom_bodyid, -1)  # the last for -1, where there is nothing
        return body[geom] == self._body

    @property
    def T_world_object(self) -> np.ndarray:
        """(4, 4) of the object's body."""
        return make_T(self.data.xmat[self._body].reshape(3, 3), self.data.xpos[self._body])

    def set_load(self, mass_kg: float, friction: float) -> None:
        """Give the object a mass and a friction; the state is that of the model until it is settled or restored."""
        share = mass_kg / self.model.body_mass[self._body]
        self.model.body_mass[self._body] *= share
        self.model.body_inertia[self._body] *= share
        self.model.geom_friction[self.model.geom_bodyid == self._body, 0] = friction
        mujoco.mj_setConst(self.model, self.data)

    def settle(self, T_world_object: np.ndarray) -> None:
        """Put the object down, let it come to rest, and remember the state.

        Args:
            T_world_object: (4, 4) where to put it.
        """
        mujoco.mj_resetData(self.model, self.data)
        joint = self.model.joint(f"{TARGET}_free")
        at, speed = joint.qposadr[0], joint.dofadr[0]
        self.data.qpos[at : at + 3] = T_world_object[:3, 3]
        self.data.qpos[at + 3 : at + 7] = quat_wxyz(T_world_object[:3, :3])
        steps = round(0.05 / self.model.opt.timestep)
        for _ in range(round(_LONGEST_S / 0.05)):
            mujoco.mj_step(self.model, self.data, steps)
            if np.abs(self.data.qvel[speed : speed + 6]).max() < _REST_MPS:
                break
        self.data.qvel[speed : speed + 6] = 0.0
        self._remember()

    def restore(self) -> None:
        """Back to the state after the last settling, or to that of the scene where there was none."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._state, _STATE)
        mujoco.mj_forward(self.model, self.data)

    def _remember(self) -> None:
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_getState(self.model, self.data, self._state, _STATE)
