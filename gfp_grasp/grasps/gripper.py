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

    def swept(self, opening_m: np.ndarray, standoff_m: float) -> np.ndarray:
        """Boxes (p, b, 2, 3) m that the gripper sweeps on a straight approach of so many metres along z.

        The boxes of a jaw are one box where they differ only in what a box of the body sweeps as well.
        """
        boxes, num = self.solids(opening_m), len(self.jaw)
        if self._jaws_are_one(np.max(opening_m, initial=0.0) / 2, standoff_m):
            jaws = (boxes[:, :num], boxes[:, num : 2 * num])
            whole = [np.stack([jaw[:, :, 0].min(axis=1), jaw[:, :, 1].max(axis=1)], axis=1) for jaw in jaws]
            boxes = np.concatenate([np.stack(whole, axis=1), boxes[:, 2 * num :]], axis=1)
        boxes[:, :, 0, 2] -= standoff_m
        return boxes

    def _jaws_are_one(self, reach_m: float, standoff_m: float) -> bool:
        """Whether a jaw, open to reach_m from the middle, may go as one box: flush in front, the body behind."""
        low, high = np.stack([box.low_high for box in self.jaw]).transpose(1, 0, 2)
        flush = np.ptp(low[:, 0]) + np.ptp(high[:, 0]) + np.ptp(high[:, 2]) < 1e-9
        without_gaps = (np.sort(low[:, 1])[1:] <= np.sort(high[:, 1])[:-1] + 1e-9).all()
        outermost = np.array([high[:, 0].max(), reach_m + high[:, 1].max(), low[:, 2].max() - standoff_m])
        innermost = np.array([low[:, 0].min(), -outermost[1], low[:, 2].min()])
        body = [box.low_high for box in self.body]
        behind = [(first <= innermost).all() and (last >= outermost).all() for first, last in body]
        return bool(flush and without_gaps and any(behind))
