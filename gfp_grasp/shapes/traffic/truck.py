"""Lorries: boxes, flatbeds, tippers, tanks, fire engines, and tractors with a trailer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gfp_grasp.shapes.body import Body, both_sides, on_wheels, straight_body
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded

_KINDS = {"box": 0.44, "flatbed": 0.1, "tipper": 0.14, "tank": 0.08, "fire": 0.14, "semi": 0.1}
_LENGTHS_M = {"semi": (11.0, 17.0), "tank": (6.5, 10.5), "fire": (6.0, 12.5)}


@dataclass(frozen=True)
class _Plan:
    """Sizes of one lorry, m; the load reaches from `tail` to `front`, the cab from there to `nose`.

    `half` and `frame` are half-widths of the cab and of the frame, `low` the height of the frame's lower edge.
    """

    kind: str
    tail: float
    front: float
    gap: float
    nose: float
    half: float
    frame: float
    low: float
    tyre: float
    floor: float
    cab_high: float
    high: float
    bonnet: float


def _make(rng: np.random.Generator) -> Made:
    """One lorry: cab, frame, load and wheels."""
    kind = draw_kind(rng, _KINDS)
    plan = _plan(rng, kind)
    front, *others = _axles(rng, plan)
    bodies = [_cab(rng, plan).mesh(), _between(rng, plan), *_load(rng, plan, others)]
    shoulder, rim = rng.uniform(0.02, 0.05), rng.uniform(0.54, 0.62)
    features = {"rim": rim, "shoulder": shoulder, "hub": rng.uniform(0.15, 0.3)}
    outer = plan.half * rng.uniform(0.95, 1.0)
    gap, depth, dish = rng.uniform(0.04, 0.1), rng.uniform(0.08, 0.16), rng.uniform(0.02, 0.08)
    steered = both_sides(front, outer, plan.tyre, rng.uniform(0.28, 0.36), dish=0.3 * dish, **features)
    broad = outer - plan.frame + 0.15
    driven = [wheel for x in others for wheel in both_sides(x, outer, plan.tyre, broad, dish=dish, **features)]
    segments = 24 if len(driven) <= 4 else 16
    return Made(on_wheels(bodies, steered, gap=gap, depth=depth, free=driven, segments=segments), kind)


def _plan(rng: np.random.Generator, kind: str) -> _Plan:
    length = rng.uniform(*_LENGTHS_M.get(kind, (5.5, 11.0)))
    size = float(np.clip((length - 5.5) / 3.5 + rng.normal(0, 0.15), 0, 1))  # 0 is a light, 1 a heavy lorry
    tyre = 0.37 + 0.14 * size + rng.uniform(-0.01, 0.02)
    bonnet = rng.uniform(0.7, 1.6) if rng.random() < 0.18 else rng.uniform(0.03, 0.12)
    crew = rng.uniform(0.6, 1.4) if kind == "fire" else rng.choice([0.0, 0.6], p=[0.7, 0.3])
    cab = 1.45 + 0.3 * size + bonnet + float(crew) * rng.uniform(0.6, 1.0)
    cab_high = 2.1 + size * rng.uniform(0.4, 1.0) + (kind == "semi") * rng.uniform(0.0, 0.5)
    high = {
        "box": rng.uniform(0.95, 1.35) * cab_high,
        "fire": rng.uniform(0.9, 1.12) * cab_high,
        "semi": rng.uniform(3.5, 4.0),
        "tank": rng.uniform(0.9, 1.15) * cab_high,
    }.get(kind, cab_high)
    nose, half = length / 2, 0.97 + 0.25 * size + rng.uniform(-0.03, 0.03)
    frame, low = half * rng.uniform(0.7, 0.9), rng.uniform(0.8, 1.4) * tyre
    floor, gap = 2 * tyre + rng.uniform(0.11, 0.3), rng.uniform(0.06, 0.3)
    return _Plan(
        kind, -nose, nose - cab, gap, nose, half, frame, low, tyre, floor, cab_high, min(high, 4.0), bonnet
    )  # fmt: skip


def _cab(rng: np.random.Generator, plan: _Plan) -> Body:
    """From the load to the nose: roof, perhaps with a spoiler up to the load, windscreen, bonnet."""
    tail, nose, tall, tyre = plan.front + plan.gap, plan.nose, plan.cab_high, plan.tyre
    roof = max(plan.high, tall) if plan.kind in ("box", "semi") and rng.random() < 0.4 else tall
    lean, edge = rng.uniform(0.05, 0.45), nose - plan.bonnet
    waist = max(rng.uniform(0.44, 0.56) * tall, 2 * tyre + 0.3)
    grille = max(waist - rng.uniform(0.02, 0.12) - 0.12 * plan.bonnet, 2 * tyre + 0.2)
    bumper = rng.uniform(0.6, 0.85)
    snout = min(0.1 * plan.bonnet, 0.08)
    corners = [
        [tail, roof - 0.02], [tail + 0.3, roof], [edge - lean - 0.2, tall + 0.01], [edge - lean, tall - 0.04],
        [edge, waist], [nose - 3 * snout, grille], [nose - snout, bumper + 0.04], [nose, bumper],
    ]  # fmt: skip
    low = rng.uniform(0.35, 0.55)
    front = (nose - tail) * rng.uniform(0.03, 0.12)
    outline = [[tail, plan.half], [nose - front, plan.half], [nose, plan.half * rng.uniform(0.75, 0.92)]]
    flat = np.array([[0.3, 1.0], [waist, 1.0], [tall, rng.uniform(0.86, 0.98)], [max(roof, tall + 0.1), 0.85]])
    return Body(
        rounded(corners, rng.uniform(0.4, 1.4) * np.array([0, 0.2, 0.1, 0.15, 0.2, 0.15, 0.05, 0])),
        np.array([[tail, low + 0.1], [nose - 0.4, low], [nose, low + 0.02]]),
        rounded(outline, [0, front, 0]),
        flat,
        belt=waist,
        round_top=rng.uniform(0.04, 0.2),
        round_bottom=0.04,
        crown=rng.uniform(0.01, 0.1),
    )


def _between(rng: np.random.Generator, plan: _Plan) -> trimesh.Trimesh:
    """What stands between cab and load."""
    load = max(min(plan.cab_high, plan.high), plan.floor + 0.5)
    top = plan.floor + rng.uniform(0.6, 0.9) * (load - plan.floor)
    return straight_body((plan.front - 0.3, plan.front + plan.gap + 0.3), 0.86 * plan.half, (plan.low, top)).mesh()


def _load(rng: np.random.Generator, plan: _Plan, axles: list[float]) -> list[trimesh.Trimesh]:
    """What stands behind the cab, on the frame that bears it and the lockers and tanks beside the frame."""
    half, kind = plan.half * rng.uniform(0.98, 1.05), plan.kind
    if kind == "semi":
        kind = str(rng.choice(["box", "tank"], p=[0.8, 0.2]))
    side, lean, crown, top = plan.high - plan.floor, (0.02, 0.02), rng.uniform(0.002, 0.04), rng.uniform(0.02, 0.1)
    if kind == "flatbed":
        side, crown = rng.uniform(0.12, 0.5), 0.004
    elif kind == "tipper":
        side, lean = rng.uniform(0.6, 1.5), (rng.uniform(0.02, 0.25), 0.02)
        crown = rng.uniform(0.1, 0.3) if rng.random() < 0.4 else 0.01  # heaped or not; what is inside counts as full
    high = plan.floor + side
    share = plan.frame / half
    body = straight_body((plan.tail, plan.front), half, (plan.low, high), lean=lean, round_top=top, crown=crown)
    if kind == "tank":
        frame = straight_body((plan.tail, plan.front), plan.frame, (plan.low, plan.floor + 0.1))
        ends = (rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.3))
        tank = straight_body((plan.tail, plan.front), 0.93 * half, (plan.floor, high), lean=ends, crown=0.1)
        tank = replace(tank, round_top=0.42 * side, round_bottom=0.3 * side)
        return [tank.mesh(), _above_the_road(plan, frame, axles).mesh()]
    # The frame widens towards the floor of the load.
    flat = [[plan.low, share], [plan.floor - 0.15, share], [plan.floor + 0.08, 1.0], [high, rng.uniform(0.96, 1.0)]]
    body = _above_the_road(plan, replace(body, front=np.array(flat), belt=plan.floor + 0.08), axles)
    return [body.mesh(), *([_ladder(rng, plan).mesh()] if kind == "fire" else [])]


def _above_the_road(plan: _Plan, body: Body, axles: list[float]) -> Body:
    """The body; a trailer has nothing below its floor between its axles and the tractor."""
    if plan.kind != "semi":
        return body
    back, front = max(axles[1:]) + plan.tyre + 0.2, axles[0] - plan.tyre - 0.2
    high = plan.floor - 0.15
    steps = np.column_stack([[back, back + 0.3, front - 0.3, front], [plan.low, high, high, plan.low]])
    return replace(body, lower=np.concatenate([body.lower[:1], steps, body.lower[1:]]))


def _ladder(rng: np.random.Generator, plan: _Plan) -> Body:
    """A ladder that lies along the roof, drawn as its bulk, or lockers there."""
    half, high = rng.uniform(0.25, 0.75) * plan.half, plan.high + rng.uniform(0.1, 0.6)
    x = (plan.tail + rng.uniform(0.02, 0.8), plan.front - rng.uniform(0.0, 0.3))
    return straight_body(x, half, (plan.high - 0.3, high), lean=(0.2, 0.3))


def _axles(rng: np.random.Generator, plan: _Plan) -> list[float]:
    """Places of the axles, from the front."""
    length, room = plan.nose - plan.tail, 2 * plan.tyre + rng.uniform(0.15, 0.4)
    front = plan.nose - max(plan.bonnet * 0.6, 0.25) - rng.uniform(1.0, 1.25) * plan.tyre - 0.2
    last = plan.tail + rng.uniform(0.1, 0.2) * min(length, 10.0) + plan.tyre
    if plan.kind == "semi":
        tractor = front - rng.uniform(3.2, 4.0)
        count = int(rng.integers(1, 4))
        return [front, tractor, *(last + i * max(room, 1.3) for i in range(count))]
    heavy = length > 8.5 or (length > 6.2 and rng.random() < 0.35)
    return [front, last + room, last] if heavy else [front, last + 0.3]


TRUCK = Family(
    "truck",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (100.0, 500.0),
        "alike": ("van", "bus"),
        "names": {"kitti": ("Truck",)},
    },
    members=120,
)
