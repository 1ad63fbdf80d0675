"""How well vehicles and people of LiDAR scans are found: recall and precision by class and distance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gfp_grasp.datasets import ALIKE
from gfp_grasp.detect import SURE_BOX, find_boxes, inside, iou_from_above
from gfp_grasp.train import StreetScan

OVERLAPS = (0.5, 0.7)
RANGES_M = ((0.0, 15.0), (15.0, 30.0), (30.0, 50.0))
_FEWEST_POINTS = 30
_CLEAR_POINTS, _CLEAR_M = 200, 30.0  # what nobody may miss


def detection_rows(scans: Sequence[StreetScan]) -> dict[str, Any]:
    """Recall and precision of the shipped detector.

    Args:
        scans: Labelled scans; what lies beside their labelled angle does not count.

    Returns:
        {class: {range: {"things", "found", "recall_0.5", "precision_0.5", "recall_0.7", "precision_0.7"}}}: things of
        labels, boxes that are found; a class that is easily taken for another (a van for a car) is right too. The
        range "clear" is that of 200 points or more within 30 m; in the others 30 points are enough.
    """
    found = [_Scan(scan) for scan in scans]
    names = sorted({str(name) for one in found for name in (*one.classes, *one.named)})
    ranges = {f"{low:g} to {high:g} m": (low, high, _FEWEST_POINTS) for low, high in RANGES_M}
    ranges["clear"] = (0.0, _CLEAR_M, _CLEAR_POINTS)
    return {name: {title: _figures(found, name, *limits) for title, limits in ranges.items()} for name in names}


class _Scan:
    """Labels and found boxes of a scan, with their points and distances."""

    def __init__(self, scan: StreetScan) -> None:
        boxes, scores, self.named = find_boxes(scan.points)
        sure = scores > SURE_BOX
        self.found, self.named = boxes[sure], self.named[sure]
        self.truth, self.classes = scan.boxes, scan.classes
        in_sight = np.abs(np.arctan2(self.found[:, 1], self.found[:, 0])) < scan.labelled
        self.points, self.found_points = (
            np.array([inside(scan.points, box).sum() for box in some], dtype=int) for some in (self.truth, self.found)
        )
        self.counts = in_sight
        self.overlap = iou_from_above(self.found, self.truth)


def _figures(
    scans: Sequence[_Scan], name: str, low_m: float, high_m: float, least_points: int
) -> Mapping[str, float | int]:
    alike = {name, *(other for pair in ALIKE if name in pair for other in pair)}
    things, found = 0, 0
    hit, right = np.zeros(len(OVERLAPS)), np.zeros(len(OVERLAPS))
    for scan in scans:
        of_class, of_alike = scan.classes == name, np.isin(scan.classes, list(alike))
        for n in np.flatnonzero(of_class & (scan.points >= least_points) & _within(scan.truth, low_m, high_m)):
            things += 1
            best = scan.overlap[np.isin(scan.named, list(alike)), n].max(initial=0.0)
            hit += best >= np.array(OVERLAPS)
        ours = (scan.named == name) & scan.counts & (scan.found_points >= least_points)
        for n in np.flatnonzero(ours & _within(scan.found, low_m, high_m)):
            found += 1
            right += scan.overlap[n, of_alike].max(initial=0.0) >= np.array(OVERLAPS)
    figures: dict[str, float | int] = {"things": things, "found": found}
    for overlap, one, other in zip(OVERLAPS, hit, right, strict=True):
        if things:
            figures[f"recall_{overlap}"] = round(float(one / things), 4)
        if found:
            figures[f"precision_{overlap}"] = round(float(other / found), 4)
    return figures


def _within(boxes: np.ndarray, low_m: float, high_m: float) -> np.ndarray:
    away = np.hypot(boxes[:, 0], boxes[:, 1])
    return (away >= low_m) & (away < high_m)
