"""Questions to a finished fit."""

from __future__ import annotations

from scipy.spatial import KDTree

from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.surface import surface_samples
from gfp_grasp.types import HANDLE, FittedPrimitive

# A handle is believed when this many of the thinned points lie on it and stand off the body by more than noise.
_HANDLE_POINTS = 6
_OFF_BODY_M = 0.005
_ON_HANDLE_M = 0.008


def handle_is_seen(fit: FittedPrimitive, evidence: Evidence) -> bool:
    """Whether points support the fit's handle: near it, and away from the body."""
    samples = surface_samples(fit.primitive)
    local = samples.local(fit.coefficients) * fit.scale
    world = local @ fit.T_world_object[:3, :3].T + fit.T_world_object[:3, 3]
    region = fit.primitive.regions[fit.primitive.faces[samples.face]]
    on_handle = (region == HANDLE).all(axis=1)
    if not on_handle.any() or on_handle.all():
        return False
    to_handle = KDTree(world[on_handle]).query(evidence.points)[0]
    to_body = KDTree(world[~on_handle]).query(evidence.points)[0]
    return int(((to_handle < _ON_HANDLE_M) & (to_body > _OFF_BODY_M)).sum()) >= _HANDLE_POINTS
