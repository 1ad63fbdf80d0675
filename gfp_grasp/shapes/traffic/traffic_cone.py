"""Traffic cones on square or round bases, with collars, bands and tips of many kinds."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import loft, rounded, rows, smoothstep

_KINDS = {"square": 0.75, "rounded_square": 0.17, "round": 0.08}


def _make(rng: np.random.Generator) -> Made:
    """One cone, as a solid: base, collar, cone, bands and tip."""
    kind = draw_kind(rng, _KINDS)
    tall = float(rng.choice([rng.uniform(0.3, 0.55), rng.uniform(0.45, 0.8), rng.uniform(0.65, 1.0)]))
    base = 0.5 * float(np.clip(tall * rng.uniform(0.46, 0.72), 0.2, 0.5))
    power = {"square": rng.uniform(9.0, 24.0), "rounded_square": rng.uniform(4.0, 7.0), "round": 2.0}[kind]
    plate = rng.uniform(0.012, 0.05) * (0.6 + 0.6 * tall)
    foot, tip = base * rng.uniform(0.58, 0.82), rng.uniform(0.018, 0.035) * (0.6 + 0.6 * tall)
    side = _side(rng, foot, tip, plate, tall)
    edge = rng.uniform(0.1, 0.4) * plate
    under = rounded([[0.97 * base, 0.0], [base, 0.0], [base, plate], [foot, plate]], [0, edge, edge, 0], steps=4)
    slope = plate * rng.uniform(0.0, 0.4) * np.clip((base - under[:, 0]) / (base - foot), 0, 1)
    high = under[:, 1] + slope
    rise = float(high[-1] - side[0, 1])
    return Made(
        loft(
            np.concatenate(
                [
                    rows([1e-6], [0.0]),
                    rows(under[:-1, 0], high[:-1], power=power),
                    rows(under[-1:, 0], high[-1:], power=2.0),
                    rows(side[:, 0], side[:, 1] + rise * (1 - smoothstep((side[:, 1] - plate) / (0.3 * tall)))),
                    rows([1e-6], side[-1:, 1]),
                ]
            ),
            segments=72,
            longest_m=0.025,
        ),
        kind,
    )


def _side(rng: np.random.Generator, foot: float, tip: float, plate: float, tall: float) -> np.ndarray:
    """Radius and height (n, 2) m of the cone from its foot over its tip."""
    t = np.linspace(0, 1, 160)
    z = plate + t * (tall - plate)
    # The cone proper is narrower than its foot, which flares out or is a collar.
    cone = foot * rng.uniform(0.72, 0.97)
    radius = tip + (cone - tip) * (1 - t ** rng.uniform(0.92, 1.15))
    reach = rng.uniform(0.02, 0.1)
    flare = np.exp(-t / reach) if rng.random() < 0.5 else 1 - smoothstep((t / reach - 0.5) * 3)
    radius = radius + (foot - cone) * flare
    if rng.random() < 0.6:
        radius = radius + _bands(rng, t)
    end = rng.choice(["flat", "dome", "knob"], p=[0.5, 0.3, 0.2])
    if end == "knob":
        neck, ball = rng.uniform(0.9, 0.96), tip * rng.uniform(1.1, 1.5)
        radius = radius + (ball - radius) * smoothstep((t - neck) / 0.02) * (t > neck)
    bend = radius[-1] * {"flat": rng.uniform(0.1, 0.3), "dome": 0.95, "knob": 0.6}[end]
    turn = np.linspace(0, np.pi / 2, 10)[1:-1]
    over = np.column_stack([radius[-1] - bend * (1 - np.cos(turn)), z[-1] + bend * np.sin(turn)])
    cap = np.array([[radius[-1] - bend, z[-1] + bend]])
    return np.concatenate([np.column_stack([radius, z]), over, np.maximum(cap, [[1e-3, 0.0]])])


def _bands(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Reflecting sleeves that stand out a little, (n,) m."""
    size = rng.uniform(0.001, 0.004)
    places = [rng.uniform(0.6, 0.75)] if rng.random() < 0.5 else [rng.uniform(0.35, 0.45), rng.uniform(0.65, 0.75)]
    half = rng.uniform(0.05, 0.11)
    return size * np.sum([smoothstep((half - np.abs(t - place)) / 0.01) for place in places], axis=0)


TRAFFIC_CONE = Family(
    "traffic_cone",
    _make,
    "traffic",
    spec={"rests": {"upright": 0.95, "lying": 0.05}, "density_kg_m3": (150.0, 1100.0)},
)
