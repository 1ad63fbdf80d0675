"""Galleries: all means of a library, what their first modes do, and what completers make of the same views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw

from gfp_grasp.drawing.pictures import shaded_panel
from gfp_grasp.journal import write_file
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import GenericPrimitive

_COLUMNS = 6
_NUM_WITH_MODES = 6
_SWINGS = (-2.0, 2.0)  # standard deviations
_NUM_MODES = 3
_INK = (40, 40, 40)
_SMALL_PX, _STRIP_PX = 180, 26
# What looks along +x then stands 100 degrees to the left of the pictures' own camera: both see a part in common.
_ASIDE = make_T(rotation_about((0, 0, 1), np.deg2rad(125.0)), None)
_NUM_DOTS, _DOT_SHARE = 1500, 0.008  # of a cloud; radius of a dot as a share of the framed shape's diagonal


def draw_primitives(library: PrimitiveLibrary, path: Path) -> None:
    """Write the means of all classes of a library as a PNG, each in a panel with its name and longest side."""
    panels = [
        _labelled(_mean(primitive), _title(primitive)) for primitive in map(library.primitive, library.categories)
    ]
    _write_grid(panels, _COLUMNS, path)


def draw_modes(library: PrimitiveLibrary, path: Path) -> None:
    """Write the first three modes of six classes as a PNG, a row each, two standard deviations down and up."""
    step = max(1, len(library.categories) // _NUM_WITH_MODES)
    panels = []
    for name in library.categories[::step][:_NUM_WITH_MODES]:
        primitive = library.primitive(name)
        panels.append(_labelled(_mean(primitive), name))
        for mode in range(_NUM_MODES):
            for swing in _SWINGS:
                coefficients = np.zeros(len(primitive.modes))
                coefficients[mode : mode + 1] = swing
                vertices = primitive.shape(coefficients, np.ones(3))
                shape = trimesh.Trimesh(vertices, primitive.faces, process=False)
                panels.append(_labelled(shape, f"mode {mode + 1}: {swing:+.0f} sd"))
    _write_grid(panels, 1 + _NUM_MODES * len(_SWINGS), path)


def draw_completions(rows: Mapping[str, Mapping[str, trimesh.Trimesh | np.ndarray]], path: Path) -> None:
    """Write what each completer made of a view as a PNG, a row for each view, a column for each completer.

    Args:
        rows: {view: {completer: mesh, or points (n, 3), m}}; z is up, and the camera of the view looks along +x. The
            first of each row is the true shape, which all of its row are framed by.
        path: A .png file.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    columns = list(dict.fromkeys(name for row in rows.values() for name in row))
    canvas = Image.new("RGB", (_SMALL_PX * len(columns), _STRIP_PX + _SMALL_PX * len(rows)), "white")
    draw = ImageDraw.Draw(canvas)
    for number, (view, row) in enumerate(rows.items()):
        top = _STRIP_PX + _SMALL_PX * number
        truth = _turned(next(iter(row.values())), 0.0)
        dot_m = _DOT_SHARE * float(np.linalg.norm(truth.extents))
        for name, shape in row.items():
            panel = Image.fromarray(shaded_panel(_turned(shape, dot_m), framed=truth))
            panel = panel.resize((_SMALL_PX, _SMALL_PX), Image.Resampling.LANCZOS)
            canvas.paste(panel, (_SMALL_PX * columns.index(name), top))
        draw.text((6, top + _SMALL_PX - 20), view, fill=_INK, font_size=14)
    for number, name in enumerate(columns):
        draw.text((_SMALL_PX * number + 6, 5), name, fill=_INK, font_size=13)
    _write(canvas, path)


def _turned(shape: trimesh.Trimesh | np.ndarray, dot_m: float) -> trimesh.Trimesh:
    """A shape as the pictures' camera has it; points become dots of some radius."""
    if isinstance(shape, np.ndarray):
        points = shape[:: max(1, len(shape) // _NUM_DOTS)]
        dot = trimesh.creation.icosphere(subdivisions=0, radius=dot_m)
        shape = trimesh.Trimesh(
            (points[:, None] + dot.vertices).reshape(-1, 3),
            (len(dot.vertices) * np.arange(len(points))[:, None, None] + dot.faces).reshape(-1, 3),
            process=False,
        )
    return shape.copy().apply_transform(_ASIDE)


def _mean(primitive: GenericPrimitive) -> trimesh.Trimesh:
    return trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)


def _title(primitive: GenericPrimitive) -> str:
    longest = float(np.ptp(primitive.vertices, axis=0).max())
    return f"{primitive.name}, {longest:.1f} m" if longest >= 1 else f"{primitive.name}, {100 * longest:.0f} cm"


def _labelled(mesh: trimesh.Trimesh, text: str) -> np.ndarray:
    picture = Image.fromarray(shaded_panel(mesh))
    ImageDraw.Draw(picture).text((8, 6), text, fill=_INK, font_size=16)
    return np.asarray(picture)


def _write_grid(panels: Sequence[np.ndarray], columns: int, path: Path) -> None:
    white = np.full_like(panels[0], 255)
    padded = [*panels, *[white] * (-len(panels) % columns)]
    rows = [np.concatenate(padded[i : i + columns], axis=1) for i in range(0, len(padded), columns)]
    _write(Image.fromarray(np.concatenate(rows)), path)


def _write(picture: Image.Image, path: Path) -> None:
    write_file(path, lambda file: picture.quantize(64).save(file, "PNG", optimize=True))
