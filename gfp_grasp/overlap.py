"""Completed objects of one scene that do not cut into each other: what was guessed gives way before what was seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, KDTree, QhullError
from sklearn.svm import LinearSVC

from gfp_grasp.deform import stand_on
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import CompletedShape

_ALLOWED_M = 0.0005  # that two surfaces may overlap by
_CLEARANCE_M = 0.0001  # that is left between them
_WITHIN_M = 0.001  # so far within one surface is within the other, too, where two lie in the same place
_NEAR_M = 0.02  # convex parts reach so far beyond the surface that they stand for
_SEEN_WEIGHT = 1000.0  # of a seen vertex against a guessed one
_MOST_SEEN_M = 0.01  # that a seen surface is moved by, or the overlap: one thing in another is left as it is
_NESTED = 0.8  # share of an object's vertices within another from which on it is one thing within another
_SAME_NORMAL = 5  # digits to which the faces of a hull are one side of it
_LEVEL = 0.9  # cosine between up and the normal of a plane that things stand on
_LEANING = 0.6  # cosine from which on a plane is rather level than upright
_RAISED = 8.0  # in multiples of the noise: what stands so high above the support stands on another object,
_ABOUT = 10.0  # and so far about its foot, whose surface it meets;
_LIFTED = 25.0  # the top of that, where nobody saw it, comes up by so much at most
_FACES_UP = 0.3  # z of the normal of a vertex that can carry something
_MUCH_BETTER = 9.0  # times less cut off, as a sum of squares


@dataclass(frozen=True)
class GaveWay:
    """One object was cut back where it reached into another, or could not be.

    Attributes:
        index: The object, by its place in the scene.
        other: What it reached into.
        depth_m: How far its surface was moved at most; where it was not, how far it reaches into the other.
        seen_m: How far a vertex of it that had been seen was moved at most.
        moved: Whether it was cut back; one thing within another cannot be.
    """

    index: int
    other: int
    depth_m: float
    seen_m: float
    moved: bool


@dataclass(frozen=True, eq=False)
class Apart:
    """Shapes that no longer overlap.

    Attributes:
        shapes: The shapes, in the order in which they came.
        bounds: (k, 4) half-spaces for each shape, unit normal and offset: it lies where normal @ x <= offset.
        gave_way: What was changed, or could not be.
    """

    shapes: list[CompletedShape]
    bounds: list[np.ndarray]
    gave_way: list[GaveWay]


def make_way(
    shapes: Sequence[CompletedShape], *, up: np.ndarray, floors_m: Sequence[float | None], sigma_m: float
) -> Apart:
    """Shapes of one frame that do not overlap.

    Two that overlap are parted by a plane, one side of either hull or one between the two, that moves least of what was
    seen, and after it least of the rest; whatever lies beyond it is put into it. What is cut off from above stands on
    the plane then, as on a floor. Where what was seen would move by more than 10 mm and by more than the overlap, or
    where nearly all of an object is within the other or beyond the plane, both stay. What nobody saw of an object
    comes up to the foot of what it carries. Meshes keep their connectivity.

    Args:
        shapes: Completed shapes.
        up: (3,) unit.
        floors_m: Height along up of what each shape stands on, another shape or the lowest of all; None where unknown.
        sigma_m: The sensor's noise.
    """
    vertices = [np.array(shape.mesh.vertices) for shape in shapes]
    known = [height for height in floors_m if height is not None]
    floor_m = min(known) if known else None
    bounds: list[list[np.ndarray]] = [[] if floor_m is None else [np.append(-up, -floor_m)] for _ in shapes]
    level = rotation_between((0.0, 0.0, 1.0), up)
    floors: dict[int, float] = {}
    given: list[GaveWay] = []
    for a, b in combinations(range(len(shapes)), 2):
        if not _near(vertices[a], vertices[b]):
            continue
        depth_m, share = _overlap(vertices[a], shapes[a].mesh.faces, vertices[b], shapes[b].mesh.faces)
        stacked = None
        if floor_m is not None:
            stacked = _meeting(vertices[a] @ level, vertices[b] @ level, floors_m[a], floors_m[b], floor_m, sigma_m)
        if stacked is not None:
            normal, offset = (up, stacked[1]) if stacked[0] else (-up, -stacked[1])
            depth_m = max(depth_m, 2 * _ALLOWED_M)
        else:
            normal, offset = _parting_plane(vertices[a], shapes[a].observed, vertices[b], shapes[b].observed, up)
        sides = ((a, b, normal, offset - _CLEARANCE_M / 2), (b, a, -normal, -offset - _CLEARANCE_M / 2))
        steps = [np.maximum(vertices[k] @ n - d, 0.0) for k, _, n, d in sides]
        if depth_m <= _ALLOWED_M and max(step.max() for step in steps) > _CLEARANCE_M:
            continue  # one reaches round the other
        seen_m = [float(step[shapes[k].observed].max(initial=0.0)) for step, (k, *_) in zip(steps, sides, strict=True)]
        flat = any(step.min() > 0.0 for step in steps)  # all of one lies beyond the plane
        if flat or share > _NESTED or max(seen_m) > max(_MOST_SEEN_M, depth_m):
            given.append(GaveWay(a, b, depth_m, 0.0, moved=False))
            continue
        for step, seen, (k, other, n, d) in zip(steps, seen_m, sides, strict=True):
            vertices[k] -= step[:, None] * n
            bounds[k].append(np.append(n, d))
            if step.max() > _ALLOWED_M:
                given.append(GaveWay(k, other, float(step.max()), seen, moved=True))
                if n @ up < -_LEVEL:
                    floors[k] = max(floors.get(k, -np.inf), float((vertices[k][step > 0] @ up).max()))
    changed = {way.index for way in given if way.moved}
    for k in changed:
        height_m = floors.get(k, floors_m[k])
        if height_m is not None:
            own, faces = vertices[k] @ level, shapes[k].mesh.faces
            lowest_m = float(own[:, 2].min())
            height_m = height_m if lowest_m < height_m + sigma_m else lowest_m  # another object carries it
            vertices[k] = stand_on(own, faces, height_m, sigma_m=sigma_m, turn=False) @ level.T
    if floor_m is not None:
        for k, other in permutations(range(len(shapes)), 2):
            lifted = _carrying(vertices[other] @ level, shapes[other], vertices[k] @ level, floor_m, sigma_m)
            if lifted is not None:
                vertices[other] = lifted @ level.T
                changed.add(other)
    return Apart(
        [_with_vertices(s, vertices[k]) if k in changed else s for k, s in enumerate(shapes)],
        [np.array(own).reshape(-1, 4) for own in bounds],
        given,
    )


def _meeting(
    a: np.ndarray, b: np.ndarray, floor_a: float | None, floor_b: float | None, floor_m: float, sigma_m: float
) -> tuple[bool, float] | None:
    """Whether b stands on a (else a on b), and the height at which they meet; None where neither stands on the other.

    Args:
        a: (n, 3) m, z up, vertices of a shape.
        b: (m, 3) m of the other.
        floor_a: Height of what the first stands on, m.
        floor_b: Height of what the other stands on, m.
        floor_m: Height of the support of all.
        sigma_m: The sensor's noise.
    """
    for b_above, high, low, foot_m in ((True, b, a, floor_b), (False, a, b, floor_a)):
        near_m = _RAISED * sigma_m
        if foot_m is None or foot_m < floor_m + near_m or abs(float(low[:, 2].max()) - foot_m) > near_m:
            continue
        beyond_m = _beyond_foot_m(low[low[:, 2] > foot_m - near_m], high, foot_m + near_m)
        if beyond_m is not None and beyond_m.min(initial=np.inf) <= 0.0:
            return b_above, foot_m
    return None


def _beyond_foot_m(points: np.ndarray, above: np.ndarray, highest_m: float) -> np.ndarray | None:
    """(n,) m, how far points (n, 3) are beyond the outline of what is lower than a height; None where that is flat."""
    try:
        hull = ConvexHull(above[above[:, 2] < highest_m, :2])
    except (QhullError, ValueError):  # a line, or a point
        return None
    return (points[:, :2] @ hull.equations[:, :2].T + hull.equations[:, 2]).max(axis=1)


def _carrying(
    vertices: np.ndarray, shape: CompletedShape, above: np.ndarray, floor_m: float, sigma_m: float
) -> np.ndarray | None:
    """Vertices (v, 3), z up, of a shape with its unseen top at the foot of what stands on it; None where nothing does.

    Args:
        vertices: (v, 3) m of the shape.
        shape: Says what of it was seen.
        above: (n, 3) m, vertices of what may stand on it.
        floor_m: z of the support of all.
        sigma_m: The sensor's noise.
    """
    foot_m = float(above[:, 2].min())
    if foot_m < floor_m + _RAISED * sigma_m:
        return None
    beyond_m = _beyond_foot_m(vertices, above, foot_m + _CLEARANCE_M)
    if beyond_m is None:
        return None
    up = vertex_normals(vertices, shape.mesh.faces)[:, 2] > _FACES_UP
    gap_m = foot_m - vertices[:, 2]
    about = up & (beyond_m <= _ABOUT * sigma_m)
    if not about.any() or not -_ALLOWED_M < gap_m[about].min() < _RAISED * sigma_m:
        return None
    under = up & (beyond_m <= 0.0)
    low = under & ~shape.observed & (gap_m > _CLEARANCE_M) & (gap_m < _LIFTED * sigma_m)
    if not low.any():
        return None
    lifted = vertices.copy()
    lifted[low, 2] = foot_m - _CLEARANCE_M / 2
    return lifted


def _near(a: np.ndarray, b: np.ndarray) -> bool:
    low, high = np.maximum(a.min(axis=0), b.min(axis=0)), np.minimum(a.max(axis=0), b.max(axis=0))
    return bool((high - low).min() > -_NEAR_M)


def _overlap(a: np.ndarray, faces_a: np.ndarray, b: np.ndarray, faces_b: np.ndarray) -> tuple[float, float]:
    """How deep two closed surfaces reach into each other, m, and the larger share of the vertices of one in the other.

    Asked are the vertices and what lies a little within them.
    """
    deep_a, deep_b = (np.vstack([v, v - _WITHIN_M * vertex_normals(v, f)]) for v, f in ((a, faces_a), (b, faces_b)))
    depths = _depths_m(deep_a, b, faces_b), _depths_m(deep_b, a, faces_a)
    shares = [float((depth[len(depth) // 2 :] > 0).mean()) for depth in depths]
    return max(float(depth.max()) for depth in depths), max(shares)


def _depths_m(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How deep each point (n,) lies within a closed surface, m, by the vertex nearest to it; 0 outside of its box."""
    inside = ((points >= vertices.min(axis=0)) & (points <= vertices.max(axis=0))).all(axis=1)
    depths = np.zeros(len(points))
    if inside.any():
        nearest = KDTree(vertices).query(points[inside])[1]
        normals = vertex_normals(vertices, faces)[nearest]
        depths[inside] = np.maximum(np.einsum("ni,ni->n", vertices[nearest] - points[inside], normals), 0.0)
    return depths


def _parting_plane(
    a: np.ndarray, seen_a: np.ndarray, b: np.ndarray, seen_b: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, float]:
    """Unit normal (3,) and offset of a plane, a below it and b above, that cuts off little of what was seen."""
    weights = [np.where(seen, _SEEN_WEIGHT, 1.0) / len(seen) for seen in (seen_a, seen_b)]
    best, least = _least_cut(a, b, weights, np.vstack([up, -up]))
    sides = np.vstack([_sides(a), -_sides(b), *([_between(a, b, weights)] if least > 0.0 else [])])
    leaning = np.abs(sides @ up) > _LEANING
    # What stands on another stands on a level plane, unless a leaning one is much better.
    for normals, factor in ((sides[~leaning], 1.0), (sides[leaning], _MUCH_BETTER)):
        if least > 0.0 and len(normals):
            other, cut = _least_cut(a, b, weights, normals)
            if factor * cut < least:
                best, least = other, factor * cut
    return best


def _least_cut(
    a: np.ndarray, b: np.ndarray, weights: list[np.ndarray], normals: np.ndarray
) -> tuple[tuple[np.ndarray, float], float]:
    """Of planes with some normals (n, 3), the one that cuts off least, and the weighted sum of squares cut off."""
    along_a, along_b = a @ normals.T, b @ normals.T
    best, least = (normals[0], 0.0), np.inf
    # Either hull is left whole, or both give way half.
    tops, bottoms = along_a.max(axis=0), along_b.min(axis=0)
    for offsets in (tops, bottoms, (tops + bottoms) / 2):
        cut = weights[0] @ np.maximum(along_a - offsets, 0.0) ** 2
        cut += weights[1] @ np.maximum(offsets - along_b, 0.0) ** 2
        k = int(cut.argmin())
        if cut[k] < least:
            best, least = (normals[k], float(offsets[k])), float(cut[k])
    return best, least


def _sides(points: np.ndarray) -> np.ndarray:
    """Outward unit normals (n, 3) of the hull of points; none where they are flat."""
    try:
        normals = ConvexHull(points).equations[:, :3]
    except QhullError:  # flat
        return np.empty((0, 3))
    return normals[np.unique(normals.round(_SAME_NORMAL), axis=0, return_index=True)[1]]


def _between(a: np.ndarray, b: np.ndarray, weights: list[np.ndarray]) -> np.ndarray:
    """Unit normal (1, 3) of the plane that a linear classifier lays between two sets of points, or none (0, 3)."""
    points = np.vstack([a, b])
    size = float(points.std())
    labels = np.repeat([0, 1], [len(a), len(b)])
    machine = LinearSVC(dual="auto", C=1e3, random_state=0)
    normal = machine.fit((points - points.mean(axis=0)) / size, labels, sample_weight=np.concatenate(weights)).coef_
    length = np.linalg.norm(normal)
    return normal / length if length > 0.0 else normal[:0]  # two sets in the same place


def _with_vertices(shape: CompletedShape, vertices: np.ndarray) -> CompletedShape:
    return replace(shape, mesh=trimesh.Trimesh(vertices, shape.mesh.faces.copy(), process=False))
