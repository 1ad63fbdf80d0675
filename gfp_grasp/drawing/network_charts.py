"""Charts of the paper's networks as SVG files: curves over iterations, and time against error."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from gfp_grasp.drawing.bench_charts import LINES, OTHER, OURS, PALE, PANEL, WRONG, chart_text, write_chart

_DOT, _LISTED = 4.5, 20
_AROUND = 0.06  # share of a range that is left free at both of its ends


def write_curves(panels: Mapping[str, Mapping[str, Sequence[float]]], path: Path, *, title: str, axis: str) -> Path:
    """Draw one line for each row over 1, 2, 3 and so on, the panels beside each other on one scale.

    Args:
        panels: {heading: {name: values in patch units}}.
        path: An .svg file.
        title: Heading of the chart.
        axis: Name of the numbers along the bottom.

    Returns:
        The path.
    """
    every = [values for rows in panels.values() for values in rows.values()]
    up = _scale_of([value for values in every for value in values])
    most, keys = max(map(len, every)), max(map(len, panels.values()))
    left, top, wide, down = 60, 78, PANEL - 50, 230
    width, height = left + len(panels) * PANEL, top + down + 66 + 16 * keys
    across, ground = wide / max(most - 1, 1), top + down
    lines = []
    for column, (heading, rows) in enumerate(panels.items()):
        start = left + column * PANEL
        lines.append(chart_text(start, top - 14, heading, weight="bold"))
        lines.append(chart_text(start + wide / 2, ground + 36, axis, anchor="middle"))
        for i in range(most):
            lines.append(chart_text(start + i * across, ground + 18, str(i + 1), anchor="middle"))
        lines += _levels(up, start, wide, ground, down)
        for number, (name, values) in enumerate(rows.items()):
            colour = LINES[number % len(LINES)]
            drawn = [(start + i * across, ground - down * up.share(v)) for i, v in enumerate(values)]
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in drawn)
            lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
            y = ground + 54 + 16 * number
            lines.append(f'<rect x="{start}" y="{y}" width="12" height="4" fill="{colour}"/>')
            lines.append(chart_text(start + 18, y + 6, name))
    subtitle = "Chamfer distance of the predicted patch to its label, in its units; the scale begins above zero"
    return write_chart(path, width, height, title, subtitle, lines)


def write_front(
    trials: Sequence[Mapping[str, Any]],
    front: Sequence[Mapping[str, Any]],
    marked: Mapping[str, Any],
    path: Path,
    *,
    title: str,
) -> Path:
    """Draw what networks take against how near they come, the front as a stair whose points are listed beside it.

    Args:
        trials: All networks, with "name", "ms" and "cd_units".
        front: Those that no other one matches in both, the quickest first.
        marked: The one that the others are compared with.
        path: An .svg file.
        title: Heading of the chart.

    Returns:
        The path.
    """
    left, top, wide, list_at = 60, 60, 480, 580
    down = max(300, _LISTED * len(front) + 60)
    ground = top + down
    across, up = _scale_of([row["ms"] for row in trials], log=True), _scale_of([row["cd_units"] for row in trials])

    def at(row: Mapping[str, Any]) -> tuple[float, float]:
        return left + wide * across.share(row["ms"]), ground - down * up.share(row["cd_units"])

    lines = [chart_text(left + wide / 2, ground + 40, "one call for all patches of a primitive, ms", anchor="middle")]
    for value in across.marks:
        x = left + wide * across.share(value)
        lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top}" y2="{ground}" stroke="{PALE}"/>')
        lines.append(chart_text(x, ground + 18, f"{value:g}", anchor="middle"))
    lines += _levels(up, left, wide, ground, down)
    for x, y in map(at, trials):
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_DOT}" fill="{OTHER}"/>')
    (x, y), *further = map(at, front)
    steps = "".join(f" H{x:.1f} V{y:.1f}" for x, y in further)
    lines.append(f'<path d="M{x:.1f},{y:.1f}{steps}" fill="none" stroke="{OURS}" stroke-width="1.5"/>')
    lines.append(chart_text(list_at, top + 4, "encoder, decoder, iterations m", weight="bold"))
    for number, row in enumerate(front, 1):
        x, y = at(row)
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_DOT}" fill="{OURS}"/>')
        lines.append(chart_text(x - 7, y + 15, str(number), anchor="end", weight="bold"))
        lines.append(chart_text(list_at, top + 4 + _LISTED * number, f"{number}: {_described(row)}"))
    x, y = at(marked)
    diamond = f'd="M{x:.1f},{y - 8:.1f} l8,8 l-8,8 l-8,-8 z" fill="none" stroke="{WRONG}" stroke-width="2"'
    lines.append(f"<path {diamond}/>")
    y = top + 4 + _LISTED * (len(front) + 1)
    lines.append(f'<path d="M{list_at + 4},{y - 10} l6,6 l-6,6 l-6,-6 z" fill="none" stroke="{WRONG}"/>')
    lines.append(chart_text(list_at + 16, y, f"the paper's: {_described(marked)}"))
    subtitle = "Chamfer distance of predicted patches to their labels, in units of the patch, against time"
    longest = max(len(_described(row)) for row in (*front, marked))
    return write_chart(path, list_at + 100 + 7 * longest, ground + 56, title, subtitle, lines)


def _described(row: Mapping[str, Any]) -> str:
    return f"{row['name']}: {row['ms']:.3g} ms, {row['cd_units']:.4f}"


def _levels(scale: _Scale, left: float, wide: float, ground: float, down: float) -> list[str]:
    """A level line with its number for each round number of an upright axis."""
    lines = []
    for value in scale.marks:
        y = ground - down * scale.share(value)
        lines.append(f'<line x1="{left}" x2="{left + wide}" y1="{y:.1f}" y2="{y:.1f}" stroke="{PALE}"/>')
        lines.append(chart_text(left - 6, y + 4, f"{value:g}", anchor="end"))
    return lines


class _Scale(NamedTuple):
    """A range of numbers along an axis, and the round ones among them.

    Attributes:
        low: Number at the beginning, or its logarithm.
        high: Number at the end, or its logarithm.
        marks: Round numbers in between.
        log: Whether lengths are ratios.
    """

    low: float
    high: float
    marks: list[float]
    log: bool

    def share(self, value: float) -> float:
        """Where a number stands, from 0 to 1."""
        return ((math.log10(value) if self.log else value) - self.low) / (self.high - self.low)


def _scale_of(values: Sequence[float], *, log: bool = False) -> _Scale:
    """The scale on which some numbers fill an axis; a logarithmic one is marked at 1, 2 and 5 times powers of ten."""
    ends = [math.log10(v) if log else v for v in (min(values), max(values))]
    free = _AROUND * (ends[1] - ends[0]) or 0.1 * abs(ends[0]) or 0.1
    low, high = ends[0] - free, ends[1] + free
    if log:
        powers = range(math.floor(low), math.ceil(high) + 1)
        marks = [n * 10.0**power for power in powers for n in (1, 2, 5) if low <= math.log10(n) + power <= high]
    else:
        rough = (high - low) / 6
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(n * power for n in (1, 2, 5, 10) if n * power >= rough)
        marks = [round(n * step, 9) for n in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return _Scale(low, high, marks, log)
