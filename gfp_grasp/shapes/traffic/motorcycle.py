"""Motorcycles and scooters without riders, all bent from one whose middle sinks for a scooter."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.shapes.bones import SIDES, Bone, Bones, Ring, pipe
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.grown import grown
from gfp_grasp.shapes.loft import unite
from gfp_grasp.shapes.skeleton import Skeleton, first_clean

_KINDS = {"street": 0.35, "sport": 0.2, "cruiser": 0.15, "scooter": 0.3}
# Bones of the body, smoothly united: their ends, and the half-widths (across at either end, in height) of each.
_BODY = {
    "neck": ("head", "engine_front"),
    "fairing": ("head", "tank"),
    "tank": ("tank", "waist"),
    "riser": ("waist", "seat"),
    "seat": ("seat", "seat_back"),
    "tail": ("seat_back", "tail"),
    "engine": ("engine_front", "engine_back"),
    "rear": ("seat", "engine_back"),
    "lamp": ("lamp_back", "lamp"),
}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    machine = _machine(_draw(rng, kind))
    return Made(first_clean(lambda give: _bent(machine, give)), kind)


def _bent(machine: Bones, give: float) -> trimesh.Trimesh:
    """The machine; as it gives way, it goes towards the first one, of its own size."""
    body, moves = _first(), {}
    long = [bones["front_wheel"].start[0] - bones["rear_wheel"].start[0] for bones in (machine, body.bones)]
    size = long[0] / long[1]

    def mixed(own, first):
        return (1 - give) * np.asarray(own) + give * np.asarray(first)

    for name, first in body.bones.items():
        bone = machine[name]
        start = mixed(bone.start, size * first.start)
        if isinstance(first, Ring):
            radius, tyre = mixed((bone.radius_m, bone.tyre_m), (size * first.radius_m, size * first.tyre_m))
            moves[name] = first.moved(body.vertices, np.eye(3), start, radius_m=radius, tyre_m=tyre)
            continue
        own = np.multiply(bone.aspect, np.mean(bone.radii)) / np.multiply(first.aspect, np.mean(first.radii))
        moves[name] = first.between(start, mixed(bone.end, size * first.end), tuple(mixed(own, (size, size))))
    return body.mended(moves)


@cache
def _first() -> Skeleton:
    bones = _machine(_FIRST)
    body = grown({name: bones[name] for name in _BODY}, edge_m=0.045, fillet_m=0.012)
    parts = [body]
    for name, bone in bones.items():
        if isinstance(bone, Ring):
            parts.append(bone.mesh(around=36))
        elif name.endswith("stalk"):
            parts.append(pipe([bone, bones[name.replace("stalk", "mirror")]]))
        elif name not in _BODY and not any(part in name for part in ("bar", "mirror")):
            parts.append(pipe([bone], segments=24 if name.endswith("disc") else 8))
    bar = [bones[f"left_{part}"] for part in ("bar_out", "bar")]
    bar = [Bone(bone.end, bone.start, bone.radii[::-1]) for bone in bar]
    parts.append(pipe([*bar, bones["right_bar"], bones["right_bar_out"]]))
    return Skeleton.of(unite(parts), bones, spread_m=0.012)


# Places in x and z, m, and half-widths (across, in height), m, of a machine between a motorcycle and a scooter.
_FIRST = {
    "front": (0.68, 0.29), "rear": (-0.66, 0.29), "crown": (0.45, 0.74), "head": (0.4, 0.8), "bar": (0.36, 0.95),
    "bend": (0.32, 1.01), "grip": (0.24, 1.0), "tank": (0.26, 0.6), "waist": (-0.05, 0.58), "seat": (-0.2, 0.7),
    "seat_back": (-0.5, 0.74), "tail": (-0.84, 0.76), "engine_front": (0.18, 0.38), "engine_back": (-0.3, 0.36),
    "lamp_back": (0.45, 0.82), "lamp": (0.56, 0.83), "wheels": (0.29, 0.27), "tyre": (0.055, 0.055),
    "grips": (0.36, 0.2),
    "pipe_end": (-0.72, 0.36), "mirror": (0.3, 1.16), "size_neck": (0.13, 0.09),
    "size_fairing": (0.12, 0.09), "size_tank": (0.14, 0.12), "size_riser": (0.13, 0.11), "size_seat": (0.14, 0.08),
    "size_tail": (0.1, 0.06), "size_engine": (0.16, 0.13), "size_rear": (0.13, 0.15), "size_lamp": (0.1, 0.09),
}  # fmt: skip


# Height of the tank above the engine over the tank's half-width in height: less, and they would pass each other.
_STOREY = (_FIRST["tank"][1] - _FIRST["engine_front"][1]) / _FIRST["size_tank"][1]


def _draw(rng: np.random.Generator, kind: str) -> dict[str, tuple[float, float]]:
    """Places and half-widths of one machine, as in _FIRST."""
    u = rng.uniform
    base = {"street": u(1.32, 1.5), "sport": u(1.34, 1.46), "cruiser": u(1.5, 1.72), "scooter": u(1.18, 1.46)}[kind]
    front = u(0.29, 0.34) if kind != "scooter" else u(0.2, 0.3)
    rear = {"scooter": front * u(0.95, 1.02), "cruiser": u(0.29, 0.33)}.get(kind, u(0.29, 0.325))
    seat = {"street": u(0.76, 0.87), "sport": u(0.79, 0.85), "cruiser": u(0.65, 0.74), "scooter": u(0.72, 0.82)}[kind]
    bar = {"street": u(1.0, 1.16), "sport": u(0.86, 0.98), "cruiser": u(0.98, 1.2), "scooter": u(0.96, 1.12)}[kind]
    slope = np.radians({"cruiser": u(56, 62), "scooter": u(62, 66)}.get(kind, u(63, 67)))
    x0, x1 = -base / 2, base / 2
    high = max(bar - (u(0.05, 0.12) if kind == "sport" else u(0.14, 0.24)), 2 * front + 0.16)
    bar = max(bar, high + 0.2)
    over = 2 * rear + 0.05  # what is over the rear wheel stays above this
    up = lambda z: x1 - 0.06 - (z - front) / np.tan(slope)  # noqa: E731
    head = (up(high) - 0.03, high)
    places = {
        "front": (x1, front), "rear": (x0, rear), "wheels": (front, rear), "crown": (up(high - 0.05), high - 0.05),
        "head": head, "bar": (up(bar - 0.05) - 0.02, bar - 0.05), "lamp_back": (head[0] + 0.05, high + u(0.01, 0.03)),
        "tail": (x0 - u(0.02, 0.3), max(seat + u(-0.06, 0.06), over + 0.05)), "grips": (u(0.33, 0.43), u(0.15, 0.24)),
        "pipe_end": (x0 + u(-0.15, 0.2), u(0.3, 0.5)),
    }  # fmt: skip
    bend = places["bar"][0] - u(0.0, 0.05), bar + u(-0.03, 0.03)
    reach = {"cruiser": u(0.1, 0.28), "sport": u(0.02, 0.1)}.get(kind, u(0.05, 0.15))
    places |= {"bend": bend, "grip": (bend[0] - reach, bend[1] + u(-0.06, 0.02))}
    places["mirror"] = (bend[0] + u(-0.06, 0.06), bend[1] + u(0.06, 0.2))
    places["lamp"] = (places["lamp_back"][0] + u(0.05, 0.16), places["lamp_back"][1] + u(-0.05, 0.02))
    if kind == "scooter":
        floor, thick, wide = u(0.23, 0.31), u(0.03, 0.05), u(0.13, 0.19)
        shield, edge, top = (
            min(head[0] - u(0.02, 0.08), x1 - front - wide - 0.02),
            x0 + u(0.42, 0.56),
            floor + 1.12 * _STOREY * thick,
        )
        return places | {
            "tyre": (u(0.045, 0.06), u(0.045, 0.06)), "engine_front": (shield, floor), "tank": (shield, top),
            "engine_back": (edge - 0.12, floor), "waist": (edge, top), "seat": (edge - 0.02, seat - 0.08),
            "seat_back": (edge - u(0.3, 0.42), max(seat - 0.06, over + 0.08)),
            "size_neck": (u(0.13, 0.19), u(0.05, 0.07)), "size_fairing": (u(0.12, 0.19), u(0.04, 0.06)),
            "size_tank": (wide, thick), "size_riser": (u(0.1, 0.15), 0.08), "size_seat": (u(0.12, 0.17), u(0.07, 0.1)),
            "size_tail": (u(0.1, 0.16), u(0.05, 0.09)), "size_engine": (wide, 1.08 * thick),
            "size_rear": (u(0.13, 0.18), u(0.1, 0.16)), "size_lamp": (u(0.09, 0.15), u(0.08, 0.12)),
        }  # fmt: skip
    low, belly = u(0.34, 0.42), u(0.12, 0.17)
    fairing = {"sport": u(0.13, 0.18), "cruiser": u(0.09, 0.11)}.get(kind, u(0.09, 0.15))
    start = u(-0.2, -0.05) - 0.1 * (kind == "cruiser")
    return places | {
        "tyre": (u(0.05, 0.062), u(0.062, 0.095)), "tank": (head[0] - u(0.1, 0.16), seat + u(-0.1, 0.02)),
        "waist": (start + 0.1, seat - u(0.08, 0.14)), "seat": (start, seat - 0.08),
        "seat_back": (x0 + u(0.1, 0.3), max(seat - u(0.02, 0.09), over + 0.06)),
        "engine_front": (x1 - front - 0.17 - u(0.03, 0.1), low), "engine_back": (x0 + rear + u(0.08, 0.16), low),
        "size_neck": (fairing, u(0.06, 0.1) + 0.2 * max(fairing - 0.12, 0)),
        "size_fairing": (u(0.09, 0.12) + 0.3 * max(fairing - 0.1, 0), u(0.08, 0.12)),
        "size_tank": (u(0.11, 0.17), u(0.1, 0.16)), "size_riser": (u(0.1, 0.15), u(0.09, 0.13)),
        "size_seat": (u(0.1, 0.17), u(0.05, 0.09)), "size_tail": (u(0.06, 0.12), u(0.035, 0.08)),
        "size_engine": (u(0.14, 0.2), belly), "size_rear": (u(0.09, 0.14), u(0.1, 0.16)),
        "size_lamp": (u(0.08, 0.12) + 0.5 * max(fairing - 0.12, 0), u(0.07, 0.13)),
    }  # fmt: skip


def _machine(p: Mapping[str, tuple[float, float]]) -> Bones:
    """Bones of a machine with such places and half-widths."""
    at = lambda name, y=0.0: np.array([p[name][0], y, p[name][1]])  # noqa: E731
    bones: dict[str, Any] = {}
    for name, (start, end) in _BODY.items():
        across, thick = p[f"size_{name}"]
        bones[name] = Bone(
            at(start), at(end), (1.1 * across, 0.8 * across) if name == "tail" else (across,) * 2, (1.0, thick / across)
        )
    for i, name in enumerate(("front", "rear")):
        tyre, outer = p["tyre"][i], p["wheels"][i]
        bones[f"{name}_wheel"] = Ring(at(name), outer - tyre, tyre)
        wide = np.array([0, 0.6 * tyre, 0])
        bones[f"{name}_disc"] = Bone(at(name) - wide, at(name) + wide, (outer - 1.5 * tyre,) * 2)
        hub = np.array([0, 0.058 + tyre, 0])
        bones[f"{name}_hub"] = Bone(at(name) - hub, at(name) + hub, (0.035, 0.035))
    fork, arm = 0.037 + p["tyre"][0], 0.037 + p["tyre"][1]
    bones["crown"] = Bone(at("crown", -fork - 0.02), at("crown", fork + 0.02), (0.035, 0.035))
    bones["column"] = Bone(at("crown"), at("bar"), (0.035, 0.028))
    muffler = 0.75 * at("engine_back") + 0.25 * at("seat") - [0, 0.8 * p["size_rear"][0], 0]
    bones["pipe"] = Bone(muffler, at("pipe_end", -0.1 - arm), (0.045, 0.055))
    for name, side in SIDES.items():
        wide, kink = side * p["grips"][0], side * p["grips"][1]
        bones[f"{name}_fork"] = Bone(at("front", side * fork), at("crown", side * fork), (0.024, 0.026))
        bones[f"{name}_arm"] = Bone(at("rear", side * arm), at("engine_back", 0.08 * side), (0.026, 0.035))
        bones[f"{name}_bar"] = Bone(at("bar"), at("bend", kink), (0.017, 0.016))
        bones[f"{name}_bar_out"] = Bone(at("bend", kink), at("grip", wide), (0.016, 0.019))
        foot, top = 0.7 * at("bend", kink) + 0.3 * at("grip", wide), at("mirror", 0.85 * wide)
        bones[f"{name}_stalk"] = Bone(foot, top, (0.012, 0.013))
        bones[f"{name}_mirror"] = Bone(top, top + np.array([-0.01, 0.1 * side, 0.03]), (0.03, 0.045))
    return bones


MOTORCYCLE = Family(
    "motorcycle",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (400.0, 900.0),
        "alike": ("bicycle", "cyclist"),
        "optional_parts": (),
        "names": {"shapenet": ("03790512",)},
    },
    members=160,
)
