"""What the agent sees: fixed-size arrays of an episode."""

import numpy as np
from gymnasium import spaces

from gfp_grasp.envs.config import EnvConfig
from gfp_grasp.envs.episode import Episode
from gfp_grasp.meshes import sample_surface

# Clouds are clipped to this far from the world's origin, which is the table's centre; depths to _FARTHEST_M.
_REACH_M, _FARTHEST_M = 2.0, 10.0

Observation = dict[str, np.ndarray]


def observation_space(config: EnvConfig) -> spaces.Dict:
    """Spaces of `observe`, by key."""
    cloud = spaces.Box(-_REACH_M, _REACH_M, (config.num_points, 3), np.float32)
    return spaces.Dict(
        {
            "observed": cloud,
            "observed_mask": spaces.MultiBinary(config.num_points),
            "completed": spaces.Box(-_REACH_M, _REACH_M, (config.num_points, 3), np.float32),
            "depth": spaces.Box(0.0, _FARTHEST_M, (config.image_height, config.image_width), np.float32),
        }
    )


def observe(episode: Episode, config: EnvConfig, rng: np.random.Generator) -> Observation:
    """Arrays of an episode: the object's points, padded with zeros and masked; samples of the completion; depth.

    Where nothing was detected or completed the cloud is all zeros.
    """
    observed = np.zeros((config.num_points, 3), dtype=np.float32)
    mask = np.zeros(config.num_points, dtype=np.int8)
    completed = np.zeros((config.num_points, 3), dtype=np.float32)
    if episode.detection is not None:
        points = episode.detection.cloud.points
        if len(points) > config.num_points:
            points = points[np.sort(rng.choice(len(points), config.num_points, replace=False))]
        observed[: len(points)] = np.clip(points, -_REACH_M, _REACH_M)
        mask[: len(points)] = 1
    if episode.completion is not None:
        samples, _, _ = sample_surface(episode.completion.mesh, config.num_points, rng)
        completed[:] = np.clip(samples, -_REACH_M, _REACH_M)
    depth = np.minimum(episode.image.depth_m, np.float32(_FARTHEST_M))
    return {"observed": observed, "observed_mask": mask, "completed": completed, "depth": depth}
