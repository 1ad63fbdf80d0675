"""Files of every kind that a user may have come in as points, or are refused by name."""

import struct
from pathlib import Path

import numpy as np
import pytest
import real_data
import trimesh
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gfp_grasp.camera import intrinsics, mask_of_points
from gfp_grasp.captures import SUFFIXES, Capture, read_capture
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidView, UnreadableFile
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage

POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (60, 3)).round(6)
K = intrinsics(32, 24, 40.0)


def points_of(capture: Capture) -> np.ndarray:
    assert capture.points is not None
    return capture.points


def write(path: Path, points: np.ndarray) -> Path:
    """The same points in the file format that the suffix says."""
    rows = [" ".join(f"{c:.6f}" for c in p) for p in points]
    if path.suffix == ".npz":
        np.savez(path, points=points)
    elif path.suffix == ".npy":
        np.save(path, points)
    elif path.suffix == ".bin":
        np.column_stack([points, np.full(len(points), 0.25)]).astype("<f4").tofile(path)
    elif path.suffix == ".ply":
        trimesh.PointCloud(points).export(path)
    elif path.suffix == ".obj":
        path.write_text("\n".join(f"v {row}" for row in rows))
    elif path.suffix == ".pcd":
        head = f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS {len(points)}\nDATA ascii\n"
        path.write_text(head + "\n".join(rows))
    elif path.suffix == ".csv":
        path.write_text("x,y,z\n" + "\n".join(row.replace(" ", ",") for row in rows))
    else:
        path.write_text("\n".join(rows))
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_same_points_come_out_of_every_format(tmp_path: Path, suffix: str) -> None:
    capture = read_capture(write(tmp_path / f"cloud{suffix}", POINTS))
    assert capture.points is not None
    np.testing.assert_allclose(points_of(capture), POINTS, atol=1e-6)
    assert capture.viewpoint is None
    np.testing.assert_array_equal(capture.up, [0, 0, 1])


def test_binary_pcd_with_colour_and_padding_gives_its_coordinates(tmp_path: Path) -> None:
    head = "VERSION 0.7\nFIELDS rgb x y z _\nSIZE 4 4 4 4 1\nTYPE U F F F U\nCOUNT 1 1 1 1 3\nPOINTS 60\nDATA binary\n"
    body = b"".join(struct.pack("<Ifff3B", 7, *point, 1, 2, 3) for point in POINTS)
    path = tmp_path / "cloud.pcd"
    path.write_bytes(head.encode() + body)
    np.testing.assert_allclose(points_of(read_capture(path)), POINTS, atol=1e-6)
    path.write_bytes(head.encode() + body[:-5])
    with pytest.raises(UnreadableFile, match="cut short"):
        read_capture(path)


def test_capture_in_the_camera_frame_leaves_up_to_be_estimated(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", depth_m=np.full((24, 32), 0.5), K=K, object_points_cam=POINTS + np.array([0, 0, 0.5]))
    capture = read_capture(tmp_path / "a.npz")
    assert capture.up is None
    assert capture.view is not None
    np.testing.assert_array_equal(capture.viewpoint, [0, 0, 0])


def test_capture_with_a_pose_is_in_the_world_frame(tmp_path: Path) -> None:
    T = look_at((0.3, 0.0, 0.4), (0, 0, 0))
    np.savez(tmp_path / "a.npz", depth_m=np.full((24, 32), 0.5), K=K, T_world_camera=T, mask=np.ones((24, 32), bool))
    capture = read_capture(tmp_path / "a.npz")
    assert capture.view is not None
    assert capture.points is not None
    np.testing.assert_allclose(np.asarray(capture.viewpoint), [0.3, 0.0, 0.4])
    np.testing.assert_allclose(points_of(capture), capture.view.points().reshape(-1, 3), atol=1e-9)
    np.testing.assert_array_equal(capture.up, [0, 0, 1])


def test_organised_points_become_a_picture_with_their_intrinsics(tmp_path: Path) -> None:
    depth = np.random.default_rng(1).uniform(0.4, 0.6, (24, 32))
    points = DepthImage(depth, K, np.eye(4)).points()
    points[3, 4] = np.nan
    np.savez(tmp_path / "a.npz", points_cam=points)
    capture = read_capture(tmp_path / "a.npz")
    assert capture.points is None
    assert capture.view is not None
    np.testing.assert_allclose(capture.view.K, K, atol=1e-3)
    assert capture.view.depth_m[3, 4] == 0


def test_mask_of_points_is_the_pixels_that_saw_them() -> None:
    depth = np.full((24, 32), 0.5, np.float32)
    depth[5:9, 10:15] = 0.4
    view = DepthImage(depth, K, look_at((0.3, 0.1, 0.4), (0, 0, 0)))
    points = view.points()[depth == np.float32(0.4)]
    np.testing.assert_array_equal(mask_of_points(points, view, tolerance_m=0.006), depth == np.float32(0.4))


def test_true_mesh_comes_along_in_the_frame_of_the_points(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    T = look_at((0.3, 0.0, 0.4), (0, 0, 0))
    vertices_cam = (box.vertices - T[:3, 3]) @ T[:3, :3]
    np.savez(
        tmp_path / "a.npz",
        object_points_cam=(POINTS - T[:3, 3]) @ T[:3, :3],
        T_world_camera=T,
        mesh_vertices_cam=vertices_cam,
        mesh_faces=box.faces,
    )
    capture = read_capture(tmp_path / "a.npz")
    assert capture.truth is not None
    assert capture.truth.is_volume
    np.testing.assert_allclose(capture.truth.bounds, box.bounds, atol=1e-12)
    np.testing.assert_allclose(points_of(capture), POINTS, atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "error", "words"),
    [
        ({"colour": np.ones(3)}, UnreadableFile, "object_points_cam"),
        ({"depth_m": np.ones((4, 4))}, InvalidView, "add K"),
        ({"points": np.ones((5, 5))}, InvalidCloud, r"\(n, 3 or 4\)"),
        ({"points": np.array([["a", "b", "c"]])}, InvalidCloud, r"\(n, 3 or 4\)"),
        ({"object_points_cam": np.ones((5, 4))}, InvalidCloud, r"\(n, 3\)"),
        ({"points": POINTS, "mask": np.ones((4, 4))}, InvalidView, "no picture"),
        ({"points": POINTS, "up": np.ones(2)}, InvalidView, "three finite"),
        (
            {"points": POINTS, "T_world_camera": np.ones((4, 4))},
            InvalidView,
            "3 x 3 of T_world_camera is no rotation, and the pose not rigid",
        ),
        ({"points": POINTS, "T_world_camera": np.eye(3)}, InvalidView, r"shape \(3, 3\); a rigid \(4, 4\)"),
        ({"points": POINTS, "T_world_camera": "pose"}, UnreadableFile, "pose"),
        ({"points": POINTS, "viewpoint": ["a", "b", "c"]}, UnreadableFile, "key"),
        ({"points": POINTS, "support_height": [0.0, 1.0]}, UnreadableFile, "key"),
        ({"points": POINTS, "support_height": "low"}, UnreadableFile, "low"),
        ({"points_cam": np.full((4, 4, 3), "a")}, UnreadableFile, "key"),
        ({"depth_m": np.full((4, 4), "a"), "K": K}, InvalidView, "depth_m"),
        ({"depth_m": np.ones((24, 32)), "K": K, "mask": np.full((24, 32), "a")}, InvalidView, "mask"),
        ({"depth_m": np.ones((24, 32)), "K": K, "mask": np.ones((32, 24))}, InvalidView, "mask"),
        ({"points": POINTS, "mesh_vertices_cam": np.ones(3), "mesh_faces": ["a"]}, UnreadableFile, "key"),
        ({"depth_m": np.zeros((24, 32)), "K": K, "mask": np.ones((24, 32), bool)}, InvalidCloud, "no pixel"),
    ],
)
def test_keys_that_do_not_fit_are_refused(tmp_path: Path, keys: dict, error: type[Exception], words: str) -> None:
    np.savez(tmp_path / "a.npz", **keys)
    with pytest.raises(error, match=words):
        read_capture(tmp_path / "a.npz")


def test_a_pickle_is_refused_unread(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.array([{"run": "me"}], dtype=object))
    with pytest.raises(UnreadableFile, match="plain arrays"):
        read_capture(tmp_path / "a.npz")


def test_an_archive_that_unpacks_to_more_than_is_read_is_refused_packed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((100_000, 3)))
    monkeypatch.setattr("gfp_grasp.captures.read.LARGEST_BYTES", 100_000)
    assert (tmp_path / "a.npz").stat().st_size < 100_000
    with pytest.raises(UnreadableFile, match="unpacked"):
        read_capture(tmp_path / "a.npz")


def test_an_array_that_promises_more_than_memory_is_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.npy", POINTS).read_bytes()
    (tmp_path / "a.npy").write_bytes(whole.replace(b"(60, 3), }          ", b"(10000000000000, 3)}"))
    with pytest.raises(UnreadableFile):
        read_capture(tmp_path / "a.npy")


def test_missing_file_and_unknown_suffix_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="cannot be read"):
        read_capture(tmp_path / "nowhere.ply")
    with pytest.raises(UnreadableFile, match=r"\.npz"):
        read_capture(tmp_path / "cloud.docx")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(suffix=st.sampled_from(SUFFIXES), content=st.binary(min_size=1, max_size=200), keep=st.floats(0, 1))
@example(suffix=".npy", content=bytes(11) + b"[", keep=0.07421875)  # a header that opens a bracket and ends
def test_broken_files_are_refused_by_name_and_nothing_else(
    tmp_path: Path, suffix: str, content: bytes, keep: float
) -> None:
    path = write(tmp_path / f"broken{suffix}", POINTS)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole))] + content)
    try:
        found = points_of(read_capture(path))
    except GfpGraspError:
        return
    assert found.ndim == 2
    assert found.shape[1] == 3
    assert np.isfinite(found).all() or suffix == ".bin"  # any four numbers are a point of a scan
    known = int(keep * len(POINTS)) - 12  # what is before the first point takes the place of fewer than twelve
    np.testing.assert_allclose(found[: max(known, 0)], POINTS[: max(known, 0)], atol=1e-6)


@pytest.mark.parametrize("name", ["mug_red", "bottle_mustard", "bowl_green", "table_learn0"])
def test_real_captures_are_read(name: str) -> None:
    capture = read_capture(real_data.folder() / "captures" / f"{name}.npz")
    assert capture.view is not None
    assert capture.up is None
    assert (capture.points is None) == name.startswith("table")
    assert (capture.truth is not None) == (name == "bottle_mustard")
