"""Points in text: one a row, their coordinates in columns that a heading may name."""

from __future__ import annotations

import io
import re

import numpy as np

from gfp_grasp.errors import UnreadableFile

# The last piece of a column's name is its axis, perhaps with a unit: x, field.x, position/x, x_mm, "x [mm]", pos_x.
_NAME = re.compile(r"(?P<of>.*?)(?P<axis>[xyz])(?:[\s_]*[\[(]?(?P<unit>mm|cm|m)[\])]?)?", re.IGNORECASE)
_NUMBERED = re.compile(r"(?P<of>points?)[:_ ]?(?P<axis>[012])", re.IGNORECASE)  # as ParaView names them
_OTHER = re.compile(r"norm|orient|quat|rot|vel|acc|ang|twist|std|var", re.IGNORECASE)  # has axes, and is no place
_METRES = {None: 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
_LINES_BEFORE = 30  # comments, a title, a count and a heading fit into these


def parse_columns(content: bytes) -> np.ndarray:
    """Points (n, 3) float64 of .xyz, .pts, .txt and .csv.

    Columns are parted by commas, semicolons (the decimals may then have commas), tabs or blanks. Where a heading names
    them, x y z are found by name, also with something before (field.x) or a unit behind (x_mm), which is heeded. Where
    nothing names them, they are the first three. A first line that holds only the number of points is stepped over.

    Raises:
        UnreadableFile: No rows of numbers, or no three columns that can be x y z; the message names the columns.
    """
    lines = content.decode("utf-8-sig").splitlines()
    first = _first_row(lines)
    if lines[first].strip().isdecimal():  # the number of points
        lines = lines[first + 1 :]
        first = _first_row(lines)
    separator = _separator(lines[first])
    if separator in (";", "\t"):
        lines = [line.replace(",", ".") for line in lines]
    width = len(_words(lines[first], separator))
    if width < 3:
        raise UnreadableFile(f"its rows hold {width} numbers; x y z are expected")
    columns, unit_m = _columns(_heading(lines[:first], separator, width), width)
    rows = "\n".join(lines[first:])
    options = {"delimiter": separator, "ndmin": 2, "usecols": columns, "quotechar": '"'}
    table = np.loadtxt(io.StringIO(rows), **options).astype(np.float64)
    _refuse_colours(table, rows, options, width)
    return unit_m * table


def _first_row(lines: list[str]) -> int:
    """Index of the first line that holds numbers and nothing that should be one and is none."""
    for index, line in enumerate(lines[:_LINES_BEFORE]):
        words = re.split(r"[\s,;]+", line.strip().strip(",;"))
        if words != [""] and sum(map(_is_number, words)) >= min(3, len(words)):
            return index
    shown = next((line for line in lines if line.strip()), "").strip()[:80]
    raise UnreadableFile(f"it holds no rows of numbers{f'; it begins with {shown!r}' if shown else ''}")


def _is_number(word: str) -> bool:
    try:
        float(word.strip('"'))
    except ValueError:
        return False
    return True


def _separator(line: str) -> str | None:
    return next((mark for mark in (";", "\t", ",") if len(_words(line, mark)) > 2), None)


def _words(line: str, separator: str | None) -> list[str]:
    return [word.strip().strip('"').strip() for word in line.strip().split(separator)]


def _heading(lines: list[str], separator: str | None, width: int) -> list[str] | None:
    """Names of the columns from the last line before the rows that has as many words as these; None without one."""
    for line in reversed(lines):
        bare = line.strip().lstrip("#%/").strip()
        for mark in dict.fromkeys((separator, ",", ";", "\t", None)):
            names = _words(bare, mark)
            if len(names) == width and not all(map(_is_number, names)):
                return names
    return None


def _columns(names: list[str] | None, width: int) -> tuple[list[int], float]:
    """Indices of x, y and z, and the metres of one unit of theirs."""
    if names is None:
        return [0, 1, 2], 1.0
    groups: dict[str, dict[str, tuple[int, str | None]]] = {}
    for index, name in enumerate(names):
        match = _NAME.fullmatch(name) or _NUMBERED.fullmatch(name)
        if match is None or (match["of"] and match["of"][-1].isalpha() and match.re is _NAME):
            continue
        axis = "xyz"[int(match["axis"])] if match["axis"].isdecimal() else match["axis"].lower()
        unit = match.groupdict().get("unit")
        groups.setdefault(match["of"].lower(), {}).setdefault(axis, (index, unit and unit.lower()))
    whole = {of: axes for of, axes in groups.items() if len(axes) == 3 and not _OTHER.search(of)}
    if not whole:
        raise UnreadableFile(
            f"its {width} columns are named {', '.join(names)}; x, y and z are expected among them (also as field.x or "
            "x_mm): rename those that hold the coordinates"
        )
    axes = whole.get("", next(iter(whole.values())))
    units = {axes[axis][1] for axis in "xyz"}
    if len(units) > 1:
        raise UnreadableFile(f"its columns {', '.join(names)} have x, y and z in different units; one is expected")
    return [axes[axis][0] for axis in "xyz"], _METRES[units.pop()]


def _refuse_colours(table: np.ndarray, rows: str, options: dict, width: int) -> None:
    """Whole numbers from 0 to 255 before numbers that are not whole are colours."""
    if width < 6 or options["usecols"] != [0, 1, 2] or not _are_bytes(table):
        return
    after = np.loadtxt(io.StringIO(rows), **{**options, "usecols": [3, 4, 5]})
    if not _are_bytes(after):
        raise UnreadableFile(
            f"the first three of its {width} columns hold whole numbers from 0 to 255, as colours do: give the columns "
            "names in a first line, with x, y and z among them"
        )


def _are_bytes(table: np.ndarray) -> bool:
    return bool(((table == np.round(table)) & (table >= 0) & (table <= 255)).all())
