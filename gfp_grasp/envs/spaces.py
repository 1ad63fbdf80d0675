"""What the agent sees and does: fixed-size arrays of an episode, and a grasp as a vector between -1 and 1."""

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces

from gfp_grasp.envs.config import EnvConfig
from gfp_grasp.envs.episode import Episode
from gfp_grasp.errors import InvalidAction, InvalidOption
from gfp_grasp.meshes import sample_surface
from gfp_grasp.transforms import is_rotation, make_T
from gfp_grasp.types import Grasp

NUM_ACTION = 10
# Actions come as float32, whose rounding may leave the box by this much.
_ROUNDING = 1e-5
# Shorter than this, a column has no direction.
_SHORT = 1e-4


@dataclass(frozen=True)
class ActionCode:
    """The map between grasps and actions.

    | entries | meaning | at -1 | at +1 |
    |---|---|---|---|
    | 0:3 | position x, y, z of the gripper's origin, m | centre - half | centre + half |
    | 3:6 | approach direction (gripper's z), world frame, any length | | |
    | 6:9 | closing axis (gripper's y), world frame, any length; made square to the approach | | |
    | 9 | opening of the jaws before they close, m | 0 | max_width |

    An approach shorter than 1e-4 means straight down. A closing axis that is too short, or along the approach, means
    some axis square to the approach. So every vector of the box is a grasp.

    Attributes:
        centre_m: Centre of the workspace box, world frame.
        half_m: Half extents of the box.
        max_width_m: Opening at +1; wider than the gripper's stroke, so that an unreachable width can be asked for.
    """

    centre_m: tuple[float, float, float] = (0.0, 0.0, 0.2)
    half_m: tuple[float, float, float] = (0.4, 0.4, 0.3)
    max_width_m: float = 0.12

    def __post_init__(self) -> None:
        if not (min(self.half_m) > 0 and self.max_width_m > 0):
            raise InvalidOption(
                f"ActionCode has half_m {self.half_m} and max_width_m {self.max_width_m}; give positive"
            )

    def encode(self, grasp: Grasp) -> np.ndarray:
        """Action (10,) float32 of a grasp.

        Raises:
            InvalidAction: The grasp is outside of the workspace box, wider than max_width_m, or not rigid.
        """
        T = grasp.T_world_gripper
        if not is_rotation(T[:3, :3]):
            raise InvalidAction(f"the rotation of T_world_gripper is no rotation:\n{T[:3, :3]}")
        position = (T[:3, 3] - self.centre_m) / self.half_m
        width = 2.0 * grasp.width_m / self.max_width_m - 1.0
        action = np.concatenate([position, T[:3, 2], T[:3, 1], [width]])
        if not (np.abs(action) <= 1.0 + _ROUNDING).all():
            raise InvalidAction(
                f"grasp at {T[:3, 3].round(3).tolist()} m, width {grasp.width_m} m, is outside of the workspace "
                f"{self.centre_m} +- {self.half_m} m, 0 to {self.max_width_m} m"
            )
        return np.clip(action, -1.0, 1.0).astype(np.float32)

    def decode(self, action: np.ndarray) -> Grasp:
        """Grasp of an action (10,).

        Raises:
            InvalidAction: Wrong shape, not finite, or outside of -1 to 1.
        """
        try:
            raw = np.asarray(action)
        except ValueError as error:  # rows of different lengths
            raise InvalidAction(f"action is {action!r}; an array of ({NUM_ACTION},) numbers is expected") from error
        if raw.dtype.kind not in "biuf":
            raise InvalidAction(f"action is of type {raw.dtype}; ({NUM_ACTION},) numbers are expected")
        vector = raw.astype(np.float64)
        if vector.shape != (NUM_ACTION,):
            raise InvalidAction(f"action has shape {vector.shape}; ({NUM_ACTION},) is expected")
        if not np.isfinite(vector).all():
            raise InvalidAction(f"action has {np.sum(~np.isfinite(vector))} entries that are not finite")
        if np.abs(vector).max() > 1.0 + _ROUNDING:
            raise InvalidAction(f"action reaches {np.abs(vector).max():.3g}; every entry must lie between -1 and 1")
        vector = np.clip(vector, -1.0, 1.0)
        z = _unit(vector[3:6], np.array([0.0, 0.0, -1.0]))
        level = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
        y = _unit(vector[6:9] - (vector[6:9] @ z) * z, level / np.linalg.norm(level))
        R = np.column_stack([np.cross(y, z), y, z])
        width = (vector[9] + 1.0) / 2.0 * self.max_width_m
        return Grasp(make_T(R, vector[:3] * self.half_m + self.centre_m), float(width))


def _unit(vector: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > _SHORT else otherwise


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
