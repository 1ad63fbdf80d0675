"""Methods by name and views by protocol, each as the documents say."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import l_shape

from gfp_grasp.bench import BRIEF, METHODS, methods
from gfp_grasp.bench.methods import SWITCHES, ObjectView, config_of, in_sight, run_method, view_object
from gfp_grasp.camera import SensorModel, intrinsics
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.completers import CONFIGS
from gfp_grasp.deform import DeformConfig
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, icp_config, pcrnet_config, size_of_extents
from gfp_grasp.train import across_edge
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, DepthImage, FittedPrimitive, PointCloud

VIEWPOINT = np.array([0.3, 0.4, 0.5])
LAPS = ("quick", "middle", "thorough")


@pytest.fixture
def seen(monkeypatch) -> list:
    """What is rendered, without a renderer: a picture of 4 x 6 px at 1 m, the object in its left half."""
    seen = []
    index = np.where(np.arange(6) < 3, 0, -1) * np.ones((4, 1), int)

    def render(meshes, *, T_world_camera, **how):
        seen.append({"meshes": meshes, "T": T_world_camera, **how})
        return DepthImage(np.ones((4, 6)), np.array([[9.0, 0, 2.5], [0, 9.0, 1.5], [0, 0, 1]]), T_world_camera), index

    def sense(image, sensor, rng):
        seen[-1]["sensor"] = sensor
        seen[-1]["depth_m"] = image.depth_m
        return image

    monkeypatch.setattr(methods, "render_mesh_view", render)
    monkeypatch.setattr(methods, "apply_sensor", sense)
    return seen


def elevation_deg(one: dict) -> float:
    """Angle above the horizon under which the camera stands."""
    away = one["T"][:3, 3] - one["meshes"][0].bounds.mean(axis=0)
    assert np.linalg.norm(away) == pytest.approx(0.6)
    np.testing.assert_allclose(one["T"][:3, 2], -away / 0.6, atol=1e-9)
    return float(np.degrees(np.arcsin(away[2] / 0.6)))


@pytest.mark.parametrize(
    ("protocol", "low", "high", "sensor"),
    [
        ("standard", 20, 60, SensorModel.gaussian(0.002)),
        ("hidden", 20, 60, SensorModel.gaussian(0.002)),
        ("noisy", 5, 80, SensorModel(sigma_m=0.003, hole_share=0.08, hole_radius_px=3.0, edge_lost_share=0.25)),
    ],
)
def test_an_object_stands_anywhere_and_is_seen_from_anywhere(seen, protocol, low, high, sensor):
    mesh = l_shape()
    views = [view_object(mesh, np.random.default_rng(i), protocol=protocol, noise_m=0.002) for i in range(150)]
    heights = [view.T_world_object[2, 3] for view in views]
    assert (min(heights), max(heights)) == (pytest.approx(-0.3, abs=0.04), pytest.approx(0.9, abs=0.04))
    elevations = [elevation_deg(one) for one in seen]
    assert (min(elevations), max(elevations)) == (pytest.approx(low, abs=2), pytest.approx(high, abs=2))
    yaws = [np.degrees(np.arctan2(*view.T_world_object[[1, 0], 0])) for view in views]
    assert (min(yaws), max(yaws)) == (pytest.approx(-180, abs=8), pytest.approx(180, abs=8))
    for view, one, height in zip(views, seen, heights, strict=True):
        assert one["meshes"][0] is view.mesh
        assert view.T_world_object[2, 2] == pytest.approx(1.0)
        assert view.T_world_object[:2, 3].tolist() == [0.0, 0.0]
        assert (one["width"], one["height"], one["table_height"]) == (320, 240, pytest.approx(height))
        np.testing.assert_array_equal(one["K"], intrinsics(320, 240, 35.0))
        assert view.mesh.bounds[0, 2] == pytest.approx(height)
        np.testing.assert_allclose(np.asarray(view.cloud.viewpoint), one["T"][:3, 3])
        assert one["sensor"] == sensor
    np.testing.assert_array_equal(mesh.bounds, l_shape().bounds)


def test_the_noise_is_a_millimetre_where_nothing_else_is_said(seen):
    view = view_object(l_shape(), np.random.default_rng(0))
    assert seen[0]["sensor"] == SensorModel.gaussian(0.001)
    assert len(view.cloud.points) == 12  # the pixels of the object, none of the table


def test_what_has_fallen_lies_on_any_side_or_stands_on_its_head(seen):
    views = [view_object(l_shape(), np.random.default_rng(i), protocol="fallen") for i in range(200)]
    ups = np.array([view.T_world_object[2, :3] for view in views])
    on_head = np.isclose(ups[:, 2], -1)
    assert 0.4 < on_head.mean() < 0.6
    assert np.allclose(ups[~on_head, 2], 0)
    sides = np.degrees(np.arctan2(ups[~on_head, 1], ups[~on_head, 0]))
    assert (sides.min(), sides.max()) == (pytest.approx(-180, abs=10), pytest.approx(180, abs=10))
    for view in views:
        table = view.T_world_object[2, 3] + (l_shape().vertices @ view.T_world_object[2, :3]).min()
        assert view.mesh.bounds[0, 2] == pytest.approx(table)
        assert -0.3 <= table <= 0.9
    assert all(one["table_height"] == pytest.approx(one["meshes"][0].bounds[0, 2]) for one in seen)


def test_a_board_hides_half_of_the_object_five_centimetres_before_it():
    depth = np.full((40, 60), 1.0)
    index = np.full((40, 60), -1)
    index[10:30, 20:40] = 0
    depth[10:30, 20:40] = 0.8
    depth[20, 25] = 0.7
    image, angles = DepthImage(depth, intrinsics(60, 40, 35.0), np.eye(4)), []
    for seed in range(40):
        hidden, left = methods._behind_a_board(image, index, np.random.default_rng(seed))
        board = left == 1
        assert np.allclose(hidden.depth_m[board], 0.65)
        np.testing.assert_allclose(hidden.depth_m[~board], depth[~board], rtol=1e-6)
        np.testing.assert_array_equal(left[~board], index[~board])
        assert 0.45 < board[10:30, 20:40].mean() <= 0.5
        rows, columns = np.nonzero(board)
        angles.append(np.arctan2(19.5 - rows.mean(), 29.5 - columns.mean()))
    assert (min(angles), max(angles)) == (pytest.approx(-np.pi, abs=0.4), pytest.approx(np.pi, abs=0.4))
    np.testing.assert_array_equal(hidden.K, image.K)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_board_hides_the_share_that_is_asked_for_and_half_as_it_always_did(share):
    index = np.full((40, 60), -1)
    index[10:30, 20:41] = 0
    index[30:33, 24:29] = 0
    image = DepthImage(np.full((40, 60), 0.8), intrinsics(60, 40, 35.0), np.eye(4))
    for seed in range(200):
        left = methods._behind_a_board(image, index, np.random.default_rng(seed), share=share)[1]
        assert (left[index == 0] == 1).mean() == pytest.approx(share, abs=0.01)
        if share == 0.5:
            along = across_edge(index.shape, np.random.default_rng(seed).uniform(0, 2 * np.pi))
            np.testing.assert_array_equal(left == 1, along < np.median(along[index == 0]))


def test_a_view_has_its_picture_and_hides_half_of_it_where_nothing_else_is_said(seen, monkeypatch):
    shares = []

    def behind(image, index, rng, *, share):
        shares.append(share)
        return image, index

    monkeypatch.setattr(methods, "_behind_a_board", behind)
    view = view_object(l_shape(), np.random.default_rng(0), protocol="hidden")
    view_object(l_shape(), np.random.default_rng(0), protocol="hidden", hidden_share=0.7)
    view_object(l_shape(), np.random.default_rng(0), hidden_share=0.7)
    assert shares == [0.5, 0.7]
    assert view.image is not None
    assert view.mask is not None
    assert view.mask.sum() == len(view.cloud.points) == 12
    np.testing.assert_allclose(view.image.points()[view.mask], view.cloud.points)


def test_points_are_in_sight_unless_they_face_away_or_something_is_before_them():
    low = trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]])
    wall = trimesh.creation.box(bounds=[[2, 0, 0], [2.2, 1, 0.6]])
    both = trimesh.util.concatenate([low, wall])
    points = np.array([[1, 0.5, 0.9], [1, 0.5, 0.2], [0, 0.5, 0.5], [0.5, 0.5, 1], [2.2, 0.5, 0.3]], dtype=float)
    normals = np.array([[1, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [1, 0, 0]], dtype=float)
    seen = in_sight(both, points, normals, np.array([4.0, 0.5, 1.2]))  # type: ignore[arg-type]
    assert seen.tolist() == [True, False, False, True, True]


def view(mesh: trimesh.Trimesh, T: np.ndarray) -> ObjectView:
    return ObjectView(mesh, T, PointCloud(np.arange(30.0).reshape(10, 3), VIEWPOINT))


def tilted() -> ObjectView:
    """An L of 100 x 60 x 20 mm that lies on its side, turned."""
    T = make_T(rotation_about((0, 0, 1), 0.5) @ rotation_about((0, 1, 0), np.pi / 2), (1.0, 2.0, 3.0))
    return view(l_shape().apply_transform(T), T)


def test_extents_are_those_of_the_object_as_it_would_stand():
    np.testing.assert_allclose(methods.extents_of(tilted()), [0.1, 0.06, 0.02])


def standing(**size: tuple[float, float, float]) -> FitConfig:
    return replace(pcrnet_config(**size), hypotheses=("upright",))


@pytest.mark.parametrize(
    ("name", "fit", "method"),
    [
        ("told-icp", icp_config, "none"),
        ("told-pcrnet", standing, "none"),
        ("told-pcrnet-gfs", standing, "gfs"),
        ("told-pcrnet-gfpnet-oneshot", standing, "gfpnet-oneshot"),
        ("told-pcrnet-gfpnet-paper", standing, "gfpnet-paper"),
    ],
)
def test_the_papers_rows_are_told_the_class_and_the_sized_ones_the_size(name, fit, method):
    library = PrimitiveLibrary.shipped()
    size = size_of_extents(library.primitive("mug"), methods.extents_of(tilted()))
    common = {
        "library": library,
        "deform": DeformConfig(method=method),
        "rival_share": 1.0,
        "subcategories": False,
        "fall_back": False,
    }
    assert config_of(name) == (CompleteConfig(fit=fit(), **common), True)
    assert config_of(f"{name}-sized", tilted(), "mug") == (CompleteConfig(fit=fit(size=size), **common), True)
    assert f"{name}-sized" in METHODS


def fit_without(**switches: object) -> FitConfig:
    return replace(FitConfig(), **{lap: replace(getattr(FitConfig(), lap), **switches) for lap in LAPS})


PLAIN = DeformConfig(method="none")
ALWAYS = {"unknown_above": 1.0, "fall_back": False}  # what was there before the package answers with a primitive always
OWN: dict[str, CompleteConfig] = {
    "registration": CompleteConfig(deform=PLAIN),
    "gfs": CompleteConfig(deform=DeformConfig(method="gfs"), **ALWAYS),
    "gfpnet-oneshot": CompleteConfig(deform=DeformConfig(method="gfpnet-oneshot"), **ALWAYS),
    "gfpnet": CompleteConfig(),
    "registration-no-modes": CompleteConfig(fit=fit_without(estimate_modes=False), deform=PLAIN),
    **{
        f"gfpnet-paper-{m}": CompleteConfig(deform=DeformConfig(method="gfpnet-paper", iterations=m), **ALWAYS)
        for m in (1, 2, 3, 4, 5, 6, 7)
    },
    "gfpnet-no-scale": CompleteConfig(fit=fit_without(estimate_scale=False)),
    "gfpnet-no-modes": CompleteConfig(fit=fit_without(estimate_modes=False)),
    "gfpnet-no-kinds": CompleteConfig(subcategories=False),
    "gfpnet-no-roundness": CompleteConfig(fit=FitConfig(roundness=False)),
    "gfpnet-no-free-space": CompleteConfig(fit=fit_without(free_space=False)),
    "gfpnet-no-support": CompleteConfig(fit=fit_without(support=False)),
    "gfpnet-no-symmetry": CompleteConfig(deform=DeformConfig(symmetry=False)),
    "gfpnet-pcrnet-start": CompleteConfig(fit=FitConfig(start="pcrnet")),
}


@pytest.mark.parametrize("name", OWN)
def test_a_row_of_the_package_differs_from_the_default_by_what_it_is_named_after(name):
    library = PrimitiveLibrary.shipped()
    assert config_of(name) == (replace(OWN[name], library=library), False)
    own = PrimitiveLibrary.from_option("")
    assert config_of(name, library=own)[0].library is own


def test_methods_come_in_the_order_of_the_table():
    rigid = ("icp", "pcrnet", "pcrnet-gfs", *PATCHED, "pcrnet-bound")
    told = [n + sized for n in rigid for sized in ("", "-sized")]
    assert ("truth", "partial", "observed", "mirror", "classfree", *(f"told-{name}" for name in told), *OWN) == METHODS
    assert list(SWITCHES) == list(OWN)[12:]
    own = ("told-icp", "registration", "gfs", "gfpnet-paper-5", "gfpnet")
    assert ("truth", "partial", "observed", "mirror", "classfree", *own) == BRIEF
    assert {"registration", "gfs", "gfpnet-oneshot", "gfpnet"} <= set(CONFIGS)


def test_the_bound_draws_what_was_observed_onto_the_true_surface_and_leaves_what_is_far_from_it(monkeypatch):
    primitive = PrimitiveLibrary.shipped().primitive("car")
    T = make_T(rotation_about((0, 0, 1), 0.4), (1.0, 2.0, 0.5))
    fit = FittedPrimitive(primitive, T, np.ones(3), np.zeros(len(primitive.modes)), 0.0)
    own = primitive.vertices
    true = trimesh.Trimesh(apply_T(T, own * [1.05, 1.08, 1.1]), primitive.faces, process=False)
    front = true.vertices[own[:, 0] > 0.5]
    view = ObjectView(true, T, PointCloud(front, np.array([9.0, 0, 1])), sensor=LIDAR)
    asked = []

    def complete(points, **how):
        asked.append(how["config"].fit)
        return SimpleNamespace(fit=fit, mesh=None)

    monkeypatch.setattr(methods, "complete_to_mesh", complete)
    answer = run_method("told-pcrnet-bound-sized", view, None, "car")
    assert asked == [standing(size=size_of_extents(primitive, methods.extents_of(view)))]
    assert answer.completion is None
    assert isinstance(answer.surface, trimesh.Trimesh)
    moved = apply_T(np.linalg.inv(T), np.asarray(answer.surface.vertices))
    before = np.abs(trimesh.proximity.signed_distance(true, apply_T(T, own[own[:, 0] > 1.2]))).mean()
    after = np.abs(trimesh.proximity.signed_distance(true, apply_T(T, moved[own[:, 0] > 1.2]))).mean()
    assert after < 0.1 * before
    assert before > 0.05
    # The rest follows its neighbours: the rear is not drawn onto its own true place.
    rear = own[:, 0] < -1.8
    missed = np.abs(trimesh.proximity.signed_distance(true, apply_T(T, moved[rear]))).mean()
    assert missed > 3 * after


PATCHED = ("pcrnet-gfpnet-oneshot", "pcrnet-gfpnet-paper")


def test_a_method_is_given_the_cloud_and_the_class_that_it_is_told(monkeypatch):
    asked = []

    def complete(points, **how):
        asked.append((points, how))
        return SimpleNamespace(mesh="mesh")

    monkeypatch.setattr(methods, "complete_to_mesh", complete)
    one, library = tilted(), PrimitiveLibrary.shipped()
    for name, told, expected in (("gfs", None, None), ("gfs", "cup", "cup"), ("told-icp", "cup", "mug")):
        answer = run_method(name, one, told, "mug", library=library)
        assert (answer.surface, answer.completion.mesh) == ("mesh", "mesh")  # type: ignore[union-attr]
        points, how = asked[-1]
        assert points is one.cloud.points
        told_to = {"category": expected, "sensor": one.sensor, "config": config_of(name)[0]}
        assert how == {"viewpoint": one.cloud.viewpoint, **told_to}
    run_method("told-icp-sized", one, None, "mug")
    assert asked[-1][1]["config"] == config_of("told-icp-sized", one, "mug")[0]


def test_the_simple_methods_look_at_the_points_and_up_alone(monkeypatch):
    asked: list[Any] = []
    one = tilted()

    def detect(points, *, viewpoint, up, config):
        assert config.sensor is one.sensor
        asked.append((points is one.cloud.points, viewpoint is one.cloud.viewpoint, up.tolist()))
        return "detection"

    monkeypatch.setattr(methods, "detect_single", detect)
    monkeypatch.setattr(methods, "complete_as_observed", lambda found: SimpleNamespace(mesh=f"hull of the {found}"))
    monkeypatch.setattr(methods, "mirror_cloud", lambda found: f"mirrored {found}")
    assert run_method("partial", one, None, "mug").surface is one.cloud.points
    assert asked == []
    assert run_method("observed", one, None, "mug").surface == "hull of the detection"
    assert run_method("mirror", one, None, "mug").surface == "mirrored detection"
    assert asked == [(True, True, [0.0, 0.0, 1.0])] * 2
    assert run_method("mirror", one, None, "mug").completion is None


def test_an_error_of_the_library_is_that_of_the_method(monkeypatch):
    def fails(points, **how):
        raise GfpGraspError("no answer")

    monkeypatch.setattr(methods, "complete_to_mesh", fails)
    with pytest.raises(GfpGraspError, match="no answer"):
        run_method("gfpnet", tilted(), None, "mug")
