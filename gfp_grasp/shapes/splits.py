"""Which seeds train and which test; committed, so that no figure is ever taken on what was trained on."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files

from gfp_grasp.errors import InvalidOption, UnknownCategory

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
