"""Hostile meshes to the number: those that the committed figures were measured on."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.bench.hostile_meshes import KINDS, hostile_mesh

# Rows of an earlier run are kept by their seed and number, so the same number must stay the same mesh. Whoever changes
# a mesh on purpose measures again and writes this file anew: a list of `measured` for each number.
KNOWN = json.loads((Path(__file__).parent / "known_hostile.json").read_text(encoding="utf-8"))


def measured(number: int) -> list:
    """Kind, counts, strange coordinates, and size, place, area and volume of those that are not."""
    kind, mesh = hostile_mesh(number, seed=0)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    plain = np.isfinite(vertices) & (np.abs(vertices) < 1e30)
    legal = np.all((faces >= 0) & (faces < len(vertices)), axis=1)
    legal[legal] &= plain[faces[legal]].all(axis=(1, 2))
    figures = [np.abs(vertices[plain]).sum(), vertices[plain].sum()]
    corners = vertices[faces[legal]] - (vertices[faces[legal]].mean(axis=(0, 1)) if legal.any() else 0.0)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    volume = np.linalg.det(corners).sum() / 6
    beyond = [int(faces[~legal].sum())]
    counts = [len(vertices), len(faces), int((~plain).sum()), int((~legal).sum())]
    if kind == "coplanar_union":  # a boolean may choose other triangles for the same solid
        counts, figures, beyond = [0], [*np.ravel(mesh.bounds)], []
    return [kind, *counts, *beyond, *(float(f"{figure:.6g}") for figure in (*figures, area, volume))]


def test_meshes_are_those_that_the_committed_figures_were_measured_on() -> None:
    assert len(KNOWN) == 12 * len(KINDS)
    for number, known in enumerate(KNOWN):
        found = measured(number)
        assert found[0] == known[0], number
        np.testing.assert_allclose(found[1:-1], known[1:-1], rtol=2e-5, atol=1e-12, err_msg=f"{number} {found[0]}")
        size = abs(known[-2]) ** 1.5 + 1e-30  # a volume may be a difference of great numbers
        assert abs(found[-1] - known[-1]) <= 1e-5 * (abs(known[-1]) + size), f"{number} {found[0]}"


def test_every_number_of_a_kind_that_is_drawn_from_a_list_is_drawn() -> None:
    of_kind = {kind: [hostile_mesh(n)[1] for n in range(i, 2000, len(KINDS))] for i, kind in enumerate(KINDS)}
    far = {round(float(np.log10(np.abs(mesh.vertices).max()))) for mesh in of_kind["far_away"]}
    assert far == {3, 6, 9}
    assert {bool(np.isnan(mesh.vertices).any()) for mesh in of_kind["nan"]} == {True}
    assert {float(mesh.vertices[np.isinf(mesh.vertices)][0]) for mesh in of_kind["inf"]} == {-np.inf, np.inf}
    assert {round(float(np.abs(mesh.vertices).max())) for mesh in of_kind["stray"]} == {100_000}
    wrong = {int(f) for mesh in of_kind["bad_indices"] for f in np.ravel(mesh.faces) if f < 0 or f >= 10_000}
    assert wrong == {-1, 2**31 - 1, -(2**31), 2**40}
    assert {len(mesh.vertices) == 0 for mesh in of_kind["empty"]} == {True, False}
    assert {len(mesh.faces) for mesh in of_kind["single_face"]} == {1, 2}
    assert max(float(np.abs(mesh.extents).max()) for mesh in of_kind["tiny"]) < 1e-8
    assert min(float(mesh.extents.max()) for mesh in of_kind["huge"]) > 1e6


@pytest.mark.parametrize("number", range(0, 20 * len(KINDS), len(KINDS)))
def test_the_sound_ones_are_solids_of_hand_size(number: int) -> None:
    kind, mesh = hostile_mesh(number)
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert (kind, mesh.is_volume) == ("sound", True)
    assert 0.01 < np.linalg.norm(mesh.extents) < 0.3
    assert (np.abs(mesh.vertices) < 0.75).all()
