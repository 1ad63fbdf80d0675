"""Meshes and models come back from their files as they were: volume, place, mass, parts, floor and light."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest
import trimesh
import yourdfpy
from compiled import bounds_of, matrix_of, pose_of
from exported_bodies import askew, cup

from gfp_grasp.export import export_completion, foot_pose
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import ConvexPart


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb"])
def test_mesh_files_come_back_with_the_same_volume_and_place(tmp_path, suffix):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "new" / f"cup{suffix}")
    back = trimesh.load_mesh(path)
    back.merge_vertices()
    assert back.is_volume
    assert back.volume == pytest.approx(mesh.volume, rel=1e-5)
    np.testing.assert_allclose(back.bounds, mesh.bounds, atol=1e-7)


def test_colors_are_kept(tmp_path):
    mesh, parts = cup()
    colors = np.zeros((len(mesh.vertices), 4), np.uint8) + np.array([200, 30, 0, 255], np.uint8)
    back = trimesh.load_mesh(export_completion(mesh, parts, tmp_path / "cup.ply", colors=colors))
    kept = back.visual.vertex_colors  # pyright: ignore
    np.testing.assert_array_equal(np.unique(kept, axis=0), [[200, 30, 0, 255]])


def test_mjcf_compiles_with_mass_centre_and_inertia_of_the_walls(tmp_path):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "my_cup.xml", name="cup", density=700.0)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.nmesh == 1 + len(parts)
    assert model.body_mass.sum() == pytest.approx(700 * mesh.volume, rel=1e-6)
    body = model.body("cup")
    np.testing.assert_allclose(body.pos, (0.3, -0.2, 0.5), atol=1e-8)
    np.testing.assert_allclose(apply_T(pose_of(body), body.ipos), mesh.center_mass, atol=1e-7)
    expected = np.sort(np.linalg.eigvalsh(mesh.moment_inertia)) * 700
    np.testing.assert_allclose(np.sort(body.inertia), expected, rtol=1e-5)


def test_urdf_compiles_and_holds_mass_and_centre(tmp_path):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "my_cup.urdf", density=700.0)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.nmesh == 1 + len(parts)
    assert model.ngeom == 1 + len(parts)
    inertial = ElementTree.parse(path).getroot().find("link/inertial")
    assert inertial is not None
    mass, origin = inertial.find("mass"), inertial.find("origin")
    assert mass is not None
    assert origin is not None
    assert float(mass.attrib["value"]) == pytest.approx(700 * mesh.volume)
    np.testing.assert_allclose([float(x) for x in origin.attrib["xyz"].split()], mesh.center_mass, atol=1e-8)


def test_mjcf_with_its_meshes_in_files_is_the_same_model_also_after_a_move(tmp_path):
    mesh, parts = cup()
    one = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "one.xml")))
    path = export_completion(mesh, parts, tmp_path / "here" / "many.xml", assets="files")
    moved = (tmp_path / "here").rename(tmp_path / "there") / path.name
    many = mujoco.MjModel.from_xml_path(str(moved))
    assert (one.nmesh, one.ngeom) == (many.nmesh, many.ngeom) == (1 + len(parts), 2 + len(parts))
    np.testing.assert_allclose(many.body_mass, one.body_mass)
    np.testing.assert_allclose(many.body_inertia, one.body_inertia)
    np.testing.assert_allclose(many.geom_pos, one.geom_pos, atol=1e-6)


def test_files_of_hulls_and_visual_come_back_as_they_were(tmp_path):
    mesh, parts = cup()
    export_completion(mesh, parts, tmp_path / "cup.urdf")
    for index, part in enumerate(parts):
        back = trimesh.load_mesh(tmp_path / "cup_meshes" / f"hull_{index:03d}.obj")
        assert back.is_volume
        assert back.is_convex
        assert back.volume == pytest.approx(part.to_trimesh().volume, rel=1e-6)
    visual = trimesh.load_mesh(tmp_path / "cup_meshes" / "visual.obj")
    np.testing.assert_allclose(visual.bounds, mesh.bounds, atol=1e-7)


def test_urdf_is_read_by_another_reader_with_mass_and_all_meshes(tmp_path):
    mesh, parts = cup()
    robot = yourdfpy.URDF.load(
        str(export_completion(mesh, parts, tmp_path / "my_cup.urdf", name="cup", density=700.0)),
        build_collision_scene_graph=True,
        load_collision_meshes=True,
    )
    assert robot.validate()
    (link,) = robot.robot.links
    assert link.inertial is not None
    assert link.inertial.origin is not None
    assert link.inertial.inertia is not None
    assert link.inertial.mass == pytest.approx(700 * mesh.volume)
    np.testing.assert_allclose(link.inertial.origin[:3, 3], mesh.center_mass, atol=1e-8)
    np.testing.assert_allclose(link.inertial.inertia, 700 * mesh.moment_inertia, rtol=1e-6, atol=1e-12)
    assert (len(link.visuals), len(link.collisions)) == (1, len(parts))
    np.testing.assert_allclose(robot.scene.bounds, mesh.bounds, atol=1e-6)
    np.testing.assert_allclose(robot.collision_scene.bounds, mesh.bounds, atol=1e-6)
    corners = sum(len(mesh.vertices) for mesh in robot.collision_scene.geometry.values())
    assert corners == sum(len(part.vertices) for part in parts)


def test_mjcf_is_one_file_that_stands_on_its_floor_and_holds_a_marble(tmp_path):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "cup.xml")
    assert [file.name for file in tmp_path.iterdir()] == ["cup.xml"]
    spec = mujoco.MjSpec.from_file(str(path))
    marble = spec.worldbody.add_body(name="marble", pos=[0.3, -0.2, 0.56])
    marble.add_freejoint()
    marble.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], density=2500)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(500):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.body("object").xpos, (0.3, -0.2, 0.5), atol=1e-3)
    assert data.body("object").xmat[8] > 0.9999
    assert data.body("marble").xpos[2] == pytest.approx(0.5 + 0.004 + 0.01, abs=1e-3)


def test_urdf_is_read_after_its_folder_was_moved(tmp_path):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "here" / "cup.urdf")
    moved = (tmp_path / "here").rename(tmp_path / "there") / path.name
    assert mujoco.MjModel.from_xml_path(str(moved)).ngeom == 1 + len(parts)
    robot = yourdfpy.URDF.load(str(moved), build_collision_scene_graph=True, load_collision_meshes=True)
    corners = sum(len(mesh.vertices) for mesh in robot.collision_scene.geometry.values())
    assert corners == sum(len(part.vertices) for part in parts)  # the reader makes one mesh of a link's


def test_floor_and_gravity_follow_up(tmp_path):
    """A cup in a camera's frame, whose up is -y, stands on the floor as it does where up is z."""
    mesh, parts = cup()
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    mesh.apply_transform(turn)
    turned = [ConvexPart(part.vertices @ turn[:3, :3].T, part.faces) for part in parts]
    path = export_completion(mesh, turned, tmp_path / "cup.xml", up=(0, -3, 0))
    model = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(model.opt.gravity, (0, 9.81, 0), atol=1e-9)
    data = mujoco.MjData(model)
    for _ in range(300):
        mujoco.mj_step(model, data)
    np.testing.assert_allclose(data.body("object").xpos, (0.3, -0.5, -0.2), atol=1e-3)
    np.testing.assert_allclose(data.body("object").xmat.reshape(3, 3)[:, 2], (0, -1, 0), atol=0.01)
    moved = data.body("object").xmat.reshape(3, 3) @ pose_of(model.body("object"))[:3, :3].T
    np.testing.assert_allclose(moved, np.eye(3), atol=0.01)


def test_hulls_collide_and_the_visual_does_not(tmp_path):
    mesh, parts = cup()
    model = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "a.xml", name="a")))
    assert model.geom("a_visual").contype[0] == model.geom("a_visual").conaffinity[0] == 0
    assert all(model.geom(f"a_hull_{i:03d}").contype[0] == 1 for i in range(len(parts)))


def test_mjcf_and_urdf_hold_the_whole_tensor_of_inertia(tmp_path):
    mesh, parts = askew()
    wanted = 700 * mesh.moment_inertia
    assert np.abs(wanted[~np.eye(3, dtype=bool)]).min() > 1e-6
    for suffix in (".xml", ".urdf"):
        path = export_completion(mesh, parts, tmp_path / f"l{suffix}", name="l", density=700.0, up=(1, -2, 2))
        spec = mujoco.MjSpec.from_file(str(path))
        if suffix == ".urdf":  # or the body is welded to the world and has none of its own
            spec.body("l").add_freejoint()
        body = spec.compile().body("l")
        R = pose_of(body)[:3, :3] @ matrix_of(body.iquat)
        np.testing.assert_allclose(R @ np.diag(body.inertia) @ R.T, wanted, atol=1e-8)
        np.testing.assert_allclose(apply_T(pose_of(body), body.ipos), mesh.center_mass, atol=1e-8)
        assert body.mass[0] == pytest.approx(700 * mesh.volume)


def test_the_floor_lies_below_the_lowest_part_and_the_lowest_vertex(tmp_path):
    """A part that reaches 3 mm below the mesh must not start inside of the floor; gravity pulls along a tilted up."""
    mesh, parts = askew()
    up = np.array([1.0, -2.0, 2.0]) / 3
    low = float((mesh.vertices @ up).min())
    for drop, lowest in ((0.003, low - 0.003), (-0.001, low)):
        moved = [ConvexPart(part.vertices - drop * up, part.faces) for part in parts]
        path = export_completion(mesh, moved, tmp_path / "l.xml", up=3 * up)
        model = mujoco.MjModel.from_xml_path(str(path))
        np.testing.assert_allclose(model.geom("floor").pos, lowest * up, atol=1e-7)
        np.testing.assert_allclose(matrix_of(model.geom("floor").quat)[:, 2], up, atol=1e-7)
        np.testing.assert_allclose(model.opt.gravity, -9.81 * up, atol=1e-7)


def test_the_light_shines_down_from_above_the_object(tmp_path):
    mesh, parts = askew()
    up = np.array([1.0, -2.0, 2.0]) / 3
    model = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "l.xml", up=up)))
    light = model.light(0)
    np.testing.assert_allclose(light.dir, -up, atol=1e-7)
    away = light.pos - mesh.bounds.mean(axis=0)
    assert away @ up == pytest.approx(1 + 5 * np.ptp(mesh.bounds, axis=0).max())
    np.testing.assert_allclose(away - (away @ up) * up, 0, atol=1e-7)


def test_geoms_of_the_file_lie_where_the_parts_do(tmp_path):
    mesh, parts = askew()
    for assets in ("embedded", "files"):
        path = export_completion(mesh, parts, tmp_path / assets / "l.xml", name="l", assets=assets)
        model = mujoco.MjModel.from_xml_path(str(path))
        for name, shape in (("l_visual", mesh), ("l_hull_000", parts[0]), ("l_hull_001", parts[1])):
            corners = [np.min(shape.vertices, axis=0), np.max(shape.vertices, axis=0)]
            np.testing.assert_allclose(bounds_of(model, name), corners, atol=1e-6)
        assert model.geom("l_visual").group[0] == 2
        assert model.geom("l_hull_000").group[0] == 3


def test_numbers_are_written_to_nine_digits(tmp_path):
    mesh, parts = askew()
    root = ElementTree.parse(export_completion(mesh, parts, tmp_path / "l.xml", up=(1, -2, 2))).getroot()
    visual, body = root.find("asset/mesh"), root.find("worldbody/body")
    assert visual is not None
    assert body is not None
    written = np.array([float(x) for x in visual.attrib["vertex"].split()]).reshape(-1, 3)
    T_world_body = foot_pose(mesh, parts, np.array([1.0, -2.0, 2.0]) / 3)
    np.testing.assert_allclose(written, apply_T(invert_T(T_world_body), mesh.vertices), rtol=1e-8, atol=1e-15)
    place, quat = ([float(x) for x in body.attrib[key].split()] for key in ("pos", "quat"))
    np.testing.assert_allclose(apply_T(make_T(matrix_of(quat), place), written), mesh.vertices, rtol=0, atol=1e-9)
