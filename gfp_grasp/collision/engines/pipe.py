"""Messages between the guard and its child: a JSON header and raw arrays, so that nothing is unpickled."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import IO

import numpy as np

_LENGTH = struct.Struct("<Q")


def send(stream: IO[bytes], header: Mapping[str, object], arrays: Sequence[np.ndarray] = ()) -> None:
    """Write one message.

    Raises:
        OSError: Nobody reads at the other end.
    """
    arrays = [np.ascontiguousarray(array) for array in arrays]
    layout = [[array.dtype.str, list(array.shape)] for array in arrays]
    text = json.dumps({"header": dict(header), "arrays": layout}).encode()
    stream.write(_LENGTH.pack(len(text)) + text)
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[dict[str, object], list[np.ndarray]]:
    """Read one message.

    Raises:
        EOFError: The stream ended before the message did.
    """
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    message = json.loads(_exactly(stream, length))
    arrays = []
    for kind, shape in message["arrays"]:
        count = int(np.prod(shape, dtype=np.int64))
        raw = _exactly(stream, count * np.dtype(kind).itemsize)
        arrays.append(np.frombuffer(raw, dtype=kind).reshape(shape))
    return message["header"], arrays


def _exactly(stream: IO[bytes], count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise EOFError(f"{len(data)} of {count} bytes came")
    return data
