"""Levels of one decomposition: a tree of merges from many convex parts to few, and how true each level is."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.collision.convex import convex_part, convex_parts
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.collision.parts import diagonal_m
from gfp_grasp.types import ConvexPart

# Parts whose boxes are farther apart than this share of the whole meet only when nothing else is left to merge.
_APART = 0.02
_MOST = 128
# CoACD cuts through every triangle that a plane meets: of several hundred corners 96 say nearly as much.
_MOST_VERTICES = 96


@dataclass(frozen=True, eq=False)
class PartLevels:
    """Parts of one mesh at the finest level, and how they are merged into fewer.

    Attributes:
        parts: The p parts of the finest level.
        merges: (p - 1, 2) as `merge_tree` returns them.
        errors_m: (p, 2) m, mean and 95 % distance between the mesh and the parts of the levels of 1 to p parts.
    """

    parts: tuple[ConvexPart, ...]
    merges: np.ndarray
    errors_m: np.ndarray


def levels_of(parts: tuple[ConvexPart, ...], mesh: trimesh.Trimesh) -> PartLevels:
    """Levels of parts that a mesh was decomposed into."""
    parts, _ = convex_parts((part.vertices for part in parts), max_vertices=_MOST_VERTICES)
    parts = merged(parts, merge_tree(parts), _MOST)
    merges = merge_tree(parts)
    errors = [
        union_error_m(merged(parts, merges, count), mesh, rng=np.random.default_rng(0))[:2]
        for count in range(1, len(parts) + 1)
    ]
    return PartLevels(parts, merges, np.array(errors))


def merge_tree(parts: Sequence[ConvexPart]) -> np.ndarray:
    """The order in which parts are merged, from which every number of parts can be had.

    Each merge takes the two parts whose joint hull adds the least volume to their own volumes.

    Args:
        parts: p convex parts, m.

    Returns:
        (p - 1, 2) numbers of the parts that each merge joins; the part that the i-th merge makes has number p + i.
    """
    clouds = {i: np.asarray(part.vertices) for i, part in enumerate(parts)}
    volumes = {i: _volume_m3(cloud) for i, cloud in clouds.items()}
    if not clouds:
        return np.zeros((0, 2), dtype=np.int64)
    everything = np.concatenate(list(clouds.values()))
    apart_m = _APART * diagonal_m(everything)
    boxes = {i: (cloud.min(axis=0), cloud.max(axis=0)) for i, cloud in clouds.items()}
    queue: list[tuple[bool, float, int, int]] = []

    def offer(i: int, j: int) -> None:
        gap = np.maximum(boxes[i][0] - boxes[j][1], boxes[j][0] - boxes[i][1]).max()
        added = _volume_m3(np.concatenate([clouds[i], clouds[j]])) - volumes[i] - volumes[j]
        heapq.heappush(queue, (bool(gap > apart_m), added, i, j))

    numbers = sorted(clouds)
    for i in numbers:
        for j in range(i):
            offer(j, i)
    merges = []
    while len(clouds) > 1:
        _, _, i, j = heapq.heappop(queue)
        if i not in clouds or j not in clouds:
            continue
        made = len(parts) + len(merges)
        merges.append((i, j))
        joint = np.concatenate([clouds.pop(i), clouds.pop(j)])
        clouds[made] = joint[_corners(joint)]
        volumes[made] = _volume_m3(joint)
        boxes[made] = (joint.min(axis=0), joint.max(axis=0))
        for other in sorted(clouds):
            if other != made:
                offer(other, made)
    return np.array(merges, dtype=np.int64).reshape(-1, 2)


def groups_of(merges: np.ndarray, num_parts: int, count: int) -> list[list[int]]:
    """Groups of the finest parts that make up the parts of one level.

    Args:
        merges: (p - 1, 2), from `merge_tree`.
        num_parts: p, the number of parts at the finest level.
        count: Number of groups; less than 1 is taken as 1, more than p as p.

    Returns:
        Numbers of the finest parts in each group, groups in the order of their first parts.
    """
    groups = {i: [i] for i in range(num_parts)}
    for number, (i, j) in enumerate(merges[: max(0, num_parts - max(count, 1))].tolist()):
        groups[num_parts + number] = sorted(groups.pop(i) + groups.pop(j))
    return sorted(groups.values())


def merged(
    parts: tuple[ConvexPart, ...], merges: np.ndarray, count: int, *, max_vertices: int | None = None
) -> tuple[ConvexPart, ...]:
    """The parts of one level: hulls of the finest parts, joined as `merge_tree` says until there are so many.

    Args:
        parts: The p finest.
        merges: (p - 1, 2), from `merge_tree`.
        count: Number of parts at most.
        max_vertices: Most vertices of each; None for no limit.
    """
    hulls = [
        convex_part(np.concatenate([parts[i].vertices for i in group]), max_vertices=max_vertices)
        for group in groups_of(merges, len(parts), count)
    ]
    return tuple(hull for hull in hulls if hull is not None)


def _corners(points: np.ndarray) -> np.ndarray:
    try:
        return np.sort(ConvexHull(points).vertices)
    except QhullError:  # flat
        return np.arange(len(points))


def _volume_m3(points: np.ndarray) -> float:
    try:
        return float(ConvexHull(points).volume)
    except QhullError:
        return 0.0
