"""Options of the environment."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields

import numpy as np

from gfp_grasp.camera import SensorModel
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary

WORLDS = ("true", "completed")
SENSORS = ("ideal", "gaussian", "realsense", "kinect")
RENDER_MODES = (None, "rgb_array", "human")


@dataclass(frozen=True)
class EnvConfig:
    """Keyword arguments of `GfpGraspEnv`; only str, int, float, bool and None, so that a spec goes through JSON.

    Attributes:
        objects: Procedural families with commas between or "all", a mesh file, or a folder of meshes.
        gps: Folders of primitives of the user's own, with a colon between (a semicolon on Windows); "" for none.
        completer: Name, see `gfp_grasp.completers.get_completer`.
        detector: Name, see `gfp_grasp.detect.get_detector`.
        world: "true" simulates the true object, "completed" the completion's convex parts in its place.
        split: Which seeds of a family: train, val or test.
        limit: Number of objects that are used, the first ones; 0 uses all.
        clutter: Number of other objects that stand around the one to be grasped.
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
        for name in ("limit", "clutter", "noise_m", "spread_m", "mass_spread"):
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
