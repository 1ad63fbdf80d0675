"""PCD files as ROS and the Point Cloud Library write them: organised, with a viewpoint, and compressed."""

import struct
from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.camera import camera_points, intrinsics
from gfp_grasp.captures import Capture, read_capture
from gfp_grasp.captures.pcd import parse_pcd
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import DepthImage

K = intrinsics(32, 24, 40.0)
DEPTH = np.random.default_rng(1).uniform(0.4, 0.6, (24, 32)).astype(np.float32)
DEPTH[3, 4] = 0.0
AXIS, ANGLE = np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25), 2.3
T = make_T(rotation_about(AXIS, ANGLE), (0.3, 0.1, 0.4))
QUAT_WXYZ = (np.cos(ANGLE / 2), *(np.sin(ANGLE / 2) * AXIS))
STATED = " ".join(f"{value:.9f}" for value in (0.3, 0.1, 0.4, *QUAT_WXYZ))
CAMERA = camera_points(DepthImage(DEPTH, K, np.eye(4)))


def head(width: int, height: int, data: str, viewpoint: str = "0 0 0 1 0 0 0") -> bytes:
    lines = ["VERSION 0.7", "FIELDS x y z rgb", "SIZE 4 4 4 4", "TYPE F F F U", "COUNT 1 1 1 1"]
    lines += [
        f"WIDTH {width}",
        f"HEIGHT {height}",
        f"VIEWPOINT {viewpoint}",
        f"POINTS {width * height}",
        f"DATA {data}",
    ]
    return ("\n".join(lines) + "\n").encode()


def rows(points: np.ndarray) -> bytes:
    return b"".join(struct.pack("<fffI", *point, 7) for point in points.reshape(-1, 3))


def literals(data: bytes) -> bytes:
    """LZF without a copy: up to 32 bytes at a time, each run after its length less one."""
    pieces = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)


def packed(data: bytes, size: int) -> bytes:
    return struct.pack("<II", len(data), size) + data


def read(folder: Path, content: bytes) -> Capture:
    (folder / "a.pcd").write_bytes(content)
    return read_capture(folder / "a.pcd")


def test_an_organised_cloud_is_the_picture_that_the_same_array_is(tmp_path: Path) -> None:
    capture = read(tmp_path, head(32, 24, "binary") + rows(CAMERA))
    np.save(tmp_path / "a.npy", CAMERA.astype(np.float32))
    same = read_capture(tmp_path / "a.npy")
    assert capture.view is not None
    assert same.view is not None
    np.testing.assert_array_equal(capture.view.depth_m, same.view.depth_m)
    np.testing.assert_array_equal(capture.view.K, same.view.K)
    np.testing.assert_allclose(capture.view.K, K, atol=1e-3)
    assert capture.points is None
    assert capture.up is None


@pytest.mark.parametrize("in_world", [True, False])
def test_the_viewpoint_of_an_organised_cloud_is_the_pose_of_its_camera(tmp_path: Path, in_world: bool) -> None:
    points = apply_T(T, CAMERA) if in_world else CAMERA
    view = read(tmp_path, head(32, 24, "binary", STATED) + rows(points)).view
    assert view is not None
    np.testing.assert_allclose(view.T_world_camera, T, atol=1e-6)
    np.testing.assert_allclose(view.depth_m, DEPTH, atol=1e-6)


def test_the_viewpoint_of_bare_points_is_where_the_camera_stood(tmp_path: Path) -> None:
    points = apply_T(T, CAMERA).reshape(-1, 3)[:700]
    capture = read(tmp_path, head(700, 1, "binary", STATED) + rows(points))
    np.testing.assert_allclose(np.asarray(capture.viewpoint), (0.3, 0.1, 0.4), atol=1e-9)
    np.testing.assert_allclose(np.asarray(capture.points), points, atol=1e-6)
    np.testing.assert_array_equal(capture.up, [0, 0, 1])
    assert capture.up_is_assumed
    assert read(tmp_path, head(700, 1, "binary") + rows(points)).viewpoint is None


def test_rows_that_no_pinhole_camera_sees_are_bare_points(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (24, 32, 3))
    capture = read(tmp_path, head(32, 24, "binary") + rows(points))
    assert capture.view is None
    np.testing.assert_allclose(np.asarray(capture.points), points.reshape(-1, 3), atol=1e-7)
    assert "24 rows are taken for bare points" in capture.notes[-1]


def test_compressed_fields_are_read_one_after_the_other(tmp_path: Path) -> None:
    points = CAMERA.reshape(-1, 3)[200:203].astype(np.float32)
    data = b"".join(np.ascontiguousarray(points[:, axis]).tobytes() for axis in range(3))
    data += struct.pack("<III", 1, 2, 3)
    content = head(3, 1, "binary_compressed") + packed(literals(data), len(data))
    np.testing.assert_array_equal(read(tmp_path, content).points, points.astype(np.float64))


def test_copies_reach_back_and_into_themselves() -> None:
    # Five of x are 1.0: four bytes, then a copy of 16 bytes from 4 back (length 7 + 7 + 2). Five of y are zeros:
    # one byte and a copy of 19 (7 + 10 + 2) from 1 back. Five of z are what x was: 20 bytes from 40 back.
    one = struct.pack("<f", 1.0)
    data = bytes([3]) + one + bytes([7 << 5, 7, 3]) + bytes([0, 0]) + bytes([7 << 5, 10, 0]) + bytes([7 << 5, 11, 39])
    data += literals(bytes(20))
    cloud = parse_pcd(head(5, 1, "binary_compressed") + packed(data, 80))
    np.testing.assert_array_equal(cloud.points, [[1.0, 0.0, 1.0]] * 5)


@pytest.mark.parametrize(
    "data",
    [b"\x20\x00", b"\xe0", b"\x05abc", literals(bytes(79)), bytes([0, 0, 7 << 5, 255, 5])],
)
def test_broken_compression_is_refused(data: bytes) -> None:
    with pytest.raises(UnreadableFile, match="compressed data is broken"):
        parse_pcd(head(5, 1, "binary_compressed") + packed(data, 80))


def test_what_unpacks_to_more_than_is_read_is_refused_packed() -> None:
    with pytest.raises(UnreadableFile, match="at most"):
        parse_pcd(head(5, 1, "binary_compressed") + packed(b"", (1 << 32) - 1))


def test_a_viewpoint_without_a_rotation_is_refused() -> None:
    with pytest.raises(UnreadableFile, match="VIEWPOINT is 1 2 3 0 0 0 0"):
        parse_pcd(head(1, 1, "ascii", "1 2 3 0 0 0 0") + b"1 2 3 0\n")
