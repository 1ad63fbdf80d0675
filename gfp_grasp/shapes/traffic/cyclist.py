"""Cyclists: a person on a bicycle, hands on the bar, feet anywhere on their circle; all bent from one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh

from gfp_grasp.shapes.bones import SIDES, Bone
from gfp_grasp.shapes.cycle import FIRST, Cycle
from gfp_grasp.shapes.cycle_styles import draw_cycle
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.grown import grown
from gfp_grasp.shapes.loft import unite
from gfp_grasp.shapes.person import Figure, draw_figure
from gfp_grasp.shapes.skeleton import Skeleton, first_clean

_KINDS = {"city": 0.4, "trekking": 0.25, "mountain": 0.15, "road": 0.1, "child": 0.1}
_LEAN = {"city": (2, 25), "trekking": (12, 38), "mountain": (18, 42), "road": (35, 55), "child": (2, 25)}
_THIGH_M, _SHIN_M, _UPPER_ARM_M, _FOREARM_M = 0.415, 0.41, 0.29, 0.25
_FARTHEST_LEAN_RAD = np.radians(62.0)


@dataclass(frozen=True)
class _Ride:
    """One rider on one bicycle.

    Attributes:
        cycle: The bicycle.
        figure: The rider's girths; lengths come from the bicycle.
        lean_rad: How far the trunk leans ahead, at least: arms must reach the bar.
        crank_rad: Where the right pedal is on its circle.
        crank_m: Radius of that circle.
        stretch: Longest leg over its length, when its pedal is farthest.
        nod: How far the head is bent back against the trunk, as a share of the lean.
    """

    cycle: Cycle
    figure: Figure
    lean_rad: float
    crank_rad: float
    crank_m: float
    stretch: float
    nod: float


_STANDARD = Figure(1.0, *[1.0] * 12, *[0.0] * 5)
_FIRST = _Ride(FIRST, _STANDARD, np.radians(18.0), 0.0, 0.0, 0.86, 0.7)


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    cycle = replace(draw_cycle(rng, kind), steer_rad=float(np.clip(rng.normal(0, 0.05), -0.12, 0.12)))
    figure = draw_figure(rng, child=kind == "child", coat=rng.random() < 0.2)
    ride = _Ride(
        cycle, figure, np.radians(rng.uniform(*_LEAN[kind])), rng.uniform(0, 2 * np.pi), cycle.crank_m,
        rng.uniform(0.9, 0.985), rng.uniform(0.5, 1.0),
    )  # fmt: skip
    return Made(first_clean(lambda give: _bent(ride, give)), kind)


def _bent(ride: _Ride, give: float) -> trimesh.Trimesh:
    """The ride; as it gives way, pedals move to the middle of their circle, girths become those of the first rider."""
    calm = 1 - give
    figure = replace(
        ride.figure, **{n: 1 + (getattr(ride.figure, n) - 1) * calm for n in ("hips", "waist", "depth", "thighs")}
    )
    ride = replace(ride, cycle=ride.cycle.eased(give), figure=figure, crank_m=ride.crank_m * calm)
    body = _body()
    moves = ride.cycle.moves(body.bones, body.vertices, ridden=True)
    for name, bone in _rider(ride).items():
        first = body.bones[name]
        girth = np.divide(bone.aspect, first.aspect) * sum(bone.radii) / sum(first.radii)
        moves[name] = first.between(bone.start, bone.end, tuple(girth))
    return body.mended(moves)


@cache
def _body() -> Skeleton:
    rider = _rider(_FIRST)
    whole = unite([grown(rider, edge_m=0.042, fillet_m=0.007), *FIRST.meshes(ridden=True)])
    return Skeleton.of(whole, {**FIRST.bones(ridden=True), **rider}, spread_m=0.01)


def _rider(ride: _Ride) -> dict[str, Bone]:
    """Bones of the rider, where the bicycle wants them."""
    f, joints = ride.figure, ride.cycle.joints()
    seat, bottom = joints["saddle"], (joints["left_bottom"] + joints["right_bottom"]) / 2
    crank = ride.crank_m * ride.cycle.size
    # The leg is as long as the farthest pedal asks for; it tells the rider's size.
    farthest = float(np.linalg.norm(seat - bottom + np.array([0.11, 0, 0.005]))) + ride.cycle.crank_m * ride.cycle.size
    size = farthest / ride.stretch / (_THIGH_M + _SHIN_M)
    middle = seat + np.array([0.0, 0.0, 0.085]) * size
    for lean in np.linspace(ride.lean_rad, max(_FARTHEST_LEAN_RAD, ride.lean_rad), 12):
        bones = _trunk(f, middle, size, lean, ride.nod)
        apart = max(float(np.linalg.norm(_shoulder(bones, s, f, size) - _hand(joints, s))) for s in SIDES)
        if apart < 0.96 * size * f.arms * (_UPPER_ARM_M + _FOREARM_M):
            break
    for name, side in SIDES.items():
        shoulder, hand = _shoulder(bones, name, f, size), _hand(joints, name)
        reach = max(size * f.arms, apart / 0.99 / (_UPPER_ARM_M + _FOREARM_M))
        elbow = _bend(shoulder, hand, reach * _UPPER_ARM_M, reach * _FOREARM_M, np.array([-0.3, 0.7 * side, -0.8]))
        way = (hand - elbow) / np.linalg.norm(hand - elbow)
        hip = middle + np.array([0.0, 0.088 * side * f.hips, -0.01]) * size
        turn = ride.crank_rad + (np.pi if name == "left" else 0.0)
        ball = bottom + np.array([crank * np.cos(turn), 0.135 * side, crank * np.sin(turn)])
        tilt = np.radians(8.0) - 0.25 * np.sin(turn) * (crank > 0) * crank / 0.17
        toe = np.array([np.cos(tilt), 0.08 * side, np.sin(tilt)])
        heel = ball - 0.15 * size * toe + [0, 0, 0.03 * size]
        ankle = heel + np.array([0.025, 0.0, 0.045]) * size
        leg = size * _THIGH_M, size * _SHIN_M
        knee = _bend(hip, ankle, *leg, np.array([1.0, 0.12 * side, 0.3]))
        arm, thigh, shin = size * f.sleeves, size * f.thighs, size * f.shins
        bones |= {
            f"{name}_collar": Bone(
                bones["chest"].end + 0.05 * side * size * np.array([0, 1, 0]), shoulder, (0.06 * size, 0.052 * size)
            ),
            f"{name}_upper_arm": Bone(shoulder, elbow, (0.05 * arm, 0.04 * arm)),
            f"{name}_forearm": Bone(elbow, hand - 0.05 * size * way, (0.04 * arm, 0.029 * arm)),
            f"{name}_hand": Bone(hand - 0.05 * size * way, hand + 0.035 * size * way, (0.036 * size, 0.034 * size)),
            f"{name}_thigh": Bone(hip, knee, (0.083 * thigh, 0.058 * thigh)),
            f"{name}_shin": Bone(knee, ankle, (0.056 * shin, 0.038 * shin)),
            f"{name}_foot": Bone(heel, ball + 0.045 * size * toe, (0.04 * size * f.shoes, 0.034 * size * f.shoes)),
        }
    return bones


def _trunk(f: Figure, middle: np.ndarray, size: float, lean: float, nod: float) -> dict[str, Bone]:
    at, bones = middle, {}
    for name, length, turn, radii, aspect in (
        ("hips", 0.1, 0.6, (0.108, 0.104), (1.5 * f.hips, f.depth)),
        ("waist", 0.18 * f.trunk, 0.85, (0.1, 0.108), (1.34 * f.waist, f.depth)),
        ("chest", 0.19 * f.trunk, 1.15, (0.11, 0.085), (1.42 * f.shoulders, 1.05 * f.depth)),
        ("neck", 0.13, 1.15 - 0.5 * nod, (0.056, 0.05), (1.0, 1.0)),
        ("head", 0.08 * f.head, 1.15 * (1 - nod), (0.08 * f.head, 0.087 * f.head), (0.92, 1.12)),
    ):
        start = at + (np.array([0.015, 0, 0.05]) * size if name == "head" else 0.0)
        at = start + size * length * np.array([np.sin(turn * lean), 0, np.cos(turn * lean)])
        bones[name] = Bone(start, at, (size * radii[0], size * radii[1]), aspect)
    return bones


def _shoulder(bones: Mapping[str, Bone], name: str, f: Figure, size: float) -> np.ndarray:
    return bones["chest"].end + np.array([0.01, 0.175 * SIDES[name] * f.shoulders, 0.02]) * size


def _hand(joints: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    return 0.45 * joints[f"{name}_grip"] + 0.55 * joints[f"{name}_bar_end"] + [0, 0, 0.012]


def _bend(start: np.ndarray, end: np.ndarray, upper: float, lower: float, pole: np.ndarray) -> np.ndarray:
    """Where a knee or an elbow is, towards the pole, between two ends of a limb of given lengths."""
    way = end - start
    apart = min(float(np.linalg.norm(way)), 0.999 * (upper + lower))
    way = way / np.linalg.norm(way)
    along = (apart**2 + upper**2 - lower**2) / (2 * apart)
    out = pole - (pole @ way) * way
    return start + along * way + np.sqrt(max(upper**2 - along**2, 0.0)) * out / np.linalg.norm(out)


CYCLIST = Family(
    "cyclist",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (700.0, 1100.0),
        "alike": ("pedestrian", "bicycle", "motorcycle"),
        "optional_parts": (),
        "names": {"kitti": ("Cyclist",)},
    },
    members=200,
)
