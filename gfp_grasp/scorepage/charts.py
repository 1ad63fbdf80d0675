"""The score as two drawings: success between the brackets, and what became of every attempt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gfp_grasp.report import BRACKETS
from gfp_grasp.scorepage.words import escaped, spoken
from gfp_grasp.types import REASONS

# Units of both drawings, which stand side by side on a wide page and one under the other on a phone.
_WIDTH, _LEFT, _RIGHT, _TEXT = 480, 10, 470, 14
_SPAN = _RIGHT - _LEFT
_AXIS = 400  # of the brackets, whose figures stand to its right
_LONGEST_NAME = 34
_TOP, _ROW, _BAR_ROW, _BAR = 42, 58, 52, 22
_NARROW = 18  # a share of a bar that has no room for its number
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


def bracket_chart(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Success of each row with its Wilson interval, on the true objects and, lighter, in the completed world.

    Args:
        summaries: As `Report.completers` returns them.

    Returns:
        An <svg> element. The brackets that were scored are lines from top to bottom.
    """
    bottom = _TOP + len(summaries) * _ROW
    lines = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        lines.append(_line(_at(share), _TOP - 6, bottom, "grid"))
        lines.append(_words(_at(share), bottom + 18, f"{share:g}", anchor=_anchor(share)))
    brackets = [(name, summaries[name]["success_rate"]) for name in BRACKETS if name in summaries]
    if len(brackets) == len(BRACKETS):
        low, high = sorted(_at(rate) for _, rate in brackets)
        lines.append(
            f'<rect class="between" x="{low:.1f}" y="{_TOP - 6}" width="{high - low:.1f}" '
            f'height="{bottom - _TOP + 6}"/>'
        )
    for place, (name, rate) in enumerate(brackets):
        y = 14 + 16 * place
        lines.append(_line(_at(rate), y - 10, bottom, "bracket"))
        side = 6 if rate < 0.5 else -6
        lines.append(_words(_at(rate) + side, y, f"{name} {rate:.2f}", anchor="start" if rate < 0.5 else "end"))
    for place, (name, summary) in enumerate(summaries.items()):
        top = _TOP + place * _ROW
        kind = "soft" if name in BRACKETS else "name"
        lines.append(_words(_LEFT, top + 14, name, kind=kind))
        for rates, y, world in ((summary, top + 27, "true"), (summary["completed_world"], top + 41, "completed")):
            lines.append(_whisker(rates, y, world, f"{name}, {world} world"))
            figure = f"{rates['successes']}/{rates['attempts']}"
            lines.append(_words(_RIGHT, y + 5, figure, anchor="end", kind="name" if world == "true" else "soft"))
    return _svg(bottom + 26, "Success of the best grasp of each row, with 95 % intervals", lines)


def reasons_chart(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """What became of each row's attempts on the true objects, one bar a row.

    Args:
        summaries: As `Report.completers` returns them.

    Returns:
        An <svg> element; `reasons_legend` says what its hatches mean.
    """
    lines = [f"<defs>{''.join(_pattern(reason) for reason in _met(summaries))}</defs>"]
    for place, (name, summary) in enumerate(summaries.items()):
        top = place * _BAR_ROW
        lines.append(_words(_LEFT, top + 14, name, kind="name"))
        lines.append(_words(_RIGHT, top + 14, f"{summary['attempts']} attempts", anchor="end"))
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
    return _svg(len(summaries) * _BAR_ROW, "Reasons of each row's attempts on the true objects", lines)


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
    """Of a figure under the axis, so that those at its ends stay inside."""
    return {0.0: "start", 1.0: "end"}.get(share, "middle")


def _svg(height: int, label: str, lines: Sequence[str]) -> str:
    drawn = "\n".join(lines)
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escaped(label)}">\n{drawn}\n</svg>'
    )
