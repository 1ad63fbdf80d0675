"""The gripper that moves: boxes of body and jaws as nodes of viser's scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import trimesh

from gfp_grasp.grasps import Gripper
from gfp_grasp.transforms import quat_wxyz
from gfp_grasp.view.colours import GRIPPER

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]

NAME = "/gripper"


def gripper_meshes() -> dict[str, tuple[trimesh.Trimesh, float]]:
    """Body and both jaws, closed, in the gripper's frame; with each the sense in which it opens along y: 1, -1 or 0."""
    gripper = Gripper()
    boxes = gripper.solids(np.zeros(1))[0]
    num = len(gripper.jaw)
    pieces = {"left": (boxes[:num], 1.0), "right": (boxes[num : 2 * num], -1.0), "body": (boxes[2 * num :], 0.0)}
    return {name: (_joined(some), sense) for name, (some, sense) in pieces.items()}


class MovingGripper:
    """A gripper in the scene, hidden until it is put somewhere."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._root = server.scene.add_frame(NAME, show_axes=False, visible=False)
        self._jaws = []
        for name, (mesh, sense) in gripper_meshes().items():
            node = server.scene.add_mesh_simple(
                f"{NAME}/{name}", np.asarray(mesh.vertices), np.asarray(mesh.faces), color=GRIPPER, flat_shading=True
            )
            if sense:
                self._jaws.append((node, sense))

    def put(self, T_world_gripper: np.ndarray, opening_m: float) -> None:
        """Show it at a pose (4, 4) with its jaws open by a width."""
        self._root.wxyz = quat_wxyz(T_world_gripper[:3, :3])
        self._root.position = T_world_gripper[:3, 3]
        for jaw, sense in self._jaws:
            jaw.position = (0.0, sense * opening_m / 2.0, 0.0)
        self._root.visible = True

    def hide(self) -> None:
        """Take it out of sight."""
        self._root.visible = False


def _joined(boxes: np.ndarray) -> trimesh.Trimesh:
    meshes = [trimesh.creation.box(bounds=box) for box in boxes]
    return meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)  # pyright: ignore[reportReturnType]
