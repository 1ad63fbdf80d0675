"""One grasp trial in the simulator: approach, close, lift, shake, release."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gfp_grasp.envs.config import TrialSettings
from gfp_grasp.scenes import TARGET, Handles, World
from gfp_grasp.transforms import invert_T, make_T
from gfp_grasp.types import Grasp, Outcome

_UP = np.array([0.0, 0.0, 1.0])
Course = Callable[[np.ndarray], np.ndarray]
Failure = Callable[[], str | None]
_SHAKE_AXES = (np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))


def run_trial(
    world: World,
    grasp: Grasp,
    settings: TrialSettings | None = None,
    *,
    target: str = TARGET,
    floats: bool = False,
    on_step: Callable[[mujoco.MjData], None] | None = None,
    stepper: Callable[[mujoco.MjModel, mujoco.MjData], None] = mujoco.mj_step,
) -> Outcome:
    """Try a grasp on an object that has come to rest; `TrialSettings` tells the steps.

    Args:
        world: The scene. It is restored first, so that a trial does not depend on the one before it, and is left as the
            trial ends.
        grasp: World frame.
        settings: Numbers of the trial.
        target: Name of the body to be grasped.
        floats: The object has no weight until the jaws have closed: a completed half may not stand by itself, which is
            no fault of the grasp.
        on_step: Called with the state after every command, e.g. to film.
        stepper: Moves the state on by one step in place of MuJoCo's own, e.g. to time it.

    Returns:
        What happened; success means held to the end.

    Raises:
        InvalidScene: The world has no such body.
    """
    settings = settings or TrialSettings()
    world.restore()
    trial = _Trial(Handles.of(world, target), grasp, settings, on_step, stepper)
    trial.handles.set_weight(0.0 if floats else 1.0)
    reason = trial.run()
    trial.handles.set_weight(1.0)
    lift_m = trial.lift_m()
    falls_free = reason == "held" and trial.falls_free()
    return Outcome(reason == "held", reason, lift_m, trial.largest_slip_m, falls_free, settings.as_dict())


class _Trial:
    """A trial as it goes on: where the gripper should be and what the object did."""

    def __init__(
        self,
        handles: Handles,
        grasp: Grasp,
        settings: TrialSettings,
        on_step: Callable[[mujoco.MjData], None] | None,
        stepper: Callable[[mujoco.MjModel, mujoco.MjData], None],
    ) -> None:
        self.handles, self.grasp, self.settings, self.on_step, self.stepper = handles, grasp, settings, on_step, stepper
        self.T_grasp = grasp.T_world_gripper
        self.T_target_start = handles.T_world_target
        self.T_gripper_held = np.eye(4)
        self.held_point = np.zeros(3)
        self.closing_m = 0.0
        self.largest_slip_m = 0.0
        self.substeps = max(1, round(settings.control_s / handles.model.opt.timestep))
        handles.set_force_limit(settings.grip_n)

    def run(self) -> str:
        """The reason of the outcome."""
        if not self.handles.reaches(self.grasp):
            return "unreachable_width"
        for phase in (self._approach, self._close, self._lift, self._shake):
            failure = phase()
            if failure is not None:
                return failure
        return "held"

    def lift_m(self) -> float:
        """Height gained by the object since the trial began; 0 where the state is not finite."""
        gained = float(self.handles.T_world_target[2, 3] - self.T_target_start[2, 3])
        return gained if np.isfinite(gained) else 0.0

    def falls_free(self) -> bool:
        """Open the jaws in the air and see whether the object falls."""
        s = self.settings
        held_at = float(self.handles.T_world_target[2, 3])
        self.handles.open_jaws()
        failure = self._move(_stay, s.release_s, lambda: None, raised_m=s.lift_m)
        return failure is None and float(self.handles.T_world_target[2, 3]) < held_at - s.drop_m

    def _approach(self) -> str | None:
        s = self.settings
        behind = -s.standoff_m * self.T_grasp[:3, 2]
        self.handles.place(_moved(self.T_grasp, behind), self.grasp.width_m)

        def collided() -> str | None:
            pushed = np.linalg.norm(self.handles.T_world_target[:3, 3] - self.T_target_start[:3, 3])
            touched = pushed > s.push_m or self.handles.largest_force_n() > s.touch_n
            return "collided_on_approach" if touched else None

        return collided() or self._move(lambda t: (1.0 - _smooth(t))[:, None] * behind, s.approach_s, collided)

    def _close(self) -> str | None:
        s = self.settings

        def close_further() -> None:
            self.closing_m += s.grip_ramp_mps * s.control_s
            self.handles.set_opening(self.grasp.width_m - self.closing_m)

        failure = self._move(_stay, s.close_s, close_further)
        if failure is None and self.handles.touching_pads() < 2:
            failure = "no_contact"
        self.handles.set_weight(1.0)
        self.T_gripper_held = invert_T(self.handles.T_world_gripper) @ self.handles.T_world_target
        self.held_point = invert_T(self.T_gripper_held)[:3, 3]
        return failure

    def _lift(self) -> str | None:
        s = self.settings

        def slipped() -> str | None:
            return self._slipped("slipped_on_lift")

        return self._move(lambda t: _smooth(t)[:, None] * s.lift_m * _UP, s.lift_s, slipped) or self._move(
            _stay, s.hold_s, slipped, raised_m=s.lift_m
        )

    def _shake(self) -> str | None:
        s = self.settings

        def slipped() -> str | None:
            return self._slipped("slipped_on_shake")

        for axis in _SHAKE_AXES:
            failure = self._move(
                lambda t, axis=axis: s.shake_m * _swing(t, s.shake_cycles)[:, None] * axis,
                s.shake_cycles / s.shake_hz,
                slipped,
                raised_m=s.lift_m,
            ) or self._turn(lambda t, axis=axis: np.deg2rad(s.turn_deg) * _swing(t, 1)[:, None] * axis, slipped)
            if failure is not None:
                return failure
        return None

    def _move(self, offset_at: Course, seconds: float, failure: Failure, *, raised_m: float = 0.0) -> str | None:
        """Move without turning: offsets (n, 3) m from the grasp, raised, at shares (n,) of the time."""
        share = self._shares(seconds)
        position = self.T_grasp[:3, 3] + raised_m * _UP + offset_at(share)
        quat = Rotation.from_matrix(self.T_grasp[:3, :3]).as_quat(scalar_first=True)
        return self._follow(position, np.tile(quat, (len(share), 1)), failure)

    def _turn(self, rotvec_at: Course, failure: Failure) -> str | None:
        """Turn in the air by rotation vectors (n, 3) at shares (n,) of the time."""
        share = self._shares(1.0 / self.settings.turn_hz)
        turned = Rotation.from_rotvec(rotvec_at(share)) * Rotation.from_matrix(self.T_grasp[:3, :3])
        position = self.T_grasp[:3, 3] + self.settings.lift_m * _UP
        return self._follow(np.tile(position, (len(share), 1)), turned.as_quat(scalar_first=True), failure)

    def _shares(self, seconds: float) -> np.ndarray:
        """Shares of a phase's time that have passed at each of its steps."""
        num = self.substeps * max(1, round(seconds / self.settings.control_s))
        return np.arange(1, num + 1) / num

    def _follow(self, positions: np.ndarray, quats: np.ndarray, failure: Failure) -> str | None:
        """Follow a path of positions (n, 3) and quaternions (n, 4), checked at every `control_s`.

        A command that stood for several steps would jerk the gripper at each new one, and shake the object loose.
        """
        model, data, every, step = self.handles.model, self.handles.data, self.substeps, self.stepper
        commanded = self.handles.commanded
        for i in range(len(positions)):
            commanded[0][:], commanded[1][:] = positions[i], quats[i]
            step(model, data)
            if (i + 1) % every:
                continue
            if self.on_step is not None:
                self.on_step(data)
            if self.handles.is_unstable(self.settings.too_fast_mps):
                return "unstable"
            found = failure()
            if found is not None:
                return found
        return None

    def _slipped(self, reason: str) -> str | None:
        """Compare the object in the gripper with how it was at the end of closing."""
        R_gripper, at_gripper = self.handles.pose_of(self.handles.gripper)
        R_target, at_target = self.handles.pose_of(self.handles.target)
        R = R_gripper.T @ R_target
        offset = R @ self.held_point + R_gripper.T @ (at_target - at_gripper)
        slip = float(offset @ offset) ** 0.5
        cosine = (float((R * self.T_gripper_held[:3, :3]).sum()) - 1.0) / 2.0
        turned_deg = math.degrees(math.acos(min(1.0, max(-1.0, cosine))))
        self.largest_slip_m = max(self.largest_slip_m, slip)
        if slip > self.settings.slip_m or turned_deg > self.settings.slip_deg or self.handles.touching_pads() == 0:
            return reason
        return None


def _moved(T: np.ndarray, offset: np.ndarray) -> np.ndarray:
    return make_T(T[:3, :3], T[:3, 3] + offset)


def _stay(share: np.ndarray) -> np.ndarray:
    return np.zeros((len(share), 3))


def _smooth(t: np.ndarray) -> np.ndarray:
    """Minimum jerk from 0 to 1."""
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def _swing(t: np.ndarray, cycles: int) -> np.ndarray:
    """A sinusoid over t = 0 to 1 that starts and ends gently."""
    fade = np.minimum(1.0, 4.0 * cycles * np.minimum(t, 1.0 - t))  # over a quarter of a cycle
    return _smooth(fade) * np.sin(2 * np.pi * cycles * t)
