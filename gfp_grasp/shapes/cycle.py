"""The tubes and wheels of bicycles, for those that stand and those that are ridden."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import trimesh

from gfp_grasp.shapes.bones import SIDES, Bone, Bones, Ring, pipe
from gfp_grasp.transforms import rotation_about

# Each tube's ends, its radius at both, m, and its section across and in the third direction.
_TUBES = {
    "down_tube": ("head_low", "bottom", (0.019, 0.019), (1.0, 1.0)),
    "seat_tube_low": ("bottom", "through", (0.016, 0.016), (1.0, 1.0)),
    "seat_tube": ("through", "seat", (0.016, 0.016), (1.0, 1.0)),
    "post": ("seat", "saddle", (0.013, 0.013), (1.0, 1.0)),
    "top_tube": ("head", "through", (0.015, 0.015), (1.0, 1.0)),
    "head_tube": ("head_start", "head_top", (0.02, 0.02), (1.0, 1.0)),
    "stem": ("head_top", "bar", (0.02, 0.016), (1.0, 1.0)),
    "saddle": ("saddle_back", "saddle_nose", (0.075, 0.028), (1.0, 0.42)),
    "crown": ("left_crown", "right_crown", (0.019, 0.019), (1.0, 1.0)),
    "front_hub": ("left_front_hub", "right_front_hub", (0.017, 0.017), (1.0, 1.0)),
    "rear_hub": ("left_rear_hub", "right_rear_hub", (0.021, 0.021), (1.0, 1.0)),
    "bridge": ("left_bridge", "right_bridge", (0.015, 0.015), (1.0, 1.0)),
    "cluster": ("left_seat_stay", "right_seat_stay", (0.013, 0.013), (1.0, 1.0)),
    "bottom": ("left_bottom", "right_bottom", (0.022, 0.022), (1.0, 1.0)),
}
_SIDED = {
    "blade": ("crown", "front", (0.013, 0.011)),
    "chain_stay": ("bottom_stay", "rear", (0.011, 0.01)),
    "seat_stay_low": ("bridge", "rear", (0.01, 0.01)),
    "seat_stay": ("seat_stay", "bridge", (0.01, 0.01)),
    "bar": ("bar", "bend", (0.0135, 0.0135)),
    "bar_out": ("bend", "grip", (0.0135, 0.014)),
    "grip": ("grip", "bar_end", (0.0165, 0.0165)),
}
_PEDALS = {
    "axle": ("bottom", "axle", (0.022, 0.02)),
    "crank": ("crank", "pedal", (0.014, 0.012)),
    "pedal": ("pedal_in", "pedal_out", (0.024, 0.024)),
}


@dataclass(frozen=True)
class Cycle:
    """Measures of a bicycle that stands on z = 0 between its axles, before all of it is scaled.

    Attributes:
        size: Scale of the whole.
        wheel_m: Outer radius of the wheels.
        tyre_m: Half the thickness of the tyres.
        base_m: From axle to axle.
        stay_m: From the rear axle to the bottom bracket.
        bottom_m: Height of the bottom bracket.
        seat_rad: Slope of the seat tube.
        seat_tube_m: Length of the seat tube.
        saddle_m: Height of the saddle.
        saddle_long_m: Length of the saddle.
        head_rad: Slope of the head tube.
        head_m: Length of the head tube.
        stem_m: How far the handlebar is ahead of and above the head tube.
        through: Where on the seat tube the top tube ends: 1 is its upper end, less lets riders step through.
        bend_m, grip_m, end_m: Where the left handlebar goes from its middle, each (3,).
        crank_m: Length of the cranks.
        crank_rad: How far the right pedal is above the horizon; it is ahead.
        steer_rad: How far the fork is turned to the left.
        girth: Thickness of the tubes over that of the first bicycle.
    """

    size: float = 1.0
    wheel_m: float = 0.345
    tyre_m: float = 0.022
    base_m: float = 1.06
    stay_m: float = 0.44
    bottom_m: float = 0.285
    seat_rad: float = 1.27
    seat_tube_m: float = 0.5
    saddle_m: float = 0.96
    saddle_long_m: float = 0.26
    head_rad: float = 1.23
    head_m: float = 0.14
    stem_m: tuple[float, float] = (0.05, 0.07)
    through: float = 0.65
    bend_m: tuple[float, float, float] = (0.015, 0.11, 0.01)
    grip_m: tuple[float, float, float] = (0.0, 0.2, 0.015)
    end_m: tuple[float, float, float] = (-0.07, 0.285, -0.01)
    crank_m: float = 0.165
    crank_rad: float = 0.0
    steer_rad: float = 0.0
    girth: float = 1.0

    def joints(self) -> dict[str, np.ndarray]:
        """Where tubes meet, (3,) m each."""
        rear, front = np.array([-self.base_m / 2, 0, self.wheel_m]), np.array([self.base_m / 2, 0, self.wheel_m])
        low = self.bottom_m - self.wheel_m
        bottom = rear + np.array([np.sqrt(self.stay_m**2 - low**2), 0, low])
        up = np.array([-np.cos(self.seat_rad), 0, np.sin(self.seat_rad)])
        seat = bottom + self.seat_tube_m * up
        saddle = seat + up * max(self.saddle_m - 0.03 - seat[2], 0.06) / up[2]
        steer = np.array([-np.cos(self.head_rad), 0, np.sin(self.head_rad)])
        fat = self.tyre_m / 0.022
        ahead = np.array([steer[2], 0, -steer[0]])
        crown = front + (self.wheel_m + 0.01 * fat) * steer - 0.12 * self.wheel_m * ahead
        top = crown + (0.05 + self.head_m) * steer
        bar = top + np.array([self.stem_m[0], 0, self.stem_m[1]])
        through = bottom + 0.92 * self.through * (seat - bottom)
        stays = seat - 0.15 * (seat - through)
        bridge = rear + (stays - rear) * (self.wheel_m + 0.006 * fat) / np.linalg.norm(stays - rear)
        joints = {
            "bottom": bottom, "seat": seat, "saddle": saddle, "crown": crown, "bridge": bridge,
            "head_top": top, "bar": bar,
            "head_start": crown + 0.012 * fat * steer,
            "head_low": crown + 0.32 * (top - crown), "head": crown + 0.72 * (top - crown),
            "through": through,
            "saddle_back": saddle + np.array([-0.47 * self.saddle_long_m, 0, 0.012]),
            "saddle_nose": saddle + np.array([0.53 * self.saddle_long_m, 0, 0.008]),
        }  # fmt: skip
        pedal = self.crank_m * np.array([np.cos(self.crank_rad), 0, np.sin(self.crank_rad)])
        for name, side in SIDES.items():
            out = np.array([0.0, side, 0.0])
            mirror = np.array([1.0, side, 1.0])
            sided = {
                "crown": crown + 0.05 * fat * out, "front": front + (0.01 + 0.04 * fat) * out,
                "rear": rear + 0.063 * out,
                "front_hub": front + (0.022 + 0.04 * fat) * out, "rear_hub": rear + 0.078 * out,
                "bridge": bridge + 0.05 * fat * out, "seat_stay": stays + 0.038 * out, 
                "bottom": bottom + 0.055 * out, "axle": bottom + 0.092 * out,
                "bottom_stay": bottom + np.array([-0.01, 0.034 * side, 0]), "bar": bar,
                "bend": bar + mirror * self.bend_m, "grip": bar + mirror * self.grip_m,
                "bar_end": bar + mirror * self.end_m,
                "crank": bottom + 0.075 * out, "pedal": bottom + 0.085 * out - side * pedal,
                "pedal_in": bottom + 0.078 * out - side * pedal, "pedal_out": bottom + 0.185 * out - side * pedal,
            }  # fmt: skip
            joints |= {f"{name}_{joint}": place for joint, place in sided.items()}
        turn = self.steering()
        for joint in ("bar", *(f"{s}_{j}" for s in SIDES for j in _STEERED)):
            joints[joint] = crown + turn @ (joints[joint] - crown)
        joints |= {"rear": rear, "front": crown + turn @ (front - crown)}
        return {name: self.size * place for name, place in joints.items()}

    def rolled(self, at: str) -> float:
        """Angle of the place where a wheel meets its fork or bridge, rad about its axle from ahead up."""
        joints = replace(self, steer_rad=0.0).joints()
        x, _, z = joints["crown" if at == "front" else "bridge"] - joints[at]
        return float(np.arctan2(z, x))

    def eased(self, give: float) -> Cycle:
        """A bicycle between this one (give is 0) and the first one in the size of this one (give is 1)."""
        own, first = (np.hstack([getattr(cycle, f.name) for f in fields(self)[1:]]) for cycle in (self, FIRST))
        mixed = iter(own + give * (first - own))
        values = [
            tuple(next(mixed) for _ in value) if isinstance(value, tuple) else next(mixed)
            for value in (getattr(self, f.name) for f in fields(self)[1:])
        ]
        return Cycle(self.size, *values)  # pyright: ignore[reportArgumentType]

    def steering(self) -> np.ndarray:
        """Rotation (3, 3) of the fork."""
        return rotation_about((-np.cos(self.head_rad), 0, np.sin(self.head_rad)), self.steer_rad)

    def bones(self, *, ridden: bool = False) -> Bones:
        """Tubes and wheels; those of a ridden one without saddle, cranks and pedals, which its rider hides."""
        joints = self.joints()
        middle = self.wheel_m - self.tyre_m
        bones: dict[str, Bone | Ring] = {
            f"{at}_wheel": Ring(joints[at], middle, self.tyre_m) for at in ("rear", "front")
        }
        for name, (start, end, radii, aspect) in _tubes(ridden=ridden).items():
            bones[name] = Bone(joints[start], joints[end], radii, aspect)
        return bones

    def meshes(self, *, ridden: bool = False) -> list[trimesh.Trimesh]:
        """Closed meshes of the wheels and of tubes, those that go on from each other as one."""
        bones = self.bones(ridden=ridden)
        chains = [
            _BAR,
            _HEAD,
            _SEAT,
            *([name] for name in _tubes(ridden=ridden) if name not in {*_BAR, *_HEAD, *_SEAT}),
        ]
        tubes = [[_backward(bones[name]) if name in _BAR[:3] else bones[name] for name in chain] for chain in chains]
        return [*(bones[f"{at}_wheel"].mesh() for at in ("rear", "front")), *map(pipe, tubes)]

    def moves(self, bones: Bones, vertices: np.ndarray, *, ridden: bool = False) -> dict[str, np.ndarray]:
        """Maps of each bone of the first bicycle that bring it, and vertices (v, 3) m around it, to this one."""
        joints = self.joints()
        moves = {}
        for at, turn in (("rear", np.eye(3)), ("front", self.steering())):
            roll = rotation_about((0, 1, 0), FIRST.rolled(at) - self.rolled(at))
            moves[f"{at}_wheel"] = bones[f"{at}_wheel"].moved(
                vertices, turn @ roll, joints[at],
                radius_m=self.size * (self.wheel_m - self.tyre_m), tyre_m=self.size * self.tyre_m,
            )  # fmt: skip
        for name, (start, end, _, _) in _tubes(ridden=ridden).items():
            girth = 1.0 if name == "saddle" else self.girth
            if name in ("crown", "bridge"):  # they carry the tyre's surface with them
                girth = self.tyre_m / FIRST.tyre_m
            moves[name] = bones[name].between(joints[start], joints[end], (self.size * girth,) * 2)
            if name.endswith("_axle"):
                bone = bones[name]
                turn = rotation_about((0, 1, 0), -self.crank_rad)
                scale = (float(np.linalg.norm(joints[end] - joints[start])) / bone.length_m, self.size, self.size)
                moves[name] = bone.turned(turn, scale, joints[start])
        return moves


FIRST = Cycle()  # the bicycle that others are bent from
_BAR = ["left_grip", "left_bar_out", "left_bar", "right_bar", "right_bar_out", "right_grip"]
_HEAD = ["head_tube", "stem"]
_SEAT = ["seat_tube_low", "seat_tube", "post"]
_STEERED = ("crown", "front", "front_hub", "bar", "bend", "grip", "bar_end")


def _tubes(*, ridden: bool = False) -> dict[str, tuple]:
    sided = _SIDED if ridden else _SIDED | _PEDALS
    tubes = {name: tube for name, tube in _TUBES.items() if not (ridden and name == "saddle")}
    return tubes | {
        f"{side}_{name}": (f"{side}_{start}", f"{side}_{end}", radii, (1.6, 0.5) if name == "pedal" else (1.0, 1.0))
        for side in SIDES
        for name, (start, end, radii) in sided.items()
    }


def _backward(bone: Bone) -> Bone:
    return Bone(bone.end, bone.start, bone.radii[::-1], bone.aspect)
