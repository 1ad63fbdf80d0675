"""From meshes of a class to its primitive, and back from disk."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from revolved import QUICK, cup, wall_thickness

from gfp_grasp.errors import AssetMissing, BuildFailed, InvalidOption, UnknownCategory, UnreadableFile
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.primitives import (
    BuildConfig,
    build_primitive,
    fit_full_surface,
    measure_primitive,
    read_primitive,
    save_primitive,
)
from gfp_grasp.primitives.remesh import refine
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.train import build_from_folder, build_from_shapes
from gfp_grasp.transforms import random_rotation
from gfp_grasp.types import INSIDE


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
def thin_primitive(thin_members):
    return build_primitive(thin_members, "cup", config=QUICK)


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
