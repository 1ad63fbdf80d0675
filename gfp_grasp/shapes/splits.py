"""Which seeds train and which test; committed, so that no figure is ever taken on what was trained on."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

from gfp_grasp.errors import InvalidOption, UnknownCategory

SPLITS = ("train", "val", "test")


def split_seeds(family: str, split: str) -> tuple[int, ...]:
    """Seeds of one split of one family.

    Args:
        family: One of shapes.FAMILIES.
        split: "train", "val" or "test".

    Raises:
        UnknownCategory: No such family.
        InvalidOption: No such split.
    """
    table = _table()
    if family not in table:
        raise UnknownCategory(f"no shape family {family!r}: choose one of {', '.join(table)}")
    if split not in SPLITS:
        raise InvalidOption(f"no split {split!r}: choose one of {', '.join(SPLITS)}")
    return table[family][split]


@cache
def _table() -> dict[str, dict[str, tuple[int, ...]]]:
    content = json.loads(files("gfp_grasp.shapes").joinpath("splits.json").read_text(encoding="utf-8"))
    return {family: {split: tuple(seeds) for split, seeds in splits.items()} for family, splits in content.items()}
