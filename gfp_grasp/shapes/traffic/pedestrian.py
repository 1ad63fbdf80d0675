"""Pedestrians: adults and children who stand or walk, all bent from one body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh

from gfp_grasp.shapes.bones import SIDES, carried
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.grown import grown
from gfp_grasp.shapes.person import ARM_OUT_RAD, Figure, bulged, draw_figure, standing_bones, swing
from gfp_grasp.shapes.skeleton import Skeleton, first_clean

_KINDS = {"standing": 0.3, "walking": 0.4, "coat": 0.1, "pack": 0.1, "child": 0.1}
_SAFE_OUT_RAD = np.radians(30.0)


@dataclass(frozen=True)
class _Pose:
    """Angles in rad, those of limbs for left and right: ahead is positive, out is away from the body."""

    lean: float
    sway: float
    nod: float
    twist: float
    hip: tuple[float, float]
    spread: tuple[float, float]
    knee: tuple[float, float]
    ankle: tuple[float, ...]
    toe: tuple[float, float]
    arm: tuple[float, float]
    out: tuple[float, float]
    elbow: tuple[float, float]
    inward: tuple[float, float]


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    figure = draw_figure(rng, child=kind == "child", coat=kind == "coat", pack=kind == "pack")
    walks = kind == "walking" or (kind != "standing" and rng.random() < 0.6)
    pose = _draw_pose(rng, walks=walks)
    mesh = first_clean(lambda give: _bent(figure, pose, give))
    low, high = mesh.bounds
    mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    return Made(mesh, kind)


def _draw_pose(rng: np.random.Generator, *, walks: bool) -> _Pose:
    pair = lambda low, high: tuple(np.radians(rng.uniform(low, high, 2)))  # noqa: E731
    if walks:
        phase, stride = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(14, 30))
        turns = phase + np.array([0, np.pi])
        hip = stride * np.sin(turns) + 0.06
        # A knee bends most while its leg comes ahead from behind.
        knee = 0.12 + 2.1 * stride * np.clip(np.cos(turns), 0, 1) ** 1.5
        ankle = 0.35 * stride * np.sin(turns) - 0.3 * stride * np.clip(np.cos(turns), 0, 1)
        arm = -rng.uniform(0.3, 1.1) * stride * np.sin(turns)
    else:
        hip, knee = np.radians(rng.normal(0, 4, 2)), np.radians(np.abs(rng.normal(0, 5, 2)))
        hip = hip + knee / 2
        ankle, arm = np.zeros(2), np.radians(rng.normal(0, 10, 2))
    elbow = np.radians(rng.uniform(3, 35, 2))
    inward, out = np.radians(rng.uniform(-5, 25, 2)), np.radians(rng.uniform(4, 16, 2))
    # Hands hold something, lie on a hip or are in a pocket.
    busy = rng.random(2) < (0.15 if walks else 0.3)
    elbow = np.where(busy, np.radians(rng.uniform(50, 105, 2)), elbow)
    inward = np.where(busy, np.radians(rng.uniform(0, 55, 2)), inward)
    out = np.where(busy, np.radians(rng.uniform(8, 32, 2)), out)
    return _Pose(
        lean=np.radians(rng.normal(3, 3)), sway=np.radians(rng.normal(0, 1.5)), nod=np.radians(rng.normal(5, 8)),
        twist=0.25 * float(hip[1] - hip[0]) if walks else 0.0,
        hip=tuple(hip), spread=pair(-4.0, 1.0) if walks else pair(-4.0, 6.0), knee=tuple(knee), ankle=tuple(ankle),
        toe=pair(-2, 14), arm=tuple(arm), out=tuple(out), elbow=tuple(elbow), inward=tuple(inward),
    )  # fmt: skip


def _bent(figure: Figure, pose: _Pose, give: float) -> trimesh.Trimesh:
    """The body in a pose; as it gives way, arms go out, legs apart, and bends and girths shrink."""
    body, f = _body(), figure
    moves: dict[str, np.ndarray] = {}
    calm = 1 - 0.7 * give
    trunk = swing(-pose.lean, out_rad=pose.sway)
    chest = swing(-1.3 * pose.lean, out_rad=pose.sway, turn_rad=pose.twist * calm)
    put = lambda name, R, scale, on="": moves.__setitem__(  # noqa: E731
        name, body.bones[name].turned(R, scale, carried(moves[on], body.bones[name].start) if on else np.zeros(3))
    )
    put("hips", trunk, (f.trunk, f.hips, f.depth))
    put("waist", trunk, (f.trunk, f.waist, f.depth), "hips")
    put("chest", chest, (f.trunk, f.shoulders, f.depth), "waist")
    put("neck", swing(-pose.lean - pose.nod / 2), (1.0, f.head**0.7, f.head**0.7), "chest")
    put("head", swing(-pose.lean - pose.nod), (f.head, f.head, f.head), "neck")
    for i, (name, side) in enumerate(SIDES.items()):
        out = pose.out[i] + give * (_SAFE_OUT_RAD - pose.out[i])
        put(f"{name}_collar", chest, (f.shoulders, f.depth**0.5, f.depth**0.5), "chest")
        across = side * (out - ARM_OUT_RAD)
        sleeve = (f.arms, f.sleeves, f.sleeves)
        put(f"{name}_upper_arm", swing(pose.arm[i] * calm, out_rad=across), sleeve, f"{name}_collar")
        ahead, turn = (pose.arm[i] + pose.elbow[i]) * calm, -side * pose.inward[i] * calm
        fore = swing(ahead, out_rad=across, turn_rad=turn)
        put(f"{name}_forearm", fore, sleeve, f"{name}_upper_arm")
        put(f"{name}_hand", fore, (f.arms, f.shoes, f.shoes), f"{name}_forearm")
        spread = side * (pose.spread[i] + 0.12 * give)
        thigh, shin = (1 + (girth - 1) * (1 - 0.5 * give) for girth in (f.thighs, f.shins))
        put(f"{name}_thigh", swing(pose.hip[i] * calm, out_rad=spread), (f.legs, thigh, thigh), "hips")
        low = (pose.hip[i] - pose.knee[i]) * calm
        put(f"{name}_shin", swing(low, out_rad=spread), (f.legs, shin, shin), f"{name}_thigh")
        foot = swing(low * 0.7 + pose.ankle[i] * calm, turn_rad=side * pose.toe[i])
        ankle = body.bones[f"{name}_shin"].end
        at = carried(moves[f"{name}_shin"], ankle) + foot @ (body.bones[f"{name}_foot"].start - ankle) * f.shoes
        moves[f"{name}_foot"] = body.bones[f"{name}_foot"].turned(foot, (f.shoes,) * 3, at)
    mesh = body.bent(moves, vertices=bulged(body.vertices, f, 1 - 0.5 * give))
    mesh.apply_scale(f.size / (0.5 * f.legs + 0.35 * f.trunk + 0.15 * f.head))
    return mesh


@cache
def _body() -> Skeleton:
    bones = standing_bones()
    return Skeleton.of(grown(bones, edge_m=0.036, fillet_m=0.007), bones)


PEDESTRIAN = Family(
    "pedestrian",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (900.0, 1050.0),
        "alike": ("cyclist",),
        "optional_parts": (),
        "names": {"kitti": ("Pedestrian",)},
    },
    members=200,
)
