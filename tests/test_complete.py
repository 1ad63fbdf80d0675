import warnings
from xml.etree import ElementTree

import numpy as np
import pytest
import real_data
import torch
import trimesh

from gfp_grasp import Completion, complete_scene, complete_to_mesh
from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.clouds import order_points
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidOption, InvalidView, TooFewPoints, UnknownCategory
from gfp_grasp.level import make_level_view, mark_observed
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import sureness
from gfp_grasp.shapes import make_assorted, make_shape, split_seeds
from gfp_grasp.transforms import apply_T, look_at, make_T, rotation_about
from gfp_grasp.types import DepthImage, Detection, OrientedBox, PointCloud


def _see(family: str, seed: int, *, height: float = 0.4):
    """A test shape on a table, its depth picture, its mask and its cloud."""
    rng = np.random.default_rng(seed)
    mesh = make_shape(family, seed).mesh.copy()
    mesh.apply_transform(make_T(rotation_about((0, 0, 1), rng.uniform(0, 6)), (0.1, 0.2, height)))
    K = intrinsics(320, 240, 35)
    camera = sample_viewpoint(rng, target=mesh.bounds.mean(axis=0))
    image, index = render_mesh_view([mesh], T_world_camera=camera, K=K, width=320, height=240, table_height=height)
    image = apply_sensor(image, SensorModel.gaussian(0.001), rng)
    mask = (index == 0) & (image.depth_m > 0)
    return mesh, image, mask, cloud_of(image, mask)


@pytest.fixture(scope="module")
def mug():
    mesh, image, mask, cloud = _see("mug", split_seeds("mug", "test")[0])
    return mesh, image, mask, cloud, complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint)


def test_completion_is_a_watertight_solid_that_does_not_cross_itself(mug):
    completion = mug[-1]
    assert isinstance(completion, Completion)
    assert completion.mesh.is_volume
    assert len(crossing_faces(completion.mesh.vertices, completion.mesh.faces)) == 0


def test_completion_is_metric_and_in_the_callers_frame(mug):
    truth, completion = mug[0], mug[-1]
    assert completion.mesh.bounds == pytest.approx(truth.bounds, abs=0.02)
    rng = np.random.default_rng(0)
    # The observed points alone are at 11.7 mm in this measure, two samplings of one surface at 2.7 mm.
    assert chamfer_m(visible_surface(completion.mesh, 8192, rng), visible_surface(truth, 8192, rng)) < 0.009


@pytest.mark.parametrize("kind", ["cup.lidded", "cup.stemmed", "bottle.jug", "bottle.spray"])
def test_kinds_of_a_given_class_are_found_and_completed_as_what_they_are(kind):
    family, name = kind.split(".")
    seeds = [seed for seed in split_seeds(family, "test") if make_shape(family, seed).kind == name][:4]
    names, errors, volumes = [], [], []
    for seed in seeds:
        truth, _, _, cloud = _see(family, seed)
        done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, category=family)
        assert done.fit is not None
        names.append(done.fit.primitive.name)
        rng = np.random.default_rng(0)
        errors.append(chamfer_m(visible_surface(done.mesh, 8192, rng), visible_surface(truth, 8192, rng)))
        volumes.append(done.mesh.volume / truth.volume)
    assert len(seeds) == 4
    assert names.count(kind) >= (2 if kind == "bottle.jug" else 4)  # two views show no handle
    assert max(errors) < 0.0085
    if name != "stemmed":  # the wall of a glass is guessed
        assert volumes == pytest.approx(np.ones(len(seeds)), abs=0.2)


def test_without_kinds_a_class_is_what_it_is_fitted_by():
    seed = next(seed for seed in split_seeds("cup", "test") if make_shape("cup", seed).kind == "stemmed")
    cloud = _see("cup", seed)[-1]
    done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, config=CompleteConfig(subcategories=False))
    assert done.fit is not None
    assert done.fit.primitive.subcategory == ""


def test_completion_says_what_it_is(mug):
    completion = mug[-1]
    num_vertices = len(completion.mesh.vertices)
    assert completion.category in ("mug", "cup")
    assert sum(completion.scores.values()) == pytest.approx(1.0, abs=1e-6)
    assert completion.T_world_object.shape == (4, 4)
    assert completion.scale.shape == (3,)
    assert completion.observed.shape == (num_vertices,)
    assert completion.sigma_m.shape == (num_vertices,)
    assert 0.05 < completion.observed.mean() < 0.8
    assert (completion.sigma_m > 0).all()
    assert completion.sigma_m[~completion.observed].mean() > completion.sigma_m[completion.observed].mean()
    assert {"detect", "register", "deform"} <= set(completion.timings_s)


def test_parts_are_convex_and_fill_the_mesh_but_not_its_cavity(mug):
    completion = mug[-1]
    assert len(completion.parts) > 1
    assert all(part.is_convex and part.volume > 0 for part in completion.parts)
    assert completion.parts is completion.parts
    inside = completion.T_world_object[:3, 3] + 0.6 * completion.mesh.extents[2] * completion.T_world_object[:3, 2]
    assert not any(part.contains([inside])[0] for part in completion.parts)


def test_order_of_points_does_not_matter_and_the_answer_repeats(mug):
    cloud, completion = mug[3], mug[4]
    order = np.random.default_rng(1).permutation(len(cloud.points))
    again = complete_to_mesh(cloud.points[order], viewpoint=cloud.viewpoint)
    assert np.array_equal(again.mesh.vertices, completion.mesh.vertices)


def test_answer_moves_with_its_input(mug):
    cloud, completion = mug[3], mug[4]
    T = make_T(rotation_about((0, 0, 1), 1.0), (0.3, -0.2, 0.15))
    moved = complete_to_mesh(apply_T(T, cloud.points), viewpoint=apply_T(T, cloud.viewpoint))
    rng = np.random.default_rng(0)
    a = visible_surface(moved.mesh, 4000, rng)
    expected = completion.mesh.copy()
    expected.apply_transform(T)
    distance = trimesh.proximity.closest_point(expected, a)[1]
    assert np.quantile(distance, 0.95) < 0.002


def test_view_and_mask_are_taken_and_do_no_harm(mug):
    truth, image, mask, cloud, plain = mug
    seen = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, view=image, mask=mask)
    rng = np.random.default_rng(0)
    target = visible_surface(truth, 8192, rng)
    errors = [chamfer_m(visible_surface(c.mesh, 8192, rng), target) for c in (seen, plain)]
    assert errors[0] < errors[1] + 0.0015


def test_every_kind_of_cloud_gives_the_same_answer(mug):
    cloud, completion = mug[3], mug[4]
    points = np.asarray(cloud.points)
    for kind in (points.tolist(), torch.from_numpy(points.copy()), trimesh.PointCloud(points)):
        again = complete_to_mesh(kind, viewpoint=cloud.viewpoint)
        assert np.allclose(again.mesh.vertices, completion.mesh.vertices, atol=1e-9)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb"])
def test_completion_is_written_as_the_mesh_that_it_is(mug, tmp_path, suffix):
    mesh = mug[-1].mesh
    back = trimesh.load_mesh(mug[-1].export(tmp_path / f"mug{suffix}"))
    back.merge_vertices()
    assert back.is_volume
    assert back.volume == pytest.approx(mesh.volume, rel=1e-4)
    np.testing.assert_allclose(back.bounds, mesh.bounds, atol=1e-6)


@pytest.mark.parametrize(
    ("suffix", "assets"), [(".xml", "embedded"), (".xml", "files"), (".urdf", "embedded"), (".urdf", "files")]
)
def test_completion_is_written_as_a_body_of_its_class_with_its_parts(mug, tmp_path, suffix, assets):
    completion = mug[-1]
    path = completion.export(tmp_path / f"mug{suffix}", assets=assets)
    assert (tmp_path / "mug_meshes").exists() == (suffix == ".urdf" or assets == "files")
    root = ElementTree.parse(path).getroot()
    body, mass = ("link", "inertial/mass") if suffix == ".urdf" else ("worldbody/body", "inertial")
    (link,) = root.findall(body)
    assert link.attrib["name"] == completion.category
    written = link.find(mass)
    assert written is not None
    kg = float(written.attrib["value" if suffix == ".urdf" else "mass"])
    assert completion.fit is not None
    assert kg == pytest.approx(np.mean(completion.fit.primitive.spec.density_kg_m3) * completion.mesh.volume, rel=1e-6)
    assert kg == pytest.approx(1650 * completion.mesh.volume, rel=1e-6)
    shapes = link.findall("collision") + [g for g in link.findall("geom") if "hull" in g.attrib["name"]]
    assert len(shapes) == len(completion.parts)


def test_unknown_suffix_is_refused(mug, tmp_path):
    with pytest.raises(InvalidOption, match=r"\.urdf"):
        mug[-1].export(tmp_path / "mug.doc")


def test_scene_gives_one_completion_an_object():
    _, image, _, _ = _see("bottle", split_seeds("bottle", "test")[1])
    done = complete_scene(image)
    assert [c.category for c in done] == ["bottle"]
    assert done[0].mesh.is_volume


@pytest.mark.parametrize(
    ("cloud", "error"),
    [
        (np.zeros((0, 3)), InvalidCloud),
        (np.full((500, 3), np.nan), InvalidCloud),
        (np.random.default_rng(0).random((5, 3)) * 0.1, TooFewPoints),
        (np.zeros((500, 2)), InvalidCloud),
        ("a cup", InvalidCloud),
        (np.random.default_rng(0).random((500, 3)) * [0.1, 0.1, 0.0], InvalidCloud),
        (np.random.default_rng(0).random((500, 1)) * [[0.1, 0.1, 0.1]], InvalidCloud),
        (np.random.default_rng(0).random((500, 3)) * 100, InvalidCloud),
        (np.array([["a", "b", "c"]] * 100), InvalidCloud),
        (None, InvalidCloud),
    ],
)
def test_bad_clouds_are_refused_by_name(cloud, error):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(error):
            complete_to_mesh(cloud)


def test_bad_options_are_refused_by_name(mug):
    cloud = mug[3]
    with pytest.raises(UnknownCategory, match="bottle"):
        complete_to_mesh(cloud.points, category="boat")
    with pytest.raises(InvalidView):
        complete_to_mesh(cloud.points, mask=np.ones((2, 2), dtype=bool))
    with pytest.raises(GfpGraspError):
        complete_to_mesh(cloud.points, up=(0, 0, 0))
    with pytest.raises(GfpGraspError):
        complete_to_mesh(cloud.points, viewpoint=(0, 0))
    with pytest.raises(InvalidOption):
        CompleteConfig(rival_share=0.0)


def test_some_nan_rows_are_dropped_with_their_count(mug):
    cloud, completion = mug[3], mug[4]
    dirty = np.vstack([cloud.points, np.full((17, 3), np.nan)])
    with pytest.warns(UserWarning, match="17"):
        again = complete_to_mesh(dirty, viewpoint=cloud.viewpoint)
    assert np.array_equal(again.mesh.vertices, completion.mesh.vertices)


def test_points_are_thinned_by_themselves_not_by_their_order():
    points = np.random.default_rng(0).random((300_000, 3))
    first, second = order_points(points), order_points(points[::-1])
    assert np.array_equal(first, second)
    assert 80_000 < len(first) < 120_000


def test_level_frame_looks_at_the_viewer():
    points = np.random.default_rng(0).normal((1.0, 2.0, 3.0), 0.02, (400, 3))
    detection = Detection(
        cloud=PointCloud(points, np.array([1.0, 5.0, 4.0])),
        up=np.array([0.0, 0.0, 1.0]),
        support=None,
        category="cup",
        scores={"cup": 1.0},
        box=OrientedBox(np.eye(4), np.ones(3)),
    )
    view = make_level_view(detection)
    assert view.viewpoint is not None
    assert apply_T(view.T_world_level, view.viewpoint) == pytest.approx([1.0, 5.0, 4.0])
    assert view.cloud.points.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert view.viewpoint[0] > 0
    assert view.viewpoint[1] == pytest.approx(0.0, abs=1e-9)


def test_a_sphere_is_observed_on_the_near_side_only():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    near = sphere.vertices[sphere.vertices[:, 0] > 0.01]
    observed, sigma = mark_observed(
        np.asarray(sphere.vertices),
        np.asarray(sphere.faces),
        PointCloud(near, np.array([1.0, 0.0, 0.0])),
        sensor_sigma_m=0.0015,
        sigma_m=np.full(len(sphere.vertices), np.nan),
    )
    assert observed[sphere.vertices[:, 0] > 0.012].all()
    assert not observed[sphere.vertices[:, 0] < 0].any()
    assert sigma[sphere.vertices[:, 0] < -0.04].min() > sigma[observed].max()


@pytest.mark.slow
def test_real_captures_complete_in_the_cameras_frame():
    folder = real_data.folder() / "captures"
    with np.load(folder / "bottle_mustard.npz") as capture:
        view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
        done = complete_to_mesh(capture["object_points_cam"], viewpoint=(0, 0, 0), up=None, view=view)
        truth = trimesh.Trimesh(capture["mesh_vertices_cam"].astype(float), capture["mesh_faces"], process=False)
    rng = np.random.default_rng(0)
    assert done.category in ("bottle", "spray_bottle")
    # 8.05 mm among thirty classes, as a spray bottle; among cups, mugs and bottles alone it was 4.0.
    assert chamfer_m(visible_surface(done.mesh, 8192, rng), visible_surface(truth, 8192, rng)) < 0.0085
    with np.load(folder / "mug_red.npz") as capture:
        view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
        mug = complete_to_mesh(capture["object_points_cam"], viewpoint=(0, 0, 0), up=None, view=view)
    assert mug.category == "mug"
    assert mug.mesh.is_volume


def test_torn_between_cup_and_mug_is_sure_and_between_cup_and_bottle_is_not():
    assert sureness({"cup": 0.5, "mug": 0.48, "bottle": 0.02}, PrimitiveLibrary.shipped()) == pytest.approx(0.98)
    assert sureness({"cup": 0.5, "mug": 0.02, "bottle": 0.48}, PrimitiveLibrary.shipped()) == pytest.approx(0.52)
    assert sureness({}, PrimitiveLibrary.shipped()) == 1.0


@pytest.mark.parametrize("kind", [2008, 2010, 2014])
def test_a_thing_of_no_known_class_is_unknown_and_says_why(kind):
    mesh = make_assorted(kind, 0)
    K, camera = intrinsics(320, 240, 35.0), look_at((0.45, 0.1, 0.4), mesh.bounds.mean(axis=0))
    image, index = render_mesh_view([mesh], T_world_camera=camera, K=K, width=320, height=240, table_height=0.0)
    cloud = cloud_of(image, index == 0)
    done = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint)
    assert (done.category, done.made_by, done.fit) == ("unknown", "classfree", None)
    assert "it is of no class with a probability of " in done.note
    assert done.mesh.is_volume
    with pytest.warns(UserWarning, match="no known class is likely"):
        named = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, config=CompleteConfig(unknown_above=1.0))
    assert named.made_by == "primitive"
    errors = [
        chamfer_m(
            visible_surface(shape, 8192, np.random.default_rng(0)),
            visible_surface(mesh, 8192, np.random.default_rng(1)),
        )
        for shape in (done.mesh, named.mesh)
    ]
    assert errors[0] < errors[1]
