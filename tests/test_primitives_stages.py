"""Meshes on their way to a primitive, to the number: remeshed, bent onto a member, smoothed, untangled, thinned out."""

import numpy as np
import pytest
import trimesh
from moments import assert_known, bent
from revolved import mug
from toy_bodies import l_body, refined

from gfp_grasp.primitives.correspondence import TemplateFitter, place
from gfp_grasp.primitives.mls import project
from gfp_grasp.primitives.remesh import RemeshConfig, refine, remesh
from gfp_grasp.primitives.resample import ResampleConfig, resample
from gfp_grasp.primitives.surface import Surface, folded_faces, relax_folds, surface_distance_m, untangle


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    return bent(l_body(0.03))


@pytest.fixture(scope="module")
def remeshed(body: trimesh.Trimesh) -> trimesh.Trimesh:
    return remesh(body, _rng(), config=RemeshConfig(tolerance=0.002, min_edge=0.025, max_edge=0.09, iterations=3))


def test_a_bent_body_is_remeshed_as_ever(remeshed: trimesh.Trimesh) -> None:
    assert_known("remesh vertices", remeshed.vertices)
    assert_known("remesh faces", remeshed.faces)


def test_edges_are_short_where_the_surface_bends_and_long_where_it_is_flat() -> None:
    slab = trimesh.creation.box((0.16, 0.14, 0.05))
    made = remesh(slab, _rng(), config=RemeshConfig(tolerance=0.002, min_edge=0.06, max_edge=0.2, iterations=3))
    edges = made.vertices[made.edges_unique]
    lengths = np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1) / np.linalg.norm(slab.extents)
    from_rim = np.minimum(0.08 - np.abs(edges[..., 0]), 0.07 - np.abs(edges[..., 1])).mean(axis=1)
    assert 0.05 < np.median(lengths[from_rim < 1e-3]) < 0.08
    assert np.median(lengths[from_rim > 0.04]) > 1.5 * 0.06
    assert lengths.max() < 0.2 * 4 / 3
    assert np.abs(np.bincount(made.edges_unique.ravel()) - 6).mean() < 0.8


def test_a_box_that_is_refined_has_edges_of_the_wanted_length() -> None:
    made = refine(trimesh.creation.box((0.1, 0.06, 0.03)), 0.013)
    assert made.edges_unique_length.max() < 0.013 * 1.5
    assert_known("refine", made.vertices)


def _shapes(mesh: trimesh.Trimesh) -> np.ndarray:
    mean = np.asarray(mesh.vertices)
    wave = np.sin(40 * mean[:, [1, 2, 0]]) * [0.004, 0.002, 0.003]
    return np.stack([mean, mean + wave, mean - wave])


@pytest.mark.parametrize(
    ("name", "config"),
    [
        ("default", ResampleConfig()),
        ("modes", ResampleConfig(max_error_m=0.002, mode_error=0.6, max_edge=0.25)),
        ("edges", ResampleConfig(max_error_m=0.01, mode_error=1.0, max_edge=0.15)),
    ],
)
def test_a_mesh_of_many_shapes_is_thinned_out_as_ever(remeshed, name: str, config: ResampleConfig) -> None:
    carry, faces, error_m = resample(_shapes(remeshed), np.asarray(remeshed.faces), _rng(), config=config)
    assert_known(f"resample {name} faces", faces)
    assert_known(f"resample {name} vertices", carry @ remeshed.vertices)
    assert_known(f"resample {name} error", np.array([error_m]))


@pytest.fixture(scope="module")
def member() -> trimesh.Trimesh:
    source = l_body(0.02)
    x, y, z = np.asarray(source.vertices).T
    return bent(trimesh.Trimesh(np.column_stack([1.1 * x, 0.9 * y + 0.1 * z, 1.2 * z]), source.faces, process=False))


def test_a_template_is_bent_onto_a_member_as_ever(remeshed: trimesh.Trimesh, member: trimesh.Trimesh) -> None:
    found = TemplateFitter(remeshed).fit(member)
    assert_known("correspondence", found.vertices)
    assert_known("correspondence residual", np.array([found.residual_m]))
    assert found.covered > 0.97
    # Another member, of which a part is missing, and another seed.
    upright = bent(refined(trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.03, 0.03, 0.1]]), 0.02))
    other = TemplateFitter(remeshed, seed=3).fit(upright, placed=np.asarray(remeshed.vertices))
    assert_known("correspondence of a part", [*other.vertices.ravel(), other.covered, other.flipped])
    assert other.covered < found.covered


def test_a_template_is_placed_by_scale_and_shift_alone(remeshed: trimesh.Trimesh, member: trimesh.Trimesh) -> None:
    start = np.asarray(remeshed.vertices)
    placed = place(start, np.asarray(remeshed.faces), Surface(member, _rng(), count=2000))
    scale = np.ptp(placed, axis=0) / np.ptp(start, axis=0)
    np.testing.assert_allclose(placed - placed.mean(axis=0), (start - start.mean(axis=0)) * scale, atol=1e-12)
    assert_known("place", placed)


def test_a_handle_does_not_stretch_the_body_that_is_placed() -> None:
    """The start with one scale along x and y is the better one where the member's handle reaches farther."""
    template, reaching = mug(reach=0.016), mug(reach=0.03)
    placed = place(np.asarray(template.vertices), np.asarray(template.faces), Surface(reaching, _rng(), count=3000))
    assert_known("place handle", placed)


def test_points_slide_onto_the_smooth_surface_as_ever() -> None:
    rng = _rng(5)
    x, y = rng.uniform(-0.03, 0.03, (2, 900))
    sheet = np.column_stack([x, y, 4 * x * x - 3 * x * y]) + 4e-4 * rng.normal(size=(900, 3))
    slope = np.column_stack([3 * y - 8 * x, 3 * x, np.ones(900)])
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    cloud, normals = np.vstack([sheet, sheet - [0, 0, 0.004]]), np.vstack([slope, -slope])
    alone = np.array([[0.05, 0.05, 0.01], [0.034, 0.034, 0.0]])
    points, up = np.vstack([sheet[:50] + 0.002 * slope[:50], alone]), np.vstack([slope[:50], slope[:2]])
    for name, knobs in (("default", {}), ("planes", {"degree": 1}), ("once", {"iterations": 1, "num_neighbours": 9})):
        assert_known(f"project {name}", project(points, up, cloud, normals, radius_m=0.004, **knobs) - points)


def _folded() -> tuple[np.ndarray, np.ndarray]:
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    vertices = np.array(sphere.vertices) * [1.0, 0.8, 1.2]
    near = np.linalg.norm(vertices - vertices[40], axis=1) < 0.015
    vertices[near] += 0.09 * np.cross(vertices[near], [3.0, 5.0, 8.0]) / 0.5 * [[-1.0, 1.0, 0.4]]
    return vertices, np.asarray(sphere.faces)


def test_folds_are_smoothed_away_ring_by_ring_as_ever() -> None:
    vertices, faces = _folded()
    assert folded_faces(vertices, faces).sum() >= 9
    mended = untangle(vertices, faces)
    assert not folded_faces(mended, faces).any()
    assert_known("untangle", mended)
    assert_known("untangle begun", untangle(vertices, faces, iterations=3))


def test_folds_are_slid_flat_along_a_surface_as_ever() -> None:
    vertices, faces = _folded()

    def onto_ellipsoid(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        assert points.shape == normals.shape
        unit = points / [1.0, 0.8, 1.2]
        return 0.05 * unit / np.linalg.norm(unit, axis=1, keepdims=True) * [1.0, 0.8, 1.2]

    slid = relax_folds(vertices, faces, onto_ellipsoid)
    assert folded_faces(slid, faces).sum() < folded_faces(vertices, faces).sum()
    assert_known("relax folds", slid)


def test_nearest_places_are_found_by_position_and_normal(body: trimesh.Trimesh) -> None:
    surface = Surface(body, _rng(), count=500)
    points, normals = body.triangles_center[::3] + 0.004, -body.face_normals[::3]
    assert_known("nearest", surface.nearest(points, normals, normal_weight_m=0.01))
    assert_known("closest", surface.closest(points)[0])
    assert_known("closest with normals", np.hstack(surface.closest(points, normals, normal_weight_m=0.02)))


def test_distances_between_surfaces_are_means_of_both_directions(body, member) -> None:
    assert_known("surface distance", np.array([surface_distance_m(body, member), surface_distance_m(member, body)]))
    assert surface_distance_m(body, member, seed=1) != surface_distance_m(body, member)
