"""Charts of the benches as SVG files: bars, curves, and which class is named for which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from gfp_grasp.journal import write_whole

# Units of the bars and curves of a bench.
_METHOD, _GAP, _NAMES, _PANEL, _MARGIN = 14, 5, 190, 300, 16
_LINES = ("#1f6f8b", "#d9822b", "#5b8c3e", "#8e4585", "#7a7a7a")
_OURS, _OTHER, _WRONG, _INK = "#1f6f8b", "#b9c4cb", "#c8553d", "#22303a"
# Units of the squares of a confusion.
_CELL, _CLASS_NAMES, _HEAD = 26, 110, 150
_WHISKER = 22
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
    width = _NAMES + len(classes) * _PANEL + _MARGIN
    height = 74 + len(methods) * (_METHOD + _GAP)
    lines = []
    for column, name in enumerate(classes):
        left = _NAMES + column * _PANEL
        lines.append(_text(left, 60, name, weight="bold"))
        for row, method in enumerate(methods):
            top, value = 68 + row * (_METHOD + _GAP), _cd_mm(rows[name][method])
            if column == 0:
                weight = "bold" if method == "gfpnet" else "normal"
                lines.append(_text(_NAMES - 8, top + _METHOD - 3, method, anchor="end", weight=weight))
            if value is None:
                continue
            length = value / longest * (_PANEL - 60)
            colour = _OURS if method == "gfpnet" else _OTHER
            lines.append(f'<rect x="{left}" y="{top}" width="{length:.1f}" height="{_METHOD}" fill="{colour}"/>')
            lines.append(_text(left + length + 4, top + _METHOD - 3, f"{value:.2f}"))
    return _write_chart(path, width, height, title, "mean Chamfer distance to the truth, mm; shorter is better", lines)


def write_curves(rows: Mapping[str, Sequence[float]], path: Path, *, title: str, axis: str) -> Path:
    """Draw one line for each row over 1, 2, 3 and so on.

    Args:
        rows: {name: values, mm}.
        path: An .svg file.
        title: Heading of the chart.
        axis: Name of the numbers along the bottom.

    Returns:
        The path.
    """
    width, height, left, top = 620, 360, 60, 60
    highest = 1.1 * max(max(values) for values in rows.values())
    most = max(len(values) for values in rows.values())
    across, down = (width - left - 190) / max(most - 1, 1), height - top - 50

    def at(i: int, value: float) -> tuple[float, float]:
        return left + i * across, top + down * (1 - value / highest)

    lines = [_text(left + across * (most - 1) / 2, height - 10, axis, anchor="middle")]
    for i in range(most):
        lines.append(_text(left + i * across, height - 30, str(i + 1), anchor="middle"))
    for k in range(5):
        y = at(0, highest * k / 4)[1]
        lines.append(
            f'<line x1="{left}" x2="{left + across * (most - 1):.1f}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>'
        )
        lines.append(_text(left - 6, y + 4, f"{highest * k / 4:.1f}", anchor="end"))
    for number, (name, values) in enumerate(rows.items()):
        colour = _LINES[number % len(_LINES)]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (at(i, v) for i, v in enumerate(values)))
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>')
        y = top + 16 * number
        lines.append(f'<rect x="{width - 180}" y="{y}" width="12" height="4" fill="{colour}"/>')
        lines.append(_text(width - 162, y + 6, name))
    return _write_chart(path, width, height, title, "Chamfer distance of the predicted patch to its label, mm", lines)


# What an operating curve shows of things of no class, and how its lines are drawn.
_CAUGHT = {
    "caught_or_good_left_out": ("class left out: unknown, or good", ""),
    "caught_mixture": ("of no class: unknown", ' stroke-dasharray="5 3"'),
}
_MOST_LOST = 0.2


def write_operating_curve(curves: Mapping[str, Sequence[Mapping[str, float]]], threshold: float, path: Path) -> Path:
    """Draw how many things of no class are caught against how many of a class are lost, over all thresholds.

    Args:
        curves: {views: points with "threshold", "lost" and the shares that are caught}, of `bench_openset`.
        threshold: The one whose points are marked.
        path: An .svg file.

    Returns:
        The path.
    """
    width, height, left, top = 820, 380, 60, 60
    across, down = width - left - 390, height - top - 50

    def at(point: Mapping[str, float], name: str) -> tuple[float, float]:
        return left + across * point["lost"] / _MOST_LOST, top + down * (1 - point[name])

    lines = [_text(left + across / 2, height - 10, "things of a class that are answered as unknown", anchor="middle")]
    for k in range(5):
        x, y = left + across * k / 4, top + down * (1 - k / 4)
        lines.append(f'<line x1="{left}" x2="{left + across}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        lines.append(_text(left - 6, y + 4, f"{k / 4:.0%}", anchor="end"))
        lines.append(_text(x, height - 30, f"{_MOST_LOST * k / 4:.0%}", anchor="middle"))
    rows = [(views, name) for name in _CAUGHT for views in curves if name in curves[views][0]]
    for number, (views, name) in enumerate(rows):
        colour, (words, dashes) = _LINES[list(curves).index(views) % len(_LINES)], _CAUGHT[name]
        shown = [point for point in curves[views] if point["lost"] <= _MOST_LOST]
        drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in sorted(at(point, name) for point in shown))
        lines.append(f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="2"{dashes}/>')
        for x, y in (at(point, name) for point in shown if point["threshold"] == threshold):
            lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{colour}"/>')
        y = top + 20 * number
        stroke = f'stroke="{colour}" stroke-width="2"{dashes}'
        lines.append(f'<line x1="{width - 370}" x2="{width - 344}" y1="{y}" y2="{y}" {stroke}/>')
        lines.append(_text(width - 336, y + 4, f"{views} views, {words}"))
    subtitle = f"share caught over share lost, over all thresholds; the marks are those of {threshold:g}"
    return _write_chart(path, width, height, "Known or unknown", subtitle, lines)


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
    wide, top = _PANEL - 80, 84
    lines = []
    for column, (name, rows) in enumerate(sets.items()):
        left = _NAMES + column * _PANEL
        attempts = next(iter(rows.values()))["attempts"]
        lines.append(_text(left, 64, f"{name}, {attempts} views", weight="bold"))
        bottom = top + len(methods) * _WHISKER
        for octave in range(int(most) + 1):
            x = left + wide * octave / most
            lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top - 8}" y2="{bottom}" stroke="#e4e8eb"/>')
            lines.append(_text(x, bottom + 14, str(octave), anchor="middle"))
        for row, method in enumerate(methods):
            y, figures = top + (row + 0.5) * _WHISKER, rows[method]
            colour = _OURS if method == "gfpnet" else _INK
            if column == 0:
                weight = "bold" if method == "gfpnet" else "normal"
                lines.append(_text(_NAMES - 12, y + 4, method, anchor="end", weight=weight))
            low, mean, high = (
                left + wide * value / most
                for value in (figures["margin_ci95"][0], figures["margin"], figures["margin_ci95"][1])
            )
            lines.append(
                f'<path d="M{low:.1f},{y - 4} v8 M{low:.1f},{y} H{high:.1f} M{high:.1f},{y - 4} v8" '
                f'stroke="{colour}" fill="none"/><circle cx="{mean:.1f}" cy="{y}" r="4.5" fill="{colour}"/>'
            )
            lines.append(_text(left + wide + 10, y + 4, f"{100 * figures['success_rate']:.0f} %"))
    width, height = _NAMES + len(sets) * _PANEL + _MARGIN, top + len(methods) * _WHISKER + 28
    key = "margin in doublings of friction, mean and 95 % interval over objects; beside it, best grasps that held"
    return _write_chart(path, width, height, "What completion is worth to a gripper", key, lines)


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
        lines.append(_text(_CLASS_NAMES - 8, top + _CELL - 9, true, anchor="end"))
        for column, (name, count) in enumerate(zip(columns, counts, strict=True)):
            share, colour = count / total, _OURS if name == true else _WRONG
            lines.append(
                f'<rect x="{_CLASS_NAMES + column * _CELL}" y="{top}" width="{_CELL}" height="{_CELL}" '
                f'fill="{colour}" fill-opacity="{share:.3f}" stroke="#e4e8eb"/>'
            )
            if share >= _LEAST_TOLD:
                ink = "white" if share > 0.6 else _INK
                words = f'fill="{ink}" font-size="10" text-anchor="middle">{100 * share:.0f}</text>'
                lines.append(f'<text x="{_middle(column):.1f}" y="{top + _CELL - 9}" {words}')
    width, height = _CLASS_NAMES + len(columns) * _CELL + 60, _HEAD + len(rows) * _CELL + _MARGIN
    key = "rows: the true class; columns: the named one; per cent of the row"
    return _write_chart(path, width, height, title, key, lines)


def _middle(column: int) -> float:
    return _CLASS_NAMES + (column + 0.5) * _CELL


def _write_chart(path: Path, width: int, height: int, title: str, subtitle: str, lines: Sequence[str]) -> Path:
    opening = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}"'
        f' font-family="Helvetica, Arial, sans-serif" font-size="12" fill="{_INK}">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        _text(_MARGIN, 22, title, size=15, weight="bold"),
        _text(_MARGIN, 40, subtitle),
    ]
    write_whole(path, "\n".join([*opening, *lines, "</svg>"]) + "\n")
    return path


def _cd_mm(figures: Mapping) -> float | None:
    return None if figures.get("cd_m") is None else 1000 * float(figures["cd_m"])


def _text(x: float, y: float, words: str, *, size: int = 12, weight: str = "normal", anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-weight="{weight}" text-anchor="{anchor}">'
        f"{escape(words)}</text>"
    )
