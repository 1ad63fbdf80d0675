"""Bicycles without riders, of all styles, bent from one; wheels are rings, because spokes are next to nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh

from gfp_grasp.shapes.cycle import FIRST, Cycle
from gfp_grasp.shapes.cycle_styles import draw_cycle
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import unite
from gfp_grasp.shapes.skeleton import Skeleton, first_clean

_KINDS = {"city": 0.3, "trekking": 0.25, "mountain": 0.2, "road": 0.1, "folding": 0.05, "child": 0.1}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    cycle = draw_cycle(rng, kind)
    return Made(first_clean(lambda give: _bent(cycle.eased(give))), kind)


def _bent(cycle: Cycle) -> trimesh.Trimesh:
    frame = _frame()
    return frame.mended(cycle.moves(frame.bones, frame.vertices))


@cache
def _frame() -> Skeleton:
    bones = FIRST.bones()
    return Skeleton.of(unite(FIRST.meshes()), bones, spread_m=0.01)


BICYCLE = Family(
    "bicycle",
    _make,
    "traffic",
    spec={
        "rests": {"upright": 0.98, "lying": 0.02},
        "density_kg_m3": (1500.0, 4000.0),
        "alike": ("cyclist", "motorcycle"),
        "optional_parts": (),
        "names": {"shapenet": ("02834778",)},
    },
    members=160,
)
