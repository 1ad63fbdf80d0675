"""The Point Cloud Library's file format, version 0.7: ascii and binary.

Source: "The PCD (Point Cloud Data) file format", Point Cloud Library documentation.
"""

import io

import numpy as np

from gfp_grasp.errors import UnreadableFile


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
