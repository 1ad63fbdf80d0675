"""What the planner allows and how it ranks."""

from dataclasses import dataclass, field, fields

from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps.gripper import Gripper


@dataclass(frozen=True)
class GraspConfig:
    """Knobs of `plan_grasps`.

    Attributes:
        num_rays: Surface points from which closing lines are cast.
        num_directions: Approach directions tried about each closing axis, evenly over the turn.
        num_poses: Poses that are checked for collision, at most; they are drawn evenly over the closing lines.
        num_points: Surface points that stand for the object in collision and contact checks.
        friction: Coulomb coefficient; both contact normals must lie within its cone about the closing axis.
        jaw_clearance_m: Room to either side of the object before the jaws close, where the stroke allows it.
        min_clearance_m: Least room to either side; the widest graspable object is the stroke less twice this.
        good_clearance_m: Room around the gripper from which on more of it does not raise the quality.
        table_clearance_m: Least height of the gripper above the support.
        standoff_m: Length of the straight approach.
        max_climb: Largest component of the approach direction along up; 0.1 is 6 degrees from below level.
        side_preference: Quality of a level approach over that of one straight down.
        balance_length_m: Level distance of the centre of mass from the closing line that costs a factor e.
        doubt_length_m: Standard deviation of the surface's position that costs unseen contact a factor e.
        gripper: Its boxes.
    """

    num_rays: int = 500
    num_directions: int = 12
    num_poses: int = 600
    num_points: int = 4000
    friction: float = 0.5
    jaw_clearance_m: float = 0.010
    min_clearance_m: float = 0.002
    good_clearance_m: float = 0.008
    table_clearance_m: float = 0.004
    standoff_m: float = 0.10
    max_climb: float = 0.1
    side_preference: float = 0.9
    balance_length_m: float = 0.06
    doubt_length_m: float = 0.010
    gripper: Gripper = field(default_factory=Gripper)

    def __post_init__(self) -> None:
        for knob in fields(self):
            value = getattr(self, knob.name)
            if knob.name in ("gripper", "max_climb", "table_clearance_m", "min_clearance_m"):
                continue
            if not value > 0:
                raise InvalidOption(f"GraspConfig.{knob.name} is {value}; a positive number is expected")
        if not 0 <= self.min_clearance_m < self.gripper.stroke_m / 2:
            raise InvalidOption(
                f"GraspConfig.min_clearance_m is {self.min_clearance_m}; 0 to half the stroke is expected"
            )
        if not -1 <= self.max_climb <= 1:
            raise InvalidOption(f"GraspConfig.max_climb is {self.max_climb}; a cosine between -1 and 1 is expected")

    @property
    def max_width_m(self) -> float:
        """The widest object that the jaws close on."""
        return self.gripper.stroke_m - 2 * self.min_clearance_m
