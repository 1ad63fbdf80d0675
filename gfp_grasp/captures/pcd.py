"""The Point Cloud Library's files, version 0.7: ascii, binary and binary_compressed.

Source: "The PCD (Point Cloud Data) file format", Point Cloud Library documentation; the compression is that of LibLZF.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import UnreadableFile
from gfp_grasp.meshes import LARGEST_BYTES
from gfp_grasp.transforms import make_T

_KINDS = {"F": "f", "I": "i", "U": "u"}


@dataclass(frozen=True, eq=False)
class PcdCloud:
    """What a PCD file says.

    Attributes:
        points: (n, 3) float64; rows may be NaN.
        shape: Rows and columns where the points are organised as a picture, else None.
        T_viewpoint: (4, 4) pose of the sensor; None where it is the origin's, which files say that know of none.
    """

    points: np.ndarray
    shape: tuple[int, int] | None
    T_viewpoint: np.ndarray | None


def parse_pcd(content: bytes) -> PcdCloud:
    """Read a PCD file.

    Raises:
        UnreadableFile: No PCD header, no x y z among its fields, of an unknown encoding, or cut short.
    """
    header, body = _split(content)
    names = [name for name, count in zip(header["FIELDS"], _counts(header), strict=True) for _ in range(count)]
    if not {"x", "y", "z"} <= set(names):
        raise UnreadableFile(f"the PCD has fields {' '.join(names)}; x y z are expected among them")
    columns = [names.index(axis) for axis in "xyz"]
    width, height = (int(header.get(key, ["0"])[0]) for key in ("WIDTH", "HEIGHT"))
    num_points = int(header["POINTS"][0]) if "POINTS" in header else width * height
    encoding = header["DATA"][0].lower()
    if encoding == "ascii":
        points = np.loadtxt(io.BytesIO(body), ndmin=2, usecols=columns).astype(np.float64)
    elif encoding == "binary":
        points = _from_rows(body, _kinds(header), columns, num_points)
    elif encoding == "binary_compressed":
        points = _from_columns(_unpacked(body), _kinds(header), columns, num_points)
    else:
        raise UnreadableFile(f"the PCD's data is {encoding}; ascii, binary or binary_compressed is expected")
    organised = height > 1 and width > 1 and width * height == len(points)
    return PcdCloud(points, (height, width) if organised else None, _viewpoint(header.get("VIEWPOINT", [])))


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
    needed = ("FIELDS", "SIZE", "TYPE", *(() if "WIDTH" in header and "HEIGHT" in header else ("POINTS",)), "DATA")
    missing = [key for key in needed if not header.get(key)]
    if missing:
        raise UnreadableFile(f"the PCD's header lacks {', '.join(missing)}")
    return header, rest


def _counts(header: dict[str, list[str]]) -> list[int]:
    return [int(count) for count in header.get("COUNT", ["1"] * len(header["FIELDS"]))]


def _kinds(header: dict[str, list[str]]) -> list[tuple[str, int]]:
    """Type of each field, and how many numbers it holds."""
    kinds = [f"<{_KINDS[kind.upper()]}{size}" for size, kind in zip(header["SIZE"], header["TYPE"], strict=True)]
    return list(zip(kinds, _counts(header), strict=True))


def _from_rows(body: bytes, kinds: list[tuple[str, int]], columns: list[int], num_points: int) -> np.ndarray:
    layout = np.dtype([(f"{i}", kind) for i, kind in enumerate(k for kind, count in kinds for k in [kind] * count)])
    _refuse_short(num_points, num_points * layout.itemsize, body)
    rows = np.frombuffer(body, dtype=layout, count=num_points)
    return np.stack([rows[f"{column}"] for column in columns], axis=1).astype(np.float64)


def _from_columns(body: bytes, kinds: list[tuple[str, int]], columns: list[int], num_points: int) -> np.ndarray:
    """Compressed files hold all of the first field, then all of the second, and so on."""
    found: list[np.ndarray] = []
    start = 0
    for kind, count in kinds:
        size = np.dtype(kind).itemsize * count * num_points
        _refuse_short(num_points, start + size, body)
        found.extend(np.frombuffer(body, kind, count * num_points, start).reshape(num_points, count).T)
        start += size
    return np.stack([found[column] for column in columns], axis=1).astype(np.float64)


def _refuse_short(num_points: int, needed: int, body: bytes) -> None:
    if num_points < 0 or needed > len(body):
        raise UnreadableFile(f"the PCD promises {num_points} points but is cut short")


def _unpacked(body: bytes) -> bytes:
    if len(body) < 8:
        raise UnreadableFile("the PCD's compressed data is cut short")
    packed, size = struct.unpack_from("<II", body)
    if size > LARGEST_BYTES:
        raise UnreadableFile(f"unpacked the PCD has {size} bytes, at most {LARGEST_BYTES} are read")
    data = body[8 : 8 + packed]
    unpacked = _lzf(data) if len(data) == packed else b""
    if len(unpacked) != size:
        raise UnreadableFile(f"the PCD's compressed data is broken: {len(unpacked)} of {size} bytes came of it")
    return unpacked


def _lzf(data: bytes) -> bytes:
    """Unpack: a byte below 32 announces that many literals and one more; another, a copy of what came before.

    The copy's length is in the upper three bits (7: the next byte is added), less two; how far back it begins in the
    other five and the byte that follows, less one.
    """
    out, at = bytearray(), 0
    try:
        while at < len(data):
            control = data[at]
            at += 1
            if control < 32:
                out += data[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[at]
                at += 1
            start = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            if start < 0 or len(out) > LARGEST_BYTES:
                return b""
            piece = out[start : start + length + 2]
            while len(piece) < length + 2:  # the copy reaches into itself
                piece += piece[: length + 2 - len(piece)]
            out += piece
    except IndexError:
        return b""
    return bytes(out)


def _viewpoint(words: list[str]) -> np.ndarray | None:
    """(4, 4) of seven numbers: translation, then quaternion w x y z."""
    if len(words) != 7:
        return None
    numbers = np.array(words, dtype=np.float64)
    length = np.linalg.norm(numbers[3:])
    if not np.isfinite(numbers).all() or length < 1e-9:
        raise UnreadableFile(f"the PCD's VIEWPOINT is {' '.join(words)}; a place and a unit quaternion are expected")
    w, x, y, z = numbers[3:] / length
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T = make_T(R, numbers[:3])
    return None if np.allclose(T, np.eye(4), atol=1e-9) else T
