"""What hides what: a surface that hides points which were seen, and an occluder that hides a part of the object.

A cloud without its view may tell of an occluder. Where a surface turns away from the viewpoint, the edge of its cloud
is its outline, and beyond it is free space. Where it faces the viewpoint to its very edge, it may go on beyond the
edge: behind a box, a book, another bottle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.camera import cast_rays
from gfp_grasp.meshes import triangle_normals
from gfp_grasp.register.config import RefineConfig
from gfp_grasp.register.state import PoseShape
from gfp_grasp.types import DepthImage, GenericPrimitive, LevelView, Silhouette

# A surface is in front of a point when it is nearer by this share of the unit: noise and misfit of the modes are less.
_HIDDEN = 0.125
_NUM_SIGHTS = 120  # lines of sight along which a surface is looked for
# A share of what an occluder cuts off is out of sight; ours, not measured: less than a seventh seldom is.
_TRUNCATED_SHARE = 0.15
_TRUNCATION_COST = 30.0
_FACING_COSINE = 0.5  # from which on a surface faces the viewpoint
_PAIRS = 300
_ON_LINE_PX = 1.5
_BEYOND = 0.02  # share of the outline that may lie beyond a straight edge, for noise
_CONTACT = 0.4  # share of the outline's extent along what is beside something nearer that lies on it


class _Edge(NamedTuple):
    """What a straight edge of an occluder is known by: how much the surface beside it faces the viewpoint (cosine),
    for which share of the outline on it, and which share of the outline's extent along it lies on it.
    """

    facing: float
    share: float
    contact: float


# First what few outlines have of themselves; then what a surface seen at a slant, or a narrow one, leaves of an edge.
EDGES: Mapping[str, _Edge] = {"clear": _Edge(0.5, 0.6, 0.4), "faint": _Edge(0.3, 0.4, 0.3)}
_LEAST_EDGE_PX = 8  # pixels beside the object that see something nearer
_BEYOND_OCCLUDER = 0.1  # share of the object that may lie beyond an end that is hidden: edges are not straight
_LOWEST = 0.04  # share of the points that count as the lowest seen


def cut_off(evidence: LevelView, *, edge: str | None = "clear") -> LevelView:
    """The evidence of an object, a part of which is hidden by something nearer.

    Where a long straight stretch of the outline faces the viewpoint and nothing lies beyond it, that stretch is taken
    for the edge of the occluder (`cut`); otherwise every stretch that faces the viewpoint may be one. Beyond the edge
    nothing is known of free space; and where the lowest points lie on it, the floor may be anywhere below them.

    Args:
        evidence: With a viewpoint and a silhouette that is guessed from the points.
        edge: Look for a straight edge as EDGES has it; None takes every stretch that faces the viewpoint for one.
    """
    silhouette = evidence.silhouette
    assert silhouette is not None
    assert evidence.viewpoint is not None
    sight = evidence.viewpoint - evidence.points
    cosine = np.einsum("ni,ni->n", evidence.normals, sight) / np.linalg.norm(sight, axis=1)
    seen = silhouette.pixel_of(evidence.points)[:, ::-1]  # row, column
    outline = _outline(silhouette)
    line = None
    if edge is not None:
        facing = cosine[KDTree(seen).query(outline)[1]] > EDGES[edge].facing
        line = _straight_edge(outline, facing, EDGES[edge])
    free = np.argwhere(silhouette.free_range_m > 0)
    if line is None:
        beside = free + silhouette.offset_px[:, free[:, 0], free[:, 1]].T
        unknown = cosine[KDTree(seen).query(beside)[1]] > _FACING_COSINE
    else:
        normal, offset = line
        unknown = free @ normal > offset - _ON_LINE_PX
    free_range = silhouette.free_range_m.copy()
    free_range[free[unknown, 0], free[unknown, 1]] = 0.0
    answer = replace(evidence, silhouette=replace(silhouette, free_range_m=free_range))
    if line is None:
        return answer
    assert isinstance(silhouette.view, DepthImage)  # as every silhouette is that is guessed from points
    cut = _plane_of(line, silhouette.view)
    hides_foot = not evidence.floor_seen and _foot_is_on(line, seen, evidence)
    above, below = evidence.floor_sigma_m
    return replace(answer, cut=cut, floor_sigma_m=(above, np.inf if hides_foot else below))


def is_cut_off(evidence: LevelView) -> bool:
    """Whether something nearer hides an end of the object.

    The view shows it; or, where the silhouette is guessed, a clear straight edge of the points does. Without silhouette
    or viewpoint it is so where the evidence has a `cut`.

    Args:
        evidence: One object, in its level frame.
    """
    if evidence.silhouette is None or evidence.viewpoint is None:
        return evidence.cut is not None
    seen = behind_occluder(evidence) if evidence.silhouette.certain else cut_off(evidence)
    return seen.cut is not None


def behind_occluder(evidence: LevelView) -> LevelView:
    """The evidence with its `cut`, where the view shows something nearer along one end of the object; else itself.

    Args:
        evidence: With a silhouette of a real view.
    """
    silhouette = evidence.silhouette
    assert silhouette is not None
    if evidence.viewpoint is None or not isinstance(silhouette.view, DepthImage):
        return evidence
    own = ~silhouette.offset_px.any(axis=0)
    beside = np.argwhere(np.logical_and(ndimage.binary_dilation(own, np.ones((3, 3))), ~own))
    nearest = beside + silhouette.offset_px[:, beside[:, 0], beside[:, 1]].T.astype(np.int64)
    ranges_m = silhouette.view.free_range_m
    there_m = ranges_m[beside[:, 0], beside[:, 1]]
    nearer = (there_m > 0) & (there_m < ranges_m[nearest[:, 0], nearest[:, 1]] - silhouette.margin_m)
    if nearer.sum() < _LEAST_EDGE_PX:
        return evidence
    edge, body = nearest[nearer].astype(np.float64), np.argwhere(own)
    across, normal = np.linalg.eigh(np.cov(edge.T))[1].T[::-1]
    normal = normal * (np.sign(normal @ (edge.mean(axis=0) - body.mean(axis=0))) or 1.0)
    offset = float(np.median(edge @ normal))
    beyond = (body @ normal > offset + _ON_LINE_PX).mean()
    stretch = np.ptp(np.quantile(edge @ across, [0.02, 0.98]))
    if beyond > _BEYOND_OCCLUDER or stretch < _CONTACT * np.ptp(body @ across):
        return evidence
    return replace(evidence, cut=_plane_of((normal, offset), silhouette.view))


def _plane_of(line: tuple[np.ndarray, float], view: DepthImage) -> np.ndarray:
    """Normal (3,) of the plane through the viewpoint and a line of the picture, by its outward normal and offset."""
    (down, right), offset = line
    cut = np.array([right, down, -offset]) @ view.K @ view.T_world_camera[:3, :3].T
    return cut / np.linalg.norm(cut)


def _outline(silhouette: Silhouette) -> np.ndarray:
    """Pixels (o, 2), row and column, of the object that have a neighbour outside the object."""
    mask = silhouette.free_range_m == 0
    return np.argwhere(mask & np.logical_not(ndimage.binary_erosion(mask)))


def _straight_edge(outline: np.ndarray, facing: np.ndarray, edge: _Edge) -> tuple[np.ndarray, float] | None:
    """Outward normal (2,) and offset of the line on which most of the facing outline lies, with the rest inside it."""
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
    # The side of a slim bottle is straight, too, and a few normals beside it are wrong: most of the line must face.
    all_on = (np.abs(outline @ normals.T - offsets) < _ON_LINE_PX).sum(axis=0)
    score = np.where((beyond < _BEYOND) & (on.sum(axis=0) > edge.share * all_on), on.sum(axis=0), 0)
    best = int(np.argmax(score))
    normal = normals[best]
    across = np.array([-normal[1], normal[0]])
    stretch = candidates[on[:, best]] @ across
    if score[best] < 8 or np.ptp(np.quantile(stretch, [0.02, 0.98])) < edge.contact * np.ptp(outline @ across):
        return None
    return normal, float(offsets[best])


def _foot_is_on(line: tuple[np.ndarray, float], seen: np.ndarray, evidence: LevelView) -> bool:
    normal, offset = line
    heights = evidence.points @ evidence.up
    lowest = seen[heights <= np.quantile(heights, _LOWEST)]
    return bool((lowest @ normal > offset - 4 * _ON_LINE_PX).mean() > 0.5)


def blocking_cost(state: PoseShape, primitive: GenericPrimitive, evidence: LevelView, config: RefineConfig) -> float:
    """Cost of a surface that stands between the viewpoint and what was seen from there.

    Without it a cup's inside fits the inside of the same cup turned over, whose bottom hides it. A hidden point counts
    as one that the surface does not explain.
    """
    evidence = evidence.few(_NUM_SIGHTS)
    if evidence.viewpoint is None:
        return 0.0
    sight = evidence.points - evidence.viewpoint
    vertices = _vertices(state, primitive)
    faces = primitive.faces[_faces_toward(vertices, primitive.faces, evidence.viewpoint)]
    distance, _, _ = cast_rays([(vertices, faces)], evidence.viewpoint, sight)
    length, unit_m = np.linalg.norm(sight, axis=1), config.unit_of(primitive)
    blocked = float((distance * length < length - _HIDDEN * unit_m).mean())
    robust_m, sigma_m = config.steps[-1] * unit_m, np.hypot(evidence.sigma_m, config.misfit * unit_m)
    return 0.5 * config.effective_points * blocked * float((robust_m / sigma_m) ** 2)


def _faces_toward(vertices: np.ndarray, faces: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    """(f,) bool: the faces turned to the viewpoint, one of which a ray from outside a closed surface hits first."""
    triangles = vertices[faces]
    return np.einsum("fi,fi->f", triangle_normals(triangles), viewpoint - triangles[:, 0]) > 0


def truncation_cost(state: PoseShape, primitive: GenericPrimitive, evidence: LevelView) -> float:
    """Cost of a surface that ends where an occluder hides how it goes on."""
    if evidence.cut is None:
        return 0.0
    beyond = float(((_vertices(state, primitive) - evidence.viewpoint) @ evidence.cut > 0).mean())
    return _TRUNCATION_COST * max(0.0, 1.0 - beyond / _TRUNCATED_SHARE)


def _vertices(state: PoseShape, primitive: GenericPrimitive) -> np.ndarray:
    """Vertices (v, 3) m, world, of a primitive in a state."""
    return state.world(primitive.shape(state.coefficients, np.ones(3)))
