"""Collision parts of a completed shape, by the cheapest way that is true to it."""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
import trimesh

from gfp_grasp.collision.config import CollisionConfig, DecomposeConfig
from gfp_grasp.collision.convex import convex_part, farthest_corners
from gfp_grasp.collision.cutting import quick_parts
from gfp_grasp.collision.decomposition import decompose, hull
from gfp_grasp.collision.deformed import bind_parts, deform_parts, matching_primitive
from gfp_grasp.collision.fidelity import (
    LEAST_BALL,
    ball_radii_m,
    barycentric_hold,
    union_error_m,
    volume_ratios,
    widest_gap,
)
from gfp_grasp.collision.parts import PartFaces, diagonal_m, volume_m3
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.meshes import enclosed_m3
from gfp_grasp.types import CollisionMesh, CompletedShape, GenericPrimitive

# CoACD is worth its time where the mean error of deformed parts exceeds this share of the diagonal. A mug's parts that
# follow a bulge of a fifth of its radius stay below 0.01.
_ERROR_LIMIT = 0.01
# The largest ball that fits into the mesh must fit between the parts with at least this share of its radius.
_CLEARANCE_LEFT = 0.8
# The hull of a convex mesh adds nothing but rounding to its volume.
_CONVEX_EXCESS = 1e-3
# Parts that bring the template's surface nearer by less than this share of its diagonal, on average and for 95 %, are
# not worth their time; on a template of 0.2 m, these are 0.01 mm and 0.1 mm.
_NEXT_TO_NOTHING = np.array([1 / 20_000, 1 / 2000])
_SAMPLES = 300
_NAMES = {"coacd": "CoACD", "cuts": "cutting"}
# Centre of the largest ball in a primitive without a stored binding; None where there is none.
_gaps: WeakKeyDictionary[GenericPrimitive, np.ndarray | None] = WeakKeyDictionary()


def collision_of(shape: CompletedShape, *, config: CollisionConfig = CollisionConfig()) -> CollisionMesh:
    """Convex parts of a completed shape, within a budget.

    Where the mesh has the vertices of its primitive or of a variant, the primitive's parts are deformed with it. A
    convex mesh is its own hull. For any other mesh the config's engine runs, as a rule CoACD. It also runs where
    deformed parts miss their bound, which is the config's tolerance, or else 1 % of the diagonal on average; and four
    fifths of the ball that fits into a hollow mesh must fit between the parts. If the engine's parts miss the bound
    too, the better parts of the two are returned, with a warning that tells the figures.

    Args:
        shape: The completed shape; its mesh may be in any frame, and the parts come in the same frame.
        config: The budget.

    Returns:
        The parts with their two-sided error. The `notes` of deformed parts hold level (number of parts before slivers
        were dropped), deforming_s, dropped (slivers), volume_ratio and union_volume_ratio (volume of the parts over the
        mesh's, where overlaps count each time or once), and for a hollow mesh ball_m and ball_left_m (radius of the
        largest ball that fits into the mesh, and of the one that fits between the parts at the same place). CoACD's
        parts that replace deformed ones have the ball in their notes as well.

    Raises:
        InvalidMesh: The mesh is flat or too small for MuJoCo.
        DecompositionFailed: CoACD had to run, and was lost in every attempt.
    """
    if config.engine == "auto":
        config = replace(config, engine="cuts" if shape.made_by in ("classfree", "peer") else "coacd")
    deformed = _deformed(shape, config)
    if deformed is not None:
        return deformed if _is_true(deformed, shape, config) else _decomposed_or(deformed, shape, config)
    if _is_convex(shape.mesh):
        found = hull(shape.mesh, max_vertices=config.max_vertices_per_part)
    else:
        found = _split(shape.mesh, config)
    return found if _is_true(found, shape, config) else _with_warning(found, "more parts or vertices are needed")


def _split(mesh: trimesh.Trimesh, config: CollisionConfig) -> CollisionMesh:
    """Parts of any mesh by the config's engine."""
    return quick_parts(mesh, config=config) if config.engine == "cuts" else decompose(mesh, config=_as_coacd(config))


def _is_convex(mesh: trimesh.Trimesh) -> bool:
    most_m3 = (1 + _CONVEX_EXCESS) * enclosed_m3(mesh)
    if not most_m3:
        return False
    vertices = np.asarray(mesh.vertices)
    # The hull of a few of the vertices is most often too large already, and takes a tenth of the time.
    few = convex_part(vertices[farthest_corners(vertices)])
    if few is not None and volume_m3(few) > most_m3:
        return False
    whole = convex_part(vertices)
    return whole is not None and volume_m3(whole) <= most_m3


def _deformed(shape: CompletedShape, config: CollisionConfig) -> CollisionMesh | None:
    """The primitive's parts deformed with the shape; None where no primitive with parts has the mesh's vertices."""
    if shape.fit is None:
        return None
    vertices = np.asarray(shape.mesh.vertices)
    try:
        primitive = matching_primitive(shape.fit.primitive, len(vertices))
    except InvalidMesh:  # of another connectivity: CoACD will say more
        return None
    if not primitive.parts:
        return None
    started = time.monotonic()
    found = None
    for level in _levels(primitive, vertices, config):
        try:
            found = _measured(primitive, shape.mesh, level, config)
        except InvalidMesh:  # flattened
            return None
        if config.tolerance_m is None or _is_true(found, shape, config):
            break
    assert found is not None
    return replace(found, seconds=time.monotonic() - started)


def _levels(primitive: GenericPrimitive, vertices: np.ndarray, config: CollisionConfig) -> list[int]:
    """Numbers of parts to try, fewest first."""
    most = min(config.max_parts, len(primitive.parts))
    errors_m = primitive.part_errors_m
    if len(errors_m) != len(primitive.parts):
        return [most]
    if config.tolerance_m is None:
        enough_m = errors_m[most - 1] + _NEXT_TO_NOTHING * diagonal_m(primitive.vertices)
        worse = np.flatnonzero((errors_m[:most] > enough_m).any(axis=1))
        return [int(worse[-1]) + 2 if len(worse) else 1]
    # The error of a level grows with the shape.
    growth = diagonal_m(vertices) / diagonal_m(primitive.vertices)
    enough = np.flatnonzero(errors_m[:most, 1] * growth <= config.tolerance_m)
    tried = [1 + int(enough[0])] if len(enough) else [most]
    while tried[-1] < most:
        tried.append(min(most, tried[-1] + max(1, tried[-1] // 2)))
    return tried


def _measured(primitive: GenericPrimitive, mesh: trimesh.Trimesh, level: int, config: CollisionConfig) -> CollisionMesh:
    started = time.monotonic()
    parts = deform_parts(primitive, mesh.vertices, count=level, max_vertices=config.max_vertices_per_part)
    deforming_s = time.monotonic() - started
    rng = np.random.default_rng(0)
    faces = PartFaces.of(parts)
    ratio, union_ratio = volume_ratios(faces, mesh, count=_SAMPLES, rng=rng)
    notes: dict[str, object] = {
        "level": level,
        "deforming_s": deforming_s,
        "dropped": level - len(parts),
        "volume_ratio": ratio,
        "union_volume_ratio": union_ratio,
    }
    notes |= _ball(primitive, mesh, faces)
    error = union_error_m(faces, mesh, count=_SAMPLES, rng=rng)
    return CollisionMesh(parts, error, "carried", time.monotonic() - started, notes)


def _ball(primitive: GenericPrimitive, mesh: trimesh.Trimesh, faces: PartFaces) -> dict[str, object]:
    """Notes of the ball that fits into a completed primitive; none where the primitive is not hollow."""
    gap_m = _gap_m(primitive)
    if gap_m is None:
        return {}
    holders, weights = barycentric_hold(gap_m, primitive.vertices)
    free, left = ball_radii_m(weights @ mesh.vertices[holders], mesh, faces)
    return {"ball_m": free, "ball_left_m": left} if free > LEAST_BALL * diagonal_m(primitive.vertices) else {}


def _gap_m(primitive: GenericPrimitive) -> np.ndarray | None:
    if primitive.binding is not None:
        return primitive.binding.gap_m
    if primitive not in _gaps:
        _gaps[primitive] = widest_gap(trimesh.Trimesh(primitive.vertices, primitive.faces, process=False))
    return _gaps[primitive]


def with_binding(primitive: GenericPrimitive) -> GenericPrimitive:
    """A primitive, if it has parts, with the binding of the level taken by default; its variants stay as they are."""
    if not primitive.parts:
        return replace(primitive, binding=None)
    (level,) = _levels(primitive, primitive.vertices, CollisionConfig())
    return replace(primitive, binding=bind_parts(primitive, level, gap_m=_gap_m(primitive)))


def _is_true(found: CollisionMesh, shape: CompletedShape, config: CollisionConfig) -> bool:
    if _clearance(found) < _CLEARANCE_LEFT:
        return False
    if config.tolerance_m is not None:
        return found.error_m[1] <= config.tolerance_m
    if found.made_by == "coacd" and shape.fit is None:  # nothing else was asked of it
        return True
    return found.error_m[0] <= _ERROR_LIMIT * diagonal_m(shape.mesh.vertices)


def _clearance(found: CollisionMesh) -> float:
    """Share of the ball in the mesh that fits between the parts; 1 where there is none."""
    notes = found.notes
    return float(notes["ball_left_m"] / notes["ball_m"]) if "ball_m" in notes else 1.0  # type: ignore[operator]


def _decomposed_or(deformed: CollisionMesh, shape: CompletedShape, config: CollisionConfig) -> CollisionMesh:
    """CoACD's parts where they are nearer to the mesh than the deformed ones; else the deformed ones."""
    assert shape.fit is not None
    try:
        fresh = _split(shape.mesh, config)
    except (DecompositionFailed, InvalidMesh) as error:
        return _with_warning(deformed, f"they are kept, as {_NAMES[config.engine]} failed: {error}")
    primitive = matching_primitive(shape.fit.primitive, len(shape.mesh.vertices))
    ball = _ball(primitive, shape.mesh, PartFaces.of(fresh.parts))
    fresh = replace(fresh, notes={**fresh.notes, **ball, "deformed_error_m": deformed.error_m})
    if _is_true(fresh, shape, config):
        return fresh
    hollow = [_clearance(found) >= _CLEARANCE_LEFT for found in (fresh, deformed)]
    if hollow[0] != hollow[1]:
        better, other = (fresh, deformed) if hollow[0] else (deformed, fresh)
    else:
        better, other = sorted((fresh, deformed), key=lambda found: found.error_m[0])
    return _with_warning(better, f"{_said(other)}; more parts, or a larger tolerance, are needed")


def _with_warning(found: CollisionMesh, more: str) -> CollisionMesh:
    said = f"{_said(found)}; {more}"
    warnings.warn(said, RuntimeWarning, stacklevel=4)
    return replace(found, notes={**found.notes, "warning": said})


def _said(found: CollisionMesh) -> str:
    num = len(found.parts)
    whose = {"carried": "deformed parts", "hull": "the hull", "cuts": f"{num} parts by plane cuts"}
    whose = whose.get(found.made_by, f"CoACD's {num} parts")
    mean, high = (f"{1e3 * error:.1f} mm" for error in found.error_m[:2])
    left = _clearance(found)
    ball = "" if left >= _CLEARANCE_LEFT else f", and leave {left:.0%} of the ball that fits inside"
    return f"{whose} miss the mesh by {mean} on average, {high} for 95 %{ball}"


def _as_coacd(config: CollisionConfig) -> DecomposeConfig:
    most = config.max_vertices_per_part
    limits = {} if most is None else {"decimate": True, "max_ch_vertex": most}
    return DecomposeConfig(max_convex_hull=config.max_parts, **limits)
