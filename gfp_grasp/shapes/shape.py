"""One procedural object and the way to make it, and which seeds train and which test.

The split is committed, so that no figure is ever taken on what was trained on.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from zlib import crc32

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption, UnknownCategory
from gfp_grasp.shapes.bottles import make_bottle
from gfp_grasp.shapes.cups import make_cup
from gfp_grasp.shapes.mugs import make_mug

SPLITS = ("train", "val", "test")


_MORE = 1000  # seeds from here on belong to no committed split and are for training


def split_seeds(family: str, split: str, count: int | None = None) -> tuple[int, ...]:
    """Seeds of one split of one family.

    Args:
        family: One of shapes.FAMILIES.
        split: "train", "val" or "test".
        count: The first so many; None is the whole committed split. Of "train" there are as many as are asked for.

    Raises:
        UnknownCategory: No such family.
        InvalidOption: No such split.
    """
    table = _table()
    if family not in table:
        raise UnknownCategory(f"no shape family {family!r}: choose one of {', '.join(table)}")
    if split not in SPLITS:
        raise InvalidOption(f"no split {split!r}: choose one of {', '.join(SPLITS)}")
    seeds = table[family][split]
    if count is None:
        return seeds
    more = count - len(seeds) if split == "train" else 0
    return (*seeds[:count], *range(_MORE, _MORE + more))


@cache
def _table() -> dict[str, dict[str, tuple[int, ...]]]:
    content = json.loads(files("gfp_grasp.shapes").joinpath("splits.json").read_text(encoding="utf-8"))
    return {family: {split: tuple(seeds) for split, seeds in splits.items()} for family, splits in content.items()}


FAMILIES = ("cup", "mug", "bottle")
_MAKERS = {"cup": make_cup, "mug": make_mug, "bottle": make_bottle}


@dataclass(frozen=True, eq=False)
class Shape:
    """A procedural object.

    Attributes:
        name: Family and seed, e.g. "mug-0007".
        family: One of FAMILIES.
        mesh: Watertight volume, m, z up, standing on z = 0, axis at x = y = 0, handle or spout towards +x, the wider
            side of an oval body along x. Treat as read-only.
        kind: Variant within the family, e.g. "ear" for a mug's handle.
        has_handle: Whether one can put fingers through it.
        wall_m: Thickness of the wall, m; 0 where the object is modelled as a solid.
        seed: That made it.
    """

    name: str
    family: str
    mesh: trimesh.Trimesh
    kind: str
    has_handle: bool
    wall_m: float
    seed: int


def make_shape(family: str, seed: int) -> Shape:
    """Make one object; the same family and seed give the same object.

    Args:
        family: One of FAMILIES.
        seed: Any whole number that is not negative; `split_seeds` names those set aside for training and tests.

    Raises:
        UnknownCategory: No such family.
    """
    if family not in _MAKERS:
        raise UnknownCategory(f"no shape family {family!r}: choose one of {', '.join(FAMILIES)}")
    rng = np.random.default_rng([crc32(family.encode()), seed])
    mesh, kind, wall = _MAKERS[family](rng)
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    has_handle = family == "mug" or kind == "jug"
    return Shape(f"{family}-{seed:04d}", family, mesh, kind, has_handle, float(wall), int(seed))
