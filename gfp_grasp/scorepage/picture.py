"""The bracket chart by itself, for a text that shows it."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from gfp_grasp.journal import write_whole
from gfp_grasp.report import Report
from gfp_grasp.scorepage.charts import bracket_chart

_INKS = "--card: #ffffff; --ink: #1d2127; --soft: #5d6570; --rule: #e2e3e0; --accent: #2f66b3;"


def write_picture(report: Report, path: Path) -> Path:
    """Draw success between the brackets to an .svg file that any browser shows.

    Args:
        report: What `gfp_grasp.score.score` returned.
        path: The file; its folder is made if it is not there.

    Raises:
        CannotWrite: It cannot be.
    """
    sheet = files("gfp_grasp.scorepage").joinpath("page.css").read_text(encoding="utf-8")
    rules = "\n".join(line for line in sheet.splitlines() if line.startswith(".chart "))
    chart = bracket_chart(report.completers())
    opening, drawn = chart.split("\n", 1)
    opening = opening.replace(
        "<svg ", '<svg xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif" '
    )
    style = f"<style>\n.chart {{ {_INKS} background: #ffffff; font-size: 14px; }}\n{rules}\n</style>"
    write_whole(path, f"{opening}\n{style}\n{drawn}\n")
    return path
