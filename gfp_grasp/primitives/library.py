"""The classes that there are: primitives of one or more folders of cards."""

from __future__ import annotations

import os
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import UnknownCategory, UnreadableFile
from gfp_grasp.primitives.store import read_primitive, read_spec
from gfp_grasp.types import CategorySpec, GenericPrimitive


class PrimitiveLibrary:
    """Primitives of one or more folders, as `save_primitive` writes them; the one list of classes.

    Folders are listed at the first question, and a primitive is read when it is first asked for. Libraries of the same
    folders are equal, and they pickle as those folders.

    Attributes:
        folders: Where the primitives lie; a class of a later folder replaces that of an earlier one with its
            subcategories.
        left_out: Classes that the folders hold and the library does not.
    """

    def __init__(self, *folders: str | os.PathLike[str], left_out: Iterable[str] = ()) -> None:
        """Name the folders, and classes of them to leave out.

        Raises:
            UnreadableFile: One of them is no folder, or none was named.
        """
        if not folders:
            raise UnreadableFile("a library of no folder has no class: name one, or use PrimitiveLibrary.shipped()")
        for folder in folders:
            if not Path(folder).is_dir():
                raise UnreadableFile(f"{folder} is no folder: give one that `gfp-grasp gps build ... --out` wrote")
        self.folders = tuple(Path(folder).resolve() for folder in folders)
        self.left_out = frozenset(left_out)
        self._paths: dict[str, Path] | None = None

    @classmethod
    def shipped(cls) -> PrimitiveLibrary:
        """The primitives that ship with the package; the same library every time."""
        return _shipped()

    @classmethod
    def with_shipped(cls, *folders: str | os.PathLike[str]) -> PrimitiveLibrary:
        """The primitives that ship with the package and those of more folders, whose classes replace shipped ones."""
        return cls(data_dir("gps"), *folders) if folders else cls.shipped()

    @classmethod
    def from_option(cls, folders: str) -> PrimitiveLibrary:
        """The shipped primitives and those of folders in one text, with a colon (on Windows, a semicolon) between."""
        return cls.with_shipped(*filter(None, folders.split(os.pathsep)))

    def without(self, *categories: str) -> PrimitiveLibrary:
        """The same library without some classes and their subcategories.

        Raises:
            UnknownCategory: There is no such class.
        """
        for category in categories:
            self._path(category)
        return PrimitiveLibrary(*self.folders, left_out=self.left_out | set(categories))

    @property
    def categories(self) -> tuple[str, ...]:
        """Classes in alphabetical order, without subcategories."""
        return tuple(name for name in self.names if "." not in name)

    @property
    def names(self) -> tuple[str, ...]:
        """Classes in alphabetical order, each followed by its subcategories ("cup", "cup.lidded")."""
        return tuple(self._index())

    def primitive(self, name: str) -> GenericPrimitive:
        """The primitive of a class ("cup") or of a subcategory ("cup.stemmed").

        Raises:
            UnknownCategory: There is no such primitive; the message lists the classes.
            AssetMissing, UnreadableFile: Its files are damaged; the message names them.
        """
        return _read(self._path(name), *_stamp(self._path(name)))

    def members_of(self, category: str) -> tuple[GenericPrimitive, ...]:
        """The primitive of a class, then those of its subcategories in alphabetical order.

        Raises:
            UnknownCategory: There is no such class.
            AssetMissing, UnreadableFile: A file is damaged; the message names it.
        """
        self._path(category)
        return tuple(self.primitive(name) for name in self.names if name.split(".")[0] == category)

    def spec(self, name: str) -> CategorySpec:
        """What is known of a class or subcategory; reads the card alone.

        Raises:
            UnknownCategory: There is no such primitive.
            AssetMissing, UnreadableFile: Its files are damaged; the message names them.
        """
        return _read_spec(self._path(name), *_stamp(self._path(name).with_suffix(".json")))

    def __contains__(self, name: object) -> bool:
        return name in self._index()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, PrimitiveLibrary) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[tuple[Path, ...], frozenset[str]]:
        return self.folders, self.left_out

    def __repr__(self) -> str:
        without = f" without {', '.join(sorted(self.left_out))}" if self.left_out else ""
        return f"PrimitiveLibrary({', '.join(map(str, self.folders))}{without})"

    def __getstate__(self) -> dict[str, object]:
        # The package may lie elsewhere where the pickle is read; listings are made anew there.
        shipped = _shipped_folder()
        folders = tuple(None if folder == shipped else folder for folder in self.folders)
        return {"folders": folders, "left_out": self.left_out}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.folders = tuple(_shipped_folder() if folder is None else folder for folder in state["folders"])
        self.left_out = state["left_out"]
        self._paths = None

    def _index(self) -> dict[str, Path]:
        """Path of each primitive's arrays by its name, in the order of `names`."""
        if self._paths is None:
            paths: dict[str, Path] = {}
            for folder in self.folders:
                found = {path.name.removesuffix(".safetensors"): path for path in folder.glob("*.safetensors")}
                if not found:
                    raise UnreadableFile(
                        f"{folder} holds no primitive: `gfp-grasp gps build CLASS --out FOLDER` makes one"
                    )
                replaced = {name for name in found if "." not in name}
                paths = {name: path for name, path in paths.items() if name.split(".")[0] not in replaced} | found
                for name in found:
                    if name.split(".")[0] not in paths:
                        raise UnreadableFile(f"{found[name]} is a subcategory of a class that no folder holds")
            kept = {name: path for name, path in paths.items() if name.split(".")[0] not in self.left_out}
            if not kept:
                raise UnknownCategory(f"no class is left of {', '.join(sorted(self.left_out))}: leave out fewer")
            self._paths = dict(sorted(kept.items(), key=lambda item: item[0].split(".")))
        return self._paths

    def _path(self, name: str) -> Path:
        path = self._index().get(name)
        if path is None:
            raise UnknownCategory(
                f"there is no primitive of {name!r}; there are {', '.join(self.categories)}; `gfp-grasp gps build` "
                "makes one from a folder of meshes, and --gps FOLDER or PrimitiveLibrary.with_shipped(FOLDER) adds it"
            )
        return path


@lru_cache(maxsize=1)
def _shipped() -> PrimitiveLibrary:
    return PrimitiveLibrary(data_dir("gps"))


def _shipped_folder() -> Path:
    return data_dir("gps").resolve()


def _stamp(path: Path) -> tuple[int, int]:
    """Time and size of a file: one that is written anew is read anew."""
    try:
        found = path.stat()
    except FileNotFoundError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=256)
def _read(path: Path, mtime_ns: int, size: int) -> GenericPrimitive:
    return read_primitive(path)


@lru_cache(maxsize=1024)
def _read_spec(path: Path, mtime_ns: int, size: int) -> CategorySpec:
    return read_spec(path)
