"""The table of the bench of readiness, in a terminal and in pages, where it stands between two marks.

A page says where a table goes, of which group, and of which completers where not of all:

    <!-- ready procedural: mirror gfpnet -->
    <!-- end of ready -->
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from os.path import relpath
from pathlib import Path
from typing import Any

from gfp_grasp.bench.ready import ReadyConfig
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import write_whole

_MARKS = re.compile(
    r"(?P<begin><!-- ready (?P<group>\w+)(?:: (?P<names>[^>]*?))? -->\n)(?P<table>.*?)(?P<end><!-- end of ready -->)",
    re.DOTALL,
)
_WIDTH = 120
_NONE = "-"
_WISHES = "What robotics asks of a mesh from one view ([arXiv 2505.17966](https://arxiv.org/abs/2505.17966))"
_OF_SCENES = ("cut, mm", "cut unparted, mm")


def ready_headings(rows: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Heads of the columns of `ready_cells`."""
    first = next(iter(rows.values()))
    scenes = _OF_SCENES if "cut_most_mm" in first else ()
    hidden = tuple(f"{percent} % hidden: mm, stand" for percent in first["hidden"])
    rest = ("tilt, deg", "travel, mm", "stand")
    return ("completer", "Chamfer, mm", "< 2 mm", *scenes, *rest, *hidden, "s")


def ready_cells(name: str, figures: Mapping[str, Any]) -> tuple[str, ...]:
    """One row: medians of what was answered, shares of what was asked for, and how much has no answer.

    Chamfer distances are median and mean, where pixels are hidden the median alone; cuts are the deepest of all and the
    share of objects that cut by more than 1 mm; seconds are median and 95 %.
    """
    scenes = ()
    if "cut_most_mm" in figures:
        scenes = tuple(
            f"{_number(figures[f'{key}_most_mm'], '.1f')}, {_percent(figures[f'{key}_over_1_mm'])}"
            for key in ("cut", "unparted")
        )
        scenes = (scenes[0] + _lacking(figures["missing"]), scenes[1])
    hidden = (
        f"{_number(of['chamfer_median_mm'], '.1f')}, {_percent(of['stands'])}{_lacking(of['failed'])}"
        for of in figures["hidden"].values()
    )
    return (
        name,
        _pair(figures["chamfer_median_mm"], figures["chamfer_mean_mm"]) + _lacking(figures["failed"]),
        _percent(figures["under_2_mm"]),
        *scenes,
        _number(figures["tilt_median_deg"], ".1f") + _lacking(figures["not_simulated"]),
        _number(figures["travel_median_mm"], ".1f"),
        _percent(figures["stands"]),
        *hidden,
        _pair(figures["seconds_median"], figures["seconds_p95"]),
    )


def check_pages(pages: Sequence[Path]) -> None:
    """Refuse pages without marks, before anything is measured for them.

    Raises:
        InvalidOption: A page has none.
    """
    for page in pages:
        if not _MARKS.search(page.read_text(encoding="utf-8")):
            raise InvalidOption(f"{page} has no table: '<!-- ready procedural -->' and '<!-- end of ready -->' in it?")


def write_pages(report: Mapping[str, Any], results: Path, pages: Sequence[Path]) -> None:
    """Put the tables of a report into pages, each with the name of the file that holds its figures."""
    for page in pages:
        write_whole(page, with_tables(page.read_text(encoding="utf-8"), report, relpath(results, page.parent)))


def with_tables(text: str, report: Mapping[str, Any], link: str) -> str:
    """The text of a page with the tables of a report between its marks.

    Args:
        text: The page.
        report: What `bench_ready` gives.
        link: Where its file lies, seen from the page.
    """

    def filled(marks: re.Match[str]) -> str:
        group, names = marks["group"], (marks["names"] or "").split()
        rows = report["rows"].get(group, {})
        chosen = {name: rows[name] for name in names or rows if name in rows}
        table = f"\n{_caption(report, group, link)}\n\n{_markdown(chosen)}\n\n" if chosen else ""
        return f"{marks['begin']}{table}{marks['end']}"

    return _MARKS.sub(filled, text)


def _caption(report: Mapping[str, Any], group: str, link: str) -> str:
    settings, first = report["settings"], next(iter(report["rows"][group].values()))
    said = f"{_WISHES}, on {settings['views']} views of {settings['objects'][group]} {group} objects"
    if "scenes" in first:
        said += f" and on {first['objects']} objects in {first['scenes']} scenes"
    command = "gfp-grasp bench ready" + (" --data FOLDER" if len(report["rows"]) > 1 else "")
    for name, default in asdict(ReadyConfig()).items():
        if settings[name] != default:
            command += f" --{name} {settings[name]}"
    text = f"{said} (`{command}`, {settings['machine']}, [results/{Path(link).name}]({link})):"
    return textwrap.fill(text, _WIDTH, break_long_words=False, break_on_hyphens=False)


def _markdown(rows: Mapping[str, Mapping[str, Any]]) -> str:
    head = ready_headings(rows)
    lines = [("", *head[1:]), ("---",) * len(head), *(ready_cells(name, figures) for name, figures in rows.items())]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines).replace("|  |", "| |")


def _number(value: float | None, style: str) -> str:
    return _NONE if value is None else format(value, style)


def _pair(first: float | None, second: float | None) -> str:
    return _NONE if first is None or second is None else f"{first:.2f}, {second:.2f}"


def _percent(share: float | None) -> str:
    return _NONE if share is None else f"{100 * share:.0f} %"


def _lacking(number: int) -> str:
    return f" ({number} failed)" if number else ""
