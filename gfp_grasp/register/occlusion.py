"""What a cloud without its view says of something nearer that hides a part of its object.

Where a surface turns away from the viewpoint, the edge of its cloud is its outline, and beyond it is free space. Where
it faces the viewpoint to its very edge, beyond it may be more of it: behind the edge of a box, a book, another bottle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.register.evidence import Evidence, Silhouette

_FACING_COSINE = 0.5
_PAIRS = 300
_ON_LINE_PX = 1.5
_BEYOND = 0.02  # share of the outline that may lie beyond a straight edge, for noise
_MOST = 0.6
_CONTACT = 0.4  # share of the outline's extent along a straight edge that lies on it
_LOWEST = 0.04  # share of the points that are the lowest seen


def cut_off(evidence: Evidence, *, straight: bool = True) -> Evidence:
    """The evidence of an object of which something nearer hides a part.

    Where a long straight stretch of the outline faces the viewpoint and nothing lies beyond it, that is taken for the
    edge of what hides (`cut`); else every stretch that faces the viewpoint may be one. Beyond it nothing is known of
    free space; and where the lowest points lie on it, nothing of the floor but that it is not higher.

    Args:
        evidence: With a viewpoint and a silhouette that is guessed from the points.
        straight: Look for a straight edge.
    """
    silhouette = evidence.silhouette
    assert silhouette is not None
    assert evidence.viewpoint is not None
    sight = evidence.viewpoint - evidence.points
    facing = np.einsum("ni,ni->n", evidence.normals, sight) / np.linalg.norm(sight, axis=1) > _FACING_COSINE
    column, row, _ = silhouette.pixels(evidence.points)
    seen = np.column_stack([row, column])
    outline = _outline(silhouette)
    line = _straight_edge(outline, facing[KDTree(seen).query(outline)[1]]) if straight else None
    free = np.argwhere(silhouette.free_depth_m > 0)
    if line is None:
        edge = free + silhouette.offset_px[:, free[:, 0], free[:, 1]].T
        unknown = facing[KDTree(seen).query(edge)[1]]
    else:
        normal, offset = line
        unknown = free @ normal > offset - _ON_LINE_PX
    depth = silhouette.free_depth_m.copy()
    depth[free[unknown, 0], free[unknown, 1]] = 0.0
    answer = replace(evidence, silhouette=replace(silhouette, free_depth_m=depth))
    if line is None:
        return answer
    (down, right), offset = line
    cut = np.array([right, down, -offset]) @ silhouette.K @ silhouette.T_camera_world[:3, :3]
    cut /= np.linalg.norm(cut)
    hides_foot = not evidence.floor_seen and _foot_is_on(line, seen, evidence)
    above, below = evidence.floor_sigma_m
    return replace(answer, cut=cut, floor_sigma_m=(above, np.inf if hides_foot else below))


def _outline(silhouette: Silhouette) -> np.ndarray:
    """Pixels (o, 2), row and column, of the object's picture that border on what is not."""
    mask = silhouette.free_depth_m == 0
    return np.argwhere(mask & np.logical_not(ndimage.binary_erosion(mask)))


def _straight_edge(outline: np.ndarray, facing: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Outward normal (2,) and offset of the line that most of the facing outline lies on, with all of it inside."""
    candidates = outline[facing].astype(np.float64)
    if len(candidates) < 8:
        return None
    rng = np.random.default_rng(0)
    a, b = candidates[rng.integers(len(candidates), size=(2, _PAIRS))]
    along = b - a
    length = np.linalg.norm(along, axis=1)
    sound = length > 4
    along, a = along[sound] / length[sound, None], a[sound]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    normals = np.concatenate([normals, -normals])
    offsets = np.einsum("pi,pi->p", normals, np.concatenate([a, a]))
    beyond = (outline @ normals.T > offsets + _ON_LINE_PX).mean(axis=0)
    on = np.abs(candidates @ normals.T - offsets) < _ON_LINE_PX
    # The side of a slim bottle is straight too, and a few normals next to it are wrong: most of the line must face.
    all_on = (np.abs(outline @ normals.T - offsets) < _ON_LINE_PX).sum(axis=0)
    score = np.where((beyond < _BEYOND) & (on.sum(axis=0) > _MOST * all_on), on.sum(axis=0), 0)
    best = int(np.argmax(score))
    normal = normals[best]
    across = np.array([-normal[1], normal[0]])
    stretch = candidates[on[:, best]] @ across
    if score[best] < 8 or np.ptp(np.quantile(stretch, [0.02, 0.98])) < _CONTACT * np.ptp(outline @ across):
        return None
    return normal, float(offsets[best])


def _foot_is_on(line: tuple[np.ndarray, float], seen: np.ndarray, evidence: Evidence) -> bool:
    normal, offset = line
    heights = evidence.points @ evidence.up
    lowest = seen[heights <= np.quantile(heights, _LOWEST)]
    return bool((lowest @ normal > offset - 4 * _ON_LINE_PX).mean() > 0.5)
