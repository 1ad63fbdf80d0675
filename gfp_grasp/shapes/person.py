"""A person's bones and the proportions of people, for those who walk and those who ride."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.shapes.bones import SIDES, Bone
from gfp_grasp.transforms import rotation_about

HEIGHT_M = 1.75  # height of the person before bending
ARM_OUT_RAD = np.radians(35.0)  # arms stand off as far as this before bending

HIP, KNEE, ANKLE = np.array([0.0, 0.09, 0.90]), np.array([0.01, 0.115, 0.49]), np.array([-0.015, 0.135, 0.085])
SHOULDER = np.array([0.0, 0.175, 1.415])


def standing_bones() -> dict[str, Bone]:
    """Bones of a person of 1.75 m who stands with arms and legs apart."""
    arm = np.array([0.0, np.sin(ARM_OUT_RAD), -np.cos(ARM_OUT_RAD)])
    elbow, wrist, tip = (SHOULDER + way * arm for way in (0.29, 0.53, 0.66))
    bones = {
        "hips": _bone((0, 0, 0.92), (0, 0, 1.02), (0.108, 0.104), (1.5, 1.0)),
        "waist": _bone((0, 0, 1.02), (0, 0, 1.2), (0.1, 0.108), (1.34, 1.0)),
        "chest": _bone((0, 0, 1.2), (-0.01, 0, 1.38), (0.11, 0.085), (1.42, 1.05)),
        "neck": _bone((-0.01, 0, 1.4), (0.01, 0, 1.53), (0.056, 0.05), (1.0, 1.0)),
        "head": _bone((0.02, 0, 1.585), (0.015, 0, 1.66), (0.078, 0.086), (0.92, 1.12)),
    }
    for name, side in SIDES.items():
        mirror = np.array([1.0, side, 1.0])
        for part, start, end, radii, aspect in (
            ("collar", (-0.01, 0.05, 1.405), SHOULDER, (0.06, 0.052), (1.0, 1.0)),
            ("upper_arm", SHOULDER, elbow, (0.05, 0.04), (1.0, 1.0)),
            ("forearm", elbow, wrist, (0.04, 0.029), (1.0, 1.0)),
            ("hand", wrist, tip, (0.035, 0.03), (0.7, 1.25)),
            ("thigh", HIP, KNEE, (0.083, 0.058), (1.0, 1.05)),
            ("shin", KNEE, ANKLE, (0.056, 0.038), (1.0, 1.05)),
            ("foot", (-0.04, 0.135, 0.043), (0.155, 0.15, 0.034), (0.04, 0.034), (1.05, 0.95)),
        ):
            bones[f"{name}_{part}"] = _bone(mirror * start, mirror * end, radii, aspect)
    return bones


@dataclass(frozen=True)
class Figure:
    """Proportions of one person against the standing bones.

    Attributes:
        size: Scale of the whole.
        legs, arms, trunk: Lengths of limbs and trunk.
        head: Size of the head.
        shoulders, hips, waist: Half-widths of the trunk across.
        depth: Depth of the trunk from front to back.
        thighs, shins, sleeves: Girths of the limbs.
        shoes: Size of the feet.
        belly, bust, seat, back, hair: How far bulges stand out, m before scaling: of the belly, the chest, the
            buttocks, what is worn on the back, and behind the neck.
    """

    size: float
    legs: float
    arms: float
    trunk: float
    head: float
    shoulders: float
    hips: float
    waist: float
    depth: float
    thighs: float
    shins: float
    sleeves: float
    shoes: float
    belly: float
    bust: float
    seat: float
    back: float
    hair: float


def draw_figure(rng: np.random.Generator, *, child: bool, coat: bool = False, pack: bool = False) -> Figure:
    """One person: heavier people are wider everywhere, children have large heads and short limbs."""
    tall = rng.uniform(1.0, 1.55) if child else np.clip(rng.normal(1.71, 0.095), 1.48, 1.98)
    young = np.clip((1.6 - tall) / 0.6, 0, 1) if child else 0.0
    heavy = np.clip(rng.normal(0.0, 1.0), -1.6, 2.6)
    female = rng.uniform(0, 1)
    about = lambda spread: np.exp(spread * np.clip(rng.normal(), -2, 2))  # noqa: E731
    wide = np.exp(0.075 * heavy)
    worn = rng.uniform(0.08, 0.3) if coat else rng.uniform(-0.02, 0.08)  # cloth adds to girths
    return Figure(
        size=tall / HEIGHT_M,
        legs=(1 - 0.1 * young) * about(0.03),
        arms=(1 - 0.06 * young) * about(0.035),
        trunk=(1 + 0.02 * young) * about(0.03),
        head=(1 + 0.42 * young) * (1 + 0.05 * (1.0 - tall / HEIGHT_M)) * about(0.04),
        shoulders=(1.06 - 0.14 * female) * np.exp(0.03 * heavy) * (1 + 0.3 * max(worn, 0)) * about(0.04),
        hips=(0.93 + 0.1 * female) * wide * (1 + 0.8 * worn) * about(0.04),
        waist=(1.0 - 0.13 * female) * np.exp(0.11 * heavy) * (1 + worn) * about(0.05),
        depth=np.exp(0.09 * heavy) * (1 + 0.7 * worn) * about(0.06),
        thighs=(0.94 + 0.08 * female) * np.exp(0.08 * heavy) * (1 + 0.5 * worn) * about(0.06),
        shins=np.exp(0.06 * heavy) * rng.uniform(0.9, 1.35),
        sleeves=np.exp(0.07 * heavy) * (1 + 1.2 * worn) * rng.uniform(0.92, 1.2),
        shoes=about(0.06) * (1 + 0.1 * young),
        belly=max(0.0, 0.025 * heavy + rng.normal(0.005, 0.02)),
        bust=rng.uniform(0.0, 0.06) * female,
        seat=rng.uniform(0.0, 0.045),
        back=rng.uniform(0.08, 0.24) if pack else 0.0,
        hair=rng.uniform(0.0, 0.07) * female,
    )


def bulged(vertices: np.ndarray, figure: Figure, share: float) -> np.ndarray:
    """The standing person's vertices (v, 3) m with a share of the bulges that limbs do not carry."""
    x, y, z = vertices.T
    trunk = np.exp(-((y / 0.17) ** 6))
    out = np.zeros(len(vertices))
    for high, tall, wide, reach in (
        (1.06, 0.13, 0.16, figure.belly),
        (1.3, 0.08, 0.16, figure.bust),
        (0.93, 0.09, 0.17, -figure.seat),
        (1.25, 0.19, 0.14, -figure.back),
        (1.5, 0.1, 0.09, -figure.hair),
    ):
        facing = np.clip(np.sign(reach) * x / 0.05 + 0.2, 0, 1)
        out += share * reach * facing * np.exp(-(((z - high) / tall) ** 4) - (y / wide) ** 4) * trunk
    return vertices + out[:, None] * [1, 0, 0]


def swing(ahead_rad: float, *, out_rad: float = 0.0, turn_rad: float = 0.0) -> np.ndarray:
    """Rotation (3, 3) of a limb: first out towards +y, then ahead towards +x, then about the vertical."""
    return (
        rotation_about((0, 0, 1), turn_rad) @ rotation_about((0, 1, 0), -ahead_rad) @ rotation_about((1, 0, 0), out_rad)
    )


def _bone(start, end, radii: tuple[float, float], aspect: tuple[float, float]) -> Bone:
    return Bone(np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64), radii, aspect)
