"""Several objects in one file: an L and a trough that lie askew above a leaning floor."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
from bodies import AWAY, TURN, l_parts, l_shape, trough
from compiled import bounds_of, matrix_of, pose_of

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export import (
    CONTACT_PRIORITY,
    CONTACT_SOLREF,
    Body,
    export_bodies,
    export_completion,
    foot_pose,
    make_body,
)
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about, rotation_between

UP = np.array([1.0, -2.0, 2.0]) / 3
T_L = make_T(TURN, AWAY)
T_TROUGH = make_T(rotation_about((2.0, -1.0, 0.5), 0.8), (-0.2, 0.3, 0.4))


def shapes_at(T: np.ndarray, shape: trimesh.Trimesh, parts: Sequence[Any]) -> tuple[trimesh.Trimesh, list[Any]]:
    """Mesh and parts in the world."""
    return shape.copy().apply_transform(T), [part.to_trimesh().apply_transform(T) for part in parts]


def an_l(name: str = "bar", **options: Any) -> Body:
    """It stands in its foot, askew as that is, on the leaning floor."""
    mesh, parts = shapes_at(T_L, l_shape(), l_parts())
    usual = {"density": 700.0, "T_world_body": foot_pose(mesh, parts, UP)}
    return make_body(mesh, parts, name=name, **{**usual, **options})


def a_trough(name: str = "trough") -> Body:
    """Its frame is its own: not that of its foot."""
    return make_body(*shapes_at(T_TROUGH, *trough()), name=name, density=1200.0, T_world_body=T_TROUGH)


def world_of(body: Body) -> list[np.ndarray]:
    """Corners (2, 3) of the bounds of the mesh and of each part."""
    points = [apply_T(body.T_world_body, shape.vertices) for shape in body.shapes]
    return [np.array([own.min(axis=0), own.max(axis=0)]) for own in points]


def assert_in_place(model: mujoco.MjModel, body: Body) -> None:
    """Every mesh and part of the model lies where that of the body does."""
    names = ["visual", *(f"hull_{i:03d}" for i in range(len(body.parts)))]
    for name, expected in zip(names, world_of(body), strict=True):
        np.testing.assert_allclose(bounds_of(model, f"{body.name}_{name}"), expected, atol=1e-6)


def test_a_body_has_its_meshes_and_its_weight_in_its_frame() -> None:
    body = a_trough()
    shape, parts = trough()
    np.testing.assert_allclose(body.mesh.vertices, shape.vertices, atol=1e-12)
    assert len(body.parts) == 5
    np.testing.assert_allclose(body.parts[3].vertices, parts[3].vertices, atol=1e-12)
    assert body.weight.mass_kg == pytest.approx(1200 * (0.068 * 0.048 * 0.08 - 0.06 * 0.04 * 0.05))
    np.testing.assert_allclose(body.weight.centre, shape.center_mass, atol=1e-12)
    np.testing.assert_allclose(body.weight.inertia, 1200 * shape.moment_inertia, atol=1e-12)
    plain = an_l(T_world_body=None)
    np.testing.assert_array_equal(plain.T_world_body, np.eye(4))
    np.testing.assert_array_equal(plain.mesh.vertices, l_shape().apply_transform(T_L).vertices)
    assert plain.weight.mass_kg == pytest.approx(700 * 0.02**2 * 0.14)
    assert an_l(shell_thickness_m=0.001).weight.mass_kg == pytest.approx(0.7 * l_shape().area)


def test_a_body_of_no_parts_or_no_name_is_refused() -> None:
    mesh, parts = shapes_at(T_L, l_shape(), l_parts())
    with pytest.raises(InvalidMesh, match="no convex parts came"):
        make_body(mesh, (), name="l")
    with pytest.raises(InvalidOption, match="name is 'an l'"):
        make_body(mesh, parts, name="an l")


@pytest.mark.parametrize("up", [UP, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0)])
def test_a_foot_is_the_middle_of_the_outline_at_the_lowest_point_with_z_along_up(up) -> None:
    """An L of 100 x 60 x 20 mm that stands level at a known place; one of its parts reaches 3 mm below it."""
    R = rotation_between((0.0, 0.0, 1.0), up)
    mesh, parts = shapes_at(make_T(R, R @ AWAY), l_shape(), l_parts())
    T = foot_pose(mesh, parts, np.asarray(up))
    np.testing.assert_allclose(T[:3, 2], up, atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(T[:3, 3], R @ np.add(AWAY, (0.05, 0.03, 0.0)), atol=1e-12)
    parts[1].apply_translation(-0.003 * np.asarray(up))
    lower = foot_pose(mesh, parts, np.asarray(up))
    np.testing.assert_allclose(lower[:3, 3], R @ np.add(AWAY, (0.05, 0.03, -0.003)), atol=1e-12)


def test_a_foot_moves_with_its_object_and_stays_upright() -> None:
    mesh, parts = shapes_at(T_L, l_shape(), l_parts())
    T = foot_pose(mesh, parts, UP)
    own = apply_T(invert_T(T), np.vstack([mesh.vertices, *(part.vertices for part in parts)]))
    np.testing.assert_allclose(own.min(axis=0)[:2], -own.max(axis=0)[:2], atol=1e-12)
    assert own[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    step = make_T(None, (0.3, -0.1, 0.2))
    moved = foot_pose(*shapes_at(step @ T_L, l_shape(), l_parts()), UP)
    np.testing.assert_allclose(moved, step @ T, atol=1e-12)


@pytest.mark.parametrize("contact", [True, False])
def test_contact_parameters_are_those_of_the_parts_or_of_nobody(tmp_path: Path, contact: bool) -> None:
    """The floor and the mesh that is looked at have MuJoCo's own in any case."""
    mesh, parts = shapes_at(T_L, l_shape(), l_parts())
    one = export_completion(mesh, parts, tmp_path / "one.xml", name="bar", contact=contact)
    two = export_bodies([an_l(), a_trough()], tmp_path / "two.xml", contact=contact)
    for path, hulls in ((one, ["bar_hull_001"]), (two, ["bar_hull_000", "trough_hull_004"])):
        model = mujoco.MjModel.from_xml_path(str(path))
        for name in (*hulls, "bar_visual", "floor"):
            own = contact and "hull" in name
            np.testing.assert_allclose(model.geom(name).solref, CONTACT_SOLREF if own else (0.02, 1.0))
            assert model.geom(name).priority[0] == (CONTACT_PRIORITY if own else 0)
    assert (CONTACT_SOLREF, CONTACT_PRIORITY) == ((0.004, 1.0), 1)


@pytest.mark.parametrize("assets", ["embedded", "files"])
def test_mjcf_of_a_scene_has_a_free_body_an_object_on_one_leaning_floor(tmp_path: Path, assets) -> None:
    bodies = [an_l(), a_trough()]
    path = export_bodies(bodies, tmp_path / "new" / "table.xml", up=2 * UP, floor_m=0.05, assets=assets)
    assert path == tmp_path / "new" / "table.xml"
    assert ElementTree.parse(path).getroot().attrib["model"] == "table"
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nbody, model.nmesh, model.ngeom, model.nq) == (3, 9, 10, 14)
    np.testing.assert_allclose(model.opt.gravity, -9.81 * UP, atol=1e-7)
    np.testing.assert_allclose(model.geom("floor").pos, 0.05 * UP, atol=1e-9)
    np.testing.assert_allclose(matrix_of(model.geom("floor").quat)[:, 2], UP, atol=1e-7)
    assert [model.joint(f"{name}_free").type[0] for name in ("bar", "trough")] == [mujoco.mjtJoint.mjJNT_FREE] * 2
    for body in bodies:
        written = model.body(body.name)
        np.testing.assert_allclose(pose_of(written), body.T_world_body, atol=1e-8)
        assert written.mass[0] == pytest.approx(body.weight.mass_kg)
        np.testing.assert_allclose(written.ipos, body.weight.centre, atol=1e-9)
        assert_in_place(model, body)
    names = {file.name for file in (tmp_path / "new").rglob("*.obj")}
    hulls = {"bar_hull_000", "bar_hull_001", *(f"trough_hull_00{i}" for i in range(5))}
    written = {f"{stem}.obj" for stem in (*hulls, "bar_visual", "trough_visual")}
    assert names == (written if assets == "files" else set())


def test_without_a_height_the_floor_touches_the_lowest_of_all_objects(tmp_path: Path) -> None:
    bodies = [an_l(), a_trough()]
    lows = [min((apply_T(b.T_world_body, shape.vertices) @ UP).min() for shape in b.shapes) for b in bodies]
    assert abs(lows[0] - lows[1]) > 0.05
    for own in (bodies, bodies[::-1]):
        model = mujoco.MjModel.from_xml_path(str(export_bodies(own, tmp_path / "a.xml", up=UP)))
        np.testing.assert_allclose(model.geom("floor").pos, min(lows) * UP, atol=1e-8)


def test_the_light_shines_from_above_the_middle_of_the_scene(tmp_path: Path) -> None:
    bodies = [an_l(), a_trough()]
    corners = np.vstack([*world_of(bodies[0]), *world_of(bodies[1])])
    low, high = corners.min(axis=0), corners.max(axis=0)
    model = mujoco.MjModel.from_xml_path(str(export_bodies(bodies, tmp_path / "a.xml", up=UP)))
    expected = (low + high) / 2 + (1 + 5 * (high - low).max()) * UP
    np.testing.assert_allclose(model.light(0).pos, expected, atol=1e-7)


@pytest.mark.parametrize("number", [1, 2])
def test_urdf_of_a_scene_has_a_floating_joint_an_object_and_z_up(tmp_path: Path, number: int) -> None:
    """Every object has its place, also where there is one only; all are turned about the origin until z is up."""
    bodies = [an_l(), a_trough()][:number]
    path = export_bodies(bodies, tmp_path / "table.urdf", up=UP)
    root = ElementTree.parse(path).getroot()
    assert [link.attrib["name"] for link in root.findall("link")] == ["world", "bar", "trough"][: 1 + number]
    R = rotation_between(UP, (0.0, 0.0, 1.0))
    joints = root.findall("joint")
    assert [joint.attrib for joint in joints] == [{"name": f"{b.name}_free", "type": "floating"} for b in bodies]
    for joint, body in zip(joints, bodies, strict=True):
        parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
        assert parent is not None
        assert child is not None
        assert origin is not None
        assert (parent.attrib["link"], child.attrib["link"]) == ("world", body.name)
        xyz, rpy = (np.array(origin.attrib[key].split(), dtype=float) for key in ("xyz", "rpy"))
        turns = [rotation_about(axis, angle) for axis, angle in zip(np.eye(3), rpy, strict=True)]
        np.testing.assert_allclose(turns[2] @ turns[1] @ turns[0], R @ body.T_world_body[:3, :3], atol=1e-8)
        np.testing.assert_allclose(xyz, R @ body.T_world_body[:3, 3], atol=1e-8)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nbody, model.nq, model.nmesh) == (1 + number, 7 * number, 3 + 6 * (number - 1))
    for body in bodies:
        written = model.body(body.name)
        np.testing.assert_allclose(pose_of(written), make_T(R) @ body.T_world_body, atol=1e-8)
        assert written.mass[0] == pytest.approx(body.weight.mass_kg)
    np.testing.assert_allclose(R @ UP, (0, 0, 1), atol=1e-12)


def test_glb_of_a_scene_has_a_node_an_object_at_its_place(tmp_path: Path) -> None:
    bodies = [an_l(), a_trough()]
    scene = trimesh.load_scene(export_bodies(bodies, tmp_path / "table.glb"))
    assert set(scene.graph.nodes_geometry) == {"bar", "trough"}
    for body in bodies:
        T, geometry = scene.graph[body.name]
        np.testing.assert_allclose(T, body.T_world_body, atol=1e-6)
        np.testing.assert_allclose(scene.geometry[geometry].bounds, body.mesh.bounds, atol=1e-6)
    assert scene.to_mesh().volume == pytest.approx(sum(body.mesh.volume for body in bodies), rel=1e-5)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".STL"])
def test_a_mesh_file_of_a_scene_holds_all_meshes_at_their_places(tmp_path: Path, suffix: str) -> None:
    bodies = [an_l(), a_trough()]
    path = export_bodies(bodies, tmp_path / f"table{suffix}", up=UP)
    back = trimesh.load_mesh(path)
    back.merge_vertices()
    assert back.is_volume
    pieces = sorted(back.split(), key=lambda piece: piece.centroid[0])
    for piece, body in zip(pieces, bodies[::-1], strict=True):
        assert piece.volume == pytest.approx(body.mesh.volume, rel=1e-4)
        np.testing.assert_allclose(piece.bounds, world_of(body)[0], atol=1e-6)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("names", "name", "options", "message"),
    [
        ([], "a.xml", {}, "at least one is expected"),
        (["bar", "bar"], "a.xml", {}, "each with a name of its own"),
        (["bar", "bar"], "a.glb", {}, r"the bodies are \['bar', 'bar'\]"),
        (["bar"], "a.dae", {}, r"'a\.dae' ends in \.dae"),
        (["bar"], "a.urdf", {"up": (0, 0, 0)}, "up is"),
        (["bar"], "a.xml", {"assets": "both"}, "'embedded' or 'files'"),
    ],
)
def test_scenes_that_cannot_be_written_are_refused_before_anything_is(
    tmp_path: Path, names: list[str], name: str, options: dict[str, Any], message: str
) -> None:
    bodies = [an_l(name) for name in names]
    with pytest.raises(InvalidOption, match=message):
        export_bodies(bodies, tmp_path / "new" / name, **options)
    assert list(tmp_path.iterdir()) == []
