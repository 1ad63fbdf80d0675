"""Scans of traffic with boxes: KITTI's object and tracking layouts, and .npz files; crops, and things over time.

Everything is in the LiDAR's frame: x forward, y left, z up, metres, the sensor at the origin.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.meshes import read_content
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about

ROAD_M = 0.1  # the lowest points of a box are of the road up to this
_GROWN_M = 0.3  # by which the box of a thing of a track is grown
_VALUES = 4  # of a point in a .bin: x, y, z, intensity
# Shares of a .bin's rows and values that tell another layout: coordinates in place of intensities, and no lengths.
_ODD_ROWS, _ODD_VALUES, _HUGE = 0.05, 0.01, 1e7
# What KITTI calls the things that there are primitives of.
CLASSES = {
    "car": "car",
    "van": "van",
    "truck": "truck",
    "bus": "bus",
    "pedestrian": "pedestrian",
    "person": "pedestrian",
    "person_sitting": "pedestrian",
    "cyclist": "cyclist",
}
# Labels that may be taken for each other: their borders are a matter of taste.
ALIKE = (frozenset({"car", "van"}), frozenset({"van", "truck"}))


@dataclass(frozen=True, eq=False)
class TrafficBox:
    """A thing of a scan as its label has it.

    Attributes:
        category: Class, one of the values of CLASSES, or what the label says where it is none of these.
        centre: (3,) m.
        size_m: (3,) length, width, height.
        yaw_rad: Turn of its forward direction about z, from x towards y.
        track: Number of the thing over the scans of a sequence; None where it has none.
    """

    category: str
    centre: np.ndarray
    size_m: np.ndarray
    yaw_rad: float
    track: int | None = None

    @property
    def T_scan_box(self) -> np.ndarray:
        """(4, 4): x forward, z up, the middle of the box at the origin."""
        return make_T(rotation_about((0, 0, 1), self.yaw_rad), self.centre)

    def inside(self, points: np.ndarray, *, road_m: float = ROAD_M, grow_m: float = 0.0) -> np.ndarray:
        """Which points (n, 3) m are in the box, grown to all sides, but for the road at its foot."""
        local = apply_T(invert_T(self.T_scan_box), points)
        half = self.size_m / 2
        return (np.abs(local) <= half + grow_m).all(axis=1) & (local[:, 2] > road_m - half[2])


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan with its boxes.

    Attributes:
        name: Name within its data set, never a path; of a sequence `<sequence>/<frame>`.
        points: (n, 3) m.
        intensity: (n,).
        boxes: Labelled things; regions where nothing is labelled are left out.
    """

    name: str
    points: np.ndarray
    intensity: np.ndarray
    boxes: tuple[TrafficBox, ...]


def read_scans(root: str | Path, *, limit: int | None = None) -> Iterator[Scan]:
    """The scans of a folder, in the order of their names.

    Args:
        root: Folder of KITTI's object layout (`velodyne/000000.bin`, `label_2/000000.txt`, `calib/000000.txt`, itself
            or below `training/`), of its tracking layout (`velodyne/0000/000000.bin`, `label_02/0000.txt`,
            `calib/0000.txt`), or of .npz files with `points` (n, 3 or 4), `boxes` (m, 7: centre, length, width, height,
            yaw) and `classes` (m,). Pictures are not needed.
        limit: Most scans; None reads all.

    Raises:
        UnreadableFile: None of these layouts, or a file that is not what it should be.
        InvalidOption: The limit is not positive.
    """
    if limit is not None and limit < 1:
        raise InvalidOption(f"limit is {limit}; at least 1, or None, is expected")
    folder = Path(root)
    inner = folder / "training" if (folder / "training" / "velodyne").is_dir() else folder
    if sorted(inner.glob("velodyne/*/*.bin")):
        found = _tracking_scans(inner)
    elif sorted(inner.glob("velodyne/*.bin")):
        found = _object_scans(inner)
    elif sorted(folder.glob("*.npz")):
        found = _npz_scans(folder)
    else:
        raise UnreadableFile(
            f"{folder.name} holds no scans as velodyne/*.bin, velodyne/*/*.bin (KITTI's object and tracking layouts) "
            "or *.npz"
        )
    for number, scan in enumerate(found):
        if number == limit:
            return
        yield scan


def read_bin(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) m and intensities (n,) of a KITTI .bin: float32, four a point.

    Raises:
        UnreadableFile: No such file, empty, cut within a point, or of another layout, as far as its size and values
            tell: five numbers a point as nuScenes has them, doubles, three or six numbers a point.
    """
    path = Path(path)
    content = read_content(path)
    expected = f"{path.name} has {len(content)} bytes; a KITTI scan has 16 a point, float32 x, y, z, intensity"
    five = (
        "it reads as five a point, nuScenes' x, y, z, intensity, ring: save numpy.fromfile(path, '<f4')"
        ".reshape(-1, 5)[:, :4] as .npy"
    )
    if len(content) % (4 * _VALUES):
        other = five if len(content) % 20 == 0 else "it is cut short, or its points hold more or fewer numbers"
        raise UnreadableFile(f"{expected}; {other}")
    with np.errstate(invalid="ignore"):  # another layout's bits may be signalling NaN
        values = np.frombuffer(content, dtype="<f4").reshape(-1, _VALUES).astype(np.float64)
    if (values[:, 3] < -1).mean() > _ODD_ROWS and _are_rings(content):
        raise UnreadableFile(f"{expected}; {five}")
    if (values[:, 3] < -1).mean() > _ODD_ROWS or (np.abs(values) > _HUGE).mean() > _ODD_VALUES:
        raise UnreadableFile(
            f"{expected}; its values make no sense as these, up to {np.nanmax(np.abs(values)):.3g} with intensities "
            f"from {np.nanmin(values[:, 3]):.3g}: are its numbers doubles, or more or fewer than four a point?"
        )
    return values[:, :3], values[:, 3]


def _are_rings(content: bytes) -> bool:
    """Whether every fifth number is a whole one, as the number of a ring is."""
    if len(content) % 20:
        return False
    fifth = np.frombuffer(content, dtype="<f4").reshape(-1, 5)[:, 4]
    return bool(np.isin(fifth, np.arange(256)).all())


def accumulated(views: Sequence[tuple[np.ndarray, TrafficBox]], middle: int, *, reach: int = 10) -> np.ndarray:
    """What several scans saw of one thing, together: the partial truth of a completion.

    Args:
        views: The points (n, 3) m of the thing in each scan of a track, in the order of time, and its box there.
        middle: Number of the scan whose frame the answer is in.
        reach: Scans before and after that count.

    Returns:
        (m, 3) m, in the frame of the middle scan; each box's own axes are laid over each other.
    """
    own = views[middle][1].T_scan_box
    near = views[max(0, middle - reach) : middle + reach + 1]
    return np.concatenate([apply_T(own @ invert_T(box.T_scan_box), points) for points, box in near])


def _object_scans(folder: Path) -> Iterator[Scan]:
    for path in sorted(folder.glob("velodyne/*.bin")):
        points, intensity = read_bin(path)
        calibration = _calibration(folder / "calib" / f"{path.stem}.txt")
        lines = _lines(folder / "label_2" / f"{path.stem}.txt")
        boxes = (_box(words, calibration, path.stem) for words in lines)
        yield Scan(path.stem, points, intensity, tuple(box for box in boxes if box is not None))


def _tracking_scans(folder: Path) -> Iterator[Scan]:
    for sequence in sorted(path for path in (folder / "velodyne").iterdir() if path.is_dir()):
        calibration = _calibration(folder / "calib" / f"{sequence.name}.txt")
        by_frame: dict[int, list[TrafficBox]] = {}
        for words in _lines(folder / "label_02" / f"{sequence.name}.txt"):
            box = _box(words[2:], calibration, sequence.name, track=int(words[1]))
            if box is not None:
                by_frame.setdefault(int(words[0]), []).append(box)
        for path in sorted(sequence.glob("*.bin")):
            points, intensity = read_bin(path)
            yield Scan(f"{sequence.name}/{path.stem}", points, intensity, tuple(by_frame.get(int(path.stem), ())))


def _npz_scans(folder: Path) -> Iterator[Scan]:
    for path in sorted(folder.glob("*.npz")):
        try:
            with np.load(path, allow_pickle=False) as stored:
                content: Mapping[str, Any] = {key: stored[key] for key in stored.files}
        except (OSError, ValueError) as error:
            raise UnreadableFile(f"{path.name} is no .npz of numbers and words: {error}") from error
        if not {"points", "boxes", "classes"} <= content.keys():
            continue
        points, boxes = np.asarray(content["points"], np.float64), np.asarray(content["boxes"], np.float64)
        if points.ndim != 2 or points.shape[1] < 3 or boxes.shape != (len(content["classes"]), 7):
            raise UnreadableFile(
                f"{path.name} has points {points.shape}, boxes {boxes.shape} and {len(content['classes'])} classes; "
                "(n, 3 or 4), (m, 7) and m are expected"
            )
        intensity = points[:, 3] if points.shape[1] > 3 else np.zeros(len(points))
        named = zip(content["classes"], boxes, strict=True)
        labelled = tuple(TrafficBox(class_of(str(name)), b[:3], b[3:6], float(b[6])) for name, b in named)
        yield Scan(path.stem, points[:, :3], intensity, labelled)


def read_tracks(folder: str | Path) -> dict[str, list[tuple[np.ndarray, TrafficBox]]]:
    """Things over the consecutive scans of a sequence, each with its points and its box in each of them.

    Args:
        folder: KITTI's tracking layout, or .npz files with `frames` (k,), `counts` (k,), `points` (n, 3 or 4) of all
            scans one after the other and `boxes` (k, 7), named `<anything>_<class>.npz`.

    Returns:
        {name: [(points (n, 3) m in or about the box, box), ...]}; points are those of the box grown by 0.3 m.

    Raises:
        UnreadableFile: Neither of these.
    """
    folder = Path(folder)
    found: dict[str, list[tuple[np.ndarray, TrafficBox]]] = {}
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as stored:
            if not {"counts", "points", "boxes"} <= set(stored.files):
                continue
            counts, boxes = stored["counts"], np.asarray(stored["boxes"], np.float64)
            clouds = np.split(np.asarray(stored["points"], np.float64)[:, :3], np.cumsum(counts)[:-1])
        category = class_of(path.stem.rpartition("_")[2])
        found[path.stem] = [
            (cloud, TrafficBox(category, b[:3], b[3:6], float(b[6]))) for cloud, b in zip(clouds, boxes, strict=True)
        ]
    if found:
        return found
    for scan in read_scans(folder):
        sequence = scan.name.partition("/")[0]
        for box in scan.boxes:
            if box.track is not None:
                points = scan.points[box.inside(scan.points, road_m=-_GROWN_M, grow_m=_GROWN_M)]
                found.setdefault(f"{sequence}/{box.track}_{box.category}", []).append((points, box))
    return found


def class_of(label: str) -> str:
    """Class of a label of KITTI; what there is no primitive of keeps its name, in small letters."""
    return CLASSES.get(label.lower(), label.lower())


def _lines(path: Path) -> list[list[str]]:
    """Words of each line; none where there is no file, as KITTI's test scans have no labels."""
    if not path.is_file():
        return []
    return [line.split() for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]


def _calibration(path: Path) -> np.ndarray:
    """T_scan_camera (4, 4) from the rectified camera's frame, in which labels are."""
    rows: dict[str, list[float]] = {}
    for words in _lines(path):
        try:
            rows[words[0].rstrip(":")] = [float(word) for word in words[1:]]
        except ValueError:
            continue  # calib_time and the like
    rectify, to_camera = (
        rows.get("R0_rect") or rows.get("R_rect"),
        rows.get("Tr_velo_to_cam") or rows.get("Tr_velo_cam"),
    )
    if rectify is None or to_camera is None or len(rectify) != 9 or len(to_camera) != 12:
        raise UnreadableFile(
            f"{path.name} is no calibration of KITTI: R0_rect with 9 numbers and Tr_velo_to_cam with 12 are expected"
        )
    R = np.array(rectify).reshape(3, 3)
    T_camera_scan = make_T(R, np.zeros(3)) @ np.vstack([np.array(to_camera).reshape(3, 4), [0, 0, 0, 1]])
    return invert_T(T_camera_scan)


def _box(words: Sequence[str], T_scan_camera: np.ndarray, name: str, *, track: int | None = None) -> TrafficBox | None:
    """A box of a label: class, truncation, occlusion, alpha, four of the picture, h, w, l, x, y, z, ry."""
    if words[0] == "DontCare":
        return None
    try:
        height, width, length, x, y, z, turn = (float(word) for word in words[8:15])
    except ValueError as error:
        raise UnreadableFile(f"a label of {name} is {' '.join(words)!r}; 15 words are expected") from error
    centre = apply_T(T_scan_camera, np.array([[x, y - height / 2, z]]))[0]
    forward = T_scan_camera[:3, :3] @ np.array([np.cos(turn), 0.0, -np.sin(turn)])
    yaw = float(np.arctan2(forward[1], forward[0]))
    return TrafficBox(class_of(words[0]), centre, np.array([length, width, height]), yaw, track)
