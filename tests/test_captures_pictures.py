"""Depth pictures as files: 16 bits and their unit, intrinsics as several programs write them, and refusals."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gfp_grasp.captures import Capture, read_capture, read_depth
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidOption, InvalidView, UnreadableFile
from gfp_grasp.transforms import make_T
from gfp_grasp.types import DepthImage

FX, FY, CX, CY = 38.5, 40.25, 15.0, 12.5
K = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
MILLIMETRES = np.random.default_rng(2).integers(400, 700, (24, 32)).astype(np.uint16)
MILLIMETRES[3, 4] = 0
CENTRED = {"fx": FX, "fy": FY, "cx": CX, "cy": CY}


def read(folder: Path, said: object, picture: np.ndarray = MILLIMETRES, scale: float | None = None) -> Capture:
    Image.fromarray(picture).save(folder / "depth.png")
    (folder / "k.json").write_text(json.dumps(said), encoding="utf-8")
    return read_depth(folder / "depth.png", folder / "k.json", depth_scale=scale)


def view_of(capture: Capture) -> DepthImage:
    assert capture.view is not None
    return capture.view


@pytest.mark.parametrize(
    "said",
    [
        {"K": K.tolist()},
        {"K": K.ravel().tolist(), "distortion_model": "plumb_bob"},
        K.tolist(),
        K.ravel().tolist(),
        CENTRED,
        {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "width": 32, "height": 24, "coeffs": [0, 0, 0, 0, 0]},
        {"width": 32, "height": 24, "intrinsic_matrix": K.T.ravel().tolist()},
        {"intrinsic": {"width": 32, "height": 24, "intrinsic_matrix": K.T.ravel().tolist()}, "extrinsic": []},
        {"camera_matrix": {"rows": 3, "cols": 3, "data": K.ravel().tolist()}},
        {"cam_K": K.ravel().tolist(), "depth_scale": 1.0},
    ],
)
def test_intrinsics_are_understood_as_programs_write_them(tmp_path: Path, said: object) -> None:
    view = view_of(read(tmp_path, said))
    np.testing.assert_array_equal(view.K, K)
    np.testing.assert_allclose(view.depth_m, MILLIMETRES / 1000, rtol=1e-6)
    assert view.depth_m[3, 4] == 0


@pytest.mark.parametrize(("scale", "unit_m"), [(0.001, 0.001), (1000.0, 0.001), (5000.0, 0.0002), (0.0001, 0.0001)])
def test_a_depth_scale_is_metres_of_a_unit_or_units_to_a_metre(tmp_path: Path, scale: float, unit_m: float) -> None:
    picture = (MILLIMETRES * (0.001 / unit_m)).astype(np.uint16)
    capture = read(tmp_path, CENTRED, picture, scale)
    np.testing.assert_allclose(view_of(capture).depth_m, picture * unit_m, rtol=1e-6)
    assert not any("unit" in note for note in capture.notes)


@pytest.mark.parametrize(("stated", "unit_m"), [(0.1, 0.0001), (5000, 0.0002), (0.00025, 0.00025)])
def test_a_depth_scale_that_the_intrinsics_state_is_heeded(tmp_path: Path, stated: float, unit_m: float) -> None:
    picture = (MILLIMETRES * (0.001 / unit_m)).astype(np.uint16)
    view = view_of(read(tmp_path, {**CENTRED, "depth_scale": stated}, picture))
    np.testing.assert_allclose(view.depth_m, picture * unit_m, rtol=1e-6)


def test_a_unit_and_a_frame_that_nobody_stated_are_told(tmp_path: Path) -> None:
    capture = read(tmp_path, CENTRED)
    assert any("taken to be 0.001 m" in note and "nearer than 0.549 m" in note for note in capture.notes)
    assert any("x right, y down, z forward" in note for note in capture.notes)
    assert capture.up is None
    np.testing.assert_array_equal(capture.viewpoint, [0, 0, 0])


def test_floats_are_metres(tmp_path: Path) -> None:
    metres = (MILLIMETRES / 1000).astype(np.float32)
    Image.fromarray(metres).save(tmp_path / "depth.tif")
    np.save(tmp_path / "depth.npy", metres)
    (tmp_path / "k.json").write_text(json.dumps(CENTRED), encoding="utf-8")
    for name in ("depth.tif", "depth.npy"):
        np.testing.assert_array_equal(view_of(read_depth(tmp_path / name, tmp_path / "k.json")).depth_m, metres)


@pytest.mark.parametrize(
    ("said", "picture", "scale", "error", "words"),
    [
        (CENTRED, MILLIMETRES, 1.0, InvalidView, "in millimetres it would be 0.549 m: divide by 1000"),
        (CENTRED, 10 * MILLIMETRES, 1.0, InvalidView, "in tenths of a millimetre it would be 0.549 m"),
        (CENTRED, MILLIMETRES, -1.0, InvalidOption, "depth_scale is -1.0"),
        ({**CENTRED, "fx": -300.0}, MILLIMETRES, None, InvalidView, "json: focal lengths are -300.0.*positive$"),
        ({"K": None}, MILLIMETRES, None, InvalidView, "K is None; 3 x 3 or nine numbers are expected"),
        (CENTRED, (MILLIMETRES // 4).astype(np.uint8), None, InvalidView, "8 bits and colours"),
        (CENTRED, np.zeros((24, 32, 3), np.uint8), None, InvalidView, "one channel of 16 bits"),
        (
            {**CENTRED, "width": 64, "height": 48},
            MILLIMETRES,
            None,
            InvalidView,
            "64 x 48 px, the depth picture has 32 x",
        ),
        ({"fx": 1.0, "f": 2.0}, MILLIMETRES, None, InvalidView, "k.json holds f, fx; K"),
        ({"K": [1.0, 2.0]}, MILLIMETRES, None, InvalidView, "k.json: the intrinsics"),
        ("pinhole", MILLIMETRES, None, UnreadableFile, "holds a str"),
    ],
)
def test_what_does_not_fit_is_refused_with_what_to_do(
    tmp_path: Path, said: object, picture: np.ndarray, scale: float | None, error: type[GfpGraspError], words: str
) -> None:
    with pytest.raises(error, match=words):
        read(tmp_path, said, picture, scale)


def test_a_file_that_is_no_picture_and_text_that_is_no_json_are_refused(tmp_path: Path) -> None:
    (tmp_path / "depth.png").write_bytes(b"\x89PNG nothing")
    (tmp_path / "k.json").write_text(json.dumps(CENTRED), encoding="utf-8")
    with pytest.raises(UnreadableFile, match=r"depth\.png is no picture in any known format"):
        read_depth(tmp_path / "depth.png", tmp_path / "k.json")
    (tmp_path / "k.json").write_text("fx: 3", encoding="utf-8")
    Image.fromarray(MILLIMETRES).save(tmp_path / "depth.png")
    with pytest.raises(UnreadableFile, match=r"k\.json is not readable JSON"):
        read_depth(tmp_path / "depth.png", tmp_path / "k.json")
    with pytest.raises(UnreadableFile, match="a depth picture goes by read_depth"):
        read_capture(tmp_path / "depth.png")
    np.save(tmp_path / "depth.npy", MILLIMETRES)
    with pytest.raises(InvalidCloud, match=r"shape \(24, 32\).* a depth picture goes by read_depth"):
        read_capture(tmp_path / "depth.npy")


# What an .npz says of its camera


def test_nine_numbers_are_intrinsics_and_a_transposed_matrix_is_refused() -> None:
    depth = MILLIMETRES / 1000
    np.testing.assert_array_equal(DepthImage(depth, K.ravel(), np.eye(4)).K, K)
    with pytest.raises(InvalidView, match="K is transposed"):
        DepthImage(depth, K.T, np.eye(4))


def test_a_pose_in_millimetres_is_refused_by_name(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "a.npz", depth_m=MILLIMETRES / 1000, K=K, T_world_camera=make_T(np.eye(3), (300.0, -100.0, 400.0))
    )
    with pytest.raises(
        InvalidView, match=r"T_world_camera puts the camera 509.9 m .* in millimetres it would be 0.51 m"
    ):
        read_capture(tmp_path / "a.npz")


@pytest.mark.parametrize(("factor", "unit"), [(1000, "in millimetres"), (10_000, "in tenths of a millimetre")])
def test_advice_about_units_fits_the_number_that_came(factor: int, unit: str) -> None:
    with pytest.raises(InvalidView, match=f"{unit} it would be 0.549 m: divide by {factor:g}"):
        DepthImage(MILLIMETRES / 1000 * factor, K, np.eye(4))


def test_organised_points_in_opengl_s_frame_are_a_picture_in_that_frame(tmp_path: Path) -> None:
    points = DepthImage(MILLIMETRES / 1000, K, np.eye(4)).points() * (1.0, -1.0, -1.0)
    np.save(tmp_path / "a.npy", points)
    capture = read_capture(tmp_path / "a.npy")
    view = view_of(capture)
    np.testing.assert_allclose(view.points(), points, atol=1e-5)
    np.testing.assert_array_equal(view.T_world_camera, np.diag([1.0, -1.0, -1.0, 1.0]))
    assert "y up and z backward" in capture.notes[0]
