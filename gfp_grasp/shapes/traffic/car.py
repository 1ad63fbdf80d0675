"""Cars: city cars, hatchbacks, saloons, estates, off-road and sports cars, pick-ups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.body import Body, Range, both_sides, lower_edge, on_wheels, plan_of
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded, subtract


@dataclass(frozen=True)
class _Style:
    """Ranges of what cars of one kind measure: lengths in m, runs along x as shares of the length, heights as shares
    of the height."""

    share: float
    length: Range
    width: Range
    height: Range
    bonnet: Range
    screen: Range
    window: Range
    deck: Range
    cowl_high: Range = (0.61, 0.69)
    bonnet_high: Range = (0.47, 0.57)
    deck_high: Range = (0.62, 0.74)
    clearance: Range = (0.12, 0.2)
    tyre: Range = (0.29, 0.34)
    narrowing: Range = (0.68, 0.84)
    """Half-width of the roof over that of the waist."""


_STYLES = {
    "city": _Style(
        0.14, (2.5, 3.75), (1.46, 1.7), (1.4, 1.62), (0.15, 0.24), (0.18, 0.3), (0.05, 0.18), (0.01, 0.035),
        tyre=(0.26, 0.3),
    ),
    "hatchback": _Style(
        0.22, (3.65, 4.55), (1.64, 1.86), (1.36, 1.6), (0.19, 0.27), (0.16, 0.24), (0.07, 0.19), (0.01, 0.06),
    ),
    "saloon": _Style(
        0.21, (4.1, 5.3), (1.66, 1.95), (1.34, 1.52), (0.22, 0.3), (0.13, 0.2), (0.11, 0.21), (0.08, 0.2),
    ),
    "estate": _Style(
        0.11, (4.2, 5.1), (1.68, 1.92), (1.4, 1.58), (0.21, 0.29), (0.13, 0.2), (0.05, 0.14), (0.01, 0.03),
    ),
    "suv": _Style(
        0.14, (3.9, 5.2), (1.72, 2.05), (1.54, 1.92), (0.19, 0.28), (0.1, 0.19), (0.05, 0.16), (0.01, 0.04),
        bonnet_high=(0.5, 0.6), clearance=(0.17, 0.26), tyre=(0.33, 0.39), narrowing=(0.72, 0.86),
    ),
    "offroad": _Style(
        0.06, (3.4, 5.1), (1.55, 2.15), (1.7, 2.1), (0.2, 0.31), (0.03, 0.1), (0.01, 0.05), (0.008, 0.02),
        cowl_high=(0.57, 0.66), bonnet_high=(0.52, 0.63), clearance=(0.2, 0.34), tyre=(0.34, 0.44),
        narrowing=(0.8, 0.95),
    ),
    "sports": _Style(
        0.07, (3.7, 4.9), (1.66, 2.02), (1.08, 1.36), (0.24, 0.38), (0.13, 0.22), (0.15, 0.3), (0.02, 0.16),
        cowl_high=(0.64, 0.74), bonnet_high=(0.45, 0.57), deck_high=(0.66, 0.8), clearance=(0.09, 0.14),
        narrowing=(0.6, 0.76),
    ),
    "pickup": _Style(
        0.05, (4.2, 5.6), (1.65, 2.0), (1.55, 1.92), (0.19, 0.27), (0.09, 0.18), (0.015, 0.06), (0.25, 0.38),
        deck_high=(0.56, 0.66), clearance=(0.17, 0.27), tyre=(0.32, 0.39), narrowing=(0.72, 0.86),
    ),
}  # fmt: skip


def _make(rng: np.random.Generator) -> Made:
    """One car; its wheels stand in arches."""
    kind = draw_kind(rng, {name: style.share for name, style in _STYLES.items()})
    style = _STYLES[kind]
    length, wide, tall = rng.uniform(*style.length), rng.uniform(*style.width) / 2, rng.uniform(*style.height)
    tyre = rng.uniform(*style.tyre)
    upper, bed = _upper(rng, style, length, tall, tyre)
    front = _front(rng, style, tall)
    body = Body(
        upper,
        lower_edge(rng, length, rng.uniform(*style.clearance), rise=(0.06, 0.2), nose=upper[-1, 1]),
        plan_of(rng, length, wide, tail=(0.03, 0.1), nose=(0.05, 0.16)),
        front,
        belt=front[3, 0],
        round_top=rng.uniform(0.03, 0.07) if kind == "offroad" else rng.uniform(0.05, 0.14),
        round_bottom=rng.uniform(0.03, 0.1),
        crown=rng.uniform(0.01, 0.04) if kind == "offroad" else rng.uniform(0.03, 0.09),
    )
    mesh = body.mesh()
    ahead, behind = rng.uniform(0.155, 0.225) * length, rng.uniform(0.135, 0.235) * length
    axles = length / 2 - max(ahead, tyre + 0.12), max(behind, tyre + 0.1) - length / 2
    broad, inset = rng.uniform(0.17, 0.26), rng.uniform(-0.08 if kind == "offroad" else -0.02, 0.03)
    rim = {"rim": rng.uniform(0.58, 0.74), "dish": rng.uniform(0.005, 0.05), "shoulder": rng.uniform(0.02, 0.045)}
    outer = [float(body.half_width(x, tyre)) - inset for x in axles]
    wheels = [wheel for x, y in zip(axles, outer, strict=True) for wheel in both_sides(x, y, tyre, broad, **rim)]
    gap, depth = rng.uniform(0.03, 0.07), rng.uniform(0.06, 0.1)
    if kind == "pickup":
        mesh = subtract(mesh, _bed(rng, bed, outer[1] - depth))
    return Made(on_wheels([mesh], wheels, gap=gap, depth=depth), kind)


def _upper(
    rng: np.random.Generator, style: _Style, length: float, tall: float, tyre: float
) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Upper edge of the side; and the deck behind the rear window, from x to x at a height, m."""
    bonnet, screen, window, deck = (
        rng.uniform(*run) * length for run in (style.bonnet, style.screen, style.window, style.deck)
    )
    # No bonnet is lower than the wheel arches below it.
    grille = max(rng.uniform(*style.bonnet_high) * tall, 2 * tyre + 0.12)
    cowl = max(rng.uniform(*style.cowl_high) * tall, grille + 0.06)
    boot = max(rng.uniform(*style.deck_high) * tall, 0.9 * cowl)
    tail, nose = -length / 2, length / 2
    bumper = rng.uniform(0.34, 0.44) * tall
    lean, snout = rng.uniform(0.01, 0.03) * length, rng.uniform(0.008, 0.035) * length
    sill = tail + lean + deck
    roof_back, roof_front = sill + window, nose - bonnet - screen
    peak = roof_front - rng.uniform(0.1, 0.5) * (roof_front - roof_back)
    corners = [
        [tail, bumper], [tail + 0.3 * lean, 1.04 * bumper + 0.03], [tail + lean, boot * rng.uniform(0.94, 1.0)],
        [sill, boot], [roof_back, tall * rng.uniform(0.93, 0.99)], [peak, tall],
        [roof_front, tall * rng.uniform(0.95, 0.985)], [nose - bonnet, cowl],
        [nose - bonnet * rng.uniform(0.35, 0.6), cowl - (cowl - grille) * rng.uniform(0.15, 0.45)],
        [nose - snout, grille], [nose - 0.3 * snout, 1.03 * bumper], [nose, bumper * rng.uniform(0.9, 1.0)],
    ]  # fmt: skip
    soft = rng.uniform(0.4, 1.3)
    radii = soft * np.array([0, 0.04, 0.1, 0.12, 0.25, 0.8, 0.3, 0.25, 0.5, 0.14, 0.05, 0])
    return rounded(corners, radii), (tail + lean, sill, boot)


def _front(rng: np.random.Generator, style: _Style, tall: float) -> np.ndarray:
    """Share of the half-width over z: sill, waist, belt, roof."""
    belt = rng.uniform(0.6, 0.7)
    return np.array(
        [
            [0.08 * tall, rng.uniform(0.88, 0.96)],
            [rng.uniform(0.28, 0.4) * tall, 0.99],
            [rng.uniform(0.42, 0.52) * tall, 1.0],
            [belt * tall, rng.uniform(0.92, 0.97)],
            [tall, rng.uniform(*style.narrowing)],
        ]
    )


def _bed(rng: np.random.Generator, deck: tuple[float, float, float], room: float) -> trimesh.Trimesh:
    """What is taken off a pick-up's deck, narrower than `room` on each side; under a cover it is shallow."""
    start, end, high = deck
    start, end = start + 0.05, end - rng.uniform(0.04, 0.1)
    deep = rng.uniform(0.03, 0.06) if rng.random() < 0.2 else rng.uniform(0.25, 0.48)
    box = trimesh.creation.box([end - start, 2 * (room - rng.uniform(0.02, 0.08)), 1.0])
    box.apply_translation([(start + end) / 2, 0, high - deep + 0.5])
    return box


CAR = Family(
    "car",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 1.0},
        "density_kg_m3": (110.0, 330.0),
        "alike": ("van",),
        "names": {"modelnet": ("car",), "shapenet": ("02958343",), "kitti": ("Car",)},
    },
    variants={"pickup": {}},
    members=120,
)
