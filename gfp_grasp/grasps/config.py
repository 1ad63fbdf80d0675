"""The parallel-jaw gripper as boxes in its own frame, and what the planner allows and how it ranks.

The boxes are those that sim_scenes/gripper.xml simulates.
"""

from dataclasses import dataclass, field, fields

import numpy as np

from gfp_grasp.errors import InvalidOption

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


# Knobs with limits of their own, or with none.
_MAY_BE_ZERO_OR_LESS = (
    "gripper",
    "max_climb",
    "table_clearance_m",
    "min_jaw_clearance_m",
    "min_sweep_clearance_m",
    "sway",
)


@dataclass(frozen=True)
class GraspConfig:
    """Knobs of `plan_grasps`.

    Attributes:
        num_rays: Surface points from which closing lines are cast.
        num_lines: Most closing lines that are kept, spread evenly over the object: a slim neck on a wide bottle has
            little surface, but may be all that fits between the jaws.
        num_directions: Approach directions tried about each closing axis, evenly over the turn.
        tip_offset_m: Besides grasps with the closing line through the middle of the pads, there are grasps with the
            line this much nearer to the pads' tips: necks and rims are often too short for a whole pad.
        tip_preference: Quality of a grasp near the tips over one through the middle of the pads.
        num_looks: Most poses that are looked at with a few points.
        num_poses: Most poses that are checked thoroughly.
        num_points: Surface points that stand for the object in collision and contact checks.
        friction: Coulomb coefficient; both contact normals must lie within its cone about the closing axis.
        jaw_clearance_m: Clearance to either side of the object before the jaws close, where the stroke allows it.
        min_jaw_clearance_m: Least clearance to either side; the widest graspable object is the stroke less twice this.
        min_sweep_clearance_m: Least clearance of the whole gripper on its way in; samples of a surface miss about as
            much.
        good_sweep_clearance_m: Clearance of the gripper on its way in from which on more does not raise the quality.
        table_clearance_m: Least height of the gripper above the support.
        standoff_m: Length of the straight approach.
        max_climb: Largest component of the approach direction along up; 0.1 is 6 degrees from below level.
        side_preference: Quality of a level approach over that of one straight down.
        sway: Sideways acceleration that the object is to be carried against, as a share of gravity.
        doubt_length_m: Standard deviation of the surface's position that costs unseen contact a factor e.
        neighbour_gap_m: Points that were seen farther than this from the object and from the support are another
            object's; of its own, those farther than this from its completion are something that was not completed.
        hidden_preference: Quality of a grasp whose jaws the object hides over one with both in sight.
        gripper: The boxes of the gripper.
    """

    num_rays: int = 5000
    num_lines: int = 400
    num_directions: int = 12
    tip_offset_m: float = 0.007
    tip_preference: float = 0.85
    num_looks: int = 4000
    num_poses: int = 600
    num_points: int = 4000
    friction: float = 0.5
    jaw_clearance_m: float = 0.010
    min_jaw_clearance_m: float = 0.002
    min_sweep_clearance_m: float = 0.0015
    good_sweep_clearance_m: float = 0.008
    table_clearance_m: float = 0.004
    standoff_m: float = 0.10
    max_climb: float = 0.1
    side_preference: float = 0.9
    sway: float = 0.3
    doubt_length_m: float = 0.010
    neighbour_gap_m: float = 0.010
    hidden_preference: float = 0.25
    gripper: Gripper = field(default_factory=Gripper)

    def __post_init__(self) -> None:
        for knob in fields(self):
            value = getattr(self, knob.name)
            if knob.name in _MAY_BE_ZERO_OR_LESS:
                continue
            if knob.name.endswith("_preference") and not 0 < value <= 1:
                raise InvalidOption(f"GraspConfig.{knob.name} is {value}; a share above 0 and up to 1 is expected")
            if not value > 0:
                raise InvalidOption(f"GraspConfig.{knob.name} is {value}; a positive number is expected")
        if not 0 <= self.min_jaw_clearance_m < self.gripper.stroke_m / 2:
            raise InvalidOption(
                f"GraspConfig.min_jaw_clearance_m is {self.min_jaw_clearance_m}; 0 to half the stroke is expected"
            )
        if not 0 <= self.sway < float("inf"):
            raise InvalidOption(f"GraspConfig.sway is {self.sway}; zero or a positive finite number is expected")
        if not -1 <= self.max_climb <= 1:
            raise InvalidOption(f"GraspConfig.max_climb is {self.max_climb}; a cosine between -1 and 1 is expected")

    @property
    def max_width_m(self) -> float:
        """The widest object that the jaws close on."""
        return self.gripper.stroke_m - 2 * self.min_jaw_clearance_m
