"""Building a primitive from the procedural families, or from a folder of any class's mesh files, with its figures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.errors import GfpGraspError, InvalidOption, UnknownCategory
from gfp_grasp.meshes import load_mesh, make_solid
from gfp_grasp.primitives import BuildConfig, Progress, bring_into_one_pose, build_primitive, measure_primitive
from gfp_grasp.shapes import FAMILIES, make_shape, split_seeds
from gfp_grasp.types import GenericPrimitive

_SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".off")
# A folder with fewer meshes than this is used up by the build; from this on every fifth mesh is held out.
_ENOUGH_TO_HOLD_OUT = 15
_LICENCE_OF_SHAPES = "Apache-2.0"
_OF_ALL_KINDS = 1000  # seeds of the train split that members of one kind are looked for among


def build_from_shapes(
    family: str,
    kind: str = "",
    *,
    members: int = 120,
    held_out: int = 40,
    seed: int = 0,
    config: BuildConfig | None = None,
    progress: Progress | None = None,
) -> GenericPrimitive:
    """Build the primitive of a procedural family from its train split, and measure it on its validation split.

    Args:
        family: One of shapes.FAMILIES.
        kind: Of its shapes; "" takes them all.
        members: So many seeds of the train split, the first ones; of a kind, as many as the first thousand hold.
        held_out: So many of the validation split.
        seed: Of the build.
        config: How it is built; None for the default.
        progress: Wraps the streams of members.

    Raises:
        UnknownCategory: No such family.
        InvalidOption: More members than the split has, or none; no shape is of that kind.
        BuildFailed: See build_primitive.
    """
    if family not in FAMILIES:
        raise UnknownCategory(
            f"no shape family {family!r}: choose one of {', '.join(FAMILIES)}, or give a folder of meshes"
        )
    train, val = split_seeds(family, "train"), split_seeds(family, "val")
    if kind:
        train = _of_kind(family, kind, split_seeds(family, "train", _OF_ALL_KINDS))[:members]
        val = _of_kind(family, kind, val)[:held_out]
        members, held_out = len(train), len(val)
    if not 1 <= members <= len(train) or not 1 <= held_out <= len(val):
        raise InvalidOption(f"members={members}, held_out={held_out}: 1 to {len(train)} and 1 to {len(val)} are there")
    config = config or BuildConfig(licence=_LICENCE_OF_SHAPES)
    meshes = [make_shape(family, number).mesh for number in train[:members]]
    primitive = build_primitive(meshes, family, config=config, seed=seed, progress=progress)
    primitive = replace(
        primitive, kind=kind, spec=None, twin=primitive.twin and replace(primitive.twin, kind=kind, spec=None)
    )
    figures = measure_primitive(
        primitive, [make_shape(family, number).mesh for number in val[:held_out]], progress=progress
    )
    card = {
        "command": f"gfp-grasp gps build {family} {f'--kind {kind} ' if kind else ''}--limit {members} --seed {seed}",
        "seed": seed,
        "data": f"procedural {kind} {family}s, the first {members} seeds of the train split".replace("  ", " "),
        "held_out_data": f"procedural {kind} {family}s, the first {held_out} seeds of the val split".replace("  ", " "),
    }
    return replace(primitive, card={**card, **primitive.card, **figures.figures()})


def _of_kind(family: str, kind: str, seeds: tuple[int, ...]) -> tuple[int, ...]:
    """Those of the seeds whose shapes are of a kind."""
    found = tuple(seed for seed in seeds if make_shape(family, seed).kind == kind)
    if not found:
        raise InvalidOption(f"no {family} is of the kind {kind!r}: see gfp_grasp/shapes for those that are made")
    return found


def build_from_folder(
    folder: str | Path,
    category: str,
    *,
    seed: int = 0,
    config: BuildConfig | None = None,
    progress: Progress | None = None,
) -> GenericPrimitive:
    """Build the primitive of any class from a folder of its meshes, in any pose, broken ones among them.

    Args:
        folder: With OBJ, STL, PLY, GLB or OFF files in metres; every one of them is taken for a member.
        category: Name of the class.
        seed: Of the build, and of which meshes are held out.
        config: How it is built; None for meshes in any orientation.
        progress: Wraps the streams of members.

    Raises:
        InvalidOption: The folder holds no mesh file.
        BuildFailed: See build_primitive.
    """
    paths = sorted(path for path in Path(folder).glob("*") if path.suffix.lower() in _SUFFIXES)
    if not paths:
        raise InvalidOption(f"{folder} holds no mesh file: {', '.join(_SUFFIXES)} are read")
    meshes, unreadable = [], 0
    for path in paths:
        try:
            meshes.append(load_mesh(path))
        except GfpGraspError:
            unreadable += 1
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
    return replace(primitive, card={**card, **primitive.card, **figures})


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
