"""From meshes of a class to its primitive, and back from disk."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from revolved import cup, mug, wall_thickness

from gfp_grasp.errors import AssetMissing, BuildFailed, InvalidMesh, InvalidOption, UnknownCategory, UnreadableFile
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.primitives import (
    BuildConfig,
    build_primitive,
    fit_full_surface,
    measure_primitive,
    read_primitive,
    save_primitive,
)
from gfp_grasp.primitives.correspondence import CorrespondenceConfig, TemplateFitter
from gfp_grasp.primitives.pose import bring_into_one_pose, stand_up
from gfp_grasp.primitives.procrustes import choose_template, shape_model
from gfp_grasp.primitives.remesh import RemeshConfig, refine, remesh
from gfp_grasp.primitives.surface import surface_distance_m
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.train import build_from_folder, build_from_shapes
from gfp_grasp.transforms import random_rotation
from gfp_grasp.types import INSIDE

QUICK = BuildConfig(
    rounds=1,
    parts=False,
    correspondence=CorrespondenceConfig(steps=6, rounds=3, num_samples=1200),
    remesh=RemeshConfig(min_edge=0.027, max_edge=0.1, iterations=4),
)


def _thin_cups(count):
    rng = np.random.default_rng(7)
    members = [
        cup(height=rng.uniform(0.08, 0.13), bottom=rng.uniform(0.025, 0.03), top=rng.uniform(0.033, 0.045), wall=0.0015)
        for _ in range(count)
    ]
    for number, member in enumerate(members):  # another corner first in another face: none corresponds by itself
        member.faces[number] = np.roll(member.faces[number], 1)
    return members


@pytest.fixture(scope="module")
def thin_members():
    return _thin_cups(6)


@pytest.fixture(scope="module")
def template():
    return remesh(cup(wall=0.003), np.random.default_rng(0), config=QUICK.remesh)


@pytest.fixture(scope="module")
def fitter(template):
    return TemplateFitter(template)


@pytest.fixture(scope="module")
def thin_primitive(thin_members):
    return build_primitive(thin_members, "cup", config=QUICK)


def test_template_is_the_member_of_the_commonest_topology():
    members = [mug(), cup(), cup(top=0.05), cup(bottom=0.035)]
    assert choose_template(members, np.random.default_rng(0)) in (1, 2, 3)


def test_bent_template_lies_on_the_member_and_walls_go_to_walls(template, fitter):
    member = cup(height=0.13, bottom=0.024, top=0.046, wall=0.0015)
    found = fitter.fit(member)
    bent = trimesh.Trimesh(found.vertices, template.faces, process=False)
    assert found.residual_m < 0.0003
    assert found.covered > 0.99
    assert bent.is_volume
    assert surface_distance_m(member, bent) < 0.0003
    assert bent.volume == pytest.approx(member.volume, rel=0.05)
    thickness = wall_thickness(found.vertices, template.faces, low=0.02, high=0.12)
    assert abs(np.median(thickness) - 0.0015) < 0.0002
    # Upper ends stay upper ends: heights correspond in order.
    assert np.corrcoef(found.vertices[:, 2], template.vertices[:, 2])[0, 1] > 0.99


def test_template_fits_itself_without_moving(template, fitter):
    found = fitter.fit(template)
    assert found.residual_m < 0.0001
    assert np.linalg.norm(found.vertices - template.vertices, axis=1).mean() < 0.0015  # it may slide a little


def test_stiffness_that_grows_is_refused():
    with pytest.raises(InvalidOption):
        CorrespondenceConfig(stiff=0.01, soft=0.1)


def test_modes_of_scaled_copies_are_none_and_their_scales_are_found():
    rng = np.random.default_rng(0)
    shape, weights = rng.normal(size=(80, 3)), rng.uniform(1, 2, 80)
    scale = np.exp(0.2 * rng.normal(size=(10, 3)))
    model = shape_model(shape * scale[:, None], weights)
    assert model.variance_m2 < 1e-16
    np.testing.assert_allclose(model.log_scale, np.log(scale) - np.log(scale).mean(axis=0), atol=1e-9)
    assert len(model.modes) == 0


def test_known_modes_are_recovered_with_unit_deviation():
    rng = np.random.default_rng(1)
    mean, weights = 0.05 * rng.normal(size=(200, 3)), np.ones(200)
    axes = np.linalg.qr(rng.normal(size=(600, 2)))[0].T.reshape(2, 200, 3)
    scores = rng.normal(size=(400, 2)) * [0.02, 0.01]
    members = mean + np.tensordot(scores, axes, 1)
    model = shape_model(members, weights, outlier_beyond=10.0)
    assert len(model.modes) == 2
    np.testing.assert_allclose(model.coefficients.std(axis=0, ddof=1), 1.0, atol=1e-6)
    rebuilt = (model.mean + np.tensordot(model.coefficients, model.modes, 1)) * np.exp(model.log_scale)[:, None]
    np.testing.assert_allclose(rebuilt, members, atol=1e-4)
    assert model.explained[0] == pytest.approx(0.8, abs=0.05)


def test_outlier_bends_neither_mean_nor_main_modes_but_is_expressed():
    rng = np.random.default_rng(2)
    mean = 0.05 * rng.normal(size=(100, 3))
    usual = mean + 0.001 * rng.normal(size=(30, 1, 1)) * rng.normal(size=(100, 3))
    odd = mean + 0.02 * rng.normal(size=(1, 100, 3))
    model = shape_model(np.concatenate([usual, odd]), np.ones(100))
    np.testing.assert_array_equal(np.flatnonzero(model.outlier), [30])
    assert np.linalg.norm(model.mean - mean, axis=1).mean() < 0.0005
    rebuilt = (model.mean + np.tensordot(model.coefficients[30], model.modes, 1)) * np.exp(model.log_scale[30])
    assert np.linalg.norm(rebuilt - odd[0], axis=1).mean() < 0.001


def _members_of_known_spread(deviations, count=60, seed=3):
    """Members about one mean, along orthogonal axes, of known standard deviations; their scales cannot tell them."""
    rng = np.random.default_rng(seed)
    mean = 0.05 * rng.normal(size=(150, 3))
    rows = [mean[:, k] / np.linalg.norm(mean[:, k]) for k in range(3)]
    basis = np.zeros((3, 450))
    for k in range(3):
        basis[k].reshape(150, 3)[:, k] = rows[k]
    free = rng.normal(size=(len(deviations), 450))
    free -= free @ basis.T @ basis  # what no change of scale explains
    axes = np.linalg.qr(free.T)[0].T
    scores = rng.normal(size=(count, len(deviations)))
    scores -= scores.mean(axis=0)
    scores = np.linalg.qr(scores)[0] * np.sqrt(count - 1) * deviations
    return mean, (mean + (scores @ axes).reshape(count, 150, 3))


@pytest.mark.parametrize(("variance", "kept"), [(0.55, 1), (0.8, 2), (0.95, 3), (1.0, 4)])
def test_fewest_modes_that_explain_the_variance_are_kept(variance, kept):
    # Shares of the variance: 16, 8, 3 and 1 of 28.
    mean, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0]))
    model = shape_model(members, np.ones(150), variance=variance, outlier_beyond=10.0)
    assert len(model.modes) == kept
    np.testing.assert_allclose(model.explained, np.array([16, 8, 3, 1])[:kept] / 28, rtol=0.02)
    np.testing.assert_allclose(model.mean, mean, atol=1e-5)
    assert model.variance_m2 == pytest.approx(28e-6 / 150, rel=0.01)
    # One standard deviation each, and the free sign is fixed.
    sizes = np.sqrt((model.modes**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(sizes, 0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0])[:kept], rtol=0.02)
    assert (model.modes.sum(axis=(1, 2)) > 0).all()


def test_there_are_no_more_modes_than_asked_for_and_none_without_variance():
    _, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 3.0, 1.0]))
    assert len(shape_model(members, np.ones(150), variance=1.0, max_modes=2, outlier_beyond=10.0).modes) == 2
    _, members = _members_of_known_spread(0.001 * np.sqrt([16.0, 8.0, 1e-5]))
    assert len(shape_model(members, np.ones(150), variance=1.0, outlier_beyond=10.0).modes) == 2  # a millionth


def test_a_member_beyond_two_and_a_half_medians_is_an_outlier():
    mean, members = _members_of_known_spread(0.001 * np.ones(40), count=41)
    distance = np.linalg.norm(members - mean, axis=(1, 2))
    for factor, odd in ((2.2, False), (2.9, True)):
        stretched = members.copy()
        stretched[5] = mean + (members[5] - mean) * factor * np.median(distance) / distance[5]
        assert shape_model(stretched, np.ones(150)).outlier[5] == odd


def test_members_turned_over_are_refused():
    rng = np.random.default_rng(0)
    shape = rng.normal(size=(50, 3))
    with pytest.raises(InvalidMesh, match="turned over"):
        shape_model(np.stack([shape, shape, shape * [1, 1, -1]]), np.ones(50))


def test_one_member_makes_no_class():
    with pytest.raises(InvalidMesh, match="at least two"):
        shape_model(np.zeros((1, 5, 3)), np.ones(5))


@pytest.mark.parametrize("make", [cup, mug])
def test_turned_class_is_stood_upright(make):
    mesh = refine(make(), 0.02)
    vertices = np.array(mesh.vertices)
    turned = vertices @ random_rotation(np.random.default_rng(4)).T + 0.3
    stood = stand_up(turned[None], turned, np.array(mesh.faces), upright=False)[0]
    assert stood[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(stood[:, 2] - vertices[:, 2]).max() < 0.002
    if make is mug:
        assert np.abs(stood - vertices).max() < 0.004


def test_turned_and_scaled_members_come_into_one_pose():
    rng = np.random.default_rng(5)
    members, turns = [], []
    for reach in (0.026, 0.028, 0.03):
        mesh, R = mug(reach=reach), random_rotation(rng)
        mesh.vertices = rng.uniform(0.5, 3.0) * mesh.vertices @ R.T + rng.normal(size=3)
        members.append(mesh)
        turns.append(R)
    posed = bring_into_one_pose(members, "any", rng)
    for before, after, R in zip(members, posed, turns, strict=True):
        turn = trimesh.registration.procrustes(before.vertices, after.vertices, scale=False)[0][:3, :3] @ R
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 4.0
        np.testing.assert_allclose(np.sort(before.edges_unique_length), np.sort(after.edges_unique_length))


def test_built_primitive_is_a_clean_upright_volume(thin_primitive):
    mesh = trimesh.Trimesh(thin_primitive.vertices, thin_primitive.faces, process=False)
    assert mesh.is_volume
    assert not len(crossing_faces(mesh.vertices, mesh.faces))
    assert mesh.bounds[0, 2] == 0.0
    assert np.abs(mesh.bounds[:, :2].sum(axis=0)).max() < 0.001
    assert thin_primitive.symmetry.order == math.inf
    assert 0.3 < (thin_primitive.regions == INSIDE).mean() < 0.6
    assert thin_primitive.variants == ()
    assert thin_primitive.card["members_used"] == 6


def test_built_primitive_has_the_figures_that_it_had_when_the_shipped_ones_were_built(thin_primitive):
    """Whoever changes the build on purpose builds the shipped primitives again, measures, and then changes these."""
    mesh = trimesh.Trimesh(thin_primitive.vertices, thin_primitive.faces, process=False)
    assert len(mesh.vertices) == pytest.approx(851, rel=0.02)
    np.testing.assert_allclose(mesh.extents, [0.08103, 0.08112, 0.09800], rtol=2e-3)
    assert 1e6 * mesh.volume == pytest.approx(38.99, rel=0.01)
    assert 1e4 * mesh.area == pytest.approx(447.4, rel=0.01)
    assert (thin_primitive.regions == INSIDE).sum() == pytest.approx(381, rel=0.05)
    np.testing.assert_allclose(thin_primitive.explained, [0.703, 0.170, 0.050, 0.047, 0.030], atol=0.015)
    sizes_mm = 1e3 * np.linalg.norm(thin_primitive.modes, axis=2).mean(axis=1)
    np.testing.assert_allclose(sizes_mm, [0.622, 0.262, 0.135, 0.140, 0.101], rtol=0.1)
    cov = thin_primitive.log_scale_cov
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), [0.0586, 0.0589, 0.1221], rtol=0.01)
    assert cov[0, 2] / np.sqrt(cov[0, 0] * cov[2, 2]) == pytest.approx(-0.052, abs=0.02)
    low, high = (np.array(extents) for extents in thin_primitive.spec.size_range_m)
    np.testing.assert_allclose(low, [0.0719, 0.0719, 0.0812], rtol=5e-3)
    np.testing.assert_allclose(high, [0.0857, 0.0857, 0.1123], rtol=5e-3)
    assert thin_primitive.spec.rests["upright"] == pytest.approx(0.980, abs=0.01)


def test_wall_of_one_and_a_half_millimetres_survives_it_all(thin_primitive):
    height = float(thin_primitive.vertices[:, 2].max())
    limits = {"low": 0.15 * height, "high": 0.9 * height}
    assert np.abs(wall_thickness(thin_primitive.vertices, thin_primitive.faces, **limits) - 0.0015).max() < 0.0003


def test_mean_has_the_geometric_mean_size_of_the_members(thin_primitive, thin_members):
    expected = np.exp(np.mean([np.log(member.extents) for member in thin_members], axis=0))
    np.testing.assert_allclose(np.ptp(thin_primitive.vertices, axis=0), expected, rtol=0.04)
    assert np.abs(thin_primitive.coefficient_samples[:, -3:].mean(axis=0)).max() < 1e-9


def test_primitive_fits_a_new_member_whole(thin_primitive):
    member = cup(height=0.1, bottom=0.028, top=0.04, wall=0.0015)
    vertices, error = fit_full_surface(thin_primitive, member)
    assert vertices.shape == thin_primitive.vertices.shape
    assert error < 0.0006


def test_members_with_equal_faces_correspond_vertex_by_vertex():
    block = trimesh.creation.box((0.08, 0.05, 0.1)).subdivide().subdivide().subdivide()
    block.apply_translation([0, 0, 0.05])
    shears = np.array([-0.5, -0.3, -0.2, 0.1, 0.25, 0.65])
    members = [
        trimesh.Trimesh(block.vertices + shear * block.vertices[:, 2:] * [1, 0, 0], block.faces, process=False)
        for shear in shears
    ]
    primitive = build_primitive(members, "block", config=replace(QUICK, smoothing=0.0))
    assert primitive.explained[0] > 0.999
    coefficients = primitive.coefficient_samples[:, 0]
    np.testing.assert_allclose(np.abs(np.ptp(coefficients)) * np.ptp(primitive.modes[0, :, 0]), 1.15 * 0.1, rtol=0.02)
    assert abs(np.corrcoef(coefficients, shears)[0, 1]) > 1 - 1e-6


def test_report_measures_held_out_members(thin_primitive):
    figures = measure_primitive(thin_primitive, [cup(bottom=0.028, wall=0.0015)])
    assert figures.held_out == 1
    assert figures.generalization_mm == figures.generalization_worst_mm == pytest.approx(0.126, abs=0.02)
    assert figures.generalization_median_mm == figures.generalization_mm
    assert figures.specificity_mm == pytest.approx(2.86, rel=0.05)
    assert figures.variance_kept == pytest.approx(1.0, abs=1e-6)
    assert figures.figures()["vertices"] == len(thin_primitive.vertices)
    with pytest.raises(InvalidOption, match="held-out"):
        measure_primitive(thin_primitive, [])


@pytest.mark.slow
def test_same_seed_builds_the_same_primitive(thin_members, thin_primitive):
    again = build_primitive(thin_members, "cup", config=QUICK)
    np.testing.assert_array_equal(again.vertices, thin_primitive.vertices)
    np.testing.assert_array_equal(again.modes, thin_primitive.modes)


def test_too_few_members_fail_with_the_reasons():
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(BuildFailed, match="members are left"):
        build_primitive([cup(), flat, flat], "cup", config=QUICK)


def test_unknown_orientation_is_refused():
    with pytest.raises(InvalidOption, match="placed"):
        BuildConfig(orientation="sideways")  # pyright: ignore[reportArgumentType]


def test_families_and_folders_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(UnknownCategory, match="cup, mug, bottle"):
        build_from_shapes("boat")
    with pytest.raises(InvalidOption, match="members=0"):
        build_from_shapes("cup", members=0)
    with pytest.raises(InvalidOption, match="winged"):
        build_from_shapes("cup.winged")
    with pytest.raises(InvalidOption, match="holds no mesh"):
        build_from_folder(tmp_path, "cup")


def test_primitive_comes_back_from_disk(thin_primitive, tmp_path):
    path = save_primitive(thin_primitive, tmp_path)
    again = read_primitive(path)
    for name in ("vertices", "faces", "explained", "log_scale_cov", "coefficient_samples", "regions", "up"):
        np.testing.assert_array_equal(getattr(again, name), getattr(thin_primitive, name))
    np.testing.assert_allclose(again.modes, thin_primitive.modes, atol=1e-7)
    assert again.symmetry.order == math.inf
    assert trimesh.load_mesh(path.with_suffix(".ply")).is_volume
    card = json.loads(path.with_suffix(".json").read_text())
    assert len(card["sha256"]) == 64


def test_broken_primitive_files_are_refused_by_name(thin_primitive, tmp_path):
    path = save_primitive(thin_primitive, tmp_path)
    content = path.read_bytes()
    path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(UnreadableFile, match="sha256"):
        read_primitive(path)
    path.write_bytes(b"not safetensors at all")
    with pytest.raises(UnreadableFile):
        read_primitive(path)
    path.unlink()
    with pytest.raises(AssetMissing):
        read_primitive(path)


def test_a_subcategory_keeps_its_name_on_disk(thin_primitive, tmp_path):
    path = save_primitive(replace(thin_primitive, subcategory="thin", spec=None), tmp_path)
    assert path.name == f"{thin_primitive.category}.thin.safetensors"
    assert read_primitive(path).subcategory == "thin"


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_class_is_built_from_remeshed_turned_scaled_and_broken_files(tmp_path):
    rng = np.random.default_rng(11)
    for number, seed in enumerate(split_seeds("mug", "train")[:20]):
        mesh = refine(make_shape("mug", seed).mesh, 0.012)
        vertices = rng.uniform(0.8, 1.25) * mesh.vertices @ random_rotation(rng).T + rng.normal(size=3)
        faces = np.array(mesh.faces)
        if number in (3, 8):
            faces = faces[np.linalg.norm(vertices[faces].mean(axis=1) - vertices[faces[0, 0]], axis=1) > 0.008]
        if number in (5, 12):
            faces[rng.permutation(len(faces))[:200]] = faces[rng.permutation(len(faces))[:200]][:, ::-1]
        if number == 15:
            faces = faces[:4]
        order = rng.permutation(len(vertices))
        place = np.argsort(order)
        trimesh.Trimesh(vertices[order], place[faces], process=False).export(tmp_path / f"{number:02d}.off")
    (tmp_path / "broken.off").write_text("OFF\n3 1 0\nnot a mesh")
    config = BuildConfig(orientation="any", parts=False, correspondence=QUICK.correspondence)
    primitive = build_from_folder(tmp_path, "mug", config=config)
    mesh = trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)
    assert mesh.is_volume
    assert mesh.euler_number == 0
    assert not len(crossing_faces(mesh.vertices, mesh.faces))
    assert "1 more unreadable" in str(primitive.card["data"])
    assert int(str(primitive.card["members_used"])) >= 13
    # Upright, handle towards +x, open at the top.
    handle = primitive.on_region("handle")
    assert handle.any()
    assert primitive.vertices[handle, 0].mean() > 0.9 * np.abs(primitive.vertices[:, 1]).max()
    assert primitive.without(["handle"]) is not None
    inside = primitive.regions == INSIDE
    assert primitive.vertices[inside, 2].max() > 0.85 * primitive.vertices[:, 2].max()
    assert float(str(primitive.card["generalization_mm"])) < 1.5


def test_members_that_walk_have_one_scale_along_the_way_and_across_it():
    rng = np.random.default_rng(0)
    shape, step = rng.normal(size=(200, 3)) * [0.05, 1, 1], rng.normal(size=200)
    sizes = np.array([0.7, 1.0, 1.0, 1.0 / 0.7])
    strides = np.array([0.0, -1.0, 1.0, 0.0])
    members = np.stack([size * (shape + np.outer(s * step, [1, 0, 0])) for size, s in zip(sizes, strides, strict=True)])
    model = shape_model(members, np.ones(200))
    np.testing.assert_allclose(model.log_scale, np.repeat(np.log(sizes)[:, None], 3, axis=1), atol=1e-6)
    assert len(model.modes) == 1
