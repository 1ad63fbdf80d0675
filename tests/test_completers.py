"""Completers by name, on the front of a cylinder."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import own_completers
import pytest
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.complete import Completion
from gfp_grasp.completers import COMPLETERS, Oracle, get_completer, mirror_cloud, needs_class
from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption, UnknownCompleter
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import CollisionMesh, ConvexPart, Detection, OrientedBox, PointCloud, SupportPlane, TrueObject

UP = np.array([0.0, 0.0, 1.0])
RADIUS_M, HEIGHT_M = 0.04, 0.12


def detection_of(points, viewpoint=(0.6, 0.0, 0.06)):
    points = np.asarray(points, dtype=np.float64)
    box = OrientedBox(np.eye(4), np.ptp(points, axis=0))
    return Detection(PointCloud(points, viewpoint), UP, SupportPlane(UP, 0.0), "cup", {"cup": 1.0}, box)


def front_of_cylinder(centre=(0.0, 0.0)):
    """Points on the side that faces +x."""
    angle, height = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 61), np.linspace(0, HEIGHT_M, 40))
    circle = RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=-1) + centre
    return np.concatenate([circle.reshape(-1, 2), height.reshape(-1, 1)], axis=1)


def truth():
    mesh = trimesh.creation.cylinder(RADIUS_M, HEIGHT_M, sections=64)
    mesh.apply_translation((0, 0, HEIGHT_M / 2))
    return mesh


def test_what_was_seen_is_completed_to_its_hull():
    completion = get_completer("observed")(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    np.testing.assert_allclose(completion.mesh.extents, (RADIUS_M, 2 * RADIUS_M, HEIGHT_M), atol=1e-4)
    assert completion.mesh.volume == pytest.approx(truth().volume / 2, rel=0.01)


def test_the_mirror_makes_the_front_of_a_cylinder_whole():
    completion = get_completer("mirror")(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    np.testing.assert_allclose(completion.mesh.extents, (2 * RADIUS_M, 2 * RADIUS_M, HEIGHT_M), atol=0.003)
    assert completion.mesh.volume == pytest.approx(truth().volume, rel=0.05)


def test_the_mirror_turns_with_the_scene():
    yaw = np.deg2rad(50)
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    here = get_completer("mirror")(detection_of(front_of_cylinder())).mesh
    turned = get_completer("mirror")(detection_of(front_of_cylinder() @ R.T, R @ (0.6, 0.0, 0.06))).mesh
    assert turned.volume == pytest.approx(here.volume, rel=1e-6)
    np.testing.assert_allclose(turned.center_mass, R @ here.center_mass, atol=1e-5)


@pytest.mark.parametrize("name", ["observed", "mirror"])
def test_hulls_know_what_was_seen_and_cost_no_decomposition(name):
    completion = get_completer(name)(detection_of(front_of_cylinder()))
    vertices = np.asarray(completion.mesh.vertices)
    at_front = vertices[:, 0] > 0.6 * RADIUS_M
    inner = (vertices[:, 2] > 0.02) & (vertices[:, 2] < 0.1)
    assert completion.observed[at_front & inner].mean() > 0.9
    assert not completion.observed[(vertices[:, 0] < -0.01) & inner].any()
    assert (completion.sigma_m > 0).all()
    assert completion.collision.made_by == "hull"
    assert completion.collision.error_m == (0.0, 0.0, 0.0)
    assert len(completion.parts) == 1
    assert completion.parts[0].is_convex


def test_known_parts_keep_to_what_a_scene_allows():
    whole = get_completer("mirror")(detection_of(front_of_cylinder()))
    within = replace(whole, bounds=np.array([[1.0, 0.0, 0.0, 0.01]]))
    assert whole.parts[0].bounds[1, 0] > RADIUS_M - 0.002
    assert within.parts[0].bounds[1, 0] == pytest.approx(0.01)
    np.testing.assert_allclose(within.parts[0].bounds[0], whole.parts[0].bounds[0])


def test_sigma_of_a_hull_is_the_sensors_and_a_tenth_of_the_way_to_the_nearest_point():
    points = front_of_cylinder()
    completion = get_completer("observed")(detection_of(points))
    away = KDTree(points).query(np.asarray(completion.mesh.vertices))[0]
    assert away.max() > 0.02
    assert completion.sigma_m == pytest.approx(np.hypot(completion.detection.sensor_sigma_m, 0.1 * away))


def test_edges_of_a_hull_are_split_to_8_mm():
    mesh = get_completer("observed")(detection_of(front_of_cylinder())).mesh
    assert np.median(mesh.edges_unique_length) < 0.008 < mesh.edges_unique_length.max() < 0.016  # diagonals are longer


def test_the_mirror_of_a_view_from_straight_above_is_some_upright_plane():
    """A leaning wedge, seen along up: the answer is the hull of it and one reflection, in a plane along up."""
    points = np.random.default_rng(0).uniform(0, 1, (400, 3)) * (0.04, 0.02, 0.06)
    points[:, 0] *= 1 - points[:, 2] / 0.07
    points -= (*points[:, :2].mean(axis=0), 0)
    detection = detection_of(points, viewpoint=(0.0, 0.0, 1.0))
    both = mirror_cloud(detection)
    assert np.isfinite(both).all()
    assert both[:400] == pytest.approx(points)
    assert both[400:, [0, 2]] == pytest.approx(points[:, [0, 2]])  # across x, the axis that up is farthest from
    assert get_completer("mirror")(detection).mesh.is_volume


def test_the_mirror_is_at_the_depth_of_the_silhouettes_edges_where_these_are_deeper():
    """The front half of a cylinder off the origin, seen from a slanted eye: its far side appears about its axis."""
    turn = np.deg2rad(-35)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    points = front_of_cylinder() @ R.T + (0.2, -0.3, 0.0)
    both = mirror_cloud(detection_of(points, viewpoint=R @ (0.8, 0.0, 0.5) + (0.2, -0.3, 0.0)))
    images = both[len(points) :] - (0.2, -0.3, 0.0)
    # All images lie on the same cylinder; none is where a point was seen.
    assert np.linalg.norm(images[:, :2], axis=1) == pytest.approx(np.full(len(points), RADIUS_M), abs=3e-3)
    assert (images @ R)[:, 0].max() < 0.003
    assert images[:, 2] == pytest.approx(points[:, 2])


def test_the_mirror_is_at_the_middle_of_what_was_seen_where_the_silhouette_is_nearer():
    """An upright wedge whose edge points away: the edges of its silhouette are nearest to the eye."""
    y, z = np.meshgrid(np.linspace(-0.04, 0.04, 41), np.linspace(0, 0.1, 21))
    points = np.stack([-0.05 * (1 - np.abs(y) / 0.04), y, z], axis=-1).reshape(-1, 3)
    images = mirror_cloud(detection_of(points, viewpoint=(0.6, 0.0, 0.05)))[len(points) :]
    middle = np.mean(np.quantile(points[:, 0], [0.01, 0.99]))
    assert images == pytest.approx(points * (-1, 1, 1) + np.array([2 * middle, 0.0, 0.0]))


@pytest.mark.parametrize("name", ["observed", "mirror"])
def test_points_of_a_plane_have_no_hull(name):
    flat = front_of_cylinder() * (0.0, 1.0, 1.0)
    with pytest.raises(InvalidCloud, match="a plane or a line"):
        get_completer(name)(detection_of(flat))


def test_points_that_are_flat_but_for_rounding_have_no_hull():
    """A leaning plane, its points off it by less than a hundred thousandth of its size; 100 times as much is a hull."""
    rng = np.random.default_rng(0)
    flat = rng.uniform(-0.05, 0.05, (500, 3)) * (1, 1, 0)
    R = rotation_about((1, 2, 3), 1.0)
    for thickness_m, is_refused in ((1e-7, True), (1e-4, False)):
        points = (flat + thickness_m * rng.uniform(-1, 1, (500, 3)) * (0, 0, 1)) @ R.T
        if is_refused:
            with pytest.raises(InvalidCloud, match="a plane or a line"):
                get_completer("observed")(detection_of(points))
        else:
            assert get_completer("observed")(detection_of(points)).mesh.is_volume


def test_the_mirror_needs_a_viewpoint():
    with pytest.raises(InvalidCloud, match="viewpoint"):
        get_completer("mirror")(detection_of(front_of_cylinder(), viewpoint=None))


def test_the_oracle_alone_is_given_the_truth():
    oracle = get_completer("oracle")
    assert isinstance(oracle, Oracle)
    assert not any(isinstance(get_completer(name), Oracle) for name in COMPLETERS if name != "oracle")
    mesh = truth()
    parts = CollisionMesh((ConvexPart(mesh.vertices, mesh.faces),), (0.0, 0.0, 0.0), "hull", 0.0)
    completion = oracle(detection_of(front_of_cylinder()), mesh, parts)
    assert completion.mesh is mesh
    assert completion.collision is parts


def test_the_oracle_puts_a_true_object_where_it_stands():
    mesh, T = truth(), make_T(rotation_about((0, 0, 1), 0.5), (0.3, -0.2, 0.5))
    parts = CollisionMesh((ConvexPart(mesh.vertices, mesh.faces),), (0.1, 0.2, 0.3), "cuts", 4.0, {"note": 5})
    known = TrueObject("can", "", mesh, parts, 0.3, 0.5)
    completion = Oracle().placed(detection_of(front_of_cylinder()), known, T)
    np.testing.assert_allclose(completion.mesh.vertices, apply_T(T, np.asarray(truth().vertices)))
    np.testing.assert_array_equal(mesh.vertices, truth().vertices)
    placed = completion.collision
    np.testing.assert_allclose(placed.parts[0].vertices, completion.mesh.vertices)
    assert (placed.error_m, placed.made_by, placed.seconds, placed.notes) == ((0.1, 0.2, 0.3), "cuts", 4.0, {"note": 5})


def test_the_oracle_refuses_to_guess():
    with pytest.raises(InvalidOption, match="needs the true mesh"):
        get_completer("oracle")(detection_of(front_of_cylinder()))


def test_a_function_of_the_users_is_found_by_its_name():
    completion = get_completer("own_completers:upright_box")(detection_of(front_of_cylinder()))
    assert isinstance(completion, Completion)
    assert completion.mesh.volume == pytest.approx(RADIUS_M * 2 * RADIUS_M * HEIGHT_M, rel=1e-3)


def test_an_open_mesh_of_a_users_function_is_made_solid():
    completion = get_completer("own_completers:open_box")(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    assert not own_completers.open_box(detection_of(front_of_cylinder())).is_volume
    assert completion.mesh.volume == pytest.approx(RADIUS_M * 2 * RADIUS_M * HEIGHT_M, rel=0.05)


def test_those_that_fit_no_primitive_need_no_class():
    assert [name for name in COMPLETERS if not needs_class(name)] == ["oracle", "observed", "mirror", "classfree"]
    assert needs_class("gfpnet")
    assert needs_class("own_completers:upright_box")


def test_a_function_that_returns_no_mesh_is_refused():
    with pytest.raises(InvalidMesh, match="returned a str"):
        get_completer("own_completers:returns_text")(detection_of(front_of_cylinder()))
    assert own_completers.returns_text(None) == "a mesh"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("magic", "oracle, observed, mirror, classfree, icp, pcrnet, registration, gfs"),
        ("no_such_module:complete", "cannot be imported"),
        ("own_completers:missing", "cannot be imported"),
        ("own_completers:NOT_A_FUNCTION", "is a int, not a function"),
        (":", "expected oracle"),
    ],
)
def test_an_unknown_completer_is_told_what_there_is(name, message):
    with pytest.raises(UnknownCompleter, match=message):
        get_completer(name)


@pytest.mark.parametrize(
    ("name", "error_mm"),
    [
        ("icp", 12.0),
        ("pcrnet", 12.0),
        ("registration", 2.0),
        ("gfs", 2.0),
        ("gfpnet-oneshot", 2.0),
        ("gfpnet-paper", 2.0),
        ("gfpnet", 2.0),
    ],
)
def test_the_packages_own_methods_complete_the_cylinder(name, error_mm):
    """What was seen is met, by those that only place the mean primitive as well as it is alike."""
    points = front_of_cylinder()
    completion = get_completer(name)(detection_of(points))
    mesh = completion.mesh
    assert mesh.is_volume
    assert completion.fit is not None
    assert bool(completion.fit.coefficients.any()) == (name not in ("icp", "pcrnet"))
    away = np.abs(trimesh.proximity.signed_distance(mesh, points[::10]))
    assert 1000 * away.mean() < error_mm
    np.testing.assert_allclose(mesh.extents, truth().extents, atol=0.02 if error_mm > 2 else 0.01)


def test_the_packages_own_methods_differ_by_what_they_do_with_the_fit():
    """One fit, deformed in four ways or not at all: five surfaces, no two alike."""
    names = ("registration", "gfs", "gfpnet-oneshot", "gfpnet-paper", "gfpnet")
    found = [np.asarray(get_completer(name)(detection_of(front_of_cylinder())).mesh.vertices) for name in names]
    for i, a in enumerate(found):
        for b in found[:i]:
            assert np.abs(a - b).max() > 1e-4
            assert np.abs(a - b).mean() < 0.003


def test_naming_a_completer_without_a_network_loads_no_torch():
    code = "import sys; from gfp_grasp.completers import get_completer; get_completer('mirror')"
    code += "; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
