"""Normals, samples, neighbours and crossings of the faces of a mesh."""

import time

import numpy as np
import pytest
import trimesh
from bodies import moved, together
from toy_bodies import dense_laplacian, l_body

from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import (
    crossing_faces,
    enclosed_m3,
    graph_laplacian,
    neighbour_average,
    pairs_on_the_way,
    sample_surface,
    surface,
    vertex_normals,
)
from gfp_grasp.shapes import make_shape


def test_vertex_normals_of_a_sphere_point_away_from_its_middle():
    ball = trimesh.creation.icosphere(4)
    normals = vertex_normals(ball.vertices, ball.faces)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert (np.einsum("vx,vx->v", normals, ball.vertices) > 0.999).all()
    assert (vertex_normals(np.zeros((4, 3)), ball.faces[:0]) == 0).all()


def test_a_large_face_counts_for_more_in_the_normal_of_a_vertex():
    vertices = np.array([[0, 0, 0], [3, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    normals = vertex_normals(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    expected = np.array([1.0, 0, 3]) / np.sqrt(10)
    np.testing.assert_allclose(normals[[0, 2]], [expected, expected], atol=1e-12)
    np.testing.assert_allclose(normals[[1, 3]], [[0, 0, 1], [1, 0, 0]], atol=1e-12)


def test_each_vertex_is_compared_with_the_mean_of_its_neighbours():
    body = l_body(0.02)
    faces, count = np.asarray(body.faces), len(body.vertices)
    wanted = dense_laplacian(faces, count)
    np.testing.assert_allclose(graph_laplacian(faces, count).toarray(), wanted, atol=1e-15)
    np.testing.assert_allclose(neighbour_average(faces, count).toarray(), np.eye(count) - wanted, atol=1e-15)
    alone = neighbour_average(faces, count + 1).toarray()
    assert not alone[-1].any()
    assert not alone[:, -1].any()


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


def test_samples_are_even_within_a_triangle():
    triangle = trimesh.Trimesh([[0.3, 0, 0], [1.3, 0, 0.5], [0.3, 2, 1]], [[0, 1, 2]], process=False)
    points = sample_surface(triangle, 40_000, np.random.default_rng(1))[0]
    np.testing.assert_allclose(points.mean(axis=0), triangle.vertices.mean(axis=0), atol=0.01)
    for corner in range(3):  # the quarter of the triangle at each corner
        sides = np.delete(triangle.vertices, corner, axis=0) - triangle.vertices[corner]
        share = np.linalg.lstsq(sides.T, (points - triangle.vertices[corner]).T, rcond=None)[0].sum(axis=0)
        assert (share < 0.5).mean() == pytest.approx(0.25, abs=0.01)


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
    beside = moved(box, [1.0, 0.3, 0.2])
    both = together(box, beside)
    assert len(crossing_faces(both.vertices, both.faces)) == 0
    into = together(box, moved(box, [0.5, 0.3, 0.2]))
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
    two = together(trimesh.creation.icosphere(3, 0.03), moved(trimesh.creation.icosphere(2, 0.02), [0.02, 0, 0]))
    expected = crossing_faces(two.vertices, two.faces)
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.8]))[:3, :3]
    assert len(expected) > 0
    np.testing.assert_array_equal(crossing_faces(1000 * two.vertices @ turn.T + 5, two.faces), expected)


def test_a_mug_is_searched_for_crossings_in_a_fraction_of_a_second():
    mug = make_shape("mug", 1).mesh
    started = time.perf_counter()
    assert len(crossing_faces(mug.vertices, mug.faces)) == 0
    assert time.perf_counter() - started < 0.5


def test_faces_far_apart_and_faces_of_every_size_are_searched_in_moments(monkeypatch):
    monkeypatch.setattr(surface, "_BATCH", 2000)
    rng = np.random.default_rng(0)
    small = trimesh.creation.icosphere(3, 0.01).apply_translation([0.4, 0.1, 0.2])
    large = trimesh.Trimesh([[0, 0, 0.2], [1, 0, 0.2], [0, 1, 0.2]], [[0, 1, 2]], process=False)
    both = together(small, large)
    shuffled = rng.permutation(len(both.faces))
    found = crossing_faces(both.vertices, both.faces[shuffled])
    z = small.triangles[:, :, 2]
    assert {int(i) for i in shuffled[found].ravel()} - {len(small.faces)} == set(
        np.flatnonzero((z.min(axis=1) < 0.2 - 1e-9) & (z.max(axis=1) > 0.2 + 1e-9))
    )
    assert (found[:, 0] < found[:, 1]).all()
    assert (np.lexsort((found[:, 1], found[:, 0])) == np.arange(len(found))).all()


def _cross(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether an edge of one triangle passes through the other."""
    return any(_pierces(x[i], x[(i + 1) % 3], y) for x, y in ((a, b), (b, a)) for i in range(3))


def _pierces(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> bool:
    system = np.stack([triangle[1] - triangle[0], triangle[2] - triangle[0], start - end], axis=1)
    u, v, t = np.linalg.solve(system, start - triangle[0])
    return bool(u >= 0 and v >= 0 and u + v <= 1 and 0 <= t <= 1)


def test_pairs_found_once_tell_what_crosses_at_every_step_of_the_way() -> None:
    """Two balls, one of which goes through the other, bent by noise: at each step the same pairs as when asked anew."""
    balls = [trimesh.creation.icosphere(subdivisions=2, radius=r) for r in (0.05, 0.03)]
    balls[1].apply_translation((0.1, 0.0, 0.0))
    vertices = np.concatenate([ball.vertices for ball in balls])
    faces = np.concatenate([balls[0].faces, balls[1].faces + len(balls[0].vertices)])
    rng = np.random.default_rng(0)
    way = rng.normal(scale=0.004, size=vertices.shape)
    way[vertices[:, 0] > 0.06] -= (0.09, 0.0, 0.0)
    pairs = pairs_on_the_way(vertices, vertices + way, faces)
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs, axis=0)) == len(pairs)
    counts = []
    for share in (0.0, 0.3, 0.6, 1.0):
        moved = vertices + share * rng.uniform(0.8, 1.0, (len(vertices), 1)) * way
        anew = crossing_faces(moved, faces)
        np.testing.assert_array_equal(crossing_faces(moved, faces, pairs=pairs), anew)
        among = rng.random(len(faces)) < 0.3
        np.testing.assert_array_equal(
            crossing_faces(moved, faces, among=among, pairs=pairs), anew[among[anew].any(axis=1)]
        )
        counts.append(len(anew))
    assert counts[0] == 0
    assert max(counts) > 50


def test_the_volume_within_a_mesh_is_nothing_where_it_is_no_volume() -> None:
    box = trimesh.creation.box(extents=(0.1, 0.2, 0.3))
    box.apply_translation((5.0, -2.0, 1.0))
    assert enclosed_m3(box) == pytest.approx(0.006)
    inside_out, open_box, turned = box.copy(), box.copy(), box.copy()
    inside_out.invert()
    open_box.update_faces(np.arange(1, 12))
    turned.faces[3] = turned.faces[3][::-1]
    assert [enclosed_m3(mesh) for mesh in (inside_out, open_box, turned)] == [0.0, 0.0, 0.0]
    assert not any(mesh.is_volume for mesh in (inside_out, open_box, turned))
    core = trimesh.creation.box(extents=(0.05, 0.1, 0.1)).apply_translation((5.0, -2.0, 1.0))
    core.invert()
    assert enclosed_m3(together(box, core)) == pytest.approx(0.0055)  # hollow
    nowhere = box.copy()
    nowhere.vertices[2] = np.nan
    assert enclosed_m3(nowhere) == 0.0
    assert enclosed_m3(trimesh.Trimesh(box.vertices, np.zeros((0, 3), dtype=int), process=False)) == 0.0
