"""Meshes of primitives: remeshing, thinning out, undoing folds, labels, symmetry, and the body without its handle."""

import math

import numpy as np
import pytest
import trimesh
from revolved import cup, mug, wall_thickness

from gfp_grasp.errors import BuildFailed, InvalidMesh, InvalidOption
from gfp_grasp.meshes import crossing_faces, vertex_normals
from gfp_grasp.primitives import detect_symmetry
from gfp_grasp.primitives.regions import label_regions, without_part
from gfp_grasp.primitives.remesh import RemeshConfig, refine, remesh
from gfp_grasp.primitives.resample import ResampleConfig, resample
from gfp_grasp.primitives.surface import Surface, folded_faces, surface_distance_m, untangle
from gfp_grasp.types import INSIDE, OUTSIDE

COARSE = RemeshConfig(min_edge=0.02, max_edge=0.08, iterations=4)


@pytest.fixture(scope="module")
def thin_cup():
    return cup(wall=0.0015)


@pytest.fixture(scope="module")
def remeshed_mug():
    return remesh(mug(), np.random.default_rng(0), config=RemeshConfig(min_edge=0.022, max_edge=0.08, iterations=4))


def test_closest_point_is_exact_on_a_sphere_of_few_faces():
    mesh = trimesh.creation.icosphere(subdivisions=1)
    centres = np.asarray(mesh.triangles_center)
    closest, normals = Surface(mesh, np.random.default_rng(0), count=500).closest(centres + 0.5 * mesh.face_normals)
    np.testing.assert_allclose(closest, centres, atol=1e-9)
    np.testing.assert_allclose(normals, mesh.face_normals, atol=1e-9)


def test_closest_point_with_normals_stays_on_its_side_of_a_wall():
    plate = trimesh.creation.box([0.1, 0.1, 0.001])
    surface = Surface(plate, np.random.default_rng(0), count=4000)
    near_bottom, up = np.array([[0.0, 0.0, -0.0004]]), np.array([[0.0, 0.0, 1.0]])
    assert surface.closest(near_bottom)[0][0, 2] == pytest.approx(-0.0005)
    assert surface.closest(near_bottom, up, normal_weight_m=0.02)[0][0, 2] == pytest.approx(0.0005)


def test_surface_distance_of_nested_spheres_is_their_gap():
    a, b = (trimesh.creation.icosphere(subdivisions=5, radius=r) for r in (0.05, 0.052))
    assert surface_distance_m(a, b) == pytest.approx(0.002, rel=0.02)
    assert surface_distance_m(a, a) < 1e-6


def test_remeshing_keeps_surface_topology_and_a_thin_wall(thin_cup):
    result = remesh(thin_cup, np.random.default_rng(0), config=COARSE)
    assert result.is_volume
    assert result.euler_number == 2
    assert not len(crossing_faces(result.vertices, result.faces))
    assert surface_distance_m(thin_cup, result) < 0.0003
    thickness = wall_thickness(result.vertices, result.faces, low=0.015, high=0.09)
    assert abs(np.median(thickness) - 0.0015) < 0.0001


def test_remeshed_triangles_are_well_shaped(remeshed_mug):
    corners = remeshed_mug.triangles
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = 2 * remeshed_mug.area_faces / longest / longest
    assert np.percentile(height, 1) > 0.1
    assert np.median(height) > 0.6


def test_refining_splits_edges_and_moves_nothing():
    box = trimesh.creation.box([0.1, 0.1, 0.1])
    fine = refine(box, 0.02)
    assert fine.edges_unique_length.max() <= 1.6 * 0.02
    assert fine.is_volume
    assert fine.volume == pytest.approx(box.volume, rel=1e-6)


def test_open_mesh_is_not_remeshed(thin_cup):
    holed = trimesh.Trimesh(thin_cup.vertices, thin_cup.faces[5:], process=False)
    with pytest.raises(InvalidMesh, match="closed"):
        remesh(holed, np.random.default_rng(0))


def test_edges_that_make_no_sense_are_refused():
    with pytest.raises(InvalidOption):
        RemeshConfig(min_edge=0.1, max_edge=0.05)


def test_thinned_mesh_is_within_half_a_millimetre_and_needs_fewer_vertices(remeshed_mug):
    dense, faces = np.array(remeshed_mug.vertices), np.array(remeshed_mug.faces)
    bulged = dense * (1 + 0.15 * np.sin(np.pi * dense[:, 2:] / 0.1)) * [1, 1, 0] + dense * [0, 0, 1]
    carry, thin, error = resample(np.stack([dense, bulged]), faces, np.random.default_rng(0))
    assert error <= 0.0005
    assert len(carry) < 0.8 * len(dense)
    for shape in (dense, bulged):
        result = trimesh.Trimesh(carry @ shape, thin, process=False)
        assert result.is_volume
        assert result.euler_number == 0
        assert surface_distance_m(trimesh.Trimesh(shape, faces, process=False), result) < 0.0003
    # The map is linear, so that what holds for the mean and a mode holds for their sum.
    np.testing.assert_allclose(np.asarray(carry).sum(axis=1), 1.0, atol=1e-9)


def test_resampling_without_an_error_is_refused():
    with pytest.raises(InvalidOption):
        ResampleConfig(max_error_m=0.0)


def test_folds_are_undone_and_the_rest_stays():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    vertices = np.array(sphere.vertices)
    vertices[7] -= 0.004 * np.cross(vertices[7], [0.3, 0.5, 0.8]) / 0.05
    assert folded_faces(vertices, sphere.faces).any()
    mended = untangle(vertices, sphere.faces)
    assert not folded_faces(mended, sphere.faces).any()
    assert not len(crossing_faces(mended, sphere.faces))
    assert (mended == vertices).all(axis=1).mean() > 0.95


def test_regions_of_a_mug_are_found_by_geometry():
    mesh = refine(mug(), 0.01)
    regions, names = label_regions(mesh)
    assert names == ("outside", "inside", "handle")
    radius, height = np.linalg.norm(mesh.vertices[:, :2], axis=1), mesh.vertices[:, 2]
    normals = vertex_normals(mesh.vertices, mesh.faces)
    inner_wall = (radius < 0.029 + 0.1 * height) & (height > 0.003) & (height < 0.09)
    assert (regions[inner_wall] == INSIDE).all()
    assert (regions[height < 0.001] == OUTSIDE).all()
    assert (regions[mesh.vertices[:, 0] > 0.046] == names.index("handle")).all()
    assert (regions[(mesh.vertices[:, 0] < -0.005) & (radius > 0.0295 + 0.1 * height)] == OUTSIDE).all()
    assert (regions[(normals[:, 2] < -0.9) & (height < 0.001)] == OUTSIDE).all()


def test_solid_body_has_no_inside_and_no_handle():
    regions, names = label_regions(trimesh.creation.cylinder(radius=0.03, height=0.1))
    assert (regions == OUTSIDE).all()
    assert names == ("outside", "inside")


def test_mug_loses_its_handle_and_stays_a_clean_volume(remeshed_mug):
    regions, names = label_regions(remeshed_mug)
    handle = regions == names.index("handle")
    kept, faces = without_part(np.array(remeshed_mug.vertices), np.array(remeshed_mug.faces), handle)
    body_left = trimesh.Trimesh(remeshed_mug.vertices[kept], faces, process=False)
    assert body_left.is_volume
    assert body_left.euler_number == 2
    assert not len(crossing_faces(body_left.vertices, faces))
    assert not handle[kept].any()
    assert body_left.bounds[1, 0] < 0.0425
    # All around, wherever the handle had its ends too.
    body = cup()
    assert surface_distance_m(body_left, body) < 0.001


def test_handle_that_is_everything_cannot_be_cut_off():
    sphere = trimesh.creation.icosphere(subdivisions=2)
    half = sphere.vertices[:, 0] > -0.99
    with pytest.raises(BuildFailed):
        without_part(np.array(sphere.vertices), np.array(sphere.faces), half)


@pytest.mark.parametrize(
    ("mesh", "order", "mirrored"),
    [
        (cup(), math.inf, True),
        (trimesh.creation.box([0.06, 0.06, 0.1]), 4, True),
        (trimesh.creation.box([0.09, 0.05, 0.1]), 2, True),
        (trimesh.creation.cylinder(radius=0.04, height=0.1, sections=6), 6, True),
        (mug(), 1, True),
    ],
)
def test_symmetry_is_recognised(mesh, order, mirrored):
    symmetry = detect_symmetry([mesh], np.random.default_rng(0))
    assert symmetry.order == order
    assert (symmetry.mirror_normal is not None) == mirrored
    if mirrored:
        np.testing.assert_allclose(np.asarray(symmetry.mirror_normal), [0, 1, 0], atol=1e-9)


def test_class_has_a_symmetry_only_if_most_members_do():
    round_one, square = cup(), trimesh.creation.box([0.06, 0.06, 0.1])
    assert detect_symmetry([round_one] * 9 + [square], np.random.default_rng(0), share=0.9).order == math.inf
    assert detect_symmetry([round_one] * 5 + [square] * 5, np.random.default_rng(0), share=0.9).order == 4
