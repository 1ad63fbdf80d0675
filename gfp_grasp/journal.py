"""Results on disk as they come, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from gfp_grasp.errors import CannotWrite, InvalidOption


class Journal:
    """A file of results, one in each line, below a line with the settings that they were made with.

    A last line that is incomplete, because its run was stopped, is removed.

    Attributes:
        path: The file.
        records: The results that the file held when it was opened.

    Raises:
        InvalidOption: The file holds results of other settings, or something else.
        CannotWrite: The file cannot be written.
    """

    def __init__(self, path: str | Path, settings: Mapping[str, object]) -> None:
        self.path = Path(path)
        head = json.dumps(settings, sort_keys=True, allow_nan=False)
        lines = self._whole_lines()
        if lines and lines[0] != head:
            raise InvalidOption(
                f"{self.path.name} holds results of another run, which would be lost: give that run's options, "
                "or remove the file"
            )
        self.records: list[dict[str, Any]] = [json.loads(line) for line in lines[1:]]
        if not lines:
            self._try(lambda: self.path.parent.mkdir(parents=True, exist_ok=True))
            self._append(head)

    def add(self, record: Mapping[str, object]) -> None:
        """Write one result down.

        Raises:
            CannotWrite: There is no room, or no right; all lines before this one are whole.
        """
        self._append(json.dumps(record, allow_nan=False))

    def _whole_lines(self) -> list[str]:
        """Complete lines of the file; an incomplete last line is removed from it."""
        if not self.path.exists():
            return []
        try:
            content = self.path.read_bytes()
            whole = content.rfind(b"\n") + 1
            if whole < len(content):
                with self.path.open("r+b") as file:
                    file.truncate(whole)
            return content[:whole].decode("utf-8").splitlines()
        except UnicodeDecodeError:
            raise InvalidOption(f"{self.path.name} holds no results: name another file, or remove it") from None
        except OSError as error:
            raise self._cannot(error) from error

    def _append(self, line: str) -> None:
        def write() -> None:
            with self.path.open("ab") as file:
                file.write(line.encode("utf-8") + b"\n")

        self._try(write)

    def _try(self, act: Callable[[], object]) -> None:
        try:
            act()
        except OSError as error:
            raise self._cannot(error) from error

    def _cannot(self, error: OSError) -> CannotWrite:
        return CannotWrite(
            f"{self.path.name} cannot be written ({error.strerror or error}): make room or name another place; "
            "what was written before is kept, and the same command goes on from there"
        )


def write_whole(path: str | Path, text: str) -> None:
    """Write a file completely, or leave what was there before.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    _replace(Path(path), lambda file: file.write(text.encode()))


def write_arrays(path: str | Path, **arrays: npt.ArrayLike) -> None:
    """Write arrays by their names as a whole .npz file, or leave what was there before.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    _replace(Path(path), lambda file: np.savez_compressed(file, **arrays))  # pyright: ignore[reportArgumentType]


def _replace(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as file:
            write(file)
        beside.replace(path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise CannotWrite(
            f"{path.name} cannot be written ({error.strerror or error}): make room or name another place"
        ) from error
