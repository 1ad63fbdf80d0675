"""Pictures of primitives: all means of a library, and what their first modes do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw

from gfp_grasp.drawing.pictures import shaded_panel
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import GenericPrimitive

_COLUMNS = 6
_NUM_WITH_MODES = 6
_SWINGS = (-2.0, 2.0)  # standard deviations
_NUM_MODES = 3


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


def _mean(primitive: GenericPrimitive) -> trimesh.Trimesh:
    return trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)


def _title(primitive: GenericPrimitive) -> str:
    longest = float(np.ptp(primitive.vertices, axis=0).max())
    return f"{primitive.name}, {longest:.1f} m" if longest >= 1 else f"{primitive.name}, {100 * longest:.0f} cm"


def _labelled(mesh: trimesh.Trimesh, text: str) -> np.ndarray:
    picture = Image.fromarray(shaded_panel(mesh))
    ImageDraw.Draw(picture).text((8, 6), text, fill=(40, 40, 40), font_size=16)
    return np.asarray(picture)


def _write_grid(panels: Sequence[np.ndarray], columns: int, path: Path) -> None:
    white = np.full_like(panels[0], 255)
    padded = [*panels, *[white] * (-len(panels) % columns)]
    rows = [np.concatenate(padded[i : i + columns], axis=1) for i in range(0, len(padded), columns)]
    Image.fromarray(np.concatenate(rows)).quantize(64).save(path, optimize=True)
