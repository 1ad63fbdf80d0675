"""Where objects come from: a procedural family, a kind of things of no class, one mesh file, or a folder of them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.meshes import SUFFIXES, load_mesh
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes.objects import LARGEST_M, Decompose, rested, solid_mesh, true_object
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import TrueObject

_OF_A_KIND = 100  # things of no class, of which there is no end; ours
ALL_FAMILIES = "all"  # in place of the names of `shipped_families`


@dataclass(frozen=True)
class ObjectSource:
    """An object that can be loaded; light, and pickles into workers.

    Attributes:
        name: Name of the mesh in its data set, never a path.
        category: Class, or "" where it is unknown.
        family: Procedural family, or kind of things of no class; "" for a file.
        seed: Seed of the procedural shape, or number within the kind.
        split: Split that the number counts in; "" for all but a kind.
        path: Mesh file, or None for a procedural shape.
        up: Axis of the file that is up, "z" or "y".
        height_m: Height that the file is scaled to; None where it is in metres.
    """

    name: str
    category: str
    family: str = ""
    seed: int = 0
    split: str = ""
    path: Path | None = None
    up: Literal["z", "y"] = "z"
    height_m: float | None = None

    def load_mesh(self, *, largest_m: float = LARGEST_M) -> trimesh.Trimesh:
        """The watertight mesh (m, z up, resting on z = 0), without convex parts: enough for looking at it.

        Args:
            largest_m: A file whose longest side is longer is not in metres.
        """
        if self.path is not None:
            return rested(solid_mesh(self._in_metres(load_mesh(self.path)), largest_m=largest_m))
        from gfp_grasp.shapes import make_mixture, make_shape

        if self.split:
            return make_mixture(self.family, self.seed, split=self.split)
        return rested(make_shape(self.family, self.seed).mesh)  # a volume, but of any size: networks see lorries too

    def _in_metres(self, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        """The mesh with z up and of the height that it should have."""
        if self.up == "y":
            mesh = mesh.copy()
            mesh.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2), np.zeros(3)))
        if self.height_m is not None:
            mesh = mesh.copy()
            mesh.apply_scale(self.height_m / max(float(mesh.extents[2]), 1e-12))
        return mesh

    def load(
        self,
        rng: np.random.Generator | None = None,
        *,
        decompose: Decompose | None = None,
        library: PrimitiveLibrary | None = None,
    ) -> TrueObject:
        """The object with parts, mass and friction.

        Args:
            rng: Draws mass and friction; None draws them from the name, the same every time.
            decompose: As true_object takes it.
            library: Knows what members of the object's class weigh; None takes the classes that ship.
        """
        rng = np.random.default_rng(zlib.crc32(self.name.encode())) if rng is None else rng
        library = PrimitiveLibrary.shipped() if library is None else library
        spec = library.spec(self.category) if self.category in library else None
        return true_object(self.load_mesh(), self.name, self.category, rng, decompose, spec=spec)


def load_objects(
    family_or_folder: str | Path, split: str = "test", limit: int | None = None
) -> tuple[ObjectSource, ...]:
    """Objects of procedural families or of mesh files, not loaded yet.

    Args:
        family_or_folder: A procedural family or a kind of things of no class, several with commas between;
            "household", "traffic" or "unknown" for all of a group, "all" for the household families whose classes ship;
            a mesh file, or a folder of mesh files named `<class>__<name>.<suffix>`, or just `<name>.<suffix>` where
            the class is unknown.
        split: Seeds of a family: train, val or test. Files have no split.
        limit: Most objects: families take turns, files come in the order of their names.

    Raises:
        InvalidOption: No family, file or folder of that name, an unknown split, or a limit below one.
        UnreadableFile: The file is of another suffix, or the folder holds no mesh.
    """
    from gfp_grasp.shapes import FAMILIES, MIXTURES, SPLITS

    if split not in SPLITS:
        raise InvalidOption(f"split is {split!r}; legal are {', '.join(SPLITS)}")
    if limit is not None and limit < 1:
        raise InvalidOption(f"limit is {limit}; at least 1, or None, is expected")
    families, known = _families(family_or_folder), (*FAMILIES, *MIXTURES)
    if not families:
        raise InvalidOption(
            f"objects is {str(family_or_folder)!r}; families ({', '.join(known)}), a mesh file or a folder"
        )
    if all(family in known for family in families):
        return _in_turns([_shape_sources(family, split) for family in families])[:limit]
    path = Path(family_or_folder)
    if path.is_file():
        if path.suffix.lower() not in SUFFIXES:
            raise UnreadableFile(f"{path.name}: suffix {path.suffix!r} is not among {', '.join(SUFFIXES)}")
        return (_file_source(path),)
    if path.is_dir():
        return _folder_sources(path)[:limit]
    raise InvalidOption(
        f"objects {str(family_or_folder)!r} is no family ({', '.join(known)}), no mesh file and no folder"
    )


def shipped_families() -> tuple[str, ...]:
    """The household families whose classes ship with the package."""
    from gfp_grasp.shapes import HOUSEHOLD

    return tuple(family for family in HOUSEHOLD if family in PrimitiveLibrary.shipped().categories)


def label_of(objects: str | Path) -> str:
    """Families by their names, files and folders by their own name: results never hold a path."""
    group = _groups().get(str(objects))
    if group is not None:
        return ",".join(group)
    return Path(objects).resolve().name if Path(objects).exists() else str(objects)


def class_and_name(path: Path) -> tuple[str, str]:
    """Class and name from `<class>__<name>.<suffix>`; the class is "" where the file's name does not say it."""
    category, _, name = path.stem.partition("__")
    return (category, name) if category and name else ("", path.stem)


def _families(objects: str | Path) -> list[str]:
    group = _groups().get(str(objects))
    if group is not None:
        return list(group)
    return [family.strip() for family in str(objects).split(",") if family.strip()]


def _groups() -> dict[str, tuple[str, ...]]:
    """Families of which one word stands for all."""
    from gfp_grasp.shapes import HOUSEHOLD, MIXTURES, TRAFFIC

    return {ALL_FAMILIES: shipped_families(), "household": HOUSEHOLD, "traffic": TRAFFIC, "unknown": MIXTURES}


def _shape_sources(family: str, split: str) -> list[ObjectSource]:
    from gfp_grasp.shapes import MIXTURES, split_seeds

    if family in MIXTURES:
        numbers = range(_OF_A_KIND)
        return [ObjectSource(f"{family}-{i}", "", family=family, seed=i, split=split) for i in numbers]
    seeds = split_seeds(family, split)
    return [ObjectSource(f"{family}-{seed}", family, family=family, seed=int(seed)) for seed in seeds]


def _in_turns(lists: list[list[ObjectSource]]) -> tuple[ObjectSource, ...]:
    longest = max(len(sources) for sources in lists)
    return tuple(sources[i] for i in range(longest) for sources in lists if i < len(sources))


def _folder_sources(folder: Path) -> tuple[ObjectSource, ...]:
    files = sorted(file for file in folder.iterdir() if file.is_file() and file.suffix.lower() in SUFFIXES)
    if not files:
        raise UnreadableFile(
            f"{folder} holds no mesh: files that end in {', '.join(SUFFIXES)} are looked for, subfolders are not"
        )
    sources = tuple(_file_source(file) for file in files)
    if len({source.name for source in sources}) < len(sources):  # a.ply beside a.obj
        return tuple(_file_source(file, whole_name=True) for file in files)
    return sources


def _file_source(path: Path, *, whole_name: bool = False) -> ObjectSource:
    category, name = class_and_name(path)
    return ObjectSource(path.name if whole_name else name, category, path=path)
