"""Options of the environment, and what a trial goes through, in numbers."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, fields

import numpy as np

from gfp_grasp.camera import SensorModel
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary


@dataclass(frozen=True)
class TrialSettings:
    """A trial, step by step; every outcome carries these numbers.

    1. Approach: from standoff_m behind the grasp, along its z, in approach_s. A contact force above touch_n on
       anything, or an object pushed by push_m, is `collided_on_approach`.
    2. Close: the jaws close by grip_ramp_mps, then press until close_s is over, each with grip_n at most. Fewer than
       two pads on the object then is `no_contact`.
    3. Lift by lift_m straight up in lift_s, then hold for hold_s.
    4. Shake: shake_cycles of a sinusoid of shake_m along the world's x and then y at shake_hz (3 m/s2 at its peak),
       then a turn by turn_deg to either side about each of these axes through the gripper at turn_hz.
    5. Release: the jaws open at once, and release_s later the object should have fallen by drop_m. This is told
       (`falls_free`), but is no part of success: what a hook holds is held.

    From the end of closing on, the object's point that was at the gripper's origin may leave it by slip_m and the
    object may turn in the gripper by slip_deg; more, or losing both pads, is `slipped_on_lift` or `slipped_on_shake`.
    A state that is not finite, a warning of the solver or a speed above too_fast_mps is `unstable`.

    Attributes:
        standoff_m: Length of the approach.
        approach_s: Duration of the approach.
        touch_n: Contact force that counts as a collision.
        push_m: Displacement of the object that counts as a collision.
        close_s: Time for the jaws to close and settle.
        grip_ramp_mps: Speed of the opening while they close.
        grip_n: Force limit of each jaw.
        lift_m: Height of the lift.
        lift_s: Duration of the lift.
        hold_s: Rest after the lift.
        shake_m: Amplitude of the shaking sinusoid.
        shake_hz: Frequency of the shaking sinusoid.
        shake_cycles: Cycles along each axis.
        turn_deg: Amplitude of the shaking rotation.
        turn_hz: Frequency of that rotation; one cycle about each axis.
        slip_m: Limit of slip.
        slip_deg: Limit of turning.
        release_s: Time for a released object to fall.
        drop_m: Least fall.
        too_fast_mps: Speed that no object reaches in a sound simulation.
        control_s: Time between two commands and checks.
    """

    standoff_m: float = 0.10
    approach_s: float = 0.6
    touch_n: float = 1.0
    push_m: float = 0.003
    close_s: float = 0.8
    grip_ramp_mps: float = 0.2
    grip_n: float = 30.0
    lift_m: float = 0.2
    lift_s: float = 0.8
    hold_s: float = 0.4
    shake_m: float = 0.02
    shake_hz: float = 2.0
    shake_cycles: int = 2
    turn_deg: float = 15.0
    turn_hz: float = 1.0
    slip_m: float = 0.010
    slip_deg: float = 10.0
    release_s: float = 0.3
    drop_m: float = 0.05
    too_fast_mps: float = 20.0
    control_s: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0 or value == float("inf"):
                raise InvalidOption(f"TrialSettings.{field.name} is {value}; a positive finite number is expected")

    def as_dict(self) -> dict[str, float]:
        """The numbers by name, for an Outcome and for result files."""
        return asdict(self)


WORLDS = ("true", "completed")
SENSORS = ("ideal", "gaussian", "realsense", "kinect")
RENDER_MODES = (None, "rgb_array", "human")


@dataclass(frozen=True)
class EnvConfig:
    """Keyword arguments of `GfpGraspEnv`; only str, int, float, bool and None, so that a spec goes through JSON.

    Attributes:
        objects: Procedural families with commas between, "household" (or "all") for all of those; kinds of things of no
            class, as "apple-like", "unknown" for all of those; a mesh file, or a folder of meshes. Vehicles and the
            like are no objects of a table.
        gps: Folders of primitives of the user's own, with a colon between (a semicolon on Windows); "" for none.
        completer: Name, see `gfp_grasp.completers.get_completer`.
        detector: Name, see `gfp_grasp.detect.get_detector`; objects of an episode stand apart, which needs no network.
        world: "true" simulates the true object, "completed" the completion's convex parts in its place.
        split: Which seeds of a family: train, val or test.
        limit: Number of objects that are used, the first ones; 0 uses all.
        clutter: Number of other objects that stand around the one to be grasped; fewer where so many find no place.
        num_points: Rows of both clouds in the observation.
        image_width: Columns of the depth picture.
        image_height: Rows.
        fov_deg: Vertical field of view, above 0 and below 180.
        distance_m: Distance from the camera to the object.
        elevation_min_deg: Lowest view above the horizon.
        elevation_max_deg: Highest.
        sensor: "ideal", "gaussian", "realsense" or "kinect".
        noise_m: Standard deviation of "gaussian".
        mass_spread: An episode's mass is within this share of the object's own, up and down.
        friction_min: Lowest coefficient of sliding friction: rubber on wet plastic.
        friction_max: Highest: rubber on dry stoneware.
        grip_min_n: Weakest force limit of the jaws.
        grip_max_n: Strongest.
        margin_trials: Trials after each grasp that look for the least friction at which it holds; 0 looks for none.
        spread_m: Without clutter, the object stands within this of the table's centre, along x and along y.
        render_mode: None, "rgb_array", or "human" for MuJoCo's viewer, which shows trials as they go on.
    """

    objects: str = "all"
    gps: str = ""
    completer: str = "gfpnet"
    detector: str = "tabletop"
    world: str = "true"
    split: str = "test"
    limit: int = 0
    clutter: int = 0
    num_points: int = 2048
    image_width: int = 320
    image_height: int = 240
    fov_deg: float = 35.0
    distance_m: float = 0.6
    elevation_min_deg: float = 20.0
    elevation_max_deg: float = 60.0
    sensor: str = "gaussian"
    noise_m: float = 0.001
    mass_spread: float = 0.25
    friction_min: float = 0.4
    friction_max: float = 1.0
    grip_min_n: float = 25.0
    grip_max_n: float = 35.0
    margin_trials: int = 0
    spread_m: float = 0.05
    render_mode: str | None = None

    def __post_init__(self) -> None:
        for name, legal in (("world", WORLDS), ("sensor", SENSORS), ("render_mode", RENDER_MODES)):
            value = getattr(self, name)
            if not isinstance(value, str | None) or value not in legal:
                raise InvalidOption(f"{name} is {value!r}; legal are {', '.join(map(repr, legal))}")
        for field in fields(self):
            object.__setattr__(self, field.name, _plain(field.name, str(field.type), getattr(self, field.name)))
        for name in ("num_points", "image_width", "image_height", "fov_deg", "distance_m"):
            if not getattr(self, name) > 0:
                raise InvalidOption(f"{name} is {getattr(self, name)}; a positive number is expected")
        for name in ("limit", "clutter", "noise_m", "spread_m", "mass_spread", "margin_trials"):
            if not getattr(self, name) >= 0:
                raise InvalidOption(f"{name} is {getattr(self, name)}; zero or more is expected")
        if self.fov_deg >= 180:
            raise InvalidOption(f"fov_deg is {self.fov_deg}; degrees below 180 are expected")
        if not -90 < self.elevation_min_deg <= self.elevation_max_deg < 90:
            raise InvalidOption(
                f"elevations are {self.elevation_min_deg} to {self.elevation_max_deg} degrees; "
                "-90 < min <= max < 90 is expected"
            )

        if self.mass_spread >= 1:
            raise InvalidOption(f"mass_spread is {self.mass_spread}; a share below 1 is expected")
        for what in ("friction", "grip"):
            low, high = (getattr(self, f"{what}_{end}{'_n' if what == 'grip' else ''}") for end in ("min", "max"))
            if not 0 < low <= high:
                raise InvalidOption(f"{what} is from {low} to {high}; 0 < min <= max is expected")

    @classmethod
    def of(cls, options: dict[str, object]) -> EnvConfig:
        """Make the options from keyword arguments.

        Raises:
            InvalidOption: One is unknown or has a value that is not legal; the message lists what is.
        """
        legal = [field.name for field in fields(cls)]
        unknown = sorted(set(options) - set(legal))
        if unknown:
            raise InvalidOption(f"unknown option {', '.join(map(repr, unknown))}; legal are {', '.join(legal)}")
        return cls(**options)  # pyright: ignore[reportArgumentType]

    @property
    def library(self) -> PrimitiveLibrary:
        """The classes that there are.

        Raises:
            UnreadableFile: One of `gps` is no folder.
        """
        return PrimitiveLibrary.from_option(self.gps)

    @property
    def sensor_model(self) -> SensorModel:
        """The sensor by its name."""
        if self.sensor == "gaussian":
            return SensorModel.gaussian(self.noise_m)
        return {"ideal": SensorModel.ideal, "realsense": SensorModel.realsense, "kinect": SensorModel.kinect}[
            self.sensor
        ]()


def _plain(name: str, kind: str, value: object) -> str | int | float | None:
    """The value as a type of Python's own, whatever number or path it came as.

    Raises:
        InvalidOption: The value is of another kind, or a number that is not finite.
    """
    if kind.startswith("str"):
        if isinstance(value, str) or (value is None and "None" in kind):
            return value
        if name == "objects" and isinstance(value, os.PathLike):
            return os.fspath(value)
        raise InvalidOption(f"{name} is {value!r}; a string is expected")
    whole = kind == "int"
    numbers = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers):
        raise InvalidOption(f"{name} is {value!r}; {'a whole' if whole else 'a'} number is expected")
    if not np.isfinite(value):
        raise InvalidOption(f"{name} is {value}; a finite number is expected")
    return int(value) if whole else float(value)
