"""Glasses on a stem: for wine, champagne, cocktails, liqueur, water and beer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

# Rings of the underside, the foot's edge, the foot, the stem, the bowl, the rim, the inside and its bottom.
_COUNTS = (8, 3, 12, 14, 32, 6, 30, 2)


@dataclass(frozen=True)
class _Style:
    """Ranges of one kind of glass: half-width, height of the bowl and of the stem, m; where the bowl is widest."""

    share: float
    half: tuple[float, float]
    bowl: tuple[float, float]
    stem: tuple[float, float]
    widest: tuple[float, float]


_STYLES = {
    "wine": _Style(0.32, (0.03, 0.054), (0.075, 0.125), (0.045, 0.11), (0.3, 0.65)),
    "flute": _Style(0.16, (0.021, 0.033), (0.1, 0.17), (0.035, 0.1), (0.3, 0.95)),
    "coupe": _Style(0.1, (0.04, 0.058), (0.03, 0.06), (0.05, 0.1), (0.8, 1.0)),
    "cocktail": _Style(0.14, (0.038, 0.062), (0.045, 0.08), (0.05, 0.11), (1.0, 1.0)),
    "liqueur": _Style(0.1, (0.017, 0.03), (0.035, 0.075), (0.02, 0.07), (0.35, 1.0)),
    "beer": _Style(0.1, (0.033, 0.047), (0.09, 0.16), (0.008, 0.04), (0.25, 0.6)),
    "water": _Style(0.08, (0.034, 0.047), (0.07, 0.12), (0.02, 0.06), (0.4, 1.0)),
}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, {name: style.share for name, style in _STYLES.items()})
    style = _STYLES[kind]
    half, bowl, stem_tall = (rng.uniform(*span) for span in (style.half, style.bowl, style.stem))
    stem = rng.uniform(0.0024, 0.0065) if kind in ("wine", "cocktail", "flute", "coupe") else rng.uniform(0.003, 0.009)
    foot = float(np.clip(half * rng.uniform(0.72, 1.05), 0.02, 0.045))
    edge, foot_tall = rng.uniform(0.001, 0.0025), rng.uniform(0.004, 0.014)
    marks = np.array([edge, edge + foot_tall, edge + foot_tall + stem_tall])
    height = np.unique(np.concatenate([
        np.linspace(0, edge, 12), np.linspace(edge, marks[1], 80), np.linspace(marks[1], marks[2], 60),
        marks[2] + bowl * np.linspace(0, 1, 260) ** 1.6,
    ]))  # fmt: skip
    radius = np.maximum(
        _base(rng, height, foot, stem, marks),
        half * _bowl(rng, (height - marks[2]) / bowl, kind, style, stem / half) * (height >= marks[2]),
    )
    wall = rng.uniform(0.001, 0.0022)
    floor = marks[2] + rng.uniform(1.0, 4.0) * wall
    vessel = Vessel(height, radius, wall, floor, dent=rng.choice([0.0, 0.7]) * edge)
    return Made(vessel.matched_mesh(_COUNTS, breaks_m=tuple(marks)), kind, wall)


def _base(rng: np.random.Generator, height: np.ndarray, foot: float, stem: float, marks: np.ndarray) -> np.ndarray:
    """Radius (n,) m of foot and stem."""
    edge, foot_top, stem_top = marks
    rounding = 0.4 * edge * (1 - np.sqrt(1 - np.clip(np.abs(2 * height / edge - 1), 0, 1) ** 2))
    rise = np.clip((height - edge) / (foot_top - edge), 0, 1)
    disc = (foot - 0.4 * edge - stem) * (1 - rise) ** rng.uniform(2.0, 5.0)
    along = np.clip((height - foot_top) / (stem_top - foot_top), 0, 1)
    shape = 1 + rng.uniform(0.0, 0.8) * along ** rng.uniform(2, 6)
    if rng.random() < 0.15:
        place, size = rng.uniform(0.25, 0.9), rng.uniform(0.5, 1.6)
        shape = shape + size * np.exp(-(((along - place) / rng.uniform(0.06, 0.15)) ** 2)) * (along > 0) * (along < 1)
    return np.where(height <= edge, foot - rounding, stem * shape + disc)


def _bowl(rng: np.random.Generator, t: np.ndarray, kind: str, style: _Style, stem: float) -> np.ndarray:
    """Relative radius (n,) of the bowl over t in 0 .. 1, beginning at `stem`."""
    t = np.clip(t, 0, 1)
    if kind == "cocktail":
        curve = t ** rng.uniform(0.75, 1.1)
    else:
        widest = rng.uniform(*style.widest)
        below = 1 - np.clip(t / widest, 0, 1)
        curve = (1 - below ** rng.uniform(1.5, 2.8)) ** (1 / rng.uniform(1.3, 2.3))
        above = np.clip((t - widest) / max(1 - widest, 0.05), 0, 1)
        curve = curve * (1 - rng.uniform(0.0, 0.05 if kind == "coupe" else 0.42) * above ** rng.uniform(1.4, 2.4))
    if kind in ("beer", "coupe", "liqueur") or rng.random() < 0.15:
        curve = curve + rng.choice([0.0, rng.uniform(0.03, 0.2)]) * smoothstep((t - rng.uniform(0.6, 0.8)) / 0.35)
    curve = curve * (1 + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01]), knots=5) * smoothstep(4 * t))
    curve = stem + (1 - stem) * curve
    return curve / curve.max()


WINE_GLASS = Family("wine_glass", _make, "household", spec={"alike": ("glass",)})
