"""Reading a recording: its type, the keys and suffixes that are understood, and a refusal for everything else.

PCD is read in version 0.7, ascii and binary. Source: "The PCD (Point Cloud Data) file format", Point Cloud Library
documentation.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.assets import data_file
from gfp_grasp.camera import cloud_of, view_from_points
from gfp_grasp.complete import CompleteConfig, Completion, complete_scene, complete_to_mesh
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidOption, InvalidView, UnreadableFile
from gfp_grasp.meshes import LARGEST_BYTES, READER_ERRORS, read_content
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import DepthImage


@dataclass(frozen=True, eq=False)
class Capture:
    """What a camera recorded: a depth picture, points of one object, or both.

    All of it is in one frame, the world's; where the camera's pose is not known that is the camera's own frame.

    Attributes:
        name: Name of the file, without its folder.
        points: (n, 3) m, points of one object, NaN allowed; None where only a picture is known.
        view: The whole depth picture, or None.
        mask: (h, w) bool, the object's pixels in the view, or None.
        viewpoint: (3,) m, where the camera stood, or None.
        up: (3,) normal of the support; None where it must be estimated.
        support_height: Height of the support along up, m, or None.
        truth: The true mesh in place, where somebody knows it: for measuring, never for completing.
    """

    name: str
    points: np.ndarray | None = None
    view: DepthImage | None = None
    mask: np.ndarray | None = None
    viewpoint: np.ndarray | None = None
    up: np.ndarray | None = None
    support_height: float | None = None
    truth: trimesh.Trimesh | None = None

    def __post_init__(self) -> None:
        if self.points is None and self.view is None:
            raise InvalidCloud(f"{self.name} holds neither points of an object nor a depth picture")


def complete_capture(
    capture: Capture,
    *,
    category: str | None = None,
    detector: str | None = None,
    sensor: str = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> Sequence[Completion]:
    """Complete the one object whose points are known, or else every object of the picture.

    Args:
        capture: The recording.
        category: As complete_to_mesh takes it; a whole picture's objects are classified one by one.
        detector: Name of the detector for the whole picture, see `gfp_grasp.detect.get_detector`, even where the points
            of one object are known; None takes `tabletop` where they are not.
        sensor: As complete_to_mesh takes it.
        config: Switches.
        seed: Seed of every random choice.

    Raises:
        InvalidOption: A detector, and no picture for it.
        GfpGraspError: As complete_to_mesh and complete_scene raise it.
    """
    if detector is not None and capture.view is None:
        raise InvalidOption(
            f"detector {detector!r} looks for objects in a picture, and {capture.name} holds points only"
        )
    if capture.view is not None and (detector is not None or capture.points is None):
        return complete_scene(capture.view, up=capture.up, detector=detector or "tabletop", config=config, seed=seed)
    assert capture.points is not None
    completion = complete_to_mesh(
        capture.points,
        viewpoint=capture.viewpoint,
        up=capture.up,
        support_height=capture.support_height,
        view=capture.view,
        mask=capture.mask,
        category=category,
        sensor=sensor,
        config=config,
        seed=seed,
    )
    return (completion,)


def parse_pcd(content: bytes) -> np.ndarray:
    """Points (n, 3) float64 of a PCD file; rows may be NaN.

    Raises:
        UnreadableFile: No PCD header, no x y z among its fields, compressed, or cut short.
    """
    header, body = _split(content)
    names = [name for name, count in zip(header["FIELDS"], _counts(header), strict=True) for _ in range(count)]
    if not {"x", "y", "z"} <= set(names):
        raise UnreadableFile(f"the PCD has fields {' '.join(names)}; x y z are expected among them")
    columns = [names.index(axis) for axis in "xyz"]
    encoding = header["DATA"][0].lower()
    if encoding == "ascii":
        return np.loadtxt(io.BytesIO(body), ndmin=2, usecols=columns).astype(np.float64)
    if encoding != "binary":
        raise UnreadableFile(f"the PCD's data is {encoding}; ascii or binary is expected: save it so")
    layout = np.dtype([(f"{i}", kind) for i, kind in enumerate(_kinds(header))])
    num_points = int(header["POINTS"][0])
    if num_points * layout.itemsize > len(body):
        raise UnreadableFile(f"the PCD promises {num_points} points but is cut short")
    rows = np.frombuffer(body, dtype=layout, count=num_points)
    return np.stack([rows[f"{column}"] for column in columns], axis=1).astype(np.float64)


def _split(content: bytes) -> tuple[dict[str, list[str]], bytes]:
    header: dict[str, list[str]] = {}
    rest = content
    while "DATA" not in header:
        line, found, rest = rest.partition(b"\n")
        words = line.decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        if not found or len(header) > 20:
            break
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA") if not header.get(key)]
    if missing:
        raise UnreadableFile(f"the PCD's header lacks {', '.join(missing)}")
    return header, rest


def _counts(header: dict[str, list[str]]) -> list[int]:
    return [int(count) for count in header.get("COUNT", ["1"] * len(header["FIELDS"]))]


def _kinds(header: dict[str, list[str]]) -> list[str]:
    kinds = []
    for size, kind, count in zip(header["SIZE"], header["TYPE"], _counts(header), strict=True):
        kinds += ["<" + {"F": "f", "I": "i", "U": "u"}[kind.upper()] + size] * count
    return kinds


SAMPLE, SAMPLE_FILE = "sample", "quickstart.npz"
SUFFIXES = (".npz", ".npy", ".ply", ".pcd", ".xyz", ".txt", ".csv", ".obj")
KEYS = "points | object_points_cam | depth_m and K | points_cam"
_Z_UP = np.array([0.0, 0.0, 1.0])


def read_capture(path: str | Path) -> Capture:
    """Read a cloud or a capture.

    An .npz holds one of these, in metres; camera frames are OpenCV's (x right, y down, z forward):

    | key | shape | what |
    |---|---|---|
    | `depth_m`, `K` | (h, w), (3, 3) | depth picture, 0 or NaN where nothing came back, and its intrinsics in pixels |
    | `points_cam` | (h, w, 3) | organised points in the camera frame, NaN where nothing came back; K is fitted |
    | `object_points_cam` | (n, 3) | points of one object in the camera frame |
    | `points` | (n, 3) | points of one object in the world frame |

    and may add `mask` (h, w), true on the one object to complete; `T_world_camera` (4, 4), without which the camera's
    frame is the world and up is estimated; `viewpoint` (3,), `up` (3,) and `support_height` () in the world frame;
    `mesh_vertices_cam` (v, 3) and `mesh_faces` (f, 3), the true mesh in the camera frame, which is only measured
    against. Every other file is a plain cloud in a frame of its own whose z is up: .npy of shape (n, 3) (or (h, w, 3),
    taken as `points_cam`), .ply, .pcd (ascii or binary), .obj (its vertices), and .xyz, .txt, .csv with x y z in the
    first three columns and at most one line of heading.

    Args:
        path: One of SUFFIXES; or "sample", the capture that ships with the package.

    Returns:
        The recording; of a plain cloud the viewpoint is unknown.

    Raises:
        UnreadableFile: Not there, of another suffix, or not what its suffix says.
        InvalidCloud: It reads, but holds no points.
        InvalidView: Picture, intrinsics, pose or mask do not fit each other.
    """
    path = data_file("sim_scenes", SAMPLE_FILE) if str(path) == SAMPLE else Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UnreadableFile(f"{path.name}: suffix {path.suffix!r} is not among {', '.join(SUFFIXES)}")
    content = read_content(path)
    if suffix == ".npz":
        return _of_keys(path.name, _arrays(path.name, content))
    if suffix == ".npy":
        array = _array(path.name, content)
        return _of_keys(path.name, {"points_cam" if array.ndim == 3 else "points": array})
    readers = {".ply": _parse_ply, ".pcd": parse_pcd, ".obj": _parse_obj}
    points = _read(path.name, readers.get(suffix, _parse_table), content)
    return _of_keys(path.name, {"points": points})


def _of_keys(name: str, arrays: Mapping[str, np.ndarray]) -> Capture:
    try:
        return _capture(name, arrays)
    except GfpGraspError:
        raise
    except (TypeError, ValueError, LookupError, AttributeError) as error:  # text where numbers should be, and the like
        raise UnreadableFile(f"{name}: a key does not hold what it should: {error}") from error


def _capture(name: str, arrays: Mapping[str, np.ndarray]) -> Capture:
    T = _T_world_camera(name, arrays)
    view = _view(arrays, T)
    points = None
    if "points" in arrays:
        points = _points(name, "points", arrays["points"])
    elif "object_points_cam" in arrays:
        points = apply_T(T, _points(name, "object_points_cam", arrays["object_points_cam"]))
    mask = arrays.get("mask")
    if mask is not None and mask.dtype.kind not in "bfiu":
        raise InvalidView(f"{name}: the mask is of {mask.dtype}; (h, w) true or false is expected")
    mask = None if mask is None else np.nan_to_num(mask).astype(bool)
    if mask is not None and view is None:
        raise InvalidView(f"{name} has a mask but no picture: add depth_m and K, or points_cam")
    if points is None and view is None:
        raise UnreadableFile(f"{name} holds {', '.join(sorted(arrays)) or 'nothing'}; expected {KEYS}")
    if mask is not None and points is None:
        assert view is not None
        points = _masked_points(name, view, mask)
    world_is_known = "T_world_camera" in arrays or "points" in arrays
    up = _vector(name, "up", arrays) if "up" in arrays else (_Z_UP if world_is_known else None)
    from_camera = view is not None or "object_points_cam" in arrays
    viewpoint = _vector(name, "viewpoint", arrays) if "viewpoint" in arrays else (T[:3, 3] if from_camera else None)
    height = float(arrays["support_height"]) if "support_height" in arrays else None
    return Capture(name, points, view, mask, viewpoint, up, height, _truth(arrays, T))


def _T_world_camera(name: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    T = np.asarray(arrays.get("T_world_camera", np.eye(4)), dtype=np.float64)
    if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-4):
        raise InvalidView(f"{name}: T_world_camera must be a rigid (4, 4) transform, got shape {T.shape}")
    return T


def _view(arrays: Mapping[str, np.ndarray], T: np.ndarray) -> DepthImage | None:
    if "points_cam" in arrays:
        return view_from_points(arrays["points_cam"], T_world_camera=T)
    if "depth_m" in arrays and "K" in arrays:
        return DepthImage(arrays["depth_m"], arrays["K"], T)
    if "depth_m" in arrays:
        raise InvalidView("depth_m came without its intrinsics: add K, (3, 3) px")
    return None


def _masked_points(name: str, view: DepthImage, mask: np.ndarray) -> np.ndarray:
    points = np.asarray(cloud_of(view, mask).points)
    if len(points) == 0:
        raise InvalidCloud(f"{name}: no pixel of the mask came back with a depth")
    return points


def _truth(arrays: Mapping[str, np.ndarray], T: np.ndarray) -> trimesh.Trimesh | None:
    if "mesh_vertices_cam" not in arrays or "mesh_faces" not in arrays:
        return None
    return trimesh.Trimesh(apply_T(T, arrays["mesh_vertices_cam"]), arrays["mesh_faces"].astype(int), process=False)


def _points(name: str, key: str, array: np.ndarray) -> np.ndarray:
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fiu":
        raise InvalidCloud(
            f"{name}: {key} has shape {array.shape} of {array.dtype}; (n, 3) numbers in metres are expected"
        )
    return array.astype(np.float64)


def _vector(name: str, key: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    vector = np.asarray(arrays[key], dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InvalidView(f"{name}: {key} must be three finite numbers, got shape {vector.shape}")
    return vector


def _arrays(name: str, content: bytes) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > LARGEST_BYTES:
            raise ValueError(f"unpacked it has {size} bytes, at most {LARGEST_BYTES} are read")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:  # a pickle could run anything
            return {key: file[key] for key in file.files}
    except (*READER_ERRORS, zipfile.BadZipFile) as error:
        raise UnreadableFile(f"{name} is not a readable .npz of plain arrays ({error})") from error


def _array(name: str, content: bytes) -> np.ndarray:
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except READER_ERRORS as error:
        raise UnreadableFile(f"{name} is not a readable .npy of one plain array ({error})") from error
    if not isinstance(array, np.ndarray):
        raise UnreadableFile(f"{name} holds several arrays: name it .npz")
    return array


def _read(name: str, parse: object, content: bytes) -> np.ndarray:
    try:
        return parse(content)  # pyright: ignore[reportCallIssue]
    except READER_ERRORS as error:
        if isinstance(error, UnreadableFile):
            raise
        raise UnreadableFile(f"{name} is not a readable cloud: {error}") from error


def _parse_ply(content: bytes) -> np.ndarray:
    # trimesh's reader wants faces or nothing else; a cloud and a mesh both have vertices.
    loaded = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    return np.array(loaded.vertices, dtype=np.float64)  # pyright: ignore[reportAttributeAccessIssue]


def _parse_obj(content: bytes) -> np.ndarray:
    rows = re.findall(rb"^\s*v\s+(\S+)\s+(\S+)\s+(\S+)", content, flags=re.MULTILINE)
    return np.array(rows, dtype="S").astype(np.float64).reshape(-1, 3)


def _parse_table(content: bytes) -> np.ndarray:
    text = content.decode("utf-8-sig").translate(str.maketrans(",;\t", "   "))
    first = text.lstrip().split("\n", 1)
    try:
        [float(word) for word in first[0].split()]
    except ValueError:
        text = first[1] if len(first) == 2 else ""  # a line of heading
    if not text.strip():
        raise UnreadableFile("it holds no rows of numbers")
    table = np.loadtxt(io.StringIO(text), ndmin=2, usecols=(0, 1, 2))
    return table.astype(np.float64)
