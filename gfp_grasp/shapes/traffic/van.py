"""Vans: panel vans, minibuses, people carriers, small delivery vans, and cabs with a box behind them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.body import Body, Range, both_sides, lower_edge, on_wheels, plan_of, straight_body
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded, unite


@dataclass(frozen=True)
class _Style:
    """Ranges of what vans of one kind measure: lengths in m, heights as shares of the height."""

    share: float
    length: Range
    width: Range
    height: Range
    bonnet: Range
    screen: Range
    cowl_high: Range
    window: Range = (0.03, 0.15)
    tyre: Range = (0.31, 0.37)
    narrowing: Range = (0.8, 0.93)


_STYLES = {
    "panel": _Style(0.42, (4.7, 7.4), (1.86, 2.1), (1.9, 2.85), (0.6, 1.15), (0.55, 1.0), (0.44, 0.6)),
    "flat_nosed": _Style(0.1, (4.2, 6.2), (1.62, 2.05), (1.8, 2.4), (0.12, 0.4), (0.3, 0.75), (0.46, 0.6)),
    "delivery": _Style(
        0.13, (4.2, 4.9), (1.7, 1.9), (1.78, 2.0), (0.7, 1.1), (0.6, 0.95), (0.52, 0.62), tyre=(0.29, 0.33),
        window=(0.02, 0.12),
    ),
    "mpv": _Style(
        0.2, (4.2, 5.3), (1.74, 2.0), (1.62, 1.95), (0.75, 1.15), (0.75, 1.15), (0.54, 0.66), window=(0.15, 0.55),
        tyre=(0.3, 0.35), narrowing=(0.74, 0.88),
    ),
    "box": _Style(0.15, (5.2, 7.5), (1.9, 2.2), (2.0, 2.35), (0.5, 1.15), (0.5, 0.95), (0.5, 0.62)),
}  # fmt: skip


def _make(rng: np.random.Generator) -> Made:
    """One van; its wheels stand in arches."""
    kind = draw_kind(rng, {name: style.share for name, style in _STYLES.items()})
    style = _STYLES[kind]
    length, wide = rng.uniform(*style.length), rng.uniform(*style.width) / 2
    # Long vans are tall.
    part = np.clip((length - style.length[0]) / (style.length[1] - style.length[0]) + rng.normal(0, 0.3), 0, 1)
    tall = style.height[0] + part * (style.height[1] - style.height[0])
    tyre, clear = rng.uniform(*style.tyre), rng.uniform(0.16, 0.26)
    upper = _upper(rng, style, length, tall, tyre)
    belt = rng.uniform(0.5, 0.6) * tall
    cab = Body(
        upper,
        lower_edge(rng, length, clear, rise=(0.05, 0.15), nose=upper[-1, 1]),
        plan_of(rng, length, wide, tail=(0.005, 0.03), nose=(0.04, 0.12)),
        _front(rng, style, tall, belt),
        belt=belt,
        round_top=rng.uniform(0.06, 0.2),
        round_bottom=rng.uniform(0.03, 0.08),
        crown=rng.uniform(0.02, 0.08),
    )
    bodies = [cab.mesh()]
    outer = wide
    if kind == "box":
        box, outer = _box(rng, cab, length, wide, tall, tyre, clear)
        bodies.append(box)
    ahead = max(rng.uniform(0.7, 1.0), tyre + 0.14)
    behind = max(rng.uniform(0.13, 0.22) * length, tyre + 0.16)
    features = {"rim": rng.uniform(0.56, 0.68), "dish": rng.uniform(0.01, 0.06), "shoulder": rng.uniform(0.02, 0.045)}
    broad, inset = rng.uniform(0.19, 0.25), rng.uniform(-0.01, 0.04)
    front = float(cab.half_width(length / 2 - ahead, tyre)) - inset
    wheels = [
        *both_sides(length / 2 - ahead, front, tyre, broad, **features),
        *both_sides(behind - length / 2, 0.97 * outer - inset, tyre, broad + outer - wide, **features),
    ]  # fmt: skip
    return Made(on_wheels(bodies, wheels, gap=rng.uniform(0.03, 0.08), depth=rng.uniform(0.06, 0.1)), kind)


def _upper(rng: np.random.Generator, style: _Style, length: float, tall: float, tyre: float) -> np.ndarray:
    """Upper edge of the side."""
    tail, nose = -length / 2, length / 2
    bonnet, screen = rng.uniform(*style.bonnet), rng.uniform(*style.screen)
    cowl = max(rng.uniform(*style.cowl_high) * tall, 2 * tyre + 0.3)
    grille = max(cowl - (0.03 + rng.uniform(0.1, 0.3) * bonnet), 2 * tyre + 0.1)
    bumper = rng.uniform(0.5, 0.66)
    lean = rng.uniform(0.01, 0.05)
    window = rng.uniform(*style.window)
    waist = rng.uniform(0.48, 0.62) * tall
    snout = rng.uniform(0.02, min(0.16, 0.4 * bonnet))
    roof_front = nose - bonnet - screen
    corners = [
        [tail, bumper], [tail + 0.5 * lean, bumper + 0.08], [tail + lean, waist],
        [tail + lean + window, tall * rng.uniform(0.94, 1.0)], [tail + rng.uniform(0.3, 0.6) * length, tall],
        [roof_front, tall * rng.uniform(0.93, 0.985)], [nose - bonnet, cowl],
        [nose - snout, grille], [nose - 0.2 * snout, bumper + 0.05], [nose, bumper - 0.03],
    ]  # fmt: skip
    soft = rng.uniform(0.4, 1.3)
    return rounded(corners, soft * np.array([0, 0.04, 0.2, 0.12, 0.9, 0.4, 0.25, 0.14, 0.05, 0]))


def _front(rng: np.random.Generator, style: _Style, tall: float, belt: float) -> np.ndarray:
    """Share of the half-width over z: sill, waist, belt, roof."""
    return np.array(
        [
            [0.2, rng.uniform(0.92, 0.98)], [0.55, 0.995], [0.55 * belt + 0.3, 1.0],
            [belt, rng.uniform(0.955, 0.99)], [tall, rng.uniform(*style.narrowing)],
        ]
    )  # fmt: skip


def _box(
    rng: np.random.Generator, cab: Body, length: float, wide: float, tall: float, tyre: float, clear: float
) -> tuple[trimesh.Trimesh, float]:
    """A box of its own behind the cab's seats, as ambulances and parcel vans have it; and its half-width."""
    tail = -length / 2 - 0.03
    end = float(cab.upper[cab.upper[:, 1] > 0.9 * tall, 0].max()) - rng.uniform(0.3, 0.7)
    half, high = wide * rng.uniform(1.02, 1.18), rng.uniform(2.5, 3.1)
    floor = rng.uniform(clear + 0.1, 2 * tyre + 0.05)
    edges = {"round_top": rng.uniform(0.02, 0.08), "crown": rng.uniform(0.002, 0.03)}
    roof = rng.uniform(0.96, 1.0)
    box = straight_body((tail, end), half, (floor, high), (0.01, 0.01), roof, **edges).mesh()
    if rng.random() < 0.25:
        nose = end + rng.uniform(0.3, 0.9)
        over = straight_body((end - 0.3, nose), 0.995 * half, (tall - 0.1, high - 0.005), (0.01, 0.2), **edges)
        box = unite([box, over.mesh()])
    return box, half


VAN = Family(
    "van",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (90.0, 300.0),
        "alike": ("car", "truck"),
        "names": {"kitti": ("Van",)},
    },
    members=120,
)
