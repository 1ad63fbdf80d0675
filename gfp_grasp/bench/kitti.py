"""The bench of traffic: completions of what a LiDAR saw in given boxes, by the measures of KITTI's completion papers.

Fidelity, minimal matching distance and consistency are those of PCN (Yuan et al. 2018, arXiv:1808.00671), all in
metres and unsquared, and in the box's own frame; but fidelity is measured towards what all scans of a track saw
together, since towards the input alone a copy of it is perfect.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.bench.kitti_detection import detection_rows
from gfp_grasp.bench.methods import UNDEFORMED, ask_peer, config_of
from gfp_grasp.camera import range_image
from gfp_grasp.complete import complete_detection, complete_to_mesh
from gfp_grasp.completers import PEER_COMPLETERS, check_network
from gfp_grasp.completion import Completion
from gfp_grasp.datasets import ALIKE, Scan, TrafficBox, accumulated, read_scans, read_tracks, whole_shapes
from gfp_grasp.detect import DetectConfig, Road, detect_single, detect_traffic, find_road
from gfp_grasp.errors import GfpGraspError, InvalidOption, NothingDetected
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.shapes import FAMILIES, make_shape, split_seeds
from gfp_grasp.train import street_of_kitti
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LIDAR, Detection, OrientedBox

OURS, PARTIAL, DETECTED, WHOLE = "gfpnet", "partial", "gfpnet-detected", "whole-in-box"
PAPER = ("told-pcrnet", "told-pcrnet-gfs", "told-pcrnet-gfpnet-paper")
ROWS = (PARTIAL, WHOLE, *PAPER, UNDEFORMED, OURS, DETECTED)
_SAMPLES = 4096
_UP = np.array([0.0, 0.0, 1.0])
_ABOUT_M = 0.2  # by which a label is grown for what a detection has in it
_GROUND_M, _FEW_OF_ROAD = 0.25, 8  # points of the road are as near to the foot of the box, and as many at least
_WHOLE = 24  # shapes of the test split that the matching distance looks among


@dataclass(frozen=True)
class KittiConfig:
    """What of a tree is measured.

    Attributes:
        rows: Methods, some of ROWS and of `gfp_grasp.completers.PEER_COMPLETERS`, of which those that are told the true
            box get the label's. The paper's own, PAPER, are told the class; DETECTED is told no box: it completes what
            the detector finds in the whole scans; WHOLE is told class, box and heading, and gives the whole shape of
            the class, stretched into the box, that lies nearest to what was seen: what a completion can reach.
        least_points: Things of fewer points are left out.
        frames: Consecutive scans of each track, about its middle.
        limit: Most scans; None reads all.
        shapes: Folder of the whole shapes that the matching distance looks among, as `datasets.whole_shapes` takes it;
            None takes members of the procedural test split.
    """

    rows: tuple[str, ...] = ROWS
    least_points: int = 100
    frames: int = 12
    limit: int | None = None
    shapes: Path | None = None

    def __post_init__(self) -> None:
        legal = (*ROWS, *PEER_COMPLETERS)
        if not self.rows or not set(self.rows) <= set(legal):
            raise InvalidOption(f"rows are {self.rows}; some of {', '.join(legal)} are expected")
        if self.least_points < 10 or self.frames < 2:
            raise InvalidOption(
                f"least_points is {self.least_points}, frames {self.frames}; at least 10 and 2 are expected"
            )


@dataclass(frozen=True, eq=False)
class _Thing:
    """One thing in one scan.

    Attributes:
        name: Names it among all.
        track: Name of its track; "" for none.
        frame: Number of the scan in its track.
        points: (n, 3) m, in its box, without the road.
        box: Its label.
        road_m: Height of the road under it; None where none is in sight.
        truth: (m, 3) m, what all scans near in time saw of it; None where it is of no track.
        found: What the detector found of it in the whole scan; None where it did not.
        whole: Whether its whole scan is there.
    """

    name: str
    track: str
    frame: int
    points: np.ndarray
    box: TrafficBox
    road_m: float | None
    truth: np.ndarray | None
    found: Detection | None = None
    whole: bool = False


def bench_kitti(
    data: Path, *, config: KittiConfig = KittiConfig(), workers: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Complete the things in a tree's boxes.

    Args:
        data: Folder, as `read_scans` and `read_tracks` take it.
        config: What is measured.
        workers: Processes.
        progress: Wraps the stream of things.

    What is completed stands on the road, where the scan shows it.

    Returns:
        {"rows": {row: figures}}: "things", "refused", "class_right" (van for car or truck is right, too; only of rows
        that say a class), "size_error" (median of the mean error of length, width and height), "heading_deg" (median,
        either way round) and "turned_round" (share that face backwards), "fidelity_m", "mmd_m" and "consistency_m"
        (medians), "input_m" (from what one scan saw to the answer) and "seen_m" (from what all scans saw to it),
        "seconds" (median); "by_class" has the same by class, "each" every one of them, with the sizes of answer and
        label. And "detection", as `detection_rows` has it, where there are whole scans.

    Raises:
        UnreadableFile: No scan in the folder, or the weights of another network are none.
        InvalidOption: Nothing of enough points in it.
        NotTrained: The weights of another network do not ship; the message has the command that trains it.
    """
    for row in set(config.rows) & set(PEER_COMPLETERS):
        check_network(row)
    scans = list(street_of_kitti(data, limit=config.limit)) if DETECTED in config.rows else []
    things = _things(data, config)
    if not things:
        raise InvalidOption(f"{data.name} holds no box of a class with at least {config.least_points} points")
    measured = list(
        pmap(partial(_measure, rows=config.rows, shapes=config.shapes), things, workers=workers, progress=progress)
    )
    rows = {}
    for row in config.rows:
        found = [one[row] for one in measured if row in one]
        classes = sorted({one["class"] for one in found})
        rows[row] = {
            **_figures(found),
            "by_class": {name: _figures([one for one in found if one["class"] == name]) for name in classes},
            "each": [{key: value for key, value in one.items() if key != "surface"} for one in found],
        }
    report: dict[str, Any] = {"rows": rows, "frames": config.frames, "least_points": config.least_points}
    if scans:
        report["detection"] = detection_rows(scans)
    return report


def _things(data: Path, config: KittiConfig) -> list[_Thing]:
    found = []
    for scan in read_scans(data, limit=config.limit):
        cropped = [(number, box, scan.points[box.inside(scan.points)]) for number, box in enumerate(scan.boxes)]
        own = [one for one in cropped if one[1].track is None and _counts(one[1], one[2], config)]
        road = _road_of(scan) if own else None
        detected = _detected(scan) if road is not None and DETECTED in config.rows else ()
        for number, box, points in own:
            under = None if road is None else float(box.centre[2] - road.heights(box.centre[None])[0])
            match = next((one for one in detected if _is_of(one, box, len(points))), None)
            found.append(
                _Thing(f"{scan.name}/{number}", "", 0, points, box, under, None, match, whole=road is not None)
            )
    for name, views in read_tracks(data).items():
        cropped = [(points[box.inside(points)], box) for points, box in views]
        first = max(0, (len(cropped) - config.frames) // 2)
        for frame in range(first, min(first + config.frames, len(cropped))):
            points, box = cropped[frame]
            if _counts(box, points, config):
                road_m, truth = _road_about(*views[frame]), accumulated(cropped, frame)
                found.append(_Thing(f"{name}/{frame}", name, frame, points, box, road_m, truth))
    return found


def _detected(scan: Scan) -> tuple[Detection, ...]:
    try:
        return detect_traffic(range_image(scan.points))
    except NothingDetected:
        return ()


def _is_of(detection: Detection, box: TrafficBox, num_points: int) -> bool:
    """Whether most of a detection is in a box, and most of what is in the box belongs to it."""
    shared = int(box.inside(np.asarray(detection.cloud.points), grow_m=_ABOUT_M).sum())
    return shared > len(detection.cloud.points) / 2 and shared > num_points / 3  # pixels merge points


def _counts(box: TrafficBox, points: np.ndarray, config: KittiConfig) -> bool:
    return box.category in FAMILIES and len(points) >= config.least_points


def _road_of(scan: Scan) -> Road | None:
    try:
        return find_road(scan.points, _UP, viewpoint=np.zeros(3))
    except NothingDetected:  # a crop of one thing
        return None


def _road_about(points: np.ndarray, box: TrafficBox) -> float | None:
    """Height of the road about a thing, by the points at its foot that are outside of its box; None for too few."""
    beside = ~box.inside(points, road_m=-1.0)
    low = points[beside, 2]
    low = low[np.abs(low - (box.centre[2] - box.size_m[2] / 2)) < _GROUND_M]
    return float(np.median(low)) if len(low) >= _FEW_OF_ROAD else None


def _measure(thing: _Thing, *, rows: Sequence[str], shapes: Path | None) -> dict[str, dict[str, Any]]:
    return {row: _measured(thing, row, shapes) for row in rows if row != DETECTED or thing.whole}


def _measured(thing: _Thing, row: str, shapes: Path | None) -> dict[str, Any]:
    """One thing under one method; its surface is kept, in the box's frame, for what is measured over time."""
    about = {"name": thing.name, "track": thing.track, "frame": thing.frame, "class": thing.box.category}
    about |= {"points": len(thing.points), "distance_m": round(float(np.hypot(*thing.box.centre[:2])), 1)}
    to_box = invert_T(thing.box.T_scan_box)
    started = time.perf_counter()
    seen: np.ndarray = apply_T(to_box, thing.points)
    more: dict[str, Any] = {"named": thing.box.category}
    if row == PARTIAL:
        surface = seen
    elif row == WHOLE:
        truth = seen if thing.truth is None else apply_T(to_box, thing.truth)
        surface = _whole_in_box(truth, thing.box, shapes)
    else:
        try:
            done = _completed(thing, row)
        except GfpGraspError as error:
            return {**about, "refused": f"{type(error).__name__}: {error}"}
        seconds = time.perf_counter() - started
        mesh = done.mesh.copy()
        mesh.apply_transform(to_box)
        surface = visible_surface(mesh, _SAMPLES, np.random.default_rng(0))
        more = {"made_by": done.made_by, "seconds": round(seconds, 3)}
        if row not in PEER_COMPLETERS:
            more["named"] = done.detection.category
        more |= {"size_m": mesh.extents.round(2).tolist(), "label_m": thing.box.size_m.round(2).tolist()}
        more["size_error"] = round(float(np.abs(mesh.extents / thing.box.size_m - 1).mean()), 4)
        if done.fit is not None:
            forward = to_box[:3, :3] @ done.fit.T_world_object[:3, 0]
            more["heading_deg"] = round(float(np.degrees(np.arctan2(forward[1], forward[0]))), 1)
    more["mmd_m"] = round(_matching_m(surface, thing.box.category, shapes), 4)
    tree = KDTree(surface)
    more["input_m"] = round(float(tree.query(seen)[0].mean()), 4)
    if thing.truth is not None:
        truth = apply_T(to_box, thing.truth)
        more["fidelity_m"] = round(float(KDTree(truth).query(surface)[0].mean()), 4)
        more["seen_m"] = round(float(tree.query(truth)[0].mean()), 4)
    return {**about, **more, "surface": surface}


def _completed(thing: _Thing, row: str) -> Completion:
    if row == DETECTED:
        if thing.found is None:
            raise NothingDetected("the detector did not find it")
        return complete_detection(thing.found)
    if row in PEER_COMPLETERS:
        unnamed = DetectConfig(sensor=LIDAR, classify=False)
        seen = detect_single(thing.points, viewpoint=np.zeros(3), support_height=thing.road_m, config=unnamed)
        return ask_peer(row, seen, OrientedBox(thing.box.T_scan_box, thing.box.size_m))
    config, tell = config_of(row, given=thing.box.category)
    return complete_to_mesh(
        thing.points,
        viewpoint=np.zeros(3),
        sensor=LIDAR,
        support_height=thing.road_m,
        category=thing.box.category if tell else None,
        config=config,
    )


def _matching_m(surface: np.ndarray, category: str, folder: Path | None) -> float:
    """Chamfer distance to the nearest whole shape of the class, laid middle on middle on the ground, either way."""
    centred = _on_ground(surface)
    turned = centred * (-1, -1, 1)
    return min(chamfer_m(way, whole) for whole in _whole_shapes(category, folder) for way in (centred, turned))


def _whole_in_box(seen: np.ndarray, box: TrafficBox, folder: Path | None) -> np.ndarray:
    """The whole shape of a class, stretched into a box, that lies nearest to what was seen (n, 3) m."""
    stretched = []
    for shape in _whole_shapes(box.category, folder):
        low, high = shape.min(axis=0), shape.max(axis=0)
        stretched.append((shape - (low + high) / 2) * box.size_m / (high - low))
    return min(stretched, key=lambda shape: float(KDTree(shape).query(seen)[0].mean()))


@cache
def _whole_shapes(category: str, folder: Path | None) -> tuple[np.ndarray, ...]:
    if folder is None:
        meshes = [make_shape(category, seed).mesh for seed in split_seeds(category, "test", _WHOLE)]
    else:
        meshes = whole_shapes(folder).get(category, [])
        if not meshes:
            raise InvalidOption(f"{folder.name} holds no whole shape of {category} to match things with")
    rng = np.random.default_rng(0)
    return tuple(_on_ground(visible_surface(mesh, _SAMPLES // 4, rng)) for mesh in meshes)


def _on_ground(points: np.ndarray) -> np.ndarray:
    low, high = points.min(axis=0), points.max(axis=0)
    return points - np.array([*((low + high)[:2] / 2), low[2]])


def _figures(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    answered = [one for one in found if "refused" not in one]
    figures: dict[str, Any] = {"things": len(found), "refused": len(found) - len(answered)}
    if not answered:
        return figures
    said = [{one["named"], one["class"]} for one in answered if "named" in one]
    if said:
        right = [len(pair) == 1 or any(pair <= alike for alike in ALIKE) for pair in said]
        figures["class_right"] = round(float(np.mean(right)), 4)
    headings = np.array([one["heading_deg"] for one in answered if "heading_deg" in one])
    if len(headings):
        off = np.abs((headings + 180) % 360 - 180)
        figures["heading_deg"] = round(float(np.median(np.minimum(off, 180 - off))), 1)
        figures["turned_round"] = round(float((off > 90).mean()), 4)
    for name in ("size_error", "fidelity_m", "seen_m", "input_m", "mmd_m", "seconds"):
        values = [one[name] for one in answered if name in one]
        if values:
            figures[name] = round(float(np.median(values)), 4)
    between = _consistencies(answered)
    if between:
        figures["consistency_m"] = round(float(np.median(between)), 4)
    return figures


def _consistencies(found: Sequence[Mapping[str, Any]]) -> list[float]:
    """Chamfer distances between completions of one thing in consecutive scans, in the box's frame."""
    by_place = {(one["track"], one["frame"]): one["surface"] for one in found if one["track"]}
    pairs = [(surface, by_place.get((track, frame + 1))) for (track, frame), surface in by_place.items()]
    return [chamfer_m(one, other) for one, other in pairs if other is not None]
