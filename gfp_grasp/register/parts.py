"""Whether the points show an optional part of a fitted primitive, as a handle is one."""

from __future__ import annotations

from scipy.spatial import KDTree

from gfp_grasp.register.surface import primitive_size_m, surface_samples
from gfp_grasp.types import FittedPrimitive, LevelView

# A part is believed when this many of the thinned points lie on it and stand off the rest by more than noise: within
# and beyond these shares of the primitive's size.
_PART_POINTS = 6
_OFF_REST = 0.051
_ON_PART = 0.081


def part_is_seen(fit: FittedPrimitive, part: str, evidence: LevelView) -> bool:
    """Whether points support an optional part of the fit: they lie near it, and away from the rest of the body."""
    samples, size_m = surface_samples(fit.primitive), primitive_size_m(fit.primitive)
    local = samples.local(fit.coefficients) * fit.scale
    world = local @ fit.T_world_object[:3, :3].T + fit.T_world_object[:3, 3]
    on_part = fit.primitive.on_region(part)[fit.primitive.faces[samples.face]].all(axis=1)
    if not on_part.any() or on_part.all():
        return False
    to_part = KDTree(world[on_part]).query(evidence.points)[0]
    to_rest = KDTree(world[~on_part]).query(evidence.points)[0]
    return int(((to_part < _ON_PART * size_m) & (to_rest > _OFF_REST * size_m)).sum()) >= _PART_POINTS
