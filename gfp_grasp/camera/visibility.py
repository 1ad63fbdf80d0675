"""Which of a surface a viewpoint sees."""

from __future__ import annotations

import numpy as np

from gfp_grasp.camera.cast import cast_rays

_LIFT = 1 / 300  # a ray starts this far off its own surface, as a share of the surface's diagonal


def visible_points(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, normals: np.ndarray, viewpoint: np.ndarray
) -> np.ndarray:
    """Points of a mesh's surface that face a viewpoint and that nothing of the mesh hides from it.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), outward.
        points: (n, 3) m, on the surface.
        normals: (n, 3) unit, outward.
        viewpoint: (3,) m, same frame.

    Returns:
        (n,) bool.
    """
    lift_m = _LIFT * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    sight = viewpoint - points
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    facing = np.einsum("ni,ni->n", normals, sight) > 0
    hit, _, _ = cast_rays([(vertices, faces)], points + lift_m * normals + lift_m * sight, sight)
    return facing & ~np.isfinite(hit)
