"""What a trial goes through, in numbers."""

from dataclasses import asdict, dataclass, fields

from gfp_grasp.errors import InvalidOption


@dataclass(frozen=True)
class TrialSettings:
    """A trial, step by step; every outcome carries these numbers.

    1. Approach: from standoff_m behind the grasp, along its z, in approach_s. A contact force above touch_n on
       anything, or an object pushed by push_m, is `collided_on_approach`.
    2. Close: the jaws close by grip_ramp_mps, then press until close_s is over, each with grip_n at most. Fewer than
       two pads on the object then is `no_contact`.
    3. Lift by lift_m straight up in lift_s, then hold for hold_s.
    4. Shake: shake_cycles of a sinusoid of shake_m along the world's x and then y at shake_hz (3 m/s2 at its peak),
       then a turn by turn_deg to either side about each of these axes through the gripper at turn_hz.
    5. Release: the jaws open at once, and release_s later the object should have fallen by drop_m. This is told
       (`falls_free`), but is no part of success: what a hook holds is held.

    From the end of closing on, the object's point that was at the gripper's origin may leave it by slip_m and the
    object may turn in the gripper by slip_deg; more, or losing both pads, is `slipped_on_lift` or `slipped_on_shake`.
    A state that is not finite, a warning of the solver or a speed above too_fast_mps is `unstable`.

    Attributes:
        standoff_m: Length of the approach.
        approach_s: Duration of the approach.
        touch_n: Contact force that counts as a collision.
        push_m: Displacement of the object that counts as a collision.
        close_s: Time for the jaws to close and settle.
        grip_ramp_mps: Speed of the opening while they close.
        grip_n: Force limit of each jaw.
        lift_m: Height of the lift.
        lift_s: Duration of the lift.
        hold_s: Rest after the lift.
        shake_m: Amplitude of the shaking sinusoid.
        shake_hz: Frequency of the shaking sinusoid.
        shake_cycles: Cycles along each axis.
        turn_deg: Amplitude of the shaking rotation.
        turn_hz: Frequency of that rotation; one cycle about each axis.
        slip_m: Limit of slip.
        slip_deg: Limit of turning.
        release_s: Time for a released object to fall.
        drop_m: Least fall.
        too_fast_mps: Speed that no object reaches in a sound simulation.
        control_s: Time between two commands and checks.
    """

    standoff_m: float = 0.10
    approach_s: float = 0.6
    touch_n: float = 1.0
    push_m: float = 0.003
    close_s: float = 0.8
    grip_ramp_mps: float = 0.2
    grip_n: float = 30.0
    lift_m: float = 0.2
    lift_s: float = 0.8
    hold_s: float = 0.4
    shake_m: float = 0.02
    shake_hz: float = 2.0
    shake_cycles: int = 2
    turn_deg: float = 15.0
    turn_hz: float = 1.0
    slip_m: float = 0.010
    slip_deg: float = 10.0
    release_s: float = 0.3
    drop_m: float = 0.05
    too_fast_mps: float = 20.0
    control_s: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0 or value == float("inf"):
                raise InvalidOption(f"TrialSettings.{field.name} is {value}; a positive finite number is expected")

    def as_dict(self) -> dict[str, float]:
        """The numbers by name, for an Outcome and for result files."""
        return asdict(self)
