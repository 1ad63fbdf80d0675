"""The demonstration's own objects: shapes of the held-out split whose convex parts ship with the package.

Making the parts takes seconds for each object, which a demonstration should not wait for.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gfp_grasp.assets import data_dir
from gfp_grasp.collision import parts_from_arrays, parts_to_arrays
from gfp_grasp.scenes import ObjectSource, load_objects, mesh_sha256
from gfp_grasp.types import CollisionMesh, TrueObject

FILE = "demo_parts.npz"
# Families and places in their held-out splits: objects unlike each other, each narrow enough somewhere for the gripper.
CLUTTER = (("mug", 7), ("bottle", 8), ("cup", 9), ("mug", 1))
SINGLE = (("mug", 4),)


def pick_objects(places: Sequence[tuple[str, int]], *, seed: int = 0) -> tuple[ObjectSource, ...]:
    """Objects by family and place in its held-out split; another seed moves all places on."""
    splits = {family: load_objects(family, split="test") for family, _ in places}
    return tuple(splits[family][(place + seed) % len(splits[family])] for family, place in places)


def load_asset(source: ObjectSource) -> TrueObject:
    """The object with the parts that ship for its mesh; where there are none, they are made."""
    shipped = read_parts(data_dir("sim_scenes") / FILE).get(mesh_sha256(source.load_mesh()))
    return source.load(decompose=None if shipped is None else lambda mesh: shipped)


def write_parts(objects: Sequence[TrueObject], path: Path) -> None:
    """Write the convex parts of objects to a file, under the hash of each mesh."""
    arrays: dict[str, np.ndarray] = {}
    for thing in objects:
        key = mesh_sha256(thing.mesh)
        arrays[f"{key}/error_m"] = np.array(thing.collision.error_m)
        arrays |= parts_to_arrays(thing.collision.parts, prefix=f"{key}/", dtype=np.float32)
    np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]


def read_parts(path: Path) -> dict[str, CollisionMesh]:
    """Convex parts by the hash of their mesh; nothing where the file is not there."""
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    return {key: _collision(arrays, key) for key in {name.split("/")[0] for name in arrays}}


def _collision(arrays: dict[str, np.ndarray], key: str) -> CollisionMesh:
    mean, high, largest = arrays[f"{key}/error_m"].tolist()
    return CollisionMesh(parts_from_arrays(arrays, prefix=f"{key}/"), (mean, high, largest), "cuts", 0.0)
