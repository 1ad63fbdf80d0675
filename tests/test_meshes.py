"""Reading, checking, sampling and repairing meshes."""

import time

import numpy as np
import pytest
import real_data
import trimesh
from bodies import TURN, l_shape
from toy_bodies import dense_laplacian, l_body

from gfp_grasp.errors import InvalidMesh, InvalidOption, UnreadableFile
from gfp_grasp.meshes import (
    SUFFIXES,
    check_mesh,
    crossing_faces,
    every_suffix,
    graph_laplacian,
    load,
    load_mesh,
    make_solid,
    neighbour_average,
    sample_surface,
    surface,
    vertex_normals,
)
from gfp_grasp.meshes.grid import _level, remeshed
from gfp_grasp.meshes.solid import _error_m, _filled, _joined
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import make_T

TILTED = make_T(TURN, (0.3, -0.2, 0.5))


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off"])
def test_a_mesh_comes_back_from_every_format_as_the_volume_it_was(suffix, tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.export(tmp_path / f"box.{suffix}")
    back = load_mesh(tmp_path / f"box.{suffix}")
    assert back.is_volume
    assert back.volume == pytest.approx(0.006, rel=1e-6)
    assert len(back.vertices) == 8


def test_the_pieces_of_a_scene_are_placed_and_merged(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 1.0):
        scene.add_geometry(
            trimesh.creation.box((0.1, 0.1, 0.1)), transform=trimesh.transformations.translation_matrix([x, 0, 0])
        )
    scene.export(tmp_path / "two.glb")
    np.testing.assert_allclose(
        load_mesh(tmp_path / "two.glb").bounds, [[-0.05, -0.05, -0.05], [1.05, 0.05, 0.05]], atol=1e-7
    )


def test_an_off_file_with_its_counts_on_the_first_line_is_read(tmp_path):
    text = str(trimesh.creation.box((1, 1, 1)).export(file_type="off"))
    assert text.startswith("OFF\n")
    (tmp_path / "box.off").write_text(text.replace("OFF\n", "OFF", 1))
    assert load_mesh(tmp_path / "box.off").volume == pytest.approx(1.0)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off"])
@pytest.mark.parametrize(
    "content", [b"", b"nonsense", bytes(range(256)) * 8, b"ply\nformat binary_little_endian 1.0\n", b"OFF\n9 9 9\n"]
)
def test_a_broken_file_is_refused_by_name_within_a_second(suffix, content, tmp_path):
    path = tmp_path / f"broken.{suffix}"
    path.write_bytes(content)
    started = time.perf_counter()
    with pytest.raises((UnreadableFile, InvalidMesh), match="broken"):
        load_mesh(path)
    assert time.perf_counter() - started < 1.0


def test_a_truncated_file_is_refused(tmp_path):
    content = trimesh.creation.icosphere(3).export(file_type="ply")
    (tmp_path / "cut.ply").write_bytes(content[: len(content) // 2])
    with pytest.raises((UnreadableFile, InvalidMesh), match=r"cut\.ply"):
        load_mesh(tmp_path / "cut.ply")


def test_a_missing_file_and_an_unknown_suffix_are_refused(tmp_path):
    with pytest.raises(UnreadableFile, match="cannot be read"):
        load_mesh(tmp_path / "none.ply")
    with pytest.raises(UnreadableFile, match=r"\.obj, \.stl"):
        load_mesh(tmp_path / "mesh.step")


@pytest.mark.parametrize(
    ("vertices", "faces", "word"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.zeros((0, 3), int), "0 faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]], "flat"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.nan]], [[0, 1, 2], [0, 1, 3]], "finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 9]], "9"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 4]], "0 to 3 are legal"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, -1]], "from -1"),
    ],
)
def test_what_is_not_a_mesh_is_refused(vertices, faces, word):
    with pytest.raises(InvalidMesh, match=word):
        check_mesh(trimesh.Trimesh(vertices, faces, process=False, validate=False))
    with pytest.raises(InvalidMesh, match="ndarray"):
        check_mesh(np.zeros((3, 3)))  # pyright: ignore[reportArgumentType]


def test_vertex_normals_of_a_sphere_point_away_from_its_middle():
    ball = trimesh.creation.icosphere(4)
    normals = vertex_normals(ball.vertices, ball.faces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert (np.einsum("vx,vx->v", normals, ball.vertices) > 0.999).all()
    assert (vertex_normals(np.zeros((4, 3)), ball.faces[:0]) == 0).all()


def test_samples_lie_on_the_surface_in_proportion_to_area():
    box = trimesh.creation.box((1, 1, 4))
    points, normals, face = sample_surface(box, 20_000, np.random.default_rng(0))
    np.testing.assert_allclose(np.abs(points / [0.5, 0.5, 2.0]).max(axis=1), 1.0)
    np.testing.assert_allclose(normals, box.face_normals[face])
    assert (np.abs(normals[:, 2]) > 0.5).mean() == pytest.approx(2 / 18, abs=0.01)
    again = sample_surface(box, 20_000, np.random.default_rng(0))[0]
    np.testing.assert_array_equal(points, again)
    with pytest.raises(InvalidOption, match="count is 0"):
        sample_surface(box, 0, np.random.default_rng(0))


def test_crossing_faces_are_those_that_an_exhaustive_search_finds():
    rng = np.random.default_rng(4)
    vertices = rng.normal(size=(90, 3))
    faces = rng.permutation(90).reshape(30, 3)
    found = {tuple(pair) for pair in crossing_faces(vertices, faces)}
    assert found == {
        (i, j) for i in range(30) for j in range(i + 1, 30) if _cross(vertices[faces[i]], vertices[faces[j]])
    }
    assert len(found) > 20


def test_faces_that_touch_or_are_coplanar_do_not_cross():
    box = trimesh.creation.box((1, 1, 1))
    beside = _moved(box, [1.0, 0.3, 0.2])
    both = _together([box, beside])
    assert len(crossing_faces(both.vertices, both.faces)) == 0
    into = _together([box, _moved(box, [0.5, 0.3, 0.2])])
    assert len(crossing_faces(into.vertices, into.faces)) > 0


def test_crossings_among_some_faces_are_the_pairs_that_hold_one_of_them():
    rng = np.random.default_rng(1)
    vertices, faces = rng.normal(size=(90, 3)), np.arange(90).reshape(30, 3)
    pairs = crossing_faces(vertices, faces)
    some = np.arange(30) % 7 == 2
    asked = crossing_faces(vertices, faces, among=some)
    np.testing.assert_array_equal(asked, pairs[some[pairs].any(axis=1)])
    assert 0 < len(asked) < len(pairs)
    assert len(crossing_faces(vertices, faces, among=np.zeros(30, dtype=bool))) == 0


def test_crossings_do_not_depend_on_pose_or_unit():
    two = _together([trimesh.creation.icosphere(3, 0.03), _moved(trimesh.creation.icosphere(2, 0.02), [0.02, 0, 0])])
    expected = crossing_faces(two.vertices, two.faces)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.8]))[:3, :3]
    assert len(expected) > 0
    np.testing.assert_array_equal(crossing_faces(1000 * two.vertices @ turn.T + 5, two.faces), expected)


def test_a_mug_is_searched_for_crossings_in_a_fraction_of_a_second():
    mug = make_shape("mug", 1).mesh
    started = time.perf_counter()
    assert len(crossing_faces(mug.vertices, mug.faces)) == 0
    assert time.perf_counter() - started < 0.5


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
    other = _moved(trimesh.creation.icosphere(4, 0.05), [0.06, 0.001, 0.002])
    solid, error = make_solid(_together([holed, other]))
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


def test_samples_are_even_within_a_triangle():
    triangle = trimesh.Trimesh([[0.3, 0, 0], [1.3, 0, 0.5], [0.3, 2, 1]], [[0, 1, 2]], process=False)
    points = sample_surface(triangle, 40_000, np.random.default_rng(1))[0]
    np.testing.assert_allclose(points.mean(axis=0), triangle.vertices.mean(axis=0), atol=0.01)
    for corner in range(3):  # the quarter of the triangle at each corner
        sides = np.delete(triangle.vertices, corner, axis=0) - triangle.vertices[corner]
        share = np.linalg.lstsq(sides.T, (points - triangle.vertices[corner]).T, rcond=None)[0].sum(axis=0)
        assert (share < 0.5).mean() == pytest.approx(0.25, abs=0.01)


def test_a_large_face_counts_for_more_in_the_normal_of_a_vertex():
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    normals = vertex_normals(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    expected = np.array([1.0, 0, 3]) / np.sqrt(10)
    np.testing.assert_allclose(normals[[0, 2]], [expected, expected], atol=1e-12)
    np.testing.assert_allclose(normals[[1, 3]], [[0, 0, 1], [1, 0, 0]], atol=1e-12)


def test_a_file_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(load, "LARGEST_BYTES", 1000)
    trimesh.creation.icosphere(3).export(tmp_path / "large.ply")
    with pytest.raises(UnreadableFile, match=r"large\.ply has \d{5,} bytes; 1 to 1000 are read"):
        load_mesh(tmp_path / "large.ply")


def test_suffixes_are_those_of_files_with_faces():
    assert set(SUFFIXES) < set(every_suffix())
    assert not {".xyz", ".stl_ascii"} & set(every_suffix())
    assert list(every_suffix()) == sorted(every_suffix())


@pytest.mark.parametrize(("extent_m", "is_legal"), [(9e5, True), (1.1e6, False)])
def test_a_mesh_of_a_thousand_kilometres_has_stray_vertices_or_no_unit(extent_m: float, is_legal: bool):
    mesh = trimesh.creation.box((1, 2, extent_m))
    if is_legal:
        assert check_mesh(mesh) is mesh
    else:
        with pytest.raises(InvalidMesh, match="stray"):
            check_mesh(mesh)


def test_a_thin_plate_is_not_flat_and_a_plane_is():
    plate = trimesh.creation.box((0.1, 0.1, 1e-6)).apply_transform(TILTED)
    assert check_mesh(plate) is plate
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.1, 0.2, 0]]) @ TURN.T + TILTED[:3, 3]
    plane = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)
    with pytest.raises(InvalidMesh, match="flat"):
        check_mesh(plane)


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
    solid, error = make_solid(_together(bars).apply_transform(TILTED))
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


def test_faces_far_apart_and_faces_of_every_size_are_searched_in_moments(monkeypatch):
    monkeypatch.setattr(surface, "_BATCH", 2000)
    rng = np.random.default_rng(0)
    small = trimesh.creation.icosphere(3, 0.01).apply_translation([0.4, 0.1, 0.2])
    large = trimesh.Trimesh([[0, 0, 0.2], [1, 0, 0.2], [0, 1, 0.2]], [[0, 1, 2]], process=False)
    both = _together([small, large])
    shuffled = rng.permutation(len(both.faces))
    found = crossing_faces(both.vertices, both.faces[shuffled])
    z = small.triangles[:, :, 2]
    assert {int(i) for i in shuffled[found].ravel()} - {len(small.faces)} == set(
        np.flatnonzero((z.min(axis=1) < 0.2 - 1e-9) & (z.max(axis=1) > 0.2 + 1e-9))
    )
    assert (found[:, 0] < found[:, 1]).all()
    assert (np.lexsort((found[:, 1], found[:, 0])) == np.arange(len(found))).all()


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


def _together(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return trimesh.Trimesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False)


def _moved(mesh: trimesh.Trimesh, offset: list[float]) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices + offset, mesh.faces, process=False)


def _cross(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether an edge of one triangle passes through the other."""
    return any(_pierces(x[i], x[(i + 1) % 3], y) for x, y in ((a, b), (b, a)) for i in range(3))


def _pierces(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> bool:
    system = np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0], start - end], axis=1)
    u, v, t = np.linalg.solve(system, start - triangle[0])
    return bool(u >= 0 and v >= 0 and u + v <= 1 and 0 <= t <= 1)


def test_each_vertex_is_compared_with_the_mean_of_its_neighbours():
    body = l_body(0.02)
    faces, count = np.asarray(body.faces), len(body.vertices)
    wanted = dense_laplacian(faces, count)
    np.testing.assert_allclose(graph_laplacian(faces, count).toarray(), wanted, atol=1e-15)
    np.testing.assert_allclose(neighbour_average(faces, count).toarray(), np.eye(count) - wanted, atol=1e-15)
    alone = neighbour_average(faces, count + 1).toarray()
    assert not alone[-1].any()
    assert not alone[:, -1].any()
