"""Lorries: boxes, flatbeds, tippers, tanks, fire engines, and tractors with a trailer."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gfp_grasp.shapes.body import Body, Range, both_sides, on_wheels, straight_body
from gfp_grasp.shapes.family import Family, Made
from gfp_grasp.shapes.loft import rounded, unite

_KINDS = {"box": 0.4, "flatbed": 0.12, "tipper": 0.14, "tank": 0.08, "fire": 0.13, "semi": 0.13}
_LENGTHS_M = {"semi": (11.0, 17.0), "tank": (6.5, 10.5), "fire": (6.0, 12.5)}


@dataclass(frozen=True)
class _Plan:
    """Sizes of one lorry, m; the load reaches from `tail` to `front`, the cab from there to `nose`."""

    kind: str
    tail: float
    front: float
    gap: float
    nose: float
    half: float
    tyre: float
    floor: float
    cab_high: float
    high: float
    bonnet: float


def _make(rng: np.random.Generator) -> Made:
    """One lorry: cab, frame, load and wheels."""
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    plan = _plan(rng, kind)
    frame = plan.half * rng.uniform(0.7, 0.95)
    front, *others = _axles(rng, plan)
    bodies = [_cab(rng, plan).mesh(), *_frame(rng, plan, frame, others), _load(rng, plan)]
    dish, shoulder, rim = rng.uniform(0.03, 0.12), rng.uniform(0.02, 0.05), rng.uniform(0.54, 0.62)
    features = {"rim": rim, "shoulder": shoulder, "hub": rng.uniform(0.15, 0.3)}
    outer = plan.half * rng.uniform(0.95, 1.0)
    gap, depth = rng.uniform(0.05, 0.1), rng.uniform(0.12, 0.3)
    broad = max(outer - frame, depth) + 0.15
    wheels = both_sides(front, outer, plan.tyre, 0.5, dish=0.3 * dish, **features)
    for x in others:
        wheels += both_sides(x, outer, plan.tyre, broad, dish=dish, **features)
    segments = 24 if len(wheels) <= 6 else 16
    return Made(on_wheels(bodies, wheels, gap=gap, depth=depth, segments=segments), kind)


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
    nose = length / 2
    return _Plan(
        kind, -nose, nose - cab, rng.uniform(0.04, 0.3), nose, 0.97 + 0.25 * size + rng.uniform(-0.03, 0.03), tyre,
        2 * tyre + rng.uniform(0.11, 0.3), cab_high, min(high, 4.0), bonnet,
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


def _frame(rng: np.random.Generator, plan: _Plan, half: float, axles: list[float]) -> list[trimesh.Trimesh]:
    """What bears cab and load, with the lockers and tanks beside it; and what stands between cab and load."""
    low, high, nose = rng.uniform(0.4, 0.75) * 2 * plan.tyre, plan.floor + 0.06, plan.nose - 0.5 - plan.bonnet
    back, front = plan.tail + 0.04, plan.front
    frame = straight_body((back, nose), half, (low, high))
    if plan.kind == "semi":
        # Nothing is below the trailer between its axles and the tractor.
        back_end, front_end = max(axles[1:]) + plan.tyre + 0.2, axles[0] - plan.tyre - 0.2
        under = [back_end, back_end + 0.2, front_end - 0.2, front_end]
        steps = np.column_stack([under, [low, plan.floor - 0.05, plan.floor - 0.05, low]])
        frame = replace(frame, lower=np.concatenate([frame.lower[:1], steps, frame.lower[1:]]))
    tall = plan.floor + rng.uniform(0.6, 0.9) * (min(plan.cab_high, max(plan.high, plan.floor + 0.5)) - plan.floor)
    between = straight_body((front - 0.2, front + plan.gap + 0.2), 0.8 * plan.half, (plan.floor - 0.3, tall))
    return [frame.mesh(), between.mesh()]


def _load(rng: np.random.Generator, plan: _Plan) -> trimesh.Trimesh:
    """What stands behind the cab."""
    x, kind = (plan.tail, plan.front), plan.kind
    half = plan.half * rng.uniform(0.98, 1.05)
    if kind in ("flatbed", "tipper"):
        return _open_bed(rng, plan, x, half)
    if kind == "semi":
        kind = str(rng.choice(["box", "tank"], p=[0.8, 0.2]))
    if kind == "tank":
        tall = plan.high - plan.floor
        lean = (rng.uniform(0.05, 0.3), rng.uniform(0.05, 0.3))
        return straight_body(
            x,
            0.93 * half,
            (plan.floor, plan.high),
            lean=lean,
            round_top=0.42 * tall,
            round_bottom=0.3 * tall,
            crown=0.1,
        ).mesh()
    low = plan.floor - (rng.uniform(0.0, 0.35) if kind == "fire" else 0.0)
    body = straight_body(
        x, half, (low, plan.high), roof=rng.uniform(0.96, 1.0), round_top=rng.uniform(0.01, 0.1),
        crown=rng.uniform(0.002, 0.04),
    ).mesh()  # fmt: skip
    return _with_ladder(rng, plan, body) if kind == "fire" else body


def _open_bed(rng: np.random.Generator, plan: _Plan, x: Range, half: float) -> trimesh.Trimesh:
    """A bed with low sides, or the body of a tipper, filled to within a hand's breadth of its sides or heaped."""
    tipper = plan.kind == "tipper"
    side = rng.uniform(0.6, 1.5) if tipper else rng.uniform(0.12, 0.5)
    lean = (rng.uniform(0.02, 0.25), 0.02) if tipper else (0.01, 0.01)
    heap = rng.uniform(0.1, 0.3) if tipper and rng.random() < 0.4 else 0.01
    return straight_body(x, half, (plan.floor, plan.floor + side), lean=lean, crown=heap, round_top=0.02).mesh()


def _with_ladder(rng: np.random.Generator, plan: _Plan, body: trimesh.Trimesh) -> trimesh.Trimesh:
    """A ladder that lies along the roof, drawn as its bulk, or lockers there."""
    half, high = rng.uniform(0.25, 0.75) * plan.half, plan.high + rng.uniform(0.1, 0.6)
    x = (plan.tail + rng.uniform(0.02, 0.8), plan.front - rng.uniform(0.0, 0.3))
    return unite([body, straight_body(x, half, (plan.high - 0.3, high), lean=(0.2, 0.3)).mesh()])


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
    variants={"flatbed": {}, "semi": {}},
    members=120,
)
