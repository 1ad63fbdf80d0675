"""A tree of merges over convex parts: coarse to fine levels of one decomposition."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.types import ConvexPart

# Parts whose boxes are farther apart than this share of the whole meet only when nothing else is left to merge.
_APART = 0.02


def merge_tree(parts: Sequence[ConvexPart]) -> np.ndarray:
    """Which parts become one first, for any number of parts that are to be left.

    Always those two are merged whose joint hull adds the least volume to their own.

    Args:
        parts: p convex parts, m.

    Returns:
        (p - 1, 2) numbers of the parts that are merged, in that order; what the i-th merge makes is number p + i.
    """
    clouds = {i: np.asarray(part.vertices) for i, part in enumerate(parts)}
    volumes = {i: _volume_m3(cloud) for i, cloud in clouds.items()}
    if not clouds:
        return np.zeros((0, 2), dtype=np.int64)
    everything = np.concatenate(list(clouds.values()))
    apart_m = _APART * float(np.linalg.norm(np.ptp(everything, axis=0)))
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
    """Parts that belong together where count of them are left.

    Args:
        merges: As `merge_tree` returns them.
        num_parts: p, of the finest level.
        count: How many are wanted; between 1 and p are given.

    Returns:
        Numbers of the finest parts in each group, groups in the order of their first parts.
    """
    groups = {i: [i] for i in range(num_parts)}
    for number, (i, j) in enumerate(merges[: max(0, num_parts - max(count, 1))].tolist()):
        groups[num_parts + number] = sorted(groups.pop(i) + groups.pop(j))
    return sorted(groups.values())


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
