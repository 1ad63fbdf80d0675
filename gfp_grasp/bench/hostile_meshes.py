"""Meshes that break programs, each from a seed: what exporters, scanners and modellers leave behind, and worse."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from gfp_grasp.transforms import random_rotation

Arrays = tuple[np.ndarray, np.ndarray]
Maker = Callable[[np.random.Generator], Arrays]


def hostile_mesh(number: int, *, seed: int = 0) -> tuple[str, trimesh.Trimesh]:
    """The number-th mesh of a seed, and its kind; the kinds take turns.

    Returns:
        Name of the kind, and the mesh as its maker left it: nothing joined, checked or cleaned.
    """
    kind = tuple(KINDS)[number % len(KINDS)]
    vertices, faces = KINDS[kind](np.random.default_rng([seed, number]))
    return kind, trimesh.Trimesh(vertices, faces, process=False, validate=False)


def _solid(rng: np.random.Generator) -> Arrays:
    """One of six sound solids of hand size, turned and moved."""
    size = rng.uniform(0.02, 0.12, 3)
    makers = (
        lambda: trimesh.creation.box(size),
        lambda: trimesh.creation.cylinder(size[0] / 2, size[1], sections=int(rng.integers(3, 40))),
        lambda: trimesh.creation.icosphere(subdivisions=int(rng.integers(0, 3)), radius=size[0] / 2),
        lambda: trimesh.creation.torus(size[0] / 2, size[0] / 8, major_sections=16, minor_sections=8),
        lambda: trimesh.creation.cone(size[0] / 2, size[1], sections=int(rng.integers(3, 24))),
        lambda: _cup(rng),
    )
    mesh = makers[rng.integers(len(makers))]()
    return _placed(rng, np.array(mesh.vertices)), np.array(mesh.faces)


def _cup(rng: np.random.Generator) -> trimesh.Trimesh:
    radius, height, wall = rng.uniform(0.025, 0.05), rng.uniform(0.05, 0.12), rng.uniform(0.002, 0.006)
    inner = radius - wall
    profile = [[0, 0], [radius, 0], [radius, height], [inner, height], [inner, wall], [0, wall]]
    return trimesh.creation.revolve(np.array(profile), sections=int(rng.integers(8, 28)))


def _placed(rng: np.random.Generator, vertices: np.ndarray) -> np.ndarray:
    return vertices @ random_rotation(rng).T + rng.uniform(-0.5, 0.5, 3)


def _joined(*pieces: Arrays) -> Arrays:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [faces + start for (_, faces), start in zip(pieces, starts[:-1], strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def _with_value(value: float) -> Maker:
    def make(rng: np.random.Generator) -> Arrays:
        vertices, faces = _solid(rng)
        vertices[rng.integers(len(vertices)), rng.integers(3)] = value * rng.choice([-1, 1])
        return vertices, faces

    return make


def _scaled(factor: float) -> Maker:
    def make(rng: np.random.Generator) -> Arrays:
        vertices, faces = _solid(rng)
        return vertices * factor * rng.uniform(0.1, 10), faces

    return make


def _far_away(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    return vertices + rng.choice([1e3, 1e6, 1e9]), faces


def _flat(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    vertices[:, rng.integers(3)] *= rng.choice([0.0, 1e-12, 1e-6])
    return (vertices if rng.integers(2) else _placed(rng, vertices)), faces


def _open(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    kept = rng.random(len(faces)) > rng.choice([0.02, 0.1, 0.4])
    return vertices, faces[kept] if kept.any() else faces[:2]


def _self_crossing(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    return vertices + rng.normal(0, rng.choice([0.01, 0.05]), vertices.shape), faces


def _inside_out(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    turned = rng.random(len(faces)) < rng.choice([0.3, 1.0])
    faces[turned] = faces[turned][:, ::-1]
    return vertices, faces


def _doubled(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    if rng.integers(2):  # every face has vertices of its own
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    again = rng.integers(len(faces), size=rng.integers(1, len(faces) + 1))
    return vertices, np.concatenate([faces, faces[again][:, :: rng.choice([-1, 1])]])


def _bad_indices(rng: np.random.Generator) -> Arrays:
    vertices, faces = _solid(rng)
    faces[rng.integers(len(faces)), rng.integers(3)] = rng.choice([-1, len(vertices), 2**31 - 1, -(2**31), 2**40])
    return vertices, faces


def _empty(rng: np.random.Generator) -> Arrays:
    vertices, no_faces = _solid(rng)[0], np.zeros((0, 3), dtype=np.int64)
    return (vertices, no_faces) if rng.integers(2) else (np.zeros((0, 3)), no_faces)


def _single_face(rng: np.random.Generator) -> Arrays:
    faces = [[0, 1, 2], [0, 2, 1]][: rng.integers(1, 3)]
    return rng.uniform(-0.05, 0.05, (3, 3)), np.array(faces)


def _non_manifold(rng: np.random.Generator) -> Arrays:
    """A fin on an edge, or two solids that share a vertex or an edge."""
    vertices, faces = _solid(rng)
    if rng.integers(2):
        tip = vertices.mean(axis=0) + rng.normal(0, 0.1, 3)
        return np.vstack([vertices, tip]), np.vstack([faces, [*faces[rng.integers(len(faces)), :2], len(vertices)]])
    other, their_faces = _solid(rng)
    hinges = int(rng.integers(1, 3))
    vertices, faces = _joined((vertices, faces), (other, their_faces))
    for hinge in range(hinges):
        faces[faces == len(vertices) - len(other) + hinge] = hinge
    return vertices, faces


def _coplanar_union(rng: np.random.Generator) -> Arrays:
    """A revolved cup and a torus that lies through its wall, put together or united."""
    cup = _cup(rng)
    torus = trimesh.creation.torus(0.025, 0.006, major_sections=12, minor_sections=8)
    torus.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    torus.apply_translation((cup.bounds[1, 0], 0, cup.bounds[1, 2] / 2))
    if rng.integers(2):
        both = trimesh.boolean.union([cup, torus])
        return np.array(both.vertices), np.array(both.faces)
    return _joined((np.array(cup.vertices), np.array(cup.faces)), (np.array(torus.vertices), np.array(torus.faces)))


def _stacked_boxes(rng: np.random.Generator) -> Arrays:
    """Boxes on one grid: faces in common planes, edges and corners that touch."""
    pieces = []
    for _ in range(rng.integers(2, 7)):
        low = rng.integers(0, 4, 3) * 0.02
        cube = trimesh.creation.box(bounds=[low, low + rng.integers(1, 4, 3) * 0.02])
        pieces.append((np.array(cube.vertices), np.array(cube.faces)))
    return _joined(*pieces)


def _several_pieces(rng: np.random.Generator) -> Arrays:
    return _joined(*(_solid(rng) for _ in range(rng.integers(2, 7))))


def _needles(rng: np.random.Generator) -> Arrays:
    """A solid with faces that have no width, or stretched until all are needles."""
    vertices, faces = _solid(rng)
    if rng.integers(2):
        vertices *= 10.0 ** rng.uniform(-3, 1, 3)
        return vertices, faces
    face = faces[rng.integers(len(faces), size=8)]
    return vertices, np.concatenate([faces, np.stack([face[:, 0], face[:, 1], face[:, rng.integers(2)]], axis=1)])


def _soup(rng: np.random.Generator) -> Arrays:
    count = int(10 ** rng.uniform(0.3, 2.3))
    vertices = rng.uniform(-0.05, 0.05, (max(4, count // 2), 3))
    return vertices, rng.integers(len(vertices), size=(count, 3))


def _nested_shells(rng: np.random.Generator) -> Arrays:
    """Shells within each other, facing outward, inward or in turn."""
    vertices, faces = _solid(rng)
    middle, pieces = vertices.mean(axis=0), []
    for level in range(rng.integers(2, 5)):
        shrunk = middle + (vertices - middle) * rng.choice([0.6, 0.9, 0.9999]) ** level
        pieces.append((shrunk, faces[:, :: rng.choice([-1, 1])]))
    return _joined(*pieces)


def _noise(rng: np.random.Generator) -> Arrays:
    """Every number wrong in its own way."""
    vertices = rng.normal(0, 1, (int(rng.integers(1, 60)), 3)) * 10.0 ** rng.uniform(-12, 12, 3)
    vertices[rng.random(vertices.shape) < 0.02] = rng.choice([0.0, 1e300, 5e-324, np.nan])
    return vertices, rng.integers(-1, len(vertices) + 1, size=(int(rng.integers(1, 90)), 3))


KINDS: dict[str, Maker] = {
    "sound": _solid,
    "nan": _with_value(np.nan),
    "inf": _with_value(np.inf),
    "stray": _with_value(1e5),
    "huge": _scaled(1e9),
    "tiny": _scaled(1e-9),
    "far_away": _far_away,
    "flat": _flat,
    "open": _open,
    "self_crossing": _self_crossing,
    "inside_out": _inside_out,
    "doubled": _doubled,
    "bad_indices": _bad_indices,
    "empty": _empty,
    "single_face": _single_face,
    "non_manifold": _non_manifold,
    "coplanar_union": _coplanar_union,
    "stacked_boxes": _stacked_boxes,
    "several_pieces": _several_pieces,
    "needles": _needles,
    "soup": _soup,
    "nested_shells": _nested_shells,
    "noise": _noise,
}
