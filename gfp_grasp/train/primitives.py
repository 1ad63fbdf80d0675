"""Building a primitive from the procedural families, or from a folder of any class's mesh files, with its figures."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.errors import GfpGraspError, InvalidOption, UnknownCategory
from gfp_grasp.meshes import SUFFIXES, load_mesh, make_solid
from gfp_grasp.parallel import Progress, one_thread, pmap
from gfp_grasp.primitives import BuildConfig, bring_into_one_pose, build_primitive, measure_primitive, save_primitive
from gfp_grasp.shapes import FAMILIES, get_family, make_shape, split_seeds
from gfp_grasp.types import LIDAR, CategorySpec, GenericPrimitive

# A folder with fewer meshes than this is used up by the build; from this on every fifth mesh is held out.
_ENOUGH_TO_HOLD_OUT = 15
_SMALLEST_MEMBER_M = 0.005
_LICENCE_OF_SHAPES = "Apache-2.0"
_OF_ALL_KINDS = 1000  # seeds of the train split among which members are looked for


def build_from_shapes(
    name: str,
    *,
    members: int | None = None,
    held_out: int = 40,
    seed: int = 0,
    config: BuildConfig | None = None,
    spec: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> GenericPrimitive:
    """Build the primitive of a procedural family from its train split, and measure it on its validation split.

    Args:
        name: One of shapes.FAMILIES, for those of its shapes that are of no variant with a primitive of its own, or
            "family.variant" for those that are of one variant.
        members: Number of shapes, the first of the train split, of whose thousand seeds all are taken at most. None
            takes the family's own number.
        held_out: Number of shapes of the validation split; fewer where it has not so many.
        seed: Seed of the build.
        config: How it is built; None for the default.
        spec: Fields of the class's CategorySpec that differ from what the members and the family tell.
        progress: Wraps the streams of members.

    Raises:
        UnknownCategory: No such family.
        InvalidOption: members or held_out is less than one, or there is no shape of that variant.
        BuildFailed: See build_primitive.
    """
    _check(name, spec)
    started = time.perf_counter()
    family = name.partition(".")[0]
    if family not in FAMILIES:
        raise UnknownCategory(
            f"no shape family {family!r}: choose one of {', '.join(FAMILIES)}, or give a folder of meshes"
        )
    if (members is not None and members < 1) or held_out < 1:
        raise InvalidOption(f"members={members}, held_out={held_out}: at least 1 of each is expected")
    known = {**(get_family(family).spec_of(name) if name in get_family(family).names else {}), **(spec or {})}
    meshes, val = procedural_members(name, members), procedural_members(name, held_out, split="val")
    members, held_out = len(meshes), len(val)
    config = config or BuildConfig(licence=_LICENCE_OF_SHAPES, optional_parts=bool(known.get("optional_parts", True)))
    primitive = build_primitive(meshes, name, config=config, seed=seed, progress=progress)
    figures = measure_primitive(primitive, val, progress=progress)
    shapes = f"procedural shapes of {name}"
    card = {
        "command": f"gfp-grasp gps build {name} --limit {members} --seed {seed}",
        "seed": seed,
        "data": f"{shapes}, the first {members} of the train split",
        "held_out_data": f"{shapes}, the first {held_out} of the val split",
    }
    card |= {**primitive.card, **figures.figures(), "build_s": round(time.perf_counter() - started)}
    return _recognisable(with_spec(replace(primitive, card=card), known), seed, meshes)


def build_shipped(
    names: Sequence[str], folder: Path, *, seed: int = 0, workers: int = 1, progress: Progress | None = None
) -> list[GenericPrimitive]:
    """Build primitives of procedural families and write them.

    Args:
        names: As of `build_from_shapes`; `shipped_names` gives all.
        folder: Receives the .safetensors, .ply and .json.
        seed: Seed of each build.
        workers: Number of processes.
        progress: Wraps the stream of finished primitives.
    """
    return list(pmap(partial(_built, folder=folder, seed=seed), names, workers=workers, progress=progress))


def shipped_names() -> tuple[str, ...]:
    """The classes of all procedural families, each followed by its variants that have a primitive."""
    return tuple(name for family in FAMILIES for name in get_family(family).names)


def _built(name: str, *, folder: Path, seed: int) -> GenericPrimitive:
    with one_thread():
        primitive = build_from_shapes(name, seed=seed)
    save_primitive(primitive, folder)
    return primitive


def procedural_members(name: str, count: int | None = None, *, split: str = "train") -> list[trimesh.Trimesh]:
    """The shapes that the primitive of a procedural family, or of one of its variants, is built from.

    A family's own primitive has no member of a variant that has a primitive.

    Args:
        name: "family" or "family.variant".
        count: The first so many of the split; None is as many as the primitive is built from.
        split: "train", "val" or "test".

    Raises:
        UnknownCategory: No such family.
        InvalidOption: No shape of that variant.
    """
    name_of_family, _, variant = name.partition(".")
    family = get_family(name_of_family)
    shapes = (make_shape(family.name, seed) for seed in split_seeds(family.name, split, _OF_ALL_KINDS))
    own = (shape.mesh for shape in shapes if (shape.kind == variant if variant else shape.kind not in family.variants))
    found = list(islice(own, family.members_of(name) if count is None else count))
    if not found:
        raise InvalidOption(f"no {family.name} is of the variant {variant!r}: see what gfp_grasp/shapes makes of it")
    return found


def with_spec(primitive: GenericPrimitive, changes: Mapping[str, object] | None) -> GenericPrimitive:
    """The primitive with some fields of its spec changed.

    Raises:
        InvalidOption: An unknown field, or a value that is not legal; the message names it.
    """
    return replace(primitive, spec=_changed(primitive.spec, changes)) if changes else primitive


def _changed(spec: CategorySpec, changes: Mapping[str, object] | None) -> CategorySpec:
    return CategorySpec.from_dict({**spec.as_dict(), **(changes or {})})


def _check(name: str, changes: Mapping[str, object] | None) -> None:
    """Refuse a name or changes of its spec that are not legal, before the work is done."""
    parent, _, subcategory = name.partition(".")
    _changed(CategorySpec(name, parent=parent if subcategory else None), changes)


def build_from_folder(
    folder: str | Path,
    category: str,
    *,
    seed: int = 0,
    config: BuildConfig | None = None,
    spec: Mapping[str, object] | None = None,
    progress: Progress | None = None,
) -> GenericPrimitive:
    """Build the primitive of any class from a folder of its meshes, in any pose, broken ones among them.

    Args:
        folder: With OBJ, STL, PLY, GLB or OFF files in metres; every one of them is taken for a member.
        category: Name of the class, or "class.subcategory".
        seed: Seed of the build and of the choice of meshes that are held out.
        config: How it is built; None for meshes in any orientation.
        spec: Fields of the class's CategorySpec that differ from what the members tell.
        progress: Wraps the streams of members.

    Raises:
        InvalidOption: The folder holds no mesh file, or meshes that are not in metres.
        BuildFailed: See build_primitive.

    Warns:
        UserWarning: For each file that cannot be read, with its name.
    """
    _check(category, spec)
    paths = sorted(path for path in Path(folder).glob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise InvalidOption(f"{folder} holds no mesh file: {', '.join(SUFFIXES)} are read")
    meshes, unreadable = [], 0
    for path in paths:
        try:
            meshes.append(load_mesh(path))
        except GfpGraspError as error:
            warnings.warn(f"{path.name} is left out: {error}", stacklevel=2)
            unreadable += 1
    _check_metres(meshes, folder)
    config = config or BuildConfig(orientation="any")
    kept, held_out = _hold_out(meshes, np.random.default_rng(seed))
    primitive = build_primitive(kept, category, config=config, seed=seed, progress=progress)
    card: dict[str, object] = {
        "command": f"gfp-grasp gps build {category} --meshes FOLDER --seed {seed}",
        "seed": seed,
        "data": f"{len(kept)} mesh files of a folder, {len(held_out)} more held out, {unreadable} more unreadable",
    }
    figures = {}
    if held_out:
        posed = _posed(held_out, primitive, config, seed)
        figures = measure_primitive(primitive, posed, progress=progress).figures() if posed else {}
    return _recognisable(with_spec(replace(primitive, card={**card, **primitive.card, **figures}), spec), seed)


def _check_metres(meshes: list[trimesh.Trimesh], folder: str | Path) -> None:
    """Refuse members whose median extent is smaller or larger than anything a sensor sees, as in millimetres it is."""
    if meshes:
        size_m = float(np.median([mesh.extents.max() for mesh in meshes]))
        if not _SMALLEST_MEMBER_M <= size_m <= LIDAR.largest_m:
            raise InvalidOption(
                f"the meshes of {Path(folder).name} are {size_m:.4g} m across, {_SMALLEST_MEMBER_M} to "
                f"{LIDAR.largest_m:g} m are expected: if they are in millimetres, divide them by 1000"
            )


def _recognisable(
    primitive: GenericPrimitive, seed: int, meshes: list[trimesh.Trimesh] | None = None
) -> GenericPrimitive:
    """The primitive with what the classifier knows its class by."""
    from gfp_grasp.train.prototypes import with_prototypes  # brings torch

    return with_prototypes(primitive, meshes=meshes, seed=seed)


def _hold_out(meshes: list[trimesh.Trimesh], rng: np.random.Generator) -> tuple[list, list]:
    if len(meshes) < _ENOUGH_TO_HOLD_OUT:
        return meshes, []
    order = rng.permutation(len(meshes))
    num_held = len(meshes) // 5
    return [meshes[i] for i in sorted(order[num_held:])], [meshes[i] for i in sorted(order[:num_held])]


def _posed(
    meshes: list[trimesh.Trimesh], primitive: GenericPrimitive, config: BuildConfig, seed: int
) -> list[trimesh.Trimesh]:
    """Held-out members, repaired and turned onto the mean; those that cannot be repaired are left out."""
    solids = []
    for mesh in meshes:
        try:
            solids.append(mesh if mesh.is_volume else make_solid(mesh)[0])
        except GfpGraspError:
            continue
    mean = trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)
    return bring_into_one_pose(solids, config.orientation, np.random.default_rng(seed), reference=mean)
