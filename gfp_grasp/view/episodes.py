"""Episodes of the environment in the viewer: the next one at a button, and its grasps tried at another."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from gfp_grasp.envs import GfpGraspEnv
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.types import Grasp
from gfp_grasp.view.motion import FRAMES_PER_S, Motion, MovingGripper, record_trial
from gfp_grasp.view.scene import scene_of_episode
from gfp_grasp.view.server import HOST, PORT, Viewer, check_viser
from gfp_grasp.view.text import line, outcome_text

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
