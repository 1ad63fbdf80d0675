"""The parallel-jaw gripper as boxes in its own frame: what the planner sweeps and what gripper.xml simulates."""

from dataclasses import dataclass

import numpy as np

Size = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the gripper's frame: centre and half extents along x, y, z in metres."""

    centre_m: Size
    half_m: Size

    @property
    def low_high(self) -> np.ndarray:
        """(2, 3) m, lowest and highest corner."""
        centre, half = np.array(self.centre_m), np.array(self.half_m)
        return np.stack([centre - half, centre + half])


@dataclass(frozen=True)
class Gripper:
    """Boxes of the gripper of sim_scenes/gripper.xml; a test compares the two.

    The frame is that of `types.Grasp`: origin midway between the pads' centres, z the approach direction, y the
    closing axis.

    Attributes:
        stroke_m: Largest opening between the faces of the pads.
        pad: The pad of the jaw at +y, jaws closed.
        jaw: Everything of the jaw at +y, its pad included, jaws closed; the other jaw is its mirror image.
        body: What does not move with the jaws.
    """

    stroke_m: float = 0.080
    pad: Box = Box((0.0, 0.003, 0.0), (0.010, 0.003, 0.012))
    jaw: tuple[Box, ...] = (
        Box((0.0, 0.003, 0.0), (0.010, 0.003, 0.012)),
        Box((0.0, 0.010, -0.0215), (0.010, 0.004, 0.0335)),
    )
    body: tuple[Box, ...] = (Box((0.0, 0.0, -0.085), (0.030, 0.062, 0.030)),)

    def solids(self, opening_m: np.ndarray) -> np.ndarray:
        """Lowest and highest corners (p, b, 2, 3) m of all boxes, for openings (p,) m between the faces of the pads."""
        half = np.asarray(opening_m, dtype=np.float64)[:, None, None, None] / 2.0
        jaw = np.stack([box.low_high for box in self.jaw])
        mirrored = np.stack([jaw[:, 0], jaw[:, 1]], axis=1)
        mirrored[:, 0, 1], mirrored[:, 1, 1] = -jaw[:, 1, 1], -jaw[:, 0, 1]
        sideways = np.array([0.0, 1.0, 0.0])
        body = np.broadcast_to(np.stack([box.low_high for box in self.body]), (len(half), len(self.body), 2, 3))
        return np.concatenate([jaw + half * sideways, mirrored - half * sideways, body], axis=1)
