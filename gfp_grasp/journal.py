"""Results on disk as they come, so that a run that was stopped goes on where it was."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from gfp_grasp.errors import CannotWrite, InvalidOption, UnreadableFile


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


def read_figures(path: str | Path) -> dict[str, Any]:
    """The figures of a JSON file, by their names.

    Raises:
        UnreadableFile: The file is not there, or holds something else.
    """
    path = Path(path)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UnreadableFile(f"{path} is no readable JSON ({error}): name another file, or remove it") from error
    if not isinstance(content, dict):
        raise UnreadableFile(
            f"{path} holds a {type(content).__name__}; an object with figures is expected: "
            "name another file, or remove it"
        )
    return content


def write_whole(path: str | Path, text: str) -> None:
    """Write a file completely, or leave what was there before.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    write_file(path, lambda file: file.write(text.encode()))


def write_arrays(path: str | Path, **arrays: npt.ArrayLike) -> None:
    """Write arrays by their names as a whole .npz file, or leave what was there before.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    write_file(path, lambda file: np.savez_compressed(file, **arrays))  # pyright: ignore[reportArgumentType]


def write_file(path: str | Path, write: Callable[[IO[bytes]], object]) -> None:
    """Write a file completely, or leave what was there before.

    Args:
        path: The file; its folder is made where there is none.
        write: Writes the content to a file that is open.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    path = Path(path)
    beside = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with beside.open("wb") as file:
            write(file)
        beside.replace(path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
        raise _no_place(path, error) from error


def check_place(path: str | Path) -> None:
    """Refuse a file that could not be written, before any work is done for it; nothing is left there.

    Raises:
        CannotWrite: There is no right, no room or no such place, or a folder has the name.
    """
    path = Path(path).absolute()
    try:
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        with TemporaryFile(dir=next(parent for parent in path.parents if parent.exists())):
            pass
    except OSError as error:
        raise _no_place(path, error) from error


def _no_place(path: Path, error: OSError) -> CannotWrite:
    return CannotWrite(f"{path} cannot be written ({error.strerror or error}): make room or name another place")
