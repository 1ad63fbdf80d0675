"""Reading a recording from a file: which suffixes are understood, and a refusal for everything else."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh

from gfp_grasp.assets import data_file
from gfp_grasp.captures.capture import Capture
from gfp_grasp.captures.columns import parse_columns
from gfp_grasp.captures.keys import capture_of_keys
from gfp_grasp.captures.pcd import PcdCloud, parse_pcd
from gfp_grasp.errors import GfpGraspError, UnreadableFile
from gfp_grasp.meshes import LARGEST_BYTES, READER_ERRORS, read_content
from gfp_grasp.transforms import apply_T, invert_T

_T = TypeVar("_T")

SAMPLE_FILE, STREET_FILE = "quickstart.npz", "street.npz"
SHIPPED = {"sample": SAMPLE_FILE, "street": STREET_FILE}  # names of what ships
SUFFIXES = (".npz", ".npy", ".bin", ".ply", ".pcd", ".xyz", ".pts", ".txt", ".csv", ".obj")


def read_capture(path: str | Path) -> Capture:
    """Read a cloud or a capture.

    An .npz holds one of these, in metres; camera frames are OpenCV's (x right, y down, z forward):

    | key | shape | what |
    |---|---|---|
    | `depth_m`, `K` | (h, w), (3, 3) | depth picture, 0 or NaN where nothing came back, and its intrinsics in pixels |
    | `points_cam` | (h, w, 3) | organised points in the camera frame, NaN where nothing came back; K is fitted |
    | `object_points_cam` | (n, 3) | points of one object in the camera frame |
    | `points` | (n, 3 or 4) | points of one object, or of a whole LiDAR scan, in the world frame |

    and may add `mask` (h, w), true on the one object to complete; `T_world_camera` (4, 4), without which the camera's
    frame is the world and up is estimated; `viewpoint` (3,), `up` (3,) and `support_height` () in the world frame;
    `mesh_vertices_cam` (v, 3) and `mesh_faces` (f, 3), the true mesh in the camera frame, which is only measured
    against. `points_cam` in OpenGL's frame (y up, z backward) or a ROS body's (x forward, z up) are told by where they
    lie.

    Every other file is a plain cloud in a frame of its own whose z is taken to be up: .npy of shape (n, 3 or 4) (or
    (h, w, 3), taken as `points_cam`), .bin (KITTI's, float32 x y z intensity), .ply, .pcd, .obj (its vertices), and
    .xyz, .pts, .txt, .csv: x y z by the names of their columns, or else the first three. A .pcd with more than one row
    is organised, and its VIEWPOINT is where the camera stood. A fourth column of points is an intensity, and left out.

    Args:
        path: One of SUFFIXES; or what ships with the package: "sample", a capture, or "street", a whole LiDAR scan.

    Returns:
        The recording; of a plain cloud the viewpoint is unknown.

    Raises:
        UnreadableFile: Not there, of another suffix, or not what its suffix says.
        InvalidCloud: It reads, but holds no points.
        InvalidView: Picture, intrinsics, pose or mask do not fit each other.
    """
    path = data_file("sim_scenes", SHIPPED[str(path)]) if str(path) in SHIPPED else Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        pictures = (
            "; a depth picture goes by read_depth, --depth with --intrinsics"
            if suffix in (".png", ".tif", ".tiff")
            else ""
        )
        raise UnreadableFile(f"{path.name}: suffix {path.suffix!r} is not among {', '.join(SUFFIXES)}{pictures}")
    if suffix == ".bin":
        from gfp_grasp.datasets import read_bin  # brings the simulator, only where it is needed

        return capture_of_keys(path.name, {"points": read_bin(path)[0]})
    content = read_content(path)
    if suffix == ".npz":
        return capture_of_keys(path.name, _arrays(path.name, content))
    if suffix == ".npy":
        array = read_array(path.name, content)
        return capture_of_keys(path.name, {"points_cam" if array.ndim == 3 else "points": array})
    if suffix == ".pcd":
        return _of_pcd(path.name, _read(path.name, parse_pcd, content))
    parse = {".ply": _parse_ply, ".obj": _parse_obj}.get(suffix, parse_columns)
    return capture_of_keys(path.name, {"points": _read(path.name, parse, content)})


def _of_pcd(name: str, cloud: PcdCloud) -> Capture:
    """A picture where the points are one: in the camera's frame, or in the world's with the camera at VIEWPOINT."""
    T, told = cloud.T_viewpoint, []
    if cloud.shape is not None:
        pose = {} if T is None else {"T_world_camera": T}
        for points in [cloud.points] if T is None else [apply_T(invert_T(T), cloud.points), cloud.points]:
            try:
                return capture_of_keys(name, {"points_cam": points.reshape(*cloud.shape, 3), **pose})
            except GfpGraspError as error:
                told = [f"its {cloud.shape[0]} rows are taken for bare points, not for a picture: {error}"]
    capture = capture_of_keys(name, {"points": cloud.points, **({} if T is None else {"viewpoint": T[:3, 3]})})
    return replace(capture, notes=(*capture.notes, *told))


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


def read_array(name: str, content: bytes) -> np.ndarray:
    """The one plain array of an .npy file."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except READER_ERRORS as error:
        raise UnreadableFile(f"{name} is not a readable .npy of one plain array ({error})") from error
    if not isinstance(array, np.ndarray):
        raise UnreadableFile(f"{name} holds several arrays: name it .npz")
    return array


def _read(name: str, parse: Callable[[bytes], _T], content: bytes) -> _T:
    try:
        return parse(content)
    except UnreadableFile as error:
        raise UnreadableFile(f"{name}: {error}") from error
    except READER_ERRORS as error:
        raise UnreadableFile(f"{name} is not a readable cloud: {error}") from error


def _parse_ply(content: bytes) -> np.ndarray:
    # trimesh's reader wants faces or nothing else; a cloud and a mesh both have vertices.
    loaded = trimesh.load(io.BytesIO(content), file_type="ply", process=False)
    return np.array(loaded.vertices, dtype=np.float64)  # pyright: ignore[reportAttributeAccessIssue]


def _parse_obj(content: bytes) -> np.ndarray:
    rows = re.findall(rb"^\s*v\s+(\S+)\s+(\S+)\s+(\S+)", content, flags=re.MULTILINE)
    return np.array(rows, dtype="S").astype(np.float64).reshape(-1, 3)
