"""Learning curves as an SVG file: a panel for each network, its loss and that of the validation split."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import ceil
from pathlib import Path

from gfp_grasp.drawing.bench_charts import OTHER, OURS, PALE, chart_text, log_axis, write_chart

_COLUMNS, _WIDE, _HIGH, _LEFT, _TOP, _GAP_X, _GAP_Y = 3, 250, 120, 56, 102, 70, 66

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
    lines = []
    for x, colour, name in ((16, OTHER, "training"), (106, OURS, "validation")):
        lines += [f'<rect x="{x}" y="56" width="18" height="4" fill="{colour}"/>', chart_text(x + 24, 62, name)]
    for number, (name, curve) in enumerate(curves.items()):
        row, column = divmod(number, _COLUMNS)
        lines += _panel(name, curve, _LEFT + column * (_WIDE + _GAP_X), _TOP + row * (_HIGH + _GAP_Y))
    width = _LEFT + _COLUMNS * (_WIDE + _GAP_X)
    height = _TOP + ceil(len(curves) / _COLUMNS) * (_HIGH + _GAP_Y)
    subtitle = "loss of each network, by its own measure, over the steps of its training"
    return write_chart(path, width, height, title, subtitle, lines)


def _panel(name: str, curve: Curve, left: float, top: float) -> list[str]:
    last, bottom, right = max(step for step, _, _ in curve), top + _HIGH, left + _WIDE
    values = [value for _, *both in curve for value in both]
    place, ticks = (log_axis if min(values) > 0 else _plain_axis)(values, bottom, top)
    lines = [chart_text(left, top - 8, name, weight="bold")]
    for tick in ticks:
        y = place(tick)
        lines.append(f'<line x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="{PALE}"/>')
        lines.append(chart_text(left - 6, y + 4, f"{tick:g}", anchor="end", size=11))
    for share in (0.0, 0.5, 1.0):
        x = left + share * _WIDE
        lines.append(chart_text(x, bottom + 16, str(round(share * last)), anchor="middle", size=11))
    for which, colour in ((1, OTHER), (2, OURS)):
        points = " ".join(f"{left + _WIDE * point[0] / last:.1f},{place(point[which]):.1f}" for point in curve)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
    return lines


def _plain_axis(values: Sequence[float], start: float, end: float) -> tuple[Callable[[float], float], list[float]]:
    low, high = min(values), max(values)
    span = max(high - low, 1e-6)
    ends = [float(f"{value:.2g}") for value in (low, high)]
    return lambda value: start + (end - start) * (value - low) / span, ends
