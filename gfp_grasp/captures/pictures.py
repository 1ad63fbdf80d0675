"""Depth pictures as image files, with their intrinsics in JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from gfp_grasp.captures.capture import Capture
from gfp_grasp.captures.read import read_array
from gfp_grasp.errors import InvalidOption, InvalidView, UnreadableFile
from gfp_grasp.meshes import READER_ERRORS, read_content
from gfp_grasp.types import DepthImage

SUFFIXES = (".png", ".tif", ".tiff", ".npy")
_MATRICES = ("K", "cam_K", "camera_matrix", "intrinsic_matrix")
_INSIDE = ("intrinsic", "intrinsics", "depth_intrinsics", "depth")  # objects that hold the intrinsics
_CENTRES = (("cx", "cy"), ("ppx", "ppy"))
_MILLIMETRE = 0.001


def read_depth(path: str | Path, intrinsics: str | Path, *, depth_scale: float | None = None) -> Capture:
    """Read a depth picture; its camera's frame is the world, and up is estimated.

    Args:
        path: 16-bit .png or .tif, .tif of floats, or .npy of shape (h, w): depth along the optical axis, 0 where
            nothing came back.
        intrinsics: JSON with `K` (also `cam_K`, `camera_matrix`, Open3D's `intrinsic_matrix`) as 3 x 3 or nine numbers,
            or with `fx`, `fy`, `cx`, `cy` (or `ppx`, `ppy`); `width` and `height`, where it has them, are compared.
        depth_scale: Metres of one unit of the picture, at most 1, or units to a metre, above 1: 0.001 and 1000 are
            both millimetres. None takes what the JSON says, else millimetres for whole numbers and metres for others.

    Raises:
        UnreadableFile: A file that is not there or not what it should be.
        InvalidOption: A depth scale that is none.
        InvalidView: Picture and intrinsics do not fit each other, or the depth cannot be in the unit.
    """
    path = Path(path)
    depth = _read_picture(path)
    said = _read_json(Path(intrinsics))
    K = _matrix(Path(intrinsics).name, said)
    try:
        DepthImage(np.zeros((1, 1)), K, np.eye(4))
    except InvalidView as error:
        raise InvalidView(f"{Path(intrinsics).name}: {error}") from error
    _refuse_other_size(Path(intrinsics).name, said, depth.shape)
    unit_m, source = _unit(said, depth, depth_scale)
    far = float(np.median(depth[depth > 0])) if (depth > 0).any() else 0.0
    try:
        view = DepthImage(depth * unit_m, K, np.eye(4))
    except InvalidView as error:
        raise InvalidView(f"{path.name} with a unit of {unit_m:g} m ({source}): {error}; see --depth-scale") from error
    notes = [f"the frame is that of {path.name}'s camera, x right, y down, z forward"]
    if depth_scale is None:
        seen = f"half of the picture lies nearer than {far * unit_m:.3g} m"
        notes.append(f"a unit of {path.name} is taken to be {unit_m:g} m ({source}): {seen}; see --depth-scale")
    return Capture(path.name, view=view, viewpoint=np.zeros(3), notes=tuple(notes))


def _read_picture(path: Path) -> np.ndarray:
    if path.suffix.lower() not in SUFFIXES:
        raise UnreadableFile(f"{path.name}: suffix {path.suffix!r} is not among {', '.join(SUFFIXES)}")
    content = read_content(path)
    if path.suffix.lower() == ".npy":
        picture = read_array(path.name, content)
    else:
        try:
            picture = np.asarray(Image.open(io.BytesIO(content)))
        except UnidentifiedImageError as error:
            raise UnreadableFile(f"{path.name} is no picture in any known format, whatever its suffix says") from error
        except (*READER_ERRORS, Image.DecompressionBombError) as error:
            raise UnreadableFile(f"{path.name} is not a readable picture: {error}") from error
    if picture.ndim != 2 or picture.dtype.kind not in "fiu" or picture.dtype.itemsize < 2:
        raise InvalidView(
            f"{path.name} is a picture of {picture.dtype} with shape {picture.shape}; one channel of 16 bits or of "
            "floats is expected: 8 bits and colours are made for the eye and hold no distances"
        )
    return picture


def _read_json(path: Path) -> Mapping[str, object]:
    try:
        said = json.loads(read_content(path))
    except ValueError as error:
        if isinstance(error, UnreadableFile):
            raise
        raise UnreadableFile(f"{path.name} is not readable JSON: {error}") from error
    if isinstance(said, list):  # the bare matrix
        return {"K": said}
    if not isinstance(said, dict):
        raise UnreadableFile(
            f"{path.name} holds a {type(said).__name__}; an object with K, or fx, fy, cx, cy is expected"
        )
    return next((said[key] for key in _INSIDE if isinstance(said.get(key), dict)), said)


def _matrix(name: str, said: Mapping[str, object]) -> np.ndarray:
    """K (3, 3) px."""
    try:
        for key in _MATRICES:
            if key in said:
                given = said[key]
                K = np.asarray(given["data"] if isinstance(given, dict) else given, dtype=np.float64)
                if K.size != 9:
                    raise ValueError(f"{key} is {given!r:.60}; 3 x 3 or nine numbers are expected")
                K = K.reshape(3, 3)
                # Open3D writes column by column: then the last row is where the last column should be.
                return K.T if not K[:2, 2].any() and K[2, :2].any() else K
        for centre in _CENTRES:
            if {"fx", "fy", *centre} <= set(said):
                fx, fy, cx, cy = (float(said[key]) for key in ("fx", "fy", *centre))  # type: ignore[arg-type]
                return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    except (TypeError, ValueError, KeyError) as error:
        raise InvalidView(f"{name}: the intrinsics are not the numbers that they should be: {error}") from error
    raise InvalidView(
        f"{name} holds {', '.join(sorted(said)) or 'nothing'}; K (3 x 3 or nine numbers), or fx, fy, cx, cy, in px, "
        "is expected"
    )


def _refuse_other_size(name: str, said: Mapping[str, object], shape: tuple[int, ...]) -> None:
    size = said.get("height"), said.get("width")
    if None not in size and size != shape:
        raise InvalidView(
            f"{name} is of a picture of {size[1]} x {size[0]} px, the depth picture has {shape[1]} x {shape[0]}: give "
            "the intrinsics of the depth picture itself"
        )


def _unit(said: Mapping[str, object], depth: np.ndarray, depth_scale: float | None) -> tuple[float, str]:
    """Metres of one unit of the picture, and who says so."""
    if depth_scale is not None:
        if not 0 < depth_scale < np.inf:
            raise InvalidOption(f"depth_scale is {depth_scale}; metres of one unit (0.001), or units to a metre (1000)")
        return (depth_scale if depth_scale <= 1 else 1 / depth_scale), "given"
    stated = said.get("depth_scale")
    if isinstance(stated, (int, float)) and stated > 0:
        if stated >= 100:  # units to a metre, as Open3D and TUM say it
            return 1 / stated, "as the intrinsics say"
        # Data sets of BOP say how many millimetres a unit has; nobody's unit is a decimetre.
        return (stated if stated <= 0.01 else stated * _MILLIMETRE), "as the intrinsics say"
    return (
        (_MILLIMETRE, "whole numbers mostly are millimetres")
        if depth.dtype.kind in "iu"
        else (1.0, "floats mostly are metres")
    )
