"""Primitives on disk: arrays in safetensors, the mean as PLY for looking at, the card as JSON."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from gfp_grasp.collision import parts_from_arrays, parts_to_arrays
from gfp_grasp.errors import AssetMissing, GfpGraspError, InvalidOption, UnreadableFile
from gfp_grasp.types import CategorySpec, GenericPrimitive, PartBinding, Symmetry, Variant

_AND = "+"  # between the names of the parts that a variant lacks, in the names of its arrays
_ARRAYS = ("vertices", "faces", "modes", "explained", "log_scale_cov", "coefficient_samples", "up", "regions")


def save_primitive(primitive: GenericPrimitive, folder: str | Path) -> Path:
    """Write <name>.safetensors, .ply and .json; the name is the class, or "class.subcategory".

    Args:
        primitive: With its card: command, seed, data, figures.
        folder: Made where it does not exist.

    Returns:
        Path of the .safetensors file; the card names the sha256 of it, and that of its shape: of all but the parts,
        by which a network knows what it was trained on.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{primitive.name}.safetensors"
    save_file(_arrays_of(primitive, ""), path)
    path.chmod(0o644)  # safetensors writes for the owner only; a wheel is read by others
    trimesh.Trimesh(primitive.vertices, primitive.faces, process=False).export(path.with_suffix(".ply"))
    card = {
        "category": primitive.category,
        **({"subcategory": primitive.subcategory} if primitive.subcategory else {}),
        "licence": primitive.licence,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "shape_sha256": _shape_sha256(primitive),
        "region_names": list(primitive.region_names),
        "spec": primitive.spec.as_dict(),
    }
    card |= {key: value for key, value in primitive.card.items() if key not in (*card, "subcategory")}
    path.with_suffix(".json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    return path


def read_primitive(path: str | Path) -> GenericPrimitive:
    """Read a primitive that `save_primitive` wrote.

    Raises:
        AssetMissing: The file or its card is not there.
        UnreadableFile: It is not what save_primitive writes, or the card's sha256 is another file's.
    """
    path = Path(path)
    card = _read_card(path)
    try:
        arrays = load_file(path)
    except SafetensorError as error:
        raise UnreadableFile(f"{path} is not a primitive ({error}): build it again") from error
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if card.get("sha256") != digest:
        raise UnreadableFile(
            f"{path} has sha256 {digest[:12]}, its card says {str(card.get('sha256'))[:12]}: rebuild it"
        )
    try:
        return _from_arrays(arrays, "", card)
    except KeyError as error:
        raise UnreadableFile(f"{path} lacks {error}: it is no primitive, or one of an older version") from error
    except GfpGraspError as error:
        raise UnreadableFile(f"{path} or its card is malformed: {error}") from error


def read_spec(path: str | Path) -> CategorySpec:
    """What is known of a class, from the card beside a primitive's arrays; from the arrays where the card has none.

    Raises:
        AssetMissing: The file or its card is not there.
        UnreadableFile: The card is not what save_primitive writes.
    """
    path = Path(path)
    card = _read_card(path)
    return read_primitive(path).spec if "spec" not in card else _spec_of(card, path)


def _read_card(path: Path) -> dict:
    card_path = path.with_suffix(".json")
    for part in (path, card_path):
        if not part.is_file():
            raise AssetMissing(f"{part} is missing: build the primitive again, or reinstall gfp_grasp")
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UnreadableFile(f"{card_path} is not a card ({error}): build the primitive again") from error
    if not isinstance(card, dict):
        raise UnreadableFile(f"{card_path} holds a {type(card).__name__}; an object with named fields is expected")
    name, own = path.name.removesuffix(".safetensors"), _name_in(card)
    if own != name:
        raise UnreadableFile(f"{card_path} is the card of {own!r}: its name has to be that of its class")
    return card


def _name_in(card: dict) -> str:
    return ".".join(str(card[key]) for key in ("category", "subcategory") if card.get(key))


def _spec_of(card: dict, path: Path) -> CategorySpec:
    try:
        return CategorySpec.from_dict(card["spec"])
    except InvalidOption as error:
        raise UnreadableFile(f"{path.with_suffix('.json')}: {error}") from error


def _shape_sha256(primitive: GenericPrimitive) -> str:
    """Digest of mean, faces and modes as they are stored."""
    digest = hashlib.sha256(np.ascontiguousarray(primitive.vertices).tobytes())
    digest.update(np.ascontiguousarray(primitive.faces).tobytes())
    digest.update(np.ascontiguousarray(primitive.modes, dtype=np.float32).tobytes())
    return digest.hexdigest()


def _arrays_of(primitive: GenericPrimitive, prefix: str) -> dict[str, np.ndarray]:
    arrays = {prefix + name: np.ascontiguousarray(getattr(primitive, name)) for name in _ARRAYS}
    arrays[prefix + "modes"] = arrays[prefix + "modes"].astype(np.float32)  # a tenth of a micrometre is enough
    mirror = primitive.symmetry.mirror_normal
    arrays[prefix + "symmetry"] = np.array(
        [*primitive.symmetry.axis, primitive.symmetry.order, *(np.full(3, np.nan) if mirror is None else mirror)]
    )
    arrays |= parts_to_arrays(primitive.parts, prefix=f"{prefix}part_")
    arrays[prefix + "part_merges"] = np.ascontiguousarray(primitive.part_merges)
    arrays[prefix + "part_errors_m"] = np.ascontiguousarray(primitive.part_errors_m)
    arrays |= _arrays_of_binding(primitive.binding, f"{prefix}binding_")
    if len(primitive.prototypes):
        arrays[prefix + "prototypes"] = np.ascontiguousarray(primitive.prototypes)
    for variant in primitive.variants:
        inner = f"without.{_AND.join(variant.without)}."
        arrays[inner + "vertex_map"] = np.ascontiguousarray(variant.vertex_map)
        arrays.update(_arrays_of(variant.primitive, inner))
    return arrays


def _from_arrays(arrays: dict[str, np.ndarray], prefix: str, card: dict) -> GenericPrimitive:
    values = arrays[prefix + "symmetry"]
    order = math.inf if math.isinf(values[3]) else int(values[3])
    symmetry = Symmetry(values[:3], order, None if np.isnan(values[4:]).any() else values[4:])
    return GenericPrimitive(
        category=card["category"],
        subcategory=card.get("subcategory", ""),
        **{name: arrays[prefix + name] for name in _ARRAYS},
        symmetry=symmetry,
        parts=parts_from_arrays(arrays, prefix=f"{prefix}part_"),
        part_merges=arrays.get(prefix + "part_merges", np.zeros((0, 2))),
        part_errors_m=arrays.get(prefix + "part_errors_m", np.zeros((0, 2))),
        binding=_binding_in(arrays, f"{prefix}binding_"),
        region_names=tuple(card["region_names"]),
        variants=() if prefix else tuple(_variants(arrays, card)),
        licence=card["licence"],
        card=card,
        spec=CategorySpec.from_dict(card["spec"]) if "spec" in card else None,  # pyright: ignore[reportArgumentType]
        prototypes=arrays.get(prefix + "prototypes", np.zeros((0, 0))),
    )


def _arrays_of_binding(binding: PartBinding | None, prefix: str) -> dict[str, np.ndarray]:
    if binding is None:
        return {}
    arrays = {name: np.ascontiguousarray(getattr(binding, name)) for name in ("weights", "height_m", "ends")}
    arrays["corners"] = binding.corners.astype(np.uint16 if binding.corners.max() < 2**16 else np.int32)
    if binding.gap_m is not None:
        arrays["gap_m"] = np.ascontiguousarray(binding.gap_m)
    return {prefix + name: array for name, array in arrays.items()}


def _binding_in(arrays: dict[str, np.ndarray], prefix: str) -> PartBinding | None:
    if prefix + "corners" not in arrays:
        return None
    return PartBinding(
        **{name: arrays[prefix + name] for name in ("corners", "weights", "height_m", "ends")},
        gap_m=arrays.get(prefix + "gap_m"),
    )


def _variants(arrays: dict[str, np.ndarray], card: dict) -> Iterator[Variant]:
    for name in sorted(arrays):
        if name.startswith("without.") and name.endswith(".vertex_map"):
            prefix = name.removesuffix("vertex_map")
            parts = prefix.removeprefix("without.").removesuffix(".").split(_AND)
            yield Variant(tuple(parts), _from_arrays(arrays, prefix, card), arrays[name])
