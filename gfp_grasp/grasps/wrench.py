"""What a grasp can carry: limits of friction and torque at its pads against the pull of the object's weight."""

import numpy as np

_NUM_SWAYS = 8  # directions around
_LEAST_LEVER_M = 1e-4


def load_ratio(
    T_world_gripper: np.ndarray,
    levers_m: np.ndarray,
    centre: np.ndarray,
    up: np.ndarray,
    *,
    friction: float,
    sway: float,
) -> np.ndarray:
    """The load that a grasp holds, over what its jaws hold of a weight that hangs between them.

    The pads' limit surface is taken for an ellipsoid (Howe and Cutkosky 1996, "Practical force-motion models for
    sliding manipulation"): a force f across the closing axis and torques t slip once (f / (2 mu N))^2 + sum (t_i /
    (lever_i N))^2 is 1, N the grip force. The jaws' own strength bears a force along the closing axis. The pull is
    gravity with a sway to each of eight sides; the worst of the eight counts.

    Args:
        T_world_gripper: (p, 4, 4), m.
        levers_m: (p, 3) m, levers of the pads against turns about the gripper's x, y and z, for a unit of grip force.
        centre: (3,) m, the object's centre of mass.
        up: (3,) unit, against gravity.
        friction: Coulomb coefficient mu.
        sway: Sideways acceleration, as a share of gravity.

    Returns:
        (p,) from 0 to 1; NaN where the levers are.
    """
    R = T_world_gripper[:, :3, :3]
    arm = np.einsum("pji,pj->pi", R, centre - T_world_gripper[:, :3, 3])
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    turns = 2.0 * np.pi * np.arange(_NUM_SWAYS) / _NUM_SWAYS
    sways = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(up, side)
    pull = np.einsum("pji,kj->pki", R, sway * sways - up)
    torque = np.cross(arm[:, None], pull)
    slide = pull[..., 0] ** 2 + pull[..., 2] ** 2
    turn = (2.0 * friction * torque / np.maximum(levers_m, _LEAST_LEVER_M)[:, None]) ** 2
    needed = np.sqrt(slide + turn.sum(axis=2)).max(axis=1)
    return 1.0 / np.maximum(needed, 1.0)
