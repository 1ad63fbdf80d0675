"""What pages are made of: HTML that is escaped and names no folder, and the charts of a score as SVG."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from gfp_grasp.types import REASONS

# Where an absolute path begins, all of its folders: /a/b/name and C:\a\name leave name, gfpnet/top-down stays.
_FOLDERS = re.compile(r"(?<![\w./\\~-])(?:[A-Za-z]:)?[/\\]+(?:[^\s/\\'\"<>|:;,]+[/\\]+)*(?=[^\s/\\])")


def html_page(title: str, body: str, *, css: str = "", script: str = "") -> str:
    """A whole page that asks nothing of any network.

    Args:
        title: The browser shows it; escaped here.
        body: HTML that stands inside of <main>.
        css: Rules that follow those which all pages share.
        script: HTML that follows <main>.
    """
    shared = files("gfp_grasp.drawing").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>
{shared}{css}</style>
</head>
<body>
<main>
{body}
</main>
{script}</body>
</html>
"""


def escaped(words: object) -> str:
    """Text as HTML, for an element or the quotes of an attribute; an absolute path keeps its last name only."""
    return html.escape(without_paths(str(words)))


def without_paths(words: str) -> str:
    """Text in which each absolute path has lost its folders."""
    return _FOLDERS.sub("", words)


def spoken(reason: str) -> str:
    """A reason as words."""
    return reason.replace("_", " ")


# Units of both charts of a score, which stand side by side on a wide page and one under the other on a phone.
_WIDTH, _LEFT, _RIGHT, _TEXT = 480, 10, 470, 14
_SPAN = _RIGHT - _LEFT
_AXIS = 400  # length of the axis of success; the figures stand to its right
_LONGEST_NAME = 34
_TOP, _ROW, _BAR_ROW, _BAR = 42, 58, 52, 22
_NARROW = 18  # a narrower share of a bar has no room for its number
# Base colour and strokes of each reason: they differ in lightness or in hatch, so that grey tells them apart too.
_LIGHT, _DARK = "#ffffffb0", "#00000090"
_HATCHES: Mapping[str, tuple[str, str, str]] = {
    "held": ("#2f66b3", "", ""),
    "collided_on_approach": ("#dd8a33", "M-2,2 l4,-4 M0,8 l8,-8 M6,10 l4,-4", _DARK),
    "no_contact": ("#f0cb66", "M2,2 h2 M6,6 h2", _DARK),
    "slipped_on_lift": ("#86427e", "M0,2 h8 M0,6 h8", _LIGHT),
    "slipped_on_shake": ("#c7a3d3", "M2,0 v8 M6,0 v8", _DARK),
    "unstable": ("#3b3f45", "M0,0 l8,8 M8,0 l-8,8", _LIGHT),
    "unreachable_width": ("#78838d", "M-2,6 l4,4 M0,0 l8,8 M6,-2 l4,4", _LIGHT),
    "no_grasp_found": ("#dfe2e6", "", ""),
}


def bracket_chart(summaries: Mapping[str, Mapping[str, Any]], brackets: Sequence[str]) -> str:
    """Success of each row with its Wilson interval, on the true objects and, lighter, in the completed world.

    Args:
        summaries: Figures of each row: "attempts", "successes", "success_rate", "ci95" and, for the completed world,
            the same under "completed_world".
        brackets: The rows that bracket the others; those that were scored are lines from top to bottom.

    Returns:
        An <svg> element.
    """
    bottom = _TOP + len(summaries) * _ROW
    lines = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        lines.append(_line(_at(share), _TOP - 6, bottom, "grid"))
        lines.append(_words(_at(share), bottom + 18, f"{share:g}", anchor=_anchor(share)))
    rates = [(name, summaries[name]["success_rate"]) for name in brackets if name in summaries]
    if len(rates) == len(brackets) > 1:
        low, high = min(_at(rate) for _, rate in rates), max(_at(rate) for _, rate in rates)
        lines.append(
            f'<rect class="between" x="{low:.1f}" y="{_TOP - 6}" width="{high - low:.1f}" '
            f'height="{bottom - _TOP + 6}"/>'
        )
    for place, (name, rate) in enumerate(rates):
        y = 14 + 16 * place
        lines.append(_line(_at(rate), y - 10, bottom, "bracket"))
        side = 6 if rate < 0.5 else -6
        lines.append(_words(_at(rate) + side, y, f"{name} {rate:.2f}", anchor="start" if rate < 0.5 else "end"))
    for place, (name, summary) in enumerate(summaries.items()):
        top = _TOP + place * _ROW
        kind = "soft" if name in brackets else "name"
        lines.append(_words(_LEFT, top + 14, name, kind=kind))
        for figures, y, world in ((summary, top + 27, "true"), (summary["completed_world"], top + 41, "completed")):
            lines.append(_whisker(figures, y, world, f"{name}, {world} world"))
            told = f"{figures['successes']}/{figures['attempts']}"
            lines.append(_words(_RIGHT, y + 5, told, anchor="end", kind="name" if world == "true" else "soft"))
    return _svg(bottom + 26, "Success of the best grasp of each row, with 95 % intervals", lines)


def reasons_chart(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Reasons for which each row's trials on the true objects ended, one bar a row.

    Args:
        summaries: Figures of each row, with "attempts" and "reasons" ({reason: count}).

    Returns:
        An <svg> element; `reasons_legend` says what its hatches mean.
    """
    lines = [f"<defs>{''.join(_pattern(reason) for reason in _met(summaries))}</defs>"]
    for place, (name, summary) in enumerate(summaries.items()):
        top = place * _BAR_ROW
        lines.append(_words(_LEFT, top + 14, name, kind="name"))
        lines.append(_words(_RIGHT, top + 14, f"{summary['attempts']} trials", anchor="end"))
        left = float(_LEFT)
        for reason, count in summary["reasons"].items():
            width = _SPAN * count / summary["attempts"]
            lines.append(
                f'<rect class="part" x="{left:.1f}" y="{top + 20}" width="{width:.1f}" height="{_BAR}" '
                f'fill="url(#{_pattern_id(reason)})"><title>{escaped(name)}: {escaped(spoken(reason))} {count}</title>'
                "</rect>"
            )
            if width >= _NARROW:
                lines.append(_words(left + width / 2, top + 36, str(count), anchor="middle", kind="count"))
            left += width
    return _svg(len(summaries) * _BAR_ROW, "Reasons of each row's trials on the true objects", lines)


def reasons_legend(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """The hatches of `reasons_chart` with their reasons, as HTML."""
    return "".join(
        f'<span><svg class="swatch" viewBox="0 0 24 16" aria-hidden="true"><rect class="part" width="24" height="16" '
        f'fill="url(#{_pattern_id(reason)})"/></svg>{escaped(spoken(reason))}</span>'
        for reason in _met(summaries)
    )


def _met(summaries: Mapping[str, Mapping[str, Any]]) -> list[str]:
    return [reason for reason in REASONS if any(reason in summary["reasons"] for summary in summaries.values())]


def _pattern(reason: str) -> str:
    colour, strokes, ink = _HATCHES[reason]
    hatch = f'<path d="{strokes}" stroke="{ink}" stroke-width="1.6" fill="none"/>' if strokes else ""
    return (
        f'<pattern id="{_pattern_id(reason)}" width="8" height="8" patternUnits="userSpaceOnUse">'
        f'<rect width="8" height="8" fill="{colour}"/>{hatch}</pattern>'
    )


def _pattern_id(reason: str) -> str:
    return "reason-" + reason.replace("_", "-")


def _whisker(rates: Mapping[str, Any], y: float, kind: str, name: str) -> str:
    low, high = (_at(share) for share in rates["ci95"])
    rate = rates["success_rate"]
    told = f"{name}: {rates['successes']} of {rates['attempts']}, {rates['ci95'][0]:.2f} to {rates['ci95'][1]:.2f}"
    return (
        f'<g class="{kind}"><title>{escaped(told)}</title>'
        f'<path d="M{low:.1f},{y - 4} v8 M{low:.1f},{y} H{high:.1f} M{high:.1f},{y - 4} v8"/>'
        f'<circle cx="{_at(rate):.1f}" cy="{y}" r="5"/></g>'
    )


def _words(x: float, y: float, words: str, *, anchor: str = "start", kind: str = "soft") -> str:
    short = words if len(words) <= _LONGEST_NAME else words[: _LONGEST_NAME - 1] + "…"
    place = f'x="{x:.1f}" y="{y:.1f}" font-size="{_TEXT}" text-anchor="{anchor}"'
    return f'<text class="{kind}" {place}>{escaped(short)}</text>'


def _line(x: float, top: float, bottom: float, kind: str) -> str:
    return f'<path class="{kind}" d="M{x:.1f},{top} V{bottom}"/>'


def _at(share: float) -> float:
    return _LEFT + _AXIS * share


def _anchor(share: float) -> str:
    """Text anchor of a figure under the axis: the figures at its ends stay inside of the chart."""
    return {0.0: "start", 1.0: "end"}.get(share, "middle")


def _svg(height: int, label: str, lines: Sequence[str]) -> str:
    drawn = "\n".join(lines)
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escaped(label)}">\n{drawn}\n</svg>'
    )
