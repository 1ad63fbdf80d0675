"""What a kind of sensor is like: every length of detection follows from its limits and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import InvalidOption

_TRAFFIC_M = 5.0  # what is pointed at larger things looks at traffic


@dataclass(frozen=True)
class SensorProfile:
    """Limits and noise of a kind of sensor, and the sizes that it is pointed at.

    Attributes:
        name: For messages.
        sigma_m: Standard deviation of the range noise at the distance it is mostly used at, m; lengths that tell
            noise from shape are multiples of it.
        farthest_m: An object farther away is not resolved, m.
        scene_m: Extent of the widest cloud that is looked at as a whole, m.
        largest_m: Extent of the largest single object, m.
        smallest_m: Extent of the smallest object, m.
        step_rad: Angle between neighbouring rings of a LiDAR: so much of an object's top and foot falls between two.
            0 where the points themselves tell how finely was looked.
        highest_rad: Elevation above which nothing is looked at; None where no such limit is known.
    """

    name: str
    sigma_m: float
    farthest_m: float
    scene_m: float
    largest_m: float
    smallest_m: float
    step_rad: float = 0.0
    highest_rad: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.sigma_m < self.smallest_m < self.largest_m <= self.scene_m or self.farthest_m <= 0:
            raise InvalidOption(
                f"{self}: positive lengths with sigma_m < smallest_m < largest_m <= scene_m are expected"
            )

    @property
    def floor_m(self) -> float:
        """What is nearer to the support is left out of a look, in training as in use: noise hides it, m."""
        return 4 * self.sigma_m

    @property
    def of_traffic(self) -> bool:
        """Whether it looks at vehicles and people, not at things on tables: two kinds of look have been learnt."""
        return self.largest_m > _TRAFFIC_M

    @property
    def sigma_range_m(self) -> tuple[float, float]:
        """Least and largest noise that is believed when it is read off a cloud, m."""
        return self.sigma_m / 3, 4 * self.sigma_m


# Depth cameras over a table: at 0.4 to 1 m their noise is 1 to 2 mm; the smallest cup is 15 mm wide.
TABLETOP = SensorProfile("tabletop", sigma_m=0.0015, farthest_m=20.0, scene_m=5.0, largest_m=1.5, smallest_m=0.015)
# Spinning LiDARs in traffic, as a Velodyne HDL-64E: a bus is 20 m long, a child 0.3 m wide.
LIDAR = SensorProfile(
    "lidar",
    sigma_m=0.02,
    farthest_m=150.0,
    scene_m=300.0,
    largest_m=25.0,
    smallest_m=0.2,
    step_rad=float(np.deg2rad(0.42)),
    highest_rad=float(np.deg2rad(2.0)),
)
SENSORS = {profile.name: profile for profile in (TABLETOP, LIDAR)}


def get_sensor(sensor: str | SensorProfile) -> SensorProfile:
    """A sensor's profile by name; a profile is returned as it is.

    Raises:
        InvalidOption: No sensor of that name, or neither a name nor a profile.
    """
    if isinstance(sensor, SensorProfile):
        return sensor
    if isinstance(sensor, str) and sensor in SENSORS:
        return SENSORS[sensor]
    raise InvalidOption(f"sensor is {sensor!r}; one of {', '.join(SENSORS)} or a SensorProfile is expected")
