"""Completers by name, on the front of a cylinder."""

import subprocess
import sys

import numpy as np
import own_completers
import pytest
import trimesh

from gfp_grasp.complete import Completion
from gfp_grasp.completers import COMPLETERS, Oracle, completer
from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption, UnknownCompleter
from gfp_grasp.types import CollisionMesh, ConvexPart, Detection, OrientedBox, PointCloud, SupportPlane

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
    completion = completer("observed")(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    np.testing.assert_allclose(completion.mesh.extents, (RADIUS_M, 2 * RADIUS_M, HEIGHT_M), atol=1e-4)
    assert completion.mesh.volume == pytest.approx(truth().volume / 2, rel=0.01)


def test_the_mirror_makes_the_front_of_a_cylinder_whole():
    completion = completer("mirror")(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    np.testing.assert_allclose(completion.mesh.extents, (2 * RADIUS_M, 2 * RADIUS_M, HEIGHT_M), atol=0.003)
    assert completion.mesh.volume == pytest.approx(truth().volume, rel=0.05)


def test_the_mirror_turns_with_the_scene():
    yaw = np.deg2rad(50)
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    here = completer("mirror")(detection_of(front_of_cylinder())).mesh
    turned = completer("mirror")(detection_of(front_of_cylinder() @ R.T, R @ (0.6, 0.0, 0.06))).mesh
    assert turned.volume == pytest.approx(here.volume, rel=1e-6)
    np.testing.assert_allclose(turned.center_mass, R @ here.center_mass, atol=1e-5)


@pytest.mark.parametrize("name", ["observed", "mirror"])
def test_hulls_know_what_was_seen_and_cost_no_decomposition(name):
    completion = completer(name)(detection_of(front_of_cylinder()))
    vertices = np.asarray(completion.mesh.vertices)
    at_front = vertices[:, 0] > 0.6 * RADIUS_M
    inner = (vertices[:, 2] > 0.02) & (vertices[:, 2] < 0.1)
    assert completion.observed[at_front & inner].mean() > 0.9
    assert not completion.observed[(vertices[:, 0] < -0.01) & inner].any()
    assert (completion.sigma_m > 0).all()
    assert completion.collision.made_by == "hull"
    assert len(completion.parts) == 1
    assert completion.parts[0].is_convex


@pytest.mark.parametrize("name", ["observed", "mirror"])
def test_points_of_a_plane_have_no_hull(name):
    flat = front_of_cylinder() * (0.0, 1.0, 1.0)
    with pytest.raises(InvalidCloud, match="a plane or a line"):
        completer(name)(detection_of(flat))


def test_the_mirror_needs_a_viewpoint():
    with pytest.raises(InvalidCloud, match="viewpoint"):
        completer("mirror")(detection_of(front_of_cylinder(), viewpoint=None))


def test_the_oracle_alone_is_given_the_truth():
    oracle = completer("oracle")
    assert isinstance(oracle, Oracle)
    assert oracle.needs_truth
    assert not any(isinstance(completer(name), Oracle) for name in COMPLETERS if name != "oracle")
    mesh = truth()
    parts = CollisionMesh((ConvexPart(mesh.vertices, mesh.faces),), (0.0, 0.0, 0.0), "hull", 0.0)
    completion = oracle(detection_of(front_of_cylinder()), mesh, parts)
    assert completion.mesh is mesh
    assert completion.collision is parts


def test_the_oracle_refuses_to_guess():
    with pytest.raises(InvalidOption, match="needs the true mesh"):
        completer("oracle")(detection_of(front_of_cylinder()))


def test_a_function_of_the_users_is_found_by_its_name():
    completion = completer("own_completers:upright_box")(detection_of(front_of_cylinder()))
    assert isinstance(completion, Completion)
    assert completion.mesh.volume == pytest.approx(RADIUS_M * 2 * RADIUS_M * HEIGHT_M, rel=1e-3)


def test_a_function_that_returns_no_mesh_is_refused():
    with pytest.raises(InvalidMesh, match="returned a str"):
        completer("own_completers:returns_text")(detection_of(front_of_cylinder()))
    assert own_completers.returns_text(None) == "a mesh"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("magic", "oracle, observed, mirror, icp, pcrnet, registration, gfs"),
        ("no_such_module:complete", "cannot be imported"),
        ("own_completers:missing", "cannot be imported"),
        ("own_completers:NOT_A_FUNCTION", "is a int, not a function"),
        (":", "expected oracle"),
    ],
)
def test_an_unknown_completer_is_told_what_there_is(name, message):
    with pytest.raises(UnknownCompleter, match=message):
        completer(name)


@pytest.mark.parametrize("name", ["icp", "pcrnet", "registration", "gfs", "gfpnet-oneshot", "gfpnet-paper", "gfpnet"])
def test_the_packages_own_methods_complete_the_cylinder(name):
    completion = completer(name)(detection_of(front_of_cylinder()))
    assert completion.mesh.is_volume
    assert completion.fit is not None
    np.testing.assert_allclose(completion.mesh.extents, truth().extents, atol=0.02)


def test_naming_a_completer_without_a_network_loads_no_torch():
    code = "import sys; from gfp_grasp.completers import completer; completer('mirror'); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
