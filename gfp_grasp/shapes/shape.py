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
from gfp_grasp.shapes.family import Family
from gfp_grasp.shapes.household import HOUSEHOLD_FAMILIES
from gfp_grasp.shapes.traffic import TRAFFIC_FAMILIES

SPLITS = ("train", "val", "test")
_BY_NAME = {family.name: family for family in (*HOUSEHOLD_FAMILIES, *TRAFFIC_FAMILIES)}
FAMILIES = tuple(_BY_NAME)
HOUSEHOLD = tuple(family.name for family in HOUSEHOLD_FAMILIES)
TRAFFIC = tuple(family.name for family in TRAFFIC_FAMILIES)
IN_PAPER = ("cup", "bottle", "car", "pedestrian")  # the classes of GFPNet's table I
_OTHERS = "others"  # the split of every family that has none of its own in the file
_MORE = 1000  # seeds from here on belong to no committed split and are for training


def get_family(name: str) -> Family:
    """The family of a name.

    Raises:
        UnknownCategory: No such family; the message lists those that there are.
    """
    if name not in _BY_NAME:
        raise UnknownCategory(f"no shape family {name!r}: choose one of {', '.join(FAMILIES)}")
    return _BY_NAME[name]


def split_seeds(family: str, split: str, count: int | None = None) -> tuple[int, ...]:
    """Seeds of one split of one family.

    Args:
        family: One of shapes.FAMILIES.
        split: "train", "val" or "test".
        count: The first so many; None is the whole committed split. "train" has as many as are asked for.

    Raises:
        UnknownCategory: No such family.
        InvalidOption: No such split.
    """
    get_family(family)
    if split not in SPLITS:
        raise InvalidOption(f"no split {split!r}: choose one of {', '.join(SPLITS)}")
    table = _table()
    seeds = table.get(family, table[_OTHERS])[split]
    if count is None:
        return seeds
    more = count - len(seeds) if split == "train" else 0
    return (*seeds[:count], *range(_MORE, _MORE + more))


@cache
def _table() -> dict[str, dict[str, tuple[int, ...]]]:
    content = json.loads(files("gfp_grasp.shapes").joinpath("splits.json").read_text(encoding="utf-8"))
    return {family: {split: tuple(seeds) for split, seeds in splits.items()} for family, splits in content.items()}


@dataclass(frozen=True, eq=False)
class Shape:
    """A procedural object.

    Attributes:
        name: Family and seed, e.g. "mug-0007".
        family: One of FAMILIES.
        mesh: Watertight volume, m, z up, standing on z = 0, axis at x = y = 0, handle, spout or front towards +x, the
            wider side of an oval body along x. Treat as read-only.
        kind: Variant within the family, e.g. "ear" for a mug's handle.
        wall_m: Thickness of the wall, m; 0 where the object is modelled as a solid.
        seed: Seed that made the object.
    """

    name: str
    family: str
    mesh: trimesh.Trimesh
    kind: str
    wall_m: float
    seed: int

    @property
    def has_handle(self) -> bool:
        """Whether the body has a hole through it, as a handle makes one."""
        return int(self.mesh.euler_number) < 2


def make_shape(family: str, seed: int) -> Shape:
    """Make one object; the same family and seed give the same object.

    Args:
        family: One of FAMILIES.
        seed: Any whole number that is not negative; `split_seeds` names those set aside for training and tests.

    Raises:
        UnknownCategory: No such family.
    """
    rng = np.random.default_rng([crc32(family.encode()), seed])
    made = get_family(family).make(rng)
    made.mesh.apply_translation([0, 0, -made.mesh.bounds[0, 2]])
    return Shape(f"{family}-{seed:04d}", family, made.mesh, made.kind, float(made.wall_m), int(seed))
