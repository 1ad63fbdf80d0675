"""Buses: city buses, coaches, midibuses, double-deckers, and school buses with a bonnet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.shapes.body import Body, Range, both_sides, lower_edge, on_wheels, plan_of, straight_body
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded


@dataclass(frozen=True)
class _Style:
    """Ranges of what buses of one kind measure, m."""

    share: float
    length: Range
    width: Range
    height: Range
    lean: Range
    """How far the top of the windscreen lies behind its foot."""
    waist: Range = (0.35, 0.48)
    """Height of the windscreen's foot over that of the bus."""
    bonnet: Range = (0.02, 0.1)
    narrowing: Range = (0.9, 0.99)
    tyre: Range = (0.45, 0.52)


_STYLES = {
    "city": _Style(0.42, (9.5, 13.0), (2.4, 2.6), (2.85, 3.3), (0.05, 0.5)),
    "coach": _Style(0.28, (9.5, 13.0), (2.45, 2.6), (3.2, 3.9), (0.3, 1.1), (0.33, 0.45)),
    "midi": _Style(
        0.16, (7.0, 9.5), (2.05, 2.45), (2.6, 3.1), (0.2, 0.9), (0.38, 0.5), (0.03, 0.45), tyre=(0.37, 0.46)
    ),
    "double_decker": _Style(0.08, (9.5, 12.5), (2.45, 2.6), (4.0, 4.5), (0.1, 0.8), (0.26, 0.34)),
    "school": _Style(
        0.06, (7.5, 12.0), (2.3, 2.5), (2.8, 3.2), (0.08, 0.3), (0.5, 0.58), (0.7, 1.5), (0.82, 0.94), (0.42, 0.5)
    ),
}


def _make(rng: np.random.Generator) -> Made:
    """One bus; its wheels stand in arches."""
    kind = draw_kind(rng, {name: style.share for name, style in _STYLES.items()})
    style = _STYLES[kind]
    length, wide, tall = rng.uniform(*style.length), rng.uniform(*style.width) / 2, rng.uniform(*style.height)
    tyre, clear = rng.uniform(*style.tyre), rng.uniform(0.22, 0.4)
    upper = _upper(rng, style, length, tall, tyre)
    belt = rng.uniform(0.38, 0.48) * tall
    body = Body(
        upper,
        lower_edge(rng, length, clear, rise=(0.0, 0.12), nose=upper[-1, 1]),
        plan_of(rng, length, wide, tail=(0.005, 0.02), nose=(0.01, 0.045)),
        np.array([[0.2, rng.uniform(0.96, 1)], [0.8, 1.0], [belt, 1.0], [tall, rng.uniform(*style.narrowing)]]),
        belt=belt,
        round_top=rng.uniform(0.05, 0.28),
        round_bottom=rng.uniform(0.02, 0.08),
        crown=rng.uniform(0.01, 0.1),
        longest=0.6,
    )
    bodies = [body.mesh()]
    if kind in ("city", "midi", "coach") and rng.random() < 0.35:
        bodies.append(_on_the_roof(rng, length, wide, tall).mesh())
    ahead = rng.uniform(0.17, 0.24) * length
    if kind in ("midi", "school"):
        ahead = rng.uniform(0.9, 1.6)
    behind = rng.uniform(0.22, 0.3) * length
    axles = [length / 2 - ahead, behind - length / 2]
    if kind in ("coach", "double_decker") and length > 11.5 and rng.random() < 0.4:
        axles.append(axles[1] - rng.uniform(1.25, 1.4))
    features = {"rim": rng.uniform(0.54, 0.62), "shoulder": rng.uniform(0.02, 0.05), "hub": rng.uniform(0.15, 0.3)}
    broad, inset, dish = rng.uniform(0.27, 0.32), rng.uniform(0.0, 0.06), rng.uniform(0.02, 0.1)
    wheels = [
        wheel
        for number, x in enumerate(axles)
        for wheel in both_sides(
            x, float(body.half_width(x, tyre)) - inset, tyre, broad, dish=dish * (1 + number % 2), **features
        )
    ]
    return Made(on_wheels(bodies, wheels, gap=rng.uniform(0.04, 0.1), depth=rng.uniform(0.08, 0.14)), kind)


def _upper(rng: np.random.Generator, style: _Style, length: float, tall: float, tyre: float) -> np.ndarray:
    """Upper edge of the side: tail, roof, windscreen, and a bonnet that most buses have next to none of."""
    tail, nose = -length / 2, length / 2
    bonnet, lean = rng.uniform(*style.bonnet), rng.uniform(*style.lean)
    waist = max(rng.uniform(*style.waist) * tall, 2 * tyre + 0.25 if bonnet > 0.5 else 0.0)
    back, slope = rng.uniform(0.01, 0.08), rng.uniform(0.03, 0.35)
    grille = max(waist - 0.05 - 0.15 * bonnet, 2 * tyre + 0.12 if bonnet > 0.5 else 0.0)
    bumper = rng.uniform(0.55, 0.8)
    corners = [
        [tail, bumper], [tail + back, rng.uniform(0.4, 0.6) * tall], [tail + back + slope, tall * rng.uniform(0.96, 1)],
        [tail + 0.5 * length, tall], [nose - bonnet - lean, tall * rng.uniform(0.95, 1)], [nose - bonnet, waist],
        [nose - 0.3 * bonnet, grille], [nose - 0.1 * bonnet, bumper + 0.05], [nose, bumper],
    ]  # fmt: skip
    soft = rng.uniform(0.4, 1.4)
    return rounded(corners, soft * np.array([0, 0.5, 0.12, 2.0, 0.3, 0.3, 0.1, 0.05, 0]))


def _on_the_roof(rng: np.random.Generator, length: float, wide: float, tall: float) -> Body:
    """Air conditioning, batteries or gas tanks under a cover."""
    long = rng.uniform(0.15, 0.7) * length
    middle = rng.uniform(-0.5, 0.4) * (0.85 * length - long)
    half, high, slope = wide * rng.uniform(0.55, 0.82), tall + rng.uniform(0.1, 0.35), rng.uniform(0.1, 0.5)
    return straight_body(
        (middle - long / 2, middle + long / 2),
        half,
        (tall - 0.45, high),
        lean=(slope, slope),
        roof=0.93,
        round_top=rng.uniform(0.03, 0.1),
    )


BUS = Family(
    "bus",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (90.0, 260.0),
        "alike": ("truck", "van"),
        "names": {"shapenet": ("02924116",)},
    },
    members=100,
)
