"""Charts are what they were when they were looked at; HTML is escaped and whole."""

import re
from pathlib import Path
from xml.etree import ElementTree

import known_charts
import pytest

from gfp_grasp.drawing import bracket_chart, escaped, html_page, without_paths, write_bars, write_curves, write_peers


@pytest.mark.parametrize("name", ["success", "half_way", "reasons", "bars", "curves", "front", "learning", "peers"])
def test_chart_is_the_known_one(name: str, tmp_path: Path) -> None:
    known = (known_charts.FOLDER / f"{name}.svg").read_text(encoding="utf-8")
    assert known_charts.drawn(tmp_path / "chart.svg")[name].rstrip("\n") == known.rstrip("\n")


def test_charts_are_xml_whatever_their_names_are(tmp_path: Path) -> None:
    for chart in known_charts.drawn(tmp_path / "chart.svg").values():
        ElementTree.fromstring(chart)


def test_charts_of_nothing_are_drawn_all_the_same(tmp_path: Path) -> None:
    ElementTree.fromstring(bracket_chart({}, ("oracle",)))
    rows = {"cup": {"gfpnet": {"cd_m": 0.0}, "other": {}}}
    chart = write_bars(rows, tmp_path / "bars.svg", title="").read_text(encoding="utf-8")
    assert re.findall(r'width="(0\.0)" height="14"', chart) == ["0.0"]
    none = write_bars({"cup": {"other": {}}}, tmp_path / "none.svg", title="").read_text(encoding="utf-8")
    assert 'height="74"' in none
    one = write_curves({"": {"a": [2.0]}}, tmp_path / "one.svg", title="", axis="").read_text(encoding="utf-8")
    assert 'points="60.0,193.0"' in one  # a value alone stands half way up
    ElementTree.fromstring(write_peers({}, {}, tmp_path / "peers.svg").read_text(encoding="utf-8"))
    empty = {"cup": {"pcn": {"cd_m": None}}}
    drawn = write_peers(empty, {"0.0": empty["cup"]}, tmp_path / "peers.svg").read_text(encoding="utf-8")
    assert "pcn" in drawn
    assert "<circle" not in drawn


def test_a_bracket_alone_leaves_no_space_between() -> None:
    chart = ElementTree.fromstring(known_charts.half_way())
    assert len(chart.findall("path[@class='bracket']")) == 1
    assert chart.find("rect[@class='between']") is None


@pytest.mark.parametrize(
    ("words", "left"),
    [
        (r"D:\a\b.c", "b.c"),
        (r"\\server\share\x", "x"),
        ("see:/a/b", "see:b"),
        ("~/a/b", "~/a/b"),
        ("x/a/b", "x/a/b"),
        ("/a", "a"),
        ("<'/a/b c/d'>", "<'b c/d'>"),
    ],
)
def test_absolute_paths_lose_their_folders_on_every_system(words: str, left: str) -> None:
    assert without_paths(words) == left


def test_a_page_of_a_title_and_a_body_alone_has_neither_rules_nor_programs_of_its_own() -> None:
    page = html_page("T", "<p>body</p>")
    own = html_page("T", "<p>body</p>", css=".a{}", script="<b></b>")
    assert own.replace(".a{}", "").replace("<b></b>", "") == page
    assert page.startswith("<!doctype html>\n")
    assert "<main>\n<p>body</p>\n</main>" in page
    assert escaped(3) == "3"
