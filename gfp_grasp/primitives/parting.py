"""Convex parts of a primitive, from its mean."""

from __future__ import annotations

from dataclasses import replace

import trimesh

from gfp_grasp.types import GenericPrimitive


def with_parts(primitive: GenericPrimitive) -> GenericPrimitive:
    """The same primitive, and its twin, with convex parts at every level; takes minutes.

    Raises:
        DecompositionFailed: CoACD was lost in every attempt.
    """
    from gfp_grasp.collision import part_levels  # starts a child process

    levels = part_levels(trimesh.Trimesh(primitive.vertices, primitive.faces, process=False))
    return replace(
        primitive,
        parts=levels.parts,
        part_merges=levels.merges,
        part_errors_m=levels.errors_m,
        twin=None if primitive.twin is None else with_parts(primitive.twin),
    )
