"""Bringing the members of a class into one orientation, and the class into its upright frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh


def bring_into_one_pose(
    members: Sequence[trimesh.Trimesh], orientation: str, rng: np.random.Generator
) -> list[trimesh.Trimesh]:
    if orientation == "placed":
        return list(members)
    raise NotImplementedError


def stand_up(members: np.ndarray, mean: np.ndarray, faces: np.ndarray, *, upright: bool) -> np.ndarray:
    raise NotImplementedError
