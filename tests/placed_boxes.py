"""Boxes put in a place, and several bodies as one thing, for pictures whose objects are known."""

from collections.abc import Sequence

import numpy as np
import trimesh

from gfp_grasp.transforms import make_T, rotation_about


def box(extents, place, turn_deg: float = 0.0) -> trimesh.Trimesh:
    """A box whose bottom has its middle at a place."""
    made = trimesh.creation.box(extents)
    turn = rotation_about((0, 0, 1), np.radians(turn_deg))
    return made.apply_transform(make_T(turn, np.add(place, (0, 0, extents[2] / 2))))


def together(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Several bodies as one thing."""
    made = trimesh.util.concatenate(list(parts))
    assert isinstance(made, trimesh.Trimesh)
    return made
