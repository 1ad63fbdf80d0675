"""Recordings to the letter: which key wins, what a heading is, where pixels of points lie, what completion is given."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp import captures
from gfp_grasp.camera import camera_points, intrinsics
from gfp_grasp.captures import Capture, complete_capture, read_capture
from gfp_grasp.captures.pcd import parse_pcd
from gfp_grasp.errors import InvalidCloud, InvalidOption, InvalidView, UnreadableFile
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import DepthImage

K = intrinsics(32, 24, 40.0)
T = make_T(rotation_about((1.0, -2.0, 0.5), 2.3), (0.3, 0.1, 0.4))
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (60, 3)).round(6)
DEPTH = np.random.default_rng(1).uniform(0.4, 0.6, (24, 32)).astype(np.float32)


def _saved(folder: Path, **keys: object) -> Capture:
    np.savez(folder / "a.npz", **keys)  # type: ignore[arg-type]
    return read_capture(folder / "a.npz")


def test_points_of_the_world_are_not_moved_by_the_camera_and_win_over_those_of_the_camera(tmp_path: Path) -> None:
    capture = _saved(tmp_path, points=POINTS, object_points_cam=POINTS + 1.0, T_world_camera=T)
    np.testing.assert_array_equal(capture.points, POINTS)
    np.testing.assert_array_equal(capture.up, [0, 0, 1])
    np.testing.assert_allclose(np.asarray(capture.viewpoint), T[:3, 3])
    assert capture.name == "a.npz"


def test_points_of_the_camera_are_moved_into_the_world(tmp_path: Path) -> None:
    capture = _saved(tmp_path, object_points_cam=POINTS, T_world_camera=T)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points, apply_T(T, POINTS))
    np.testing.assert_allclose(np.asarray(capture.viewpoint), T[:3, 3])


def test_plain_points_have_no_viewpoint_and_given_keys_are_taken_as_they_are(tmp_path: Path) -> None:
    assert _saved(tmp_path, points=POINTS).viewpoint is None
    assert _saved(tmp_path, points=POINTS).support_height is None
    given = _saved(tmp_path, points=POINTS, viewpoint=[1, 2, 3], up=[0, 1, 0], support_height=0.25)
    np.testing.assert_array_equal(given.viewpoint, [1, 2, 3])
    np.testing.assert_array_equal(given.up, [0, 1, 0])
    assert given.support_height == 0.25


def test_a_mask_gives_the_points_of_its_pixels(tmp_path: Path) -> None:
    mask = np.zeros((24, 32))
    mask[5:9, 10:15] = 1.0
    mask[0, 0] = np.nan
    capture = _saved(tmp_path, depth_m=DEPTH, K=K, T_world_camera=T, mask=mask)
    expected = apply_T(T, camera_points(DepthImage(DEPTH, K, T)))[5:9, 10:15].reshape(-1, 3)
    assert capture.points is not None
    assert capture.mask is not None
    np.testing.assert_allclose(capture.points, expected, atol=1e-9)
    assert capture.mask.dtype == bool
    assert capture.mask.sum() == 20


def test_organised_points_win_over_a_depth_picture_and_take_the_pose(tmp_path: Path) -> None:
    points = camera_points(DepthImage(DEPTH, K, np.eye(4)))
    capture = _saved(tmp_path, points_cam=points, depth_m=np.ones((4, 4)), K=np.eye(3), T_world_camera=T)
    assert capture.view is not None
    assert capture.view.depth_m.shape == (24, 32)
    np.testing.assert_array_equal(capture.view.T_world_camera, T)
    np.save(tmp_path / "b.npy", points)
    view = read_capture(tmp_path / "b.npy").view
    assert view is not None
    np.testing.assert_allclose(view.K, K, atol=1e-3)


def test_a_pose_that_turns_inside_out_or_scales_is_refused_and_rounding_is_not(tmp_path: Path) -> None:
    rounded = T.round(5)
    assert _saved(tmp_path, points=POINTS, T_world_camera=rounded).points is not None
    scaled = T.copy()
    scaled[:3, :3] *= 1.01
    for wrong in (scaled, T[:3]):
        with pytest.raises(InvalidView, match="rigid"):
            _saved(tmp_path, points=POINTS, T_world_camera=wrong)


def test_a_truth_without_its_faces_is_no_truth(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    keys = {"object_points_cam": POINTS, "T_world_camera": T, "mesh_vertices_cam": box.vertices}
    assert _saved(tmp_path, **keys).truth is None
    assert _saved(tmp_path, object_points_cam=POINTS, mesh_faces=box.faces).truth is None
    truth = _saved(tmp_path, **keys, mesh_faces=box.faces.astype(float)).truth
    assert truth is not None
    np.testing.assert_allclose(truth.vertices, apply_T(T, box.vertices))
    np.testing.assert_array_equal(truth.faces, box.faces)


def test_the_sample_that_ships_is_read_by_its_name() -> None:
    sample = read_capture("sample")
    assert sample.name == "quickstart.npz"
    assert sample.view is not None or sample.points is not None


def test_suffixes_are_read_in_any_case(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    (tmp_path / "a.npy").rename(tmp_path / "A.NPY")
    np.testing.assert_array_equal(read_capture(tmp_path / "A.NPY").points, POINTS)


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "x y z\n1 2 3\n4 5 6\n",
        "1,2,3\n4,5,6\n",
        "x;y;z\n1;2;3\n4;5;6",
        "1\t2\t3\t9\n4\t5\t6\t9\n",
        "\ufeff1 2 3 255 0 0\n4 5 6 255 0 0\n",
        "\n\n1 2 3\n4 5 6\n",
        "two points\nof one large mug\n1 2 3\n4 5 6\n",
    ],
)
def test_tables_of_every_separator_and_one_line_of_heading_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_capture(tmp_path / "a.txt").points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("text", ["", "x y z\n", "a b c\n1 2 3\n", "1 2\n3 4\n", "60\n", "1\n2\n3\n"])
def test_tables_without_rows_of_three_numbers_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableFile):
        read_capture(tmp_path / "a.txt")


def test_one_row_is_a_cloud_of_one_point(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n", encoding="utf-8")
    np.testing.assert_array_equal(read_capture(tmp_path / "a.xyz").points, [[1, 2, 3]])


def test_only_vertices_of_an_obj_are_points(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("# v 9 9 9\nv 1 2 3 0.5 0.5 0.5\nvn 7 7 7\n  v 4 5 6\nvt 8 8 8\nf 1 2 1\n")
    np.testing.assert_array_equal(read_capture(tmp_path / "a.obj").points, [[1, 2, 3], [4, 5, 6]])


def test_several_arrays_under_the_suffix_of_one_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=POINTS)
    (tmp_path / "a.npz").rename(tmp_path / "a.npy")
    with pytest.raises(UnreadableFile, match="several arrays"):
        read_capture(tmp_path / "a.npy")


# The Point Cloud Library's format


def _pcd(fields: str, kinds: str, sizes: str, counts: str | None, data: str, num: int) -> bytes:
    count = "" if counts is None else f"COUNT {counts}\n"
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {kinds}\n{count}POINTS {num}\nDATA {data}\n"
    ).encode()


def test_binary_fields_of_every_kind_and_count_are_stepped_over() -> None:
    head = _pcd("normal z flag x y", "F F I F U", "4 8 2 4 1", "3 1 2 1 1", "binary", 2)
    rows = [(9.0, 8.0, 7.0, 0.125, 5, 6, 1.5, 200), (9.0, 8.0, 7.0, -2.25, 5, 6, -0.5, 3)]
    body = b"".join(struct.pack("<fffdhhfB", *row) for row in rows)
    np.testing.assert_array_equal(parse_pcd(head + body).points, [[1.5, 200, 0.125], [-0.5, 3, -2.25]])
    np.testing.assert_array_equal(parse_pcd(head + body + b"more").points, [[1.5, 200, 0.125], [-0.5, 3, -2.25]])
    with pytest.raises(UnreadableFile, match="cut short"):
        parse_pcd(head + body[:-1])


def test_ascii_columns_follow_the_fields_and_counts_may_be_left_out() -> None:
    head = _pcd("rgb z x y", "U F F F", "4 4 4 4", None, "ASCII", 2)
    np.testing.assert_array_equal(parse_pcd(head + b"255 3 1 2\n0 6 4 5\n").points, [[1, 2, 3], [4, 5, 6]])
    head = _pcd("n x y z", "F F F F", "4 4 4 4", "2 1 1 1", "ascii", 1)
    np.testing.assert_array_equal(parse_pcd(head + b"9 9 1 2 3\n").points, [[1, 2, 3]])


def test_what_a_pcd_lacks_is_named() -> None:
    with pytest.raises(UnreadableFile, match="x y z are expected"):
        parse_pcd(_pcd("x y", "F F", "4 4", None, "ascii", 1) + b"1 2\n")
    with pytest.raises(UnreadableFile, match="cut short"):
        parse_pcd(_pcd("x y z", "F F F", "4 4 4", None, "binary_compressed", 1) + b"123")
    with pytest.raises(UnreadableFile, match="is base64; ascii, binary or binary_compressed"):
        parse_pcd(_pcd("x y z", "F F F", "4 4 4", None, "base64", 1) + b"123")
    with pytest.raises(UnreadableFile, match="lacks SIZE, TYPE, DATA"):
        parse_pcd(b"FIELDS x y z\nPOINTS 1\n1 2 3\n")
    with pytest.raises(UnreadableFile, match="lacks"):
        parse_pcd(b"\n".join(b"K%d 1" % n for n in range(40)) + b"\nDATA ascii\n1 2 3\n")


# What is handed to completion


class _Calls:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.single: dict = {}
        self.scene: dict = {}
        module = captures.capture  # type: ignore[attr-defined]
        monkeypatch.setattr(module, "complete_to_mesh", lambda points, **keys: self.single.update(keys, points=points))
        monkeypatch.setattr(module, "complete_scene", lambda view, **keys: self.scene.update(keys, view=view))


def test_a_picture_alone_is_completed_as_a_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, view = _Calls(monkeypatch), DepthImage(DEPTH, K, T)
    complete_capture(Capture("a", view=view, up=np.array([0.0, 1.0, 0.0])), detector="lidar", seed=7)
    assert calls.scene["view"] is view
    assert (calls.scene["seed"], calls.scene["detector"]) == (7, "lidar")
    np.testing.assert_array_equal(calls.scene["up"], [0, 1, 0])
    assert not calls.single


def test_a_detector_takes_the_picture_even_where_points_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, view = _Calls(monkeypatch), DepthImage(DEPTH, K, T)
    complete_capture(Capture("a", POINTS, view), detector="own:find")
    assert calls.scene["detector"] == "own:find"
    assert not calls.single
    complete_capture(Capture("a", view=view))
    assert calls.scene["detector"] is None  # complete_scene chooses one
    with pytest.raises(
        InvalidOption, match=r"detector 'own:find' looks for objects in a picture, and a.ply holds points"
    ):
        complete_capture(Capture("a.ply", POINTS), detector="own:find")


def test_points_are_completed_with_all_that_the_recording_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, view = _Calls(monkeypatch), DepthImage(DEPTH, K, T)
    points = apply_T(T, camera_points(view))
    mine = points[6:8, 9:12].reshape(-1, 3)
    up, viewpoint = np.array([0.0, 1.0, 0.0]), T[:3, 3]
    capture = Capture("a", mine, view, viewpoint=viewpoint, up=up, support_height=0.1)
    assert len(complete_capture(capture, category="mug", sensor="lidar", seed=3)) == 1
    assert calls.single["points"] is mine
    assert calls.single["view"] is view
    assert (calls.single["category"], calls.single["seed"], calls.single["support_height"]) == ("mug", 3, 0.1)
    assert calls.single["sensor"] == "lidar"
    assert calls.single["up"] is up
    assert calls.single["viewpoint"] is viewpoint
    assert calls.single["mask"] is None  # the completion marks the pixels that saw the points


def test_a_mask_that_was_recorded_is_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, mask = _Calls(monkeypatch), np.eye(24, 32, dtype=bool)
    complete_capture(Capture("a", POINTS, DepthImage(DEPTH, K, T), mask=mask))
    assert calls.single["mask"] is mask
    complete_capture(Capture("a", POINTS))
    assert calls.single["mask"] is None
    assert calls.single["seed"] == 0


def test_a_recording_of_nothing_is_refused() -> None:
    with pytest.raises(InvalidCloud, match="neither"):
        Capture("a")
