"""Which files of a data set are meshes of which class, and of which split.

ModelNet40 and ShapeNet tell no size: their meshes are given one, drawn from the sizes of the class.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.meshes import SUFFIXES
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource, class_and_name
from gfp_grasp.shapes import SPLITS

LAYOUTS = ("modelnet", "shapenet", "folder")
# Classes of ShapeNetCore by their WordNet number, where no card of a class names it; others keep the number for a name.
_SYNSETS = {"02880940": "bowl", "02946921": "can", "03593526": "jar"}
_TALL_M = (0.15, 0.15)  # height of a class that has no primitive: median, and deviation of its logarithm


@dataclass(frozen=True)
class _Found:
    """A mesh file, what it is, and its split where the data set says so."""

    path: Path
    name: str
    category: str
    split: str = ""


def layout_of(root: str | Path) -> str:
    """Which of LAYOUTS a folder has.

    Args:
        root: ModelNet40's folder (`<class>/train/*.off`), ShapeNetCore's (`<synset>/<id>/models/model_normalized.obj`),
            or one with `<class>/<name>.<suffix>` or `<class>__<name>.<suffix>`.

    Raises:
        UnreadableFile: No such folder, or no mesh in any of these places.
    """
    folder = Path(root)
    if not folder.is_dir():
        raise UnreadableFile(f"{root} is no folder: give that of ModelNet40, of ShapeNetCore, or one of meshes")
    for layout in LAYOUTS:
        if next(_FIND[layout](folder, {}), None) is not None:
            return layout
    raise UnreadableFile(
        f"{folder.name} holds no mesh as <class>/train/*.off (ModelNet40), <synset>/<id>/models/model_normalized.obj "
        f"(ShapeNetCore), <class>/<name> or <class>__<name> with a suffix of {', '.join(SUFFIXES)}"
    )


def read_dataset(
    root: str | Path,
    split: str = "train",
    *,
    classes: Sequence[str] | None = None,
    layout: str | None = None,
    library: PrimitiveLibrary | None = None,
) -> tuple[ObjectSource, ...]:
    """The meshes of a data set, not loaded yet; each loads as a watertight mesh in metres, z up, on z = 0.

    ModelNet's own train folder is shared between train and val, one in ten; of ShapeNet and folders one in ten is val
    and one in ten test, by the name of the file, so that a file's split never changes. Plain folders are in metres with
    z up; ModelNet has z up and ShapeNet y, and both are scaled to a height drawn from their class by the file's name.

    Args:
        root: Folder, as `layout_of` takes it.
        split: "train", "val" or "test".
        classes: Keep these; None keeps all.
        layout: One of LAYOUTS; None looks.
        library: Its cards say what the data set calls a class, and how large its members are; None for the shipped one.

    Returns:
        In the order of their names.

    Raises:
        InvalidOption: An unknown split or layout.
        UnreadableFile: No such folder, or no mesh in it.
    """
    if split not in SPLITS:
        raise InvalidOption(f"split is {split!r}; one of {', '.join(SPLITS)} is expected")
    layout = layout or layout_of(root)
    if layout not in LAYOUTS:
        raise InvalidOption(f"layout is {layout!r}; one of {', '.join(LAYOUTS)} is expected")
    library = library or PrimitiveLibrary.shipped()
    found = sorted(_FIND[layout](Path(root), _class_by_name(layout, library)), key=lambda f: (f.category, f.name))
    if not found:
        raise UnreadableFile(f"{Path(root).name} holds no mesh in the layout of {layout}")
    return tuple(
        ObjectSource(
            f.name,
            f.category,
            path=f.path,
            up="y" if layout == "shapenet" else "z",
            height_m=None if layout == "folder" else _height_m(f, library),
        )
        for f in found
        if _split(f) == split and (classes is None or f.category in classes)
    )


def _split(found: _Found) -> str:
    tenth = zlib.crc32(found.name.encode()) % 10
    if found.split:
        return "val" if found.split == "train" and tenth == 0 else found.split
    return {0: "val", 1: "test"}.get(tenth, "train")


def _class_by_name(layout: str, library: PrimitiveLibrary) -> dict[str, str]:
    """The library's classes by the names that a data set has for them."""
    others = _SYNSETS if layout == "shapenet" else {}
    named = {name: category for category in library.categories for name in library.spec(category).names.get(layout, ())}
    return others | named


def _height_m(found: _Found, library: PrimitiveLibrary) -> float:
    """Height drawn from the sizes of the class, the same for the same file."""
    median_m, spread = _TALL_M
    if found.category in library:
        primitive = library.primitive(found.category)
        median_m, spread = float(np.ptp(primitive.vertices[:, 2])), float(np.sqrt(primitive.log_scale_cov[2, 2]))
    draw = np.random.default_rng(zlib.crc32(found.name.encode())).normal()
    return median_m * float(np.exp(spread * np.clip(draw, -2, 2)))


def _modelnet(root: Path, classes: Mapping[str, str]) -> Iterator[_Found]:
    for path in sorted(root.glob("*/*/*.off")):
        if path.parent.name in ("train", "test"):
            folder = path.parent.parent.name
            yield _Found(path, path.stem, classes.get(folder, folder), path.parent.name)


def _shapenet(root: Path, classes: Mapping[str, str]) -> Iterator[_Found]:
    for path in sorted([*root.glob("*/*/models/model_normalized.obj"), *root.glob("*/*/model.obj")]):
        identity = path.parent.parent if path.parent.name == "models" else path.parent
        synset = identity.parent.name
        yield _Found(path, f"{synset}-{identity.name}", classes.get(synset, synset))


def _folder(root: Path, classes: Mapping[str, str]) -> Iterator[_Found]:
    for path in sorted([*root.iterdir(), *root.glob("*/*")]):
        if path.is_file() and path.suffix.lower() in SUFFIXES:
            category, name = class_and_name(path) if path.parent == root else (path.parent.name, path.stem)
            if category:
                yield _Found(path, f"{category}-{name}", category)


_FIND: dict[str, Callable[[Path, Mapping[str, str]], Iterator[_Found]]] = {
    "modelnet": _modelnet,
    "shapenet": _shapenet,
    "folder": _folder,
}
