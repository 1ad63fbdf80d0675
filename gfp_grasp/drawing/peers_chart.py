"""The chart of a comparison with other networks: distances by group, and how they grow with what is hidden."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from gfp_grasp.drawing.bench_charts import PALE, chart_text, log_axis, write_chart
from gfp_grasp.peers import PEERS, TRUE_BOX

Figures = Mapping[str, Mapping[str, Mapping]]
_NAMES, _PANEL, _GAP, _MARGIN = 184, 150, 26, 16
_ROW, _TOP = 19, 84
_CURVES, _CURVES_WIDE = 300, 780
_LABEL = 14
_OURS = "gfpnet"
_COLOURS: Mapping[str, str] = {
    _OURS: "#1f6f8b",
    "classfree": "#5b8c3e",
    "told-pcrnet-gfpnet-paper": "#d9822b",
    **dict(zip(PEERS, ("#8e4585", "#c8553d", "#b39b1f", "#3f51a3", "#7b5a3c", "#d070a0"), strict=True)),
}
_OTHER = "#7a7a7a"
# Curves of what is hidden: others lie beside these.
_CURVED = ("partial", *_COLOURS)


def write_peers(groups: Figures, occlusion: Figures, path: Path) -> Path:
    """Draw the mean Chamfer distance of every method in each group, and over the share that is hidden.

    A peer that is told the true box has the row of the one that is not: its mark is hollow, and its curve broken.

    Args:
        groups: {group: {method: figures with "cd_m"}}, one panel each.
        occlusion: {share: {method: figures with "cd_m"}}; nothing leaves out the curves.
        path: An .svg file.

    Returns:
        The path.
    """
    rows = list(dict.fromkeys(name.removesuffix(TRUE_BOX) for figures in groups.values() for name in figures))
    lines = []
    for row, name in enumerate(rows):
        weight = "bold" if name == _OURS else "normal"
        lines.append(chart_text(_NAMES - 12, _middle(row) + 4, name, anchor="end", weight=weight))
    for column, (group, figures) in enumerate(groups.items()):
        lines += _panel(group, figures, rows, left=_NAMES + column * (_PANEL + _GAP))
    bottom = _TOP + len(rows) * _ROW + 56
    width = max(_NAMES + len(groups) * (_PANEL + _GAP), _NAMES + _CURVES_WIDE + 190) + _MARGIN
    if occlusion:
        lines += _curves(occlusion, top=bottom)
        bottom += _CURVES + 50
    key = "mean Chamfer distance to the truth, mm, logarithmic axes of their own; hollow and broken: told the true box"
    return write_chart(path, width, bottom, "Completion beside other networks", key, lines)


def _panel(group: str, figures: Mapping[str, Mapping], rows: list[str], *, left: float) -> list[str]:
    found = {name: 1000 * row["cd_m"] for name, row in figures.items() if row.get("cd_m")}
    lines = [chart_text(left, _TOP - 14, group, weight="bold")]
    if not found:
        return lines
    bottom = _TOP + len(rows) * _ROW
    place, ticks = log_axis(list(found.values()), left, left + _PANEL)
    for tick in ticks:
        x = place(tick)
        lines.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP - 6}" y2="{bottom}" stroke="{PALE}"/>')
        lines.append(chart_text(x, bottom + 14, f"{tick:g}", anchor="middle", size=11))
    for name, value in found.items():
        base = name.removesuffix(TRUE_BOX)
        colour = _COLOURS.get(base, _OTHER)
        mark = f'cx="{place(value):.1f}" cy="{_middle(rows.index(base)):.1f}" stroke="{colour}" stroke-width="1.8"'
        lines.append(f'<circle {mark} r="4.5" fill="{"white" if base != name else colour}"/>')
    return lines


def _curves(occlusion: Figures, *, top: float) -> list[str]:
    shares = [float(share) for share in occlusion]
    shown = {
        name: [(share, 1000 * row[name]["cd_m"]) for share, row in zip(shares, occlusion.values(), strict=True)
               if row.get(name, {}).get("cd_m")]
        for name in next(iter(occlusion.values()))
        if name.removesuffix(TRUE_BOX) in _CURVED
    }  # fmt: skip
    shown = {name: points for name, points in shown.items() if points}
    bottom, right, furthest = top + _CURVES, _NAMES + _CURVES_WIDE, max(shares) or 1.0
    lines = [chart_text(_NAMES, top - 14, "over the hidden share of the object's pixels", weight="bold")]
    if not shown:
        return lines
    place, ticks = log_axis([value for points in shown.values() for _, value in points], bottom, top)
    for tick in ticks:
        y = place(tick)
        lines.append(f'<line x1="{_NAMES}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="{PALE}"/>')
        lines.append(chart_text(_NAMES - 8, y + 4, f"{tick:g}", anchor="end", size=11))
    for share in shares:
        x = _NAMES + _CURVES_WIDE * share / furthest
        lines.append(chart_text(x, bottom + 18, f"{share:.0%}", anchor="middle", size=11))
    for name, points in shown.items():
        base = name.removesuffix(TRUE_BOX)
        drawn = " ".join(f"{_NAMES + _CURVES_WIDE * share / furthest:.1f},{place(mm):.1f}" for share, mm in points)
        how = f'stroke="{_COLOURS.get(base, _OTHER)}" stroke-width="{3 if name == _OURS else 1.6}"'
        dashes = ' stroke-dasharray="4 4"' if base != name else ""
        lines.append(f'<polyline points="{drawn}" fill="none" {how}{dashes}/>')
    ends = {name: place(points[-1][1]) for name, points in shown.items() if not name.endswith(TRUE_BOX)}
    for name, y in _spread(ends, top, bottom).items():
        colour, weight = _COLOURS.get(name, _OTHER), "bold" if name == _OURS else "normal"
        lines.append(f'<path d="M{right + 3},{ends[name]:.1f} L{right + 18},{y:.1f}" stroke="{colour}" fill="none"/>')
        lines.append(f'<g fill="{colour}">{chart_text(right + 22, y + 4, name, weight=weight)}</g>')
    return lines


def _spread(ends: Mapping[str, float], top: float, bottom: float) -> dict[str, float]:
    """Heights of labels near the ends of their curves, none over another."""
    order = sorted(ends, key=lambda name: ends[name])
    heights = [max(ends[name], top) for name in order]
    for i in range(1, len(heights)):
        heights[i] = max(heights[i], heights[i - 1] + _LABEL)
    over = max(0.0, heights[-1] - bottom)
    for i in reversed(range(len(heights))):
        limit = heights[i + 1] - _LABEL if i + 1 < len(heights) else heights[i] - over
        heights[i] = min(heights[i], limit)
    return dict(zip(order, heights, strict=True))


def _middle(row: int) -> float:
    return _TOP + (row + 0.5) * _ROW
