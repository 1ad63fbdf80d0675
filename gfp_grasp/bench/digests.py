"""Digests of what a comparison is made from: files of the package that a method reads, and meshes and scans."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from gfp_grasp.assets import data_dir
from gfp_grasp.bench.costs import NETWORKS, WITH_PRIMITIVES
from gfp_grasp.scenes import ObjectSource

_OF_SCANS = (".bin", ".txt", ".npz")  # what `read_scans` reads of a tree


def digests_of_methods(methods: Iterable[str]) -> dict[str, str]:
    """Digests of the networks, their cards and the primitives that methods may come to read, by method.

    A method that reads no file of the package, as the hull of what was seen, is left out.
    """
    weights = data_dir("weights")
    primitives = [*data_dir("gps").iterdir(), weights / "openset.json"]
    found = {}
    for method in methods:
        files = [
            weights / f"{stem}{suffix}" for stem in NETWORKS.get(method, ()) for suffix in (".safetensors", ".json")
        ]
        if digest := digest_of_files([*files, *(primitives if method in WITH_PRIMITIVES else ())]):
            found[method] = digest
    return found


def digest_of_meshes(sources: Sequence[ObjectSource]) -> str | None:
    """Digest of the mesh files of objects; None where all of them are procedural."""
    return digest_of_files(source.path for source in sources if source.path is not None)


def digest_of_scans(tree: Path) -> str | None:
    """Digest of the scans, labels and calibrations below a folder."""
    return digest_of_files(path for path in tree.rglob("*") if path.suffix in _OF_SCANS)


def digest_of_files(paths: Iterable[Path]) -> str | None:
    """Digest of the names and contents of files; those that are not there count for nothing.

    Returns:
        Sixteen hexadecimal digits; None where there is no file.
    """
    files = sorted(path for path in paths if path.is_file())
    return digest_of([(path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in files]) if files else None


def digest_of(content: object) -> str:
    """Sixteen hexadecimal digits that change with what JSON says of something."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]
