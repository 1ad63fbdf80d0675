"""Closed bodies that touch stay apart when equal vertices are joined; each faces outward."""

import numpy as np
import pytest
import trimesh
from bodies import TILTED, l_shape, together

from gfp_grasp.meshes import load_mesh, make_solid
from gfp_grasp.meshes.bodies import closed_bodies, outward


def block(low: tuple[float, ...], high: tuple[float, ...]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


# Face to face, edge to edge, corner to corner, and a block on a part of another's face.
FIRST = block((0.0, 0.0, 0.0), (0.2, 0.2, 0.2))
NEIGHBOURS = {
    "face": block((0.2, 0.0, 0.0), (0.5, 0.2, 0.2)),
    "edge": block((0.2, 0.2, 0.0), (0.5, 0.4, 0.2)),
    "corner": block((0.2, 0.2, 0.2), (0.5, 0.4, 0.3)),
    "part of a face": block((0.2, 0.05, 0.05), (0.5, 0.1, 0.1)),
}


def welded(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh whose equal vertices are joined, as a file without an order of vertices is read."""
    corners = np.concatenate([mesh.triangles for mesh in meshes]).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    mesh.merge_vertices()
    return mesh


@pytest.mark.parametrize("touching", NEIGHBOURS)
def test_bodies_that_touch_are_two_solids_of_the_volume_and_the_inertia_of_both(touching: str) -> None:
    pair = (FIRST.copy().apply_transform(TILTED), NEIGHBOURS[touching].copy().apply_transform(TILTED))
    joined = welded(*pair)
    apart = closed_bodies(np.asarray(joined.vertices), np.asarray(joined.faces))
    assert apart is not None
    assert apart.is_volume
    assert apart.body_count == 2
    both = together(*pair)
    assert apart.volume == pytest.approx(both.volume)
    np.testing.assert_allclose(apart.center_mass, both.center_mass, atol=1e-12)
    np.testing.assert_allclose(apart.moment_inertia, both.moment_inertia, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "off", "glb"])
def test_touching_blocks_are_solid_in_every_format(suffix: str, tmp_path) -> None:
    scene = trimesh.Scene([FIRST, NEIGHBOURS["face"], NEIGHBOURS["edge"]])
    (scene if suffix == "glb" else scene.to_mesh()).export(tmp_path / f"three.{suffix}")
    mesh = load_mesh(tmp_path / f"three.{suffix}")
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(0.008 + 0.012 + 0.012, rel=1e-5)
    solid, error = make_solid(mesh)
    assert solid.is_volume
    assert solid.volume == pytest.approx(mesh.volume, rel=1e-6)
    np.testing.assert_allclose(solid.center_mass, mesh.center_mass, atol=1e-6)
    assert error < 1e-7


def test_a_face_told_twice_counts_once_and_an_open_or_doubled_surface_is_no_body() -> None:
    body = l_shape()
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    again = closed_bodies(vertices, np.concatenate([faces, faces[:5, [1, 2, 0]]]))
    assert again is not None
    assert again.volume == pytest.approx(body.volume)
    assert closed_bodies(vertices, faces[1:]) is None
    assert closed_bodies(vertices, np.concatenate([faces, faces[:, ::-1]])) is None
    assert closed_bodies(vertices, faces[:0]) is None


def test_a_body_that_is_inside_out_is_turned_and_a_cavity_is_not() -> None:
    inverted = NEIGHBOURS["edge"].copy()
    inverted.invert()
    assert outward(together(FIRST, inverted)).volume == pytest.approx(0.008 + 0.012)
    cavity = block((0.05, 0.05, 0.05), (0.1, 0.15, 0.15))
    cavity.invert()
    assert outward(together(FIRST, cavity)).volume == pytest.approx(0.008 - 0.0005)
    assert make_solid(together(FIRST, inverted))[0].volume == pytest.approx(0.02)
