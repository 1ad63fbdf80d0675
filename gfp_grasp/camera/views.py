"""Where a camera stands."""

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import look_at


def sample_viewpoint(
    rng: np.random.Generator,
    *,
    elevation_deg: tuple[float, float] = (20.0, 60.0),
    distance_m: float = 0.6,
    target: ArrayLike = (0.0, 0.0, 0.05),
) -> np.ndarray:
    """T_world_camera (4, 4) of a level camera that looks at the target from any side.

    Args:
        rng: Source of chance.
        elevation_deg: Lowest and highest angle above the horizon, uniform between them.
        distance_m: From the camera's centre to the target.
        target: (3,) m, world frame.

    Raises:
        InvalidOption: A distance that is not positive, or angles that are not -90 <= low <= high <= 90.
    """
    low, high = elevation_deg
    if not (-90 <= low <= high <= 90 and distance_m > 0):
        raise InvalidOption(
            f"elevation {elevation_deg} degrees at {distance_m} m: -90 <= low <= high <= 90, distance > 0"
        )
    elevation, azimuth = np.radians(rng.uniform(low, high)), rng.uniform(0, 2 * np.pi)
    outward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return look_at(np.asarray(target) + distance_m * np.array(outward), target)
