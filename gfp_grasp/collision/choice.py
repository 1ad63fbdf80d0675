"""Collision parts of a completed shape, by the cheapest way that is true to it."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace

import numpy as np

from gfp_grasp.collision.carry import bearer, carry_parts
from gfp_grasp.collision.convex import volume_m3
from gfp_grasp.collision.decomposition import decompose, hull
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.types import CollisionMesh, CompletedShape

# Mean error of carried parts over the diagonal, beyond which CoACD is worth its time. A mug's parts carried through a
# bulge of a fifth of its radius stay below 0.01.
_CARRIED_LIMIT = 0.01
# The hull of a convex mesh adds nothing but rounding to its volume.
_CONVEX_EXCESS = 1e-3


def collision_of(shape: CompletedShape) -> CollisionMesh:
    """Convex parts of a completed shape.

    The parts of the primitive it was fitted with are carried along where the mesh has the primitive's (or its twin's)
    vertices and the result is within 1 % of the diagonal on average; a convex mesh is its own hull; else CoACD runs.

    Args:
        shape: Its mesh in any frame; the parts come in the same.

    Raises:
        InvalidMesh: The mesh is flat or too small for MuJoCo.
        DecompositionFailed: CoACD had to run, and was lost in every attempt.
    """
    carried = _carried(shape)
    if carried is not None:
        diagonal = float(np.linalg.norm(np.ptp(shape.mesh.vertices, axis=0)))
        if carried.error_m[0] <= _CARRIED_LIMIT * diagonal:
            return carried
        return _decomposed_or(carried, shape)
    whole = hull(shape.mesh)
    if shape.mesh.is_volume and whole.notes["volume_ratio"] <= 1 + _CONVEX_EXCESS:  # type: ignore[operator]
        return whole
    return decompose(shape.mesh)


def _carried(shape: CompletedShape) -> CollisionMesh | None:
    """None where there is no primitive with parts whose vertices these could be."""
    if shape.fit is None:
        return None
    started = time.monotonic()
    vertices = np.asarray(shape.mesh.vertices)
    try:
        primitive = bearer(shape.fit.primitive, len(vertices))
        if not primitive.parts:
            return None
        parts = carry_parts(primitive, vertices)
    except InvalidMesh:  # of another connectivity, or flattened: CoACD will say more
        return None
    carrying_s = time.monotonic() - started
    error = union_error_m(parts, shape.mesh, count=1000, rng=np.random.default_rng(0))
    notes = {
        "carrying_s": carrying_s,
        "dropped": len(primitive.parts) - len(parts),
        "volume_ratio": float(sum(map(volume_m3, parts)) / shape.mesh.volume),
    }
    return CollisionMesh(parts, error, "carried", time.monotonic() - started, notes)


def _decomposed_or(carried: CollisionMesh, shape: CompletedShape) -> CollisionMesh:
    """CoACD's parts where they are closer to the mesh than the carried ones."""
    said = f"carried parts miss the mesh by {1e3 * carried.error_m[0]:.1f} mm on average"
    try:
        fresh = decompose(shape.mesh)
    except DecompositionFailed as error:
        warnings.warn(f"{said}, and are kept as CoACD failed: {error}", RuntimeWarning, stacklevel=3)
        return replace(carried, notes={**carried.notes, "warning": said})
    if fresh.error_m[0] < carried.error_m[0]:
        return replace(fresh, notes={**fresh.notes, "carried_error_m": carried.error_m})
    warnings.warn(f"{said}, and are kept as CoACD's miss it by more", RuntimeWarning, stacklevel=3)
    return replace(carried, notes={**carried.notes, "warning": said})
