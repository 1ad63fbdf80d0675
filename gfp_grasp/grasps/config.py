"""What the planner allows and how it ranks."""

from dataclasses import dataclass, field, fields

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.gripper import Gripper


@dataclass(frozen=True)
class GraspConfig:
    """Knobs of `plan_grasps`.

    Attributes:
        num_rays: Surface points from which closing lines are cast.
        num_lines: Closing lines that are kept, at most, spread evenly over the object: a slim neck on a wide bottle has
            little surface, but may be all that fits between the jaws.
        num_directions: Approach directions tried about each closing axis, evenly over the turn.
        tip_offset_m: Besides grasps with the closing line through the middle of the pads, there are such with the line
            this much nearer to their tips: necks and rims are often too short for a whole pad.
        tip_preference: Quality of these over the others.
        num_looks: Poses that are looked at with a few points, at most.
        num_poses: Poses that are checked thoroughly, at most.
        num_points: Surface points that stand for the object in collision and contact checks.
        friction: Coulomb coefficient; both contact normals must lie within its cone about the closing axis.
        jaw_clearance_m: Room to either side of the object before the jaws close, where the stroke allows it.
        min_clearance_m: Least room to either side; the widest graspable object is the stroke less twice this.
        least_room_m: Least room around the whole gripper on its way in; samples of a surface miss about as much of it.
        good_clearance_m: Room around the gripper from which on more of it does not raise the quality.
        table_clearance_m: Least height of the gripper above the support.
        standoff_m: Length of the straight approach.
        max_climb: Largest component of the approach direction along up; 0.1 is 6 degrees from below level.
        side_preference: Quality of a level approach over that of one straight down.
        sway: Sideways acceleration that the object is to be carried against, as a share of gravity.
        doubt_length_m: Standard deviation of the surface's position that costs unseen contact a factor e.
        neighbour_gap_m: What was seen farther than this from the object and from the support is another object.
        hidden_preference: Quality of a grasp whose jaws the object hides over one with both in sight.
        gripper: Its boxes.
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
    min_clearance_m: float = 0.002
    least_room_m: float = 0.0015
    good_clearance_m: float = 0.008
    table_clearance_m: float = 0.004
    standoff_m: float = 0.10
    max_climb: float = 0.1
    side_preference: float = 0.9
    sway: float = 0.3
    doubt_length_m: float = 0.010
    neighbour_gap_m: float = 0.010
    hidden_preference: float = 0.5
    gripper: Gripper = field(default_factory=Gripper)

    def __post_init__(self) -> None:
        for knob in fields(self):
            value = getattr(self, knob.name)
            if knob.name in ("gripper", "max_climb", "table_clearance_m", "min_clearance_m", "least_room_m", "sway"):
                continue
            if knob.name.endswith("_preference") and not 0 < value <= 1:
                raise InvalidOption(f"GraspConfig.{knob.name} is {value}; a share above 0 and up to 1 is expected")
            if not value > 0:
                raise InvalidOption(f"GraspConfig.{knob.name} is {value}; a positive number is expected")
        if not 0 <= self.min_clearance_m < self.gripper.stroke_m / 2:
            raise InvalidOption(
                f"GraspConfig.min_clearance_m is {self.min_clearance_m}; 0 to half the stroke is expected"
            )
        if not 0 <= self.sway < float("inf"):
            raise InvalidOption(f"GraspConfig.sway is {self.sway}; zero or a positive finite number is expected")
        if not -1 <= self.max_climb <= 1:
            raise InvalidOption(f"GraspConfig.max_climb is {self.max_climb}; a cosine between -1 and 1 is expected")

    @property
    def max_width_m(self) -> float:
        """The widest object that the jaws close on."""
        return self.gripper.stroke_m - 2 * self.min_clearance_m
