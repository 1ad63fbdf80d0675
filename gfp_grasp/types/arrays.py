"""Arrays of the types: checked once, where a type is made, and read-only afterwards."""

from __future__ import annotations

import numpy as np


def freeze(owner: object, name: str, array: np.ndarray) -> None:
    """Set a field of a frozen dataclass to a read-only copy of an array."""
    array = np.array(array)
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def checked_numbers(value: object, name: str, error: type[Exception]) -> np.ndarray:
    """float64 array of anything that holds numbers; raises the error given, with the name of the field."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as cause:
        raise error(f"{name} is a {type(value).__name__} that is no array of numbers: {cause}") from cause


def checked_matrix(value: object, shape: tuple[int, int], name: str, error: type[Exception]) -> np.ndarray:
    """A finite matrix of one shape; raises the error given, with the name of the field."""
    matrix = checked_numbers(value, name, error)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        finite = bool(np.isfinite(matrix).all())
        raise error(f"{name} has shape {matrix.shape}, finite: {finite}; finite {shape} is expected")
    return matrix


def checked_vector(value: object, length: int, name: str, error: type[Exception]) -> np.ndarray:
    """A finite vector of one length; raises the error given, with the name of the field."""
    vector = checked_numbers(value, name, error)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        finite = bool(np.isfinite(vector).all())
        raise error(f"{name} has shape {vector.shape}, finite: {finite}; finite ({length},) is expected")
    return vector
