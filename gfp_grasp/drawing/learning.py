"""Learning curves as an SVG file: a panel for each network, its loss and that of the validation split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import ceil, floor, log10
from pathlib import Path

from gfp_grasp.journal import write_whole

_COLUMNS, _WIDE, _HIGH, _LEFT, _TOP, _GAP_X, _GAP_Y = 3, 250, 120, 56, 84, 70, 66
_TRAINING, _VALIDATION, _INK, _SOFT = "#b9c4cb", "#1f6f8b", "#22303a", "#dddddd"

Curve = Sequence[tuple[int, float, float]]


def write_learning_curves(curves: Mapping[str, Curve], path: Path, *, title: str) -> Path:
    """Draw losses over steps, by their logarithms where all of a network's are positive.

    Args:
        curves: {name: [(step, loss since the point before, loss of validation)]}.
        path: An .svg file.
        title: Heading of the chart.

    Returns:
        The path.
    """
    rows = ceil(len(curves) / _COLUMNS)
    width = _LEFT + _COLUMNS * (_WIDE + _GAP_X)
    height = _TOP + rows * (_HIGH + _GAP_Y)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        f' font-family="Helvetica, Arial, sans-serif" font-size="11" fill="{_INK}">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        f'<text x="16" y="24" font-size="15" font-weight="bold">{escape(title)}</text>',
        f'<rect x="16" y="38" width="18" height="4" fill="{_TRAINING}"/><text x="40" y="44">training</text>',
        f'<rect x="106" y="38" width="18" height="4" fill="{_VALIDATION}"/><text x="130" y="44">validation</text>',
        '<text x="210" y="44">loss of each network, by its own measure, over the steps of its training</text>',
    ]
    for number, (name, curve) in enumerate(curves.items()):
        row, column = divmod(number, _COLUMNS)
        lines += _panel(name, curve, _LEFT + column * (_WIDE + _GAP_X), _TOP + row * (_HIGH + _GAP_Y))
    write_whole(path, "\n".join([*lines, "</svg>"]) + "\n")
    return path


def _panel(name: str, curve: Curve, left: float, top: float) -> list[str]:
    last = max(step for step, _, _ in curve)
    values = [value for _, *both in curve for value in both]
    scale = log10 if min(values) > 0 else float
    low, high = scale(min(values)), scale(max(values))
    span = max(high - low, 0.05)

    def at(step: float, value: float) -> tuple[float, float]:
        return left + _WIDE * step / last, top + _HIGH * (high - scale(value)) / span

    lines = [f'<text x="{left}" y="{top - 8}" font-weight="bold" font-size="12">{escape(name)}</text>']
    for tick in _ticks(min(values), max(values)):
        y = at(0, tick)[1]
        lines.append(f'<line x1="{left}" x2="{left + _WIDE}" y1="{y:.1f}" y2="{y:.1f}" stroke="{_SOFT}"/>')
        lines.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for share in (0.0, 0.5, 1.0):
        x = left + share * _WIDE
        lines.append(f'<text x="{x}" y="{top + _HIGH + 16}" text-anchor="middle">{round(share * last)}</text>')
    for which, colour in ((1, _TRAINING), (2, _VALIDATION)):
        points = " ".join("{:.1f},{:.1f}".format(*at(point[0], point[which])) for point in curve)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
    return lines


def _ticks(low: float, high: float) -> list[float]:
    """One, two or five times powers of ten between two values; the values themselves where there are less than two."""
    powers = range(floor(log10(low)), ceil(log10(high)) + 1) if low > 0 else ()
    found = [m * 10.0**p for p in powers for m in (1, 2, 5) if low <= m * 10.0**p <= high]
    return found if len(found) > 1 else [float(f"{low:.2g}"), float(f"{high:.2g}")]
