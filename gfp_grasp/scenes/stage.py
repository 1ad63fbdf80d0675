"""A compiled scene of several objects with a state to come back to."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np

from gfp_grasp.errors import InvalidScene
from gfp_grasp.scenes.build import build_scene, compile_scene, save_scene
from gfp_grasp.scenes.scene_object import SceneObject
from gfp_grasp.transforms import make_T

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
# Objects slower than this have come to rest; those that have not after _LONGEST_S are taken as they are.
_REST_MPS, _LONGEST_S, _CHECK_S = 1e-3, 2.0, 0.05


class Stage:
    """Objects on a table under the gripper, at rest.

    Attributes:
        model: The scene.
        data: Its state.
    """

    def __init__(self, objects: Sequence[SceneObject]) -> None:
        """Build the scene and let the objects come to rest.

        Raises:
            InvalidScene: MuJoCo refuses it.
        """
        self._objects = tuple(objects)
        self.model = compile_scene(build_scene(objects, gripper=True))
        self.data = mujoco.MjData(self.model)
        self._state = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        self._settle()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the objects, in their order."""
        return tuple(thing.name for thing in self._objects)

    def restore(self) -> None:
        """Back to the state in which the objects had come to rest."""
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_setState(self.model, self.data, self._state, _STATE)
        mujoco.mj_forward(self.model, self.data)

    def pose(self, name: str) -> np.ndarray:
        """T_world_object (4, 4) of an object as it is."""
        body = self._body(name)
        return make_T(self.data.xmat[body].reshape(3, 3), self.data.xpos[body])

    def geoms(self, name: str) -> np.ndarray:
        """(ngeom,) bool, the geoms of an object."""
        return self.model.geom_bodyid == self._body(name)

    def save(self, path: Path) -> None:
        """Write the scene, its objects at rest, as MJCF."""
        self.restore()
        objects = [
            SceneObject(o.name, o.parts, o.visual, self.pose(o.name), o.mass_kg, o.friction) for o in self._objects
        ]
        save_scene(build_scene(objects, gripper=True), path)

    def _settle(self) -> None:
        joints = [self.model.joint(f"{thing.name}_free") for thing in self._objects]
        speeds = np.concatenate([np.arange(j.dofadr[0], j.dofadr[0] + 6) for j in joints])
        steps = round(_CHECK_S / self.model.opt.timestep)
        for _ in range(round(_LONGEST_S / _CHECK_S)):
            mujoco.mj_step(self.model, self.data, steps)
            if np.abs(self.data.qvel[speeds]).max() < _REST_MPS:
                break
        self.data.qvel[speeds] = 0.0
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_getState(self.model, self.data, self._state, _STATE)

    def _body(self, name: str) -> int:
        body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, name)
        if body < 0:
            raise InvalidScene(
                f"there is no {name!r} on this stage; there are {', '.join(o.name for o in self._objects)}"
            )
        return body
