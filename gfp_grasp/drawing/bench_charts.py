"""Charts of the benches as SVG files: bars, operating curves, margins, and which class is named for which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from math import log
from pathlib import Path
from typing import Any

from gfp_grasp.journal import write_whole

# Units of the bars and curves of a bench.
_METHOD, _GAP, _NAMES, PANEL, _MARGIN = 14, 5, 190, 300, 16
LINES = ("#1f6f8b", "#d9822b", "#5b8c3e", "#8e4585", "#7a7a7a")
OURS, OTHER, WRONG, INK, PALE = "#1f6f8b", "#b9c4cb", "#c8553d", "#22303a", "#e4e8eb"
# Units of the squares of a confusion.
_CELL, _CLASS_NAMES, _HEAD = 26, 110, 150
_WHISKER = 22
_MOST_TICKS = 6
_LEAST_TOLD = 0.05  # a smaller share is a tint without a number


def write_bars(rows: Mapping[str, Mapping[str, Mapping]], path: Path, *, title: str) -> Path:
    """Draw the mean Chamfer distance of every method, one panel a class; the package's default stands out.

    Args:
        rows: {class: {method: figures with "cd_m"}}.
        path: An .svg file.
        title: Heading of the chart.

    Returns:
        The path.
    """
    classes = list(rows)
    methods = [m for m in next(iter(rows.values())) if any(_cd_mm(rows[c][m]) is not None for c in classes)]
    longest = max((_cd_mm(rows[c][m]) or 0.0 for c in classes for m in methods), default=1.0) or 1.0
    width = _NAMES + len(classes) * PANEL + _MARGIN
    height = 74 + len(methods) * (_METHOD + _GAP)
    lines = []
    for column, name in enumerate(classes):
        left = _NAMES + column * PANEL
        lines.append(chart_text(left, 60, name, weight="bold"))
        for row, method in enumerate(methods):
            top, value = 68 + row * (_METHOD + _GAP), _cd_mm(rows[name][method])
            if column == 0:
                weight = "bold" if method == "gfpnet" else "normal"
                lines.append(chart_text(_NAMES - 8, top + _METHOD - 3, method, anchor="end", weight=weight))
            if value is None:
                continue
            length = value / longest * (PANEL - 60)
            colour = OURS if method == "gfpnet" else OTHER
            lines.append(f'<rect x="{left}" y="{top}" width="{length:.1f}" height="{_METHOD}" fill="{colour}"/>')
            lines.append(chart_text(left + length + 4, top + _METHOD - 3, f"{value:.2f}"))
    return write_chart(path, width, height, title, "mean Chamfer distance to the truth, mm; shorter is better", lines)


# What an operating curve shows of things of no class, and how its lines are drawn.
_CAUGHT = {
    "caught_or_good_left_out": ("class left out: unknown, or good", ""),
    "caught_mixture": ("of no class: unknown", ' stroke-dasharray="5 3"'),
}
_MOST_LOST = 0.2


def write_operating_curve(curves: Mapping[str, Sequence[Mapping[str, float]]], threshold: float, path: Path) -> Path:
    """Draw how many things of no class are caught against how many of a class are lost, over all thresholds.

    Args:
        curves: {views: points in the order of their thresholds, with "threshold", "lost" and the shares that are
            caught}, of `bench_openset`.
        threshold: The one whose points are marked.
        path: An .svg file.

    Returns:
        The path.
    """
    width, height, left, top = 820, 380, 60, 60
    across, down = width - left - 390, height - top - 50

    def at(point: Mapping[str, float], name: str) -> tuple[float, float]:
        return left + across * point["lost"] / _MOST_LOST, top + down * (1 - point[name])

    lines = [
        chart_text(left + across / 2, height - 10, "things of a class that are answered as unknown", anchor="middle")
    ]
    for k in range(5):
        x, y = left + across * k / 4, top + down * (1 - k / 4)
        lines.append(f'<line x1="{left}" x2="{left + across}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        lines.append(chart_text(left - 6, y + 4, f"{k / 4:.0%}", anchor="end"))
        lines.append(chart_text(x, height - 30, f"{_MOST_LOST * k / 4:.0%}", anchor="middle"))
    rows = [(views, name) for name in _CAUGHT for views in curves if name in curves[views][0]]
    for number, (views, name) in enumerate(rows):
        colour, (words, dashes) = LINES[list(curves).index(views) % len(LINES)], _CAUGHT[name]
        shown = [point for point in curves[views] if point["lost"] <= _MOST_LOST]
        drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in (at(point, name) for point in shown))
        lines.append(f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="2"{dashes}/>')
        for x, y in (at(point, name) for point in shown if point["threshold"] == threshold):
            lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>')
        y = top + 20 * number
        stroke = f'stroke="{colour}" stroke-width="2"{dashes}'
        lines.append(f'<line x1="{width - 370}" x2="{width - 344}" y1="{y}" y2="{y}" {stroke}/>')
        lines.append(chart_text(width - 336, y + 4, f"{views} views, {words}"))
    subtitle = f"share caught over share lost, over all thresholds; the marks are those of {threshold:g}"
    return write_chart(path, width, height, "Known or unknown", subtitle, lines)


def write_margins(sets: Mapping[str, Mapping[str, Mapping[str, Any]]], path: Path) -> Path:
    """Draw the margin of every completer with its interval, and beside it the share that held; a panel for each set.

    Args:
        sets: {set: {completer: summary of `score.Report.completers`, with "margin"}}.
        path: An .svg file.

    Returns:
        The path.
    """
    methods = list(next(iter(sets.values())))
    most = max(figures["margin_ci95"][1] for rows in sets.values() for figures in rows.values())
    wide, top = PANEL - 80, 84
    lines = []
    for column, (name, rows) in enumerate(sets.items()):
        left = _NAMES + column * PANEL
        attempts = next(iter(rows.values()))["attempts"]
        lines.append(chart_text(left, 64, f"{name}, {attempts} views", weight="bold"))
        bottom = top + len(methods) * _WHISKER
        for octave in range(int(most) + 1):
            x = left + wide * octave / most
            lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top - 8}" y2="{bottom}" stroke="{PALE}"/>')
            lines.append(chart_text(x, bottom + 14, str(octave), anchor="middle"))
        for row, method in enumerate(methods):
            y, figures = top + (row + 0.5) * _WHISKER, rows[method]
            colour = OURS if method == "gfpnet" else INK
            if column == 0:
                weight = "bold" if method == "gfpnet" else "normal"
                lines.append(chart_text(_NAMES - 12, y + 4, method, anchor="end", weight=weight))
            low, mean, high = (
                left + wide * value / most
                for value in (figures["margin_ci95"][0], figures["margin"], figures["margin_ci95"][1])
            )
            lines.append(
                f'<path d="M{low:.1f},{y - 4} v8 M{low:.1f},{y} H{high:.1f} M{high:.1f},{y - 4} v8" '
                f'stroke="{colour}" fill="none"/><circle cx="{mean:.1f}" cy="{y}" r="4.5" fill="{colour}"/>'
            )
            lines.append(chart_text(left + wide + 10, y + 4, f"{100 * figures['success_rate']:.0f} %"))
    width, height = _NAMES + len(sets) * PANEL + _MARGIN, top + len(methods) * _WHISKER + 28
    key = "margin in doublings of friction, mean and 95 % interval over objects; beside it, best grasps that held"
    return write_chart(path, width, height, "What completion is worth to a gripper", key, lines)


def write_confusion(rows: Mapping[str, Sequence[float]], columns: Sequence[str], path: Path, *, title: str) -> Path:
    """Draw which class is named how often: a row a true class, a column a named one, the darker the more often.

    Args:
        rows: {true class: how often each of the columns was named}.
        columns: Names of the classes.
        path: An .svg file.
        title: Heading of the chart.

    Returns:
        The path.
    """
    lines = [
        f'<text transform="translate({_middle(column):.1f},{_HEAD - 8}) rotate(-60)">{escape(name)}</text>'
        for column, name in enumerate(columns)
    ]
    for row, (true, counts) in enumerate(rows.items()):
        top, total = _HEAD + row * _CELL, max(float(sum(counts)), 1e-9)
        lines.append(chart_text(_CLASS_NAMES - 8, top + _CELL - 9, true, anchor="end"))
        for column, (name, count) in enumerate(zip(columns, counts, strict=True)):
            share, colour = count / total, OURS if name == true else WRONG
            lines.append(
                f'<rect x="{_CLASS_NAMES + column * _CELL}" y="{top}" width="{_CELL}" height="{_CELL}" '
                f'fill="{colour}" fill-opacity="{share:.3f}" stroke="{PALE}"/>'
            )
            if share >= _LEAST_TOLD:
                ink = "white" if share > 0.6 else INK
                words = f'fill="{ink}" font-size="10" text-anchor="middle">{100 * share:.0f}</text>'
                lines.append(f'<text x="{_middle(column):.1f}" y="{top + _CELL - 9}" {words}')
    width, height = _CLASS_NAMES + len(columns) * _CELL + 60, _HEAD + len(rows) * _CELL + _MARGIN
    key = "rows: the true class; columns: the named one; per cent of the row"
    return write_chart(path, width, height, title, key, lines)


def _middle(column: int) -> float:
    return _CLASS_NAMES + (column + 0.5) * _CELL


def write_chart(path: Path, width: int, height: int, title: str, subtitle: str, lines: Sequence[str]) -> Path:
    """Write SVG elements below a title and a subtitle, on white."""
    opening = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        f' font-family="Helvetica, Arial, sans-serif" font-size="12" fill="{INK}">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        chart_text(_MARGIN, 22, title, size=15, weight="bold"),
        chart_text(_MARGIN, 40, subtitle),
    ]
    write_whole(path, "\n".join([*opening, *lines, "</svg>"]) + "\n")
    return path


def _cd_mm(figures: Mapping) -> float | None:
    return None if figures.get("cd_m") is None else 1000 * float(figures["cd_m"])


def chart_text(x: float, y: float, words: str, *, size: int = 12, weight: str = "normal", anchor: str = "start") -> str:
    """An SVG element of words, escaped."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}">'
        f"{escape(words)}</text>"
    )


def log_axis(values: Sequence[float], start: float, end: float) -> tuple[Callable[[float], float], list[float]]:
    """Where positive values lie on a logarithmic axis between two places, and round values to mark on it."""
    low, high = 0.85 * min(values), 1.18 * max(values)
    ticks = [m * 10.0**power for power in range(-6, 6) for m in (1, 2, 5) if low <= m * 10.0**power <= high]
    if len(ticks) > _MOST_TICKS:
        ticks = [tick for tick in ticks if f"{tick:e}".startswith("1")]
    if len(ticks) < 2:
        ticks = [float(f"{end_value:.2g}") for end_value in (min(values), max(values))]
    return lambda value: start + (end - start) * log(value / low) / log(high / low), ticks
