"""Episodes of the environment in the viewer, and their trials as the simulator ran them, 25 frames a second."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from gfp_grasp.drawing import every_nth, joined_boxes
from gfp_grasp.envs import GfpGraspEnv, run_trial
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.grasps import Gripper
from gfp_grasp.scenes import TARGET, gripper_pose
from gfp_grasp.transforms import quat_wxyz
from gfp_grasp.types import Grasp, Outcome
from gfp_grasp.view.layers import GRIPPER
from gfp_grasp.view.panels import line, outcome_text
from gfp_grasp.view.scene import scene_of_episode
from gfp_grasp.view.server import HOST, PORT, Viewer, check_viser

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]


FRAMES_PER_S = 25
GRIPPER_NODE = "/gripper"


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of gripper and object in the f frames of a trial.

    Attributes:
        outcome: Outcome of the trial.
        T_world_gripper: (f, 4, 4) poses of the gripper.
        opening_m: (f,) distance between the faces of the pads, m.
        T_world_object: (f, 4, 4) poses of the object.
        T_start: (4, 4) pose of the object before the trial.
    """

    outcome: Outcome
    T_world_gripper: np.ndarray
    opening_m: np.ndarray
    T_world_object: np.ndarray
    T_start: np.ndarray

    def __len__(self) -> int:
        return len(self.opening_m)

    def moved(self, frame: int) -> np.ndarray:
        """(4, 4) motion of the object since the trial began, in the world's frame."""
        return self.T_world_object[frame] @ np.linalg.inv(self.T_start)


def record_trial(env: GfpGraspEnv, grasp: Grasp) -> Motion:
    """Try a grasp in the scene of the env's episode, as `env.step` does, and record what moves.

    Args:
        env: Environment after a reset; its scene is left as it was before.
        grasp: Grasp in the world's frame.

    Returns:
        The motion; a trial that ends before its first frame has that frame alone.

    Raises:
        InvalidOption: The episode has no scene to try a grasp in.
    """
    world = env.world
    if world is None:
        raise InvalidOption("there is no scene to try the grasp in: completion failed; reset to another seed")
    every = max(1, round(1.0 / (FRAMES_PER_S * env.trial_settings.control_s)))
    T_start = world.pose(TARGET)
    grippers, openings, objects = [], [], []

    def shoot() -> None:
        T_world_gripper, opening_m = gripper_pose(world.model, world.data)
        grippers.append(T_world_gripper)
        openings.append(opening_m)
        objects.append(world.pose(TARGET))

    floats, on_step = env.config.world == "completed", every_nth(every, shoot)
    outcome = run_trial(world, grasp, env.trial_settings, floats=floats, on_step=on_step)
    shoot()
    world.restore()
    return Motion(outcome, np.stack(grippers), np.array(openings), np.stack(objects), T_start)


def gripper_meshes() -> dict[str, tuple[trimesh.Trimesh, float]]:
    """Meshes of body and closed jaws, gripper's frame, each with the sense in which it opens along y: 1, -1 or 0."""
    gripper = Gripper()
    boxes = gripper.solids(np.zeros(1))[0]
    num = len(gripper.jaw)
    pieces = {"left": (boxes[:num], 1.0), "right": (boxes[num : 2 * num], -1.0), "body": (boxes[2 * num :], 0.0)}
    return {name: (joined_boxes(some), sense) for name, (some, sense) in pieces.items()}


class MovingGripper:
    """A gripper in the scene, hidden until it is put somewhere."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._root = server.scene.add_frame(GRIPPER_NODE, show_axes=False, visible=False)
        self._jaws = []
        for name, (mesh, sense) in gripper_meshes().items():
            node = server.scene.add_mesh_simple(
                f"{GRIPPER_NODE}/{name}",
                np.asarray(mesh.vertices),
                np.asarray(mesh.faces),
                color=GRIPPER,
                flat_shading=True,
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


# The end of a trial stays in sight for so long before all is put back.
_LINGER_S = 1.5


def view_episodes(
    objects: str = "all", *, gps: str = "", seed: int = 0, host: str = HOST, port: int = PORT
) -> EpisodeViewer:
    """Serve a page with an episode of `GfpGrasp-v0`, whose grasps can be tried.

    Args:
        objects: Procedural families with commas between or "all", a mesh file, or a folder of meshes.
        gps: Folders of primitives of your own, as the environment's option takes them.
        seed: Seed of the first episode; the button goes on to the next.
        host: Address to listen at.
        port: Port to listen at, or the next one that is free; 0 takes any.

    Returns:
        The viewer, serving: `wait` for the user, and `stop` it.

    Raises:
        InvalidOption: Viser, an extra of this package, is not installed, or the address cannot be listened at.
        GfpGraspError: The objects cannot be used.
    """
    check_viser()
    viewer = EpisodeViewer(GfpGraspEnv(objects=objects, gps=gps), host=host, port=port)
    try:
        viewer.reset(seed)
    except BaseException:
        viewer.stop()
        raise
    return viewer


class EpisodeViewer(Viewer):
    """A viewer of one episode after the other.

    Attributes:
        env: The environment, reset with the present seed.
        seed: The present one.
    """

    headroom_m = 0.25  # of the lift

    def __init__(self, env: GfpGraspEnv, *, host: str = HOST, port: int = PORT) -> None:
        super().__init__("GfpGrasp-v0", host=host, port=port)
        self.env, self.seed = env, 0
        self._busy = threading.Lock()
        self._gripper = MovingGripper(self.server)
        gui = self.server.gui
        with gui.add_folder("Episode", order=-1.0):
            self._next = gui.add_button("next", hint="Draw the episode of the next seed.")
            self._rank = gui.add_slider("grasp to try", 1, 16, 1, 1, hint="1 is the best.")
            self._try = gui.add_button("try", color="green", hint="Approach, close, lift, shake, let go.")
            self._status = gui.add_html("")
        self._next.on_click(lambda _: self._told(lambda: self.reset(self.seed + 1)))
        self._try.on_click(lambda _: self._told(lambda: self.try_grasp(int(self._rank.value) - 1)))
        self._rank.on_update(lambda event: self._point_at(int(self._rank.value) - 1) if event.client else None)

    @property
    def grasps(self) -> tuple[Grasp, ...]:
        """Planned in the present episode, best first."""
        items = self.layers.shown.items if self.layers else ()
        return items[0].grasps if items else ()

    def reset(self, seed: int) -> None:
        """Draw the episode of a seed, complete it, plan, and show it.

        Raises:
            GfpGraspError: The object that was drawn cannot be used.
        """
        with self._at_work(f"seed {seed}: completing ..."):
            self.seed = seed
            self.env.reset(seed=seed)
            self.show(scene_of_episode(self.env.episode, title=f"Episode {seed}", seed=seed))
            self._gripper.hide()
            self._rank.max = max(1, len(self.grasps))
            self._rank.value = 1
        self._say(f"seed {seed}: {len(self.grasps)} grasps" if self.grasps else f"seed {seed}: no grasp found")

    def try_grasp(self, rank: int = 0, *, play: bool = True) -> Motion:
        """Try a planned grasp in the simulator and play what happened.

        Args:
            rank: Rank of the grasp, 0 is the best.
            play: Whether to show it, at the pace of the world; the call returns when it is over.

        Raises:
            InvalidOption: There is no such grasp.
        """
        if not 0 <= rank < len(self.grasps):
            raise InvalidOption(f"there is no grasp {rank + 1}; {len(self.grasps)} were planned")
        with self._at_work(f"grasp {rank + 1}: simulating ..."):
            motion = record_trial(self.env, self.grasps[rank])
            if play:
                self._say(f"grasp {rank + 1}: playing {len(motion) / FRAMES_PER_S:.1f} s ...")
                self._play(motion)
        self._say(f"grasp {rank + 1}: {outcome_text(motion.outcome)}")
        return motion

    def _play(self, motion: Motion) -> None:
        self.panels.playing = True
        self.panels.refresh()
        try:
            for frame in range(len(motion)):
                self._place(motion, frame)
                if self._over.wait(1.0 / FRAMES_PER_S):
                    return
            self._say(outcome_text(motion.outcome))
            self._over.wait(_LINGER_S)
        finally:
            self.panels.playing = False
            self._gripper.hide()
            if self.layers is not None:
                self.layers.move(0, np.eye(4))
            self.panels.refresh()

    def _place(self, motion: Motion, frame: int) -> None:
        assert self.layers is not None
        with self.server.atomic():
            self._gripper.put(motion.T_world_gripper[frame], float(motion.opening_m[frame]))
            self.layers.move(0, motion.moved(frame))

    def _point_at(self, rank: int) -> None:
        """Show the gripper where a grasp has it."""
        if rank < len(self.grasps) and not self._busy.locked():
            self._gripper.put(self.grasps[rank].T_world_gripper, self.grasps[rank].width_m)

    def _told(self, act: Callable[[], object]) -> None:
        """Do what a button asks for, and tell a refusal in the panel."""
        if self._busy.locked():
            return
        try:
            act()
        except GfpGraspError as error:
            self._say(f"{type(error).__name__}: {error}")

    def _say(self, text: str) -> None:
        self._status.content = line(text)

    @contextmanager
    def _at_work(self, doing: str) -> Iterator[None]:
        """One thing at a time: viser answers every button in a thread of its own."""
        with self._busy:
            self._next.disabled = self._try.disabled = True
            self._say(doing)
            try:
                yield
            finally:
                self._next.disabled = False
                self._try.disabled = not self.grasps
