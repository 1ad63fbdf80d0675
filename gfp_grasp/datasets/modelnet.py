"""ModelNet40's meshes of the four classes of GFPNet, and sets of whole shapes that completions are matched with.

Source: Wu et al., "3D ShapeNets: A Deep Representation for Volumetric Shapes", CVPR 2015, arXiv:1406.5670. Its meshes
have z up and no unit: a car may be 5 or 5000 long. They are given with their longest side 1, or of a length of their
class that is stated; all members of a class are then equally long, which the real ones are not. Neither are they turned
alike about z, and many are open.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.datasets.layouts import layout_of, read_dataset
from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.meshes import load_mesh
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import SPLITS

MODELNET_SPLITS = ("train", "test")
# Classes of the paper by the folder of ModelNet40 that holds them.
MODELNET_CLASSES = {"cup": "cup", "bottle": "bottle", "car": "car", "person": "pedestrian"}


def read_modelnet(
    root: str | Path,
    split: str = "train",
    *,
    classes: Sequence[str] | None = None,
    lengths_m: Mapping[str, float] | None = None,
    limit: int | None = None,
) -> dict[str, list[trimesh.Trimesh]]:
    """The meshes of the classes of the paper in a tree of ModelNet40.

    `read_dataset` reads all classes of such a tree, for training: as solids whose heights are drawn from their class.

    Args:
        root: Folder with `<class>/train/*.off` and `<class>/test/*.off`; it need not hold all four classes.
        split: "train" or "test", as the data set has them.
        classes: Keep these, some of the values of MODELNET_CLASSES; None keeps all four.
        lengths_m: Longest side of each class, m; None makes every longest side 1, which is no metre.
        limit: Most meshes of a class, the first by name; None reads all.

    Returns:
        {class: meshes in the order of their names}, each with z up, on z = 0, its middle over the origin; the faces
        are those of the file, so that a mesh need not be closed. A class without a mesh of this split is left out.

    Raises:
        InvalidOption: An unknown split or class, or a length or limit that is not positive, or is missing.
        UnreadableFile: No mesh of these classes and this split, or a broken one.
        InvalidMesh: A file that holds no usable triangles.
    """
    kept = tuple(MODELNET_CLASSES.values()) if classes is None else tuple(classes)
    _check_options(split, kept, lengths_m, limit)
    found: dict[str, list[trimesh.Trimesh]] = {}
    for folder, category in MODELNET_CLASSES.items():
        files = sorted((Path(root) / folder / split).glob("*.off")) if category in kept else []
        if files:
            length_m = 1.0 if lengths_m is None else lengths_m[category]
            found[category] = [_of_length(load_mesh(file), length_m) for file in files[:limit]]
    if not found:
        places = ", ".join(f"{folder}/{split}/*.off" for folder, name in MODELNET_CLASSES.items() if name in kept)
        raise UnreadableFile(f"{Path(root).name} holds none of ModelNet40's {places}")
    return found


def whole_shapes(folder: str | Path, *, limit: int | None = None) -> dict[str, list[trimesh.Trimesh]]:
    """Whole shapes in metres, by class: the stated set among which a completion looks for its nearest.

    Args:
        folder: A tree of ModelNet40, whose test split is read and scaled so that the longest side is that of the
            class's mean shape; or a folder of meshes in metres, z up, `<class>/<name>` or `<class>__<name>`.
        limit: Most shapes of a class, the first by name; None reads all.

    Returns:
        {class: meshes}, each on z = 0 with its middle over the origin; they need not be closed.

    Raises:
        InvalidOption: A limit that is not positive.
        UnreadableFile: Neither of these, or a broken mesh.
        InvalidMesh: A file that holds no usable triangles.
    """
    _check_limit(limit)
    layout = layout_of(folder)
    if layout == "modelnet":
        return read_modelnet(folder, "test", lengths_m=_mean_lengths_m(), limit=limit)
    if layout != "folder":
        raise UnreadableFile(
            f"{Path(folder).name} has the layout of {layout}; a tree of ModelNet40 or a folder of meshes in metres is "
            "expected"
        )
    sources = [source for split in SPLITS for source in read_dataset(folder, split, layout=layout)]
    found: dict[str, list[trimesh.Trimesh]] = {}
    for source in sorted(sources, key=lambda source: (source.category, source.name)):
        shapes = found.setdefault(source.category, [])
        if source.path is not None and (limit is None or len(shapes) < limit):
            shapes.append(_rested(load_mesh(source.path)))
    return found


def _check_options(
    split: str, classes: Sequence[str], lengths_m: Mapping[str, float] | None, limit: int | None
) -> None:
    if split not in MODELNET_SPLITS:
        raise InvalidOption(f"split is {split!r}; one of {', '.join(MODELNET_SPLITS)} is expected")
    known = set(MODELNET_CLASSES.values())
    if not classes or not set(classes) <= known:
        raise InvalidOption(
            f"classes are {', '.join(classes) or 'none'}; some of {', '.join(sorted(known))} are expected"
        )
    if lengths_m is not None:
        for category in classes:
            if not 0 < lengths_m.get(category, 0.0) < np.inf:
                raise InvalidOption(
                    f"lengths_m has {lengths_m.get(category)} for {category}; the longest side of the class in metres "
                    "is expected"
                )
    _check_limit(limit)


def _check_limit(limit: int | None) -> None:
    if limit is not None and limit < 1:
        raise InvalidOption(f"limit is {limit}; at least 1, or None, is expected")


def _of_length(mesh: trimesh.Trimesh, length_m: float) -> trimesh.Trimesh:
    mesh.apply_scale(length_m / float(mesh.extents.max()))
    return _rested(mesh)


def _rested(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    low, high = mesh.bounds
    mesh.apply_translation(-np.array([*((low + high)[:2] / 2), low[2]]))
    return mesh


def _mean_lengths_m() -> dict[str, float]:
    """Longest side of each class's mean shape, m."""
    library = PrimitiveLibrary.shipped()
    return {
        category: float(np.ptp(library.primitive(category).vertices, axis=0).max())
        for category in MODELNET_CLASSES.values()
    }
