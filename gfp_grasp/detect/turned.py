"""Upright boxes of traffic as rows of numbers, (n, 7): centre x, y, z, length, width, height, m, and yaw, rad."""

from __future__ import annotations

import numpy as np
import shapely

_CORNERS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2


def corners_of(boxes: np.ndarray) -> np.ndarray:
    """Corners (n, 4, 2) m of boxes (n, 7) as seen from above."""
    c, s = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    R = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    return boxes[:, None, :2] + np.einsum("nij,nkj->nki", R, _CORNERS * boxes[:, None, 3:5])


def iou_from_above(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Intersection over union (n, m) of boxes (n, 7) and (m, 7) as seen from above."""
    found = np.zeros((len(boxes), len(others)))
    reach = [np.hypot(some[:, 3], some[:, 4]) / 2 for some in (boxes, others)]
    apart = np.linalg.norm(boxes[:, None, :2] - others[None, :, :2], axis=2)
    rows, columns = np.nonzero(apart < reach[0][:, None] + reach[1][None])
    if not len(rows):
        return found
    outlines, other_outlines = (np.asarray(shapely.polygons(corners_of(some))) for some in (boxes, others))
    common = shapely.area(shapely.intersection(outlines[rows], other_outlines[columns]))
    areas, other_areas = boxes[:, 3] * boxes[:, 4], others[:, 3] * others[:, 4]
    found[rows, columns] = common / np.maximum(areas[rows] + other_areas[columns] - common, 1e-9)
    return found


def suppress(boxes: np.ndarray, scores: np.ndarray, *, iou: float, most: int) -> np.ndarray:
    """Non-maximum suppression as seen from above.

    Args:
        boxes: (n, 7).
        scores: (n,).
        iou: A box that overlaps a better one by more is left out.
        most: Most boxes that are kept.

    Returns:
        Indices of the boxes that are kept, the best first.
    """
    waiting, kept = np.argsort(-scores, kind="stable"), []
    while len(waiting) and len(kept) < most:
        best, waiting = waiting[0], waiting[1:]
        kept.append(best)
        waiting = waiting[iou_from_above(boxes[best][None], boxes[waiting])[0] <= iou]
    return np.array(kept, dtype=np.int64)


def inside(points: np.ndarray, box: np.ndarray, *, grow_m: float = 0.0) -> np.ndarray:
    """Which points (n, 3) m are in a box (7,) grown to all sides."""
    local = to_box(points, box[None])[0]
    return (np.abs(local) <= box[3:6] / 2 + grow_m).all(axis=1)


def to_box(points: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Points (n, 3) m in the frames of boxes (b, 7), (b, n, 3) m: x forward, the middle of the box at the origin."""
    moved = points[None] - boxes[:, None, :3]
    c, s = np.cos(boxes[:, 6:7]), np.sin(boxes[:, 6:7])
    x, y = c * moved[..., 0] + s * moved[..., 1], c * moved[..., 1] - s * moved[..., 0]
    return np.stack([x, y, moved[..., 2]], axis=2)
