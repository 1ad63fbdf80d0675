"""Broken meshes become solids: what is joined, turned, filled, united and thickened, and how far off the result is."""

import numpy as np
import pytest
import real_data
import trimesh
from bodies import TILTED, l_shape, moved, together

from gfp_grasp.meshes import crossing_faces, load_mesh, make_solid
from gfp_grasp.meshes.grid import _level, remeshed
from gfp_grasp.meshes.solid import _error_m, _filled, _joined
from gfp_grasp.shapes import make_shape


def test_a_good_solid_is_left_as_it_is():
    mug = make_shape("mug", 1).mesh
    solid, error = make_solid(mug)
    assert error == 0.0
    np.testing.assert_array_equal(solid.vertices, mug.vertices)


@pytest.mark.parametrize("damage", ["inverted", "soup", "mixed"])
def test_orientation_and_joints_are_restored_exactly(damage):
    cup = make_shape("cup", 3).mesh
    broken = cup.copy()
    if damage == "inverted":
        broken.invert()
    elif damage == "soup":
        broken = trimesh.Trimesh(
            cup.triangles.reshape(-1, 3), np.arange(3 * len(cup.faces)).reshape(-1, 3), process=False
        )
    else:
        faces = cup.faces.copy()
        faces[::3] = faces[::3, ::-1]
        broken = trimesh.Trimesh(cup.vertices, faces, process=False)
    solid, error = make_solid(broken)
    assert solid.is_volume
    assert error == 0.0
    assert solid.volume == pytest.approx(cup.volume, rel=1e-9)


def test_small_holes_are_filled_and_pieces_united():
    box = trimesh.creation.icosphere(4, 0.05)
    holed = trimesh.Trimesh(box.vertices, np.delete(box.faces, [5, 6, 400, 401, 900], axis=0), process=False)
    other = moved(trimesh.creation.icosphere(4, 0.05), [0.06, 0.001, 0.002])
    solid, error = make_solid(together(holed, other))
    apart = np.linalg.norm([0.06, 0.001, 0.002])
    lens = np.pi * (4 * 0.05 + apart) * (2 * 0.05 - apart) ** 2 / 12
    assert solid.is_volume
    assert solid.volume == pytest.approx(2 * 4 / 3 * np.pi * 0.05**3 - lens, rel=0.01)
    assert error < 1e-4


def test_a_sheet_becomes_a_thin_wall_and_stays_open():
    pipe = trimesh.creation.cylinder(0.04, 0.1, sections=64)
    sheet = trimesh.Trimesh(pipe.vertices, pipe.faces[pipe.face_normals[:, 2] < 0.5], process=False)
    solid, error = make_solid(sheet)
    assert solid.is_volume
    assert len(crossing_faces(solid.vertices, solid.faces)) == 0
    assert solid.volume < 0.3 * pipe.volume
    assert not solid.contains([[0, 0, 0.0]])[0]
    assert 0 < error < 0.0015


@pytest.mark.parametrize(("gap", "are_joined"), [(3e-7, True), (3e-5, False)])
def test_corners_that_nearly_coincide_are_joined(gap: float, are_joined: bool):
    mesh = l_shape()
    soup = np.array(mesh.triangles).reshape(-1, 3)
    soup += np.random.default_rng(0).uniform(-0.5, 0.5, soup.shape) * gap * np.linalg.norm(mesh.extents)
    joined = _joined(trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False))
    assert joined.is_volume is are_joined
    assert (len(joined.vertices) == len(mesh.vertices)) is are_joined


def test_needles_and_faces_told_twice_are_left_out():
    mesh = l_shape()
    faces = np.vstack([mesh.faces, mesh.faces[:3], mesh.faces[4:5, ::-1], [[0, 0, 1]], [[2, 2, 2]]])
    solid, error = make_solid(trimesh.Trimesh(mesh.vertices, faces, process=False, validate=False))
    assert len(solid.faces) == len(mesh.faces)
    assert error == 0.0
    assert solid.volume == pytest.approx(mesh.volume)


@pytest.mark.parametrize("invert", [False, True])
def test_an_arm_without_its_end_is_closed_where_it_was(invert: bool):
    whole = l_shape()
    ending = np.isclose(whole.triangles[:, :, 1], 0.06).all(axis=1)
    assert 0.01 < whole.area_faces[ending].sum() / whole.area < 0.06
    opened = trimesh.Trimesh(whole.vertices, whole.faces[~ending], process=False)
    if invert:
        opened.invert()
    solid, error = make_solid(opened)
    assert solid.volume == pytest.approx(whole.volume, rel=1e-5)
    np.testing.assert_allclose(solid.bounds, whole.bounds, atol=1e-7)
    assert error < 1e-6


@pytest.mark.parametrize(("kept_m", "is_hole"), [(0.019, True), (0.0, False)])
def test_a_hole_is_filled_and_an_opening_is_not(kept_m: float, is_hole: bool):
    # A tube of 20 x 20 x 60 mm that is closed below; above it is open but for a rim, or altogether.
    box = trimesh.creation.box((0.02, 0.02, 0.06)).subdivide().subdivide().subdivide()
    above = box.triangles_center[:, 2] > 0.03 - 1e-9
    opened = above & (np.abs(box.triangles_center[:, :2]).max(axis=1) < (0.0051 if kept_m else 0.01))
    share = box.area_faces[opened].sum() / box.area
    assert share < 0.06 if is_hole else share > 0.06
    filled = _filled(trimesh.Trimesh(box.vertices, box.faces[~opened], process=False))
    assert (filled is not None) is is_hole
    if filled is not None:
        assert filled.volume == pytest.approx(box.volume)


def test_two_bars_that_cross_are_one_l_of_known_volume():
    bars = [trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.02, 0.02]])]
    bars.append(trimesh.creation.box(bounds=[[0.003, -0.01, 0.004], [0.018, 0.06, 0.015]]))
    solid, error = make_solid(together(*bars).apply_transform(TILTED))
    common = 0.015 * 0.02 * 0.011
    assert solid.volume == pytest.approx(0.1 * 0.02 * 0.02 + 0.015 * 0.07 * 0.011 - common, rel=1e-4)
    assert error < 1e-6


def test_the_error_of_a_repair_is_the_largest_distance_of_what_was_not_swallowed():
    given = trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.06, 0.04]]).subdivide().subdivide()
    shorter = trimesh.creation.box(bounds=[[0, 0, 0], [0.098, 0.06, 0.04]]).subdivide().subdivide()
    assert _error_m(given, shorter, depth=0.0) == pytest.approx(0.002, rel=1e-6)
    assert _error_m(shorter, given, depth=0.0) < 1e-9
    assert _error_m(shorter, given, depth=0.003) == pytest.approx(0.002, rel=3e-3)


def test_the_zero_level_of_a_distance_is_a_ball_that_looks_outward():
    centre, radius = np.array([8.3, 9.1, 7.7]), 5.2
    grid = np.stack(np.meshgrid(*[np.arange(18.0)] * 3, indexing="ij"), axis=-1)
    vertices, faces = _level(np.linalg.norm(grid - centre, axis=-1) - radius)
    ball = trimesh.Trimesh(vertices, faces, process=False)
    assert ball.is_volume
    assert ball.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.03)
    np.testing.assert_allclose(np.linalg.norm(vertices - centre, axis=1), radius, atol=0.15)


def test_what_is_sealed_becomes_solid_and_a_sheet_a_wall_of_two_cells(monkeypatch):
    monkeypatch.setattr("gfp_grasp.meshes.grid.NUM_CELLS", 32)
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05).apply_translation([0.3, 0.1, 0.2])
    sealed = remeshed(ball)
    assert sealed.contains([[0.3, 0.1, 0.2]])[0]
    assert 0.95 * ball.volume < sealed.volume < 4 / 3 * np.pi * (0.05 + 0.9 * 0.1 / 32) ** 3
    corners = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 1e-5]]
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)
    cell = 0.1 / 32
    wall = remeshed(sheet)
    assert wall.is_volume
    assert wall.extents[2] == pytest.approx(2 * 0.9 * cell, rel=0.15)


@pytest.mark.slow
def test_stray_triangles_are_refused_or_made_solid_but_never_crash():
    rng = np.random.default_rng(0)
    soup = trimesh.Trimesh(rng.normal(size=(30, 3)), rng.permutation(30).reshape(10, 3), process=False)
    solid, _ = make_solid(soup)
    assert solid.is_volume


@pytest.mark.slow
def test_every_real_scan_can_be_read_and_made_solid():
    for path in sorted((real_data.folder() / "meshes").glob("*.ply")):
        solid, error = make_solid(load_mesh(path))
        assert solid.is_volume, path.name
        assert error < 0.003, path.name
