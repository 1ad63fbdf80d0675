# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
import yourdfpy
from compiled import bounds_of, matrix_of, pose_of

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export import SUFFIXES, export_completion, foot_pose, legal_name, mass_properties, needs_parts
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import ConvexPart


def cup() -> tuple[trimesh.Trimesh, list[ConvexPart]]:
    """A square cup, 80 mm wide and 100 mm high with walls of 4 mm, made of five boxes; standing off the origin."""
    offset = np.array([0.3, -0.2, 0.5])
    outer = trimesh.creation.box(bounds=[[-0.04, -0.04, 0], [0.04, 0.04, 0.1]])
    inner = trimesh.creation.box(bounds=[[-0.036, -0.036, 0.004], [0.036, 0.036, 0.2]])
    mesh = trimesh.boolean.difference([outer, inner])
    mesh.apply_translation(offset)
    bounds = [
        [[-0.04, -0.04, 0], [0.04, 0.04, 0.004]],
        [[-0.04, -0.04, 0.004], [-0.036, 0.04, 0.1]],
        [[0.036, -0.04, 0.004], [0.04, 0.04, 0.1]],
        [[-0.036, -0.04, 0.004], [0.036, -0.036, 0.1]],
        [[-0.036, 0.036, 0.004], [0.036, 0.04, 0.1]],
    ]
    boxes = [trimesh.creation.box(bounds=bound) for bound in bounds]
    return mesh, [ConvexPart(box.vertices + offset, box.faces) for box in boxes]


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


@pytest.mark.parametrize(("suffix", "assets"), [(".xml", "embedded"), (".xml", "files"), (".urdf", "embedded")])
def test_the_same_object_gives_the_same_names_and_bytes(tmp_path, suffix, assets):
    mesh, parts = cup()
    written = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        export_completion(mesh, parts, folder / f"cup{suffix}", assets=assets)
        export_completion(mesh, parts, folder / f"cup{suffix}", assets=assets)  # over itself
        written.append({str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()})
    assert written[0] == written[1]
    assert len(written[0]) == (1 if (suffix, assets) == (".xml", "embedded") else 2 + len(parts))


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


@pytest.mark.parametrize("suffix", [".glb", ".xml", ".urdf"])
def test_relative_paths_are_those_of_the_working_folder(tmp_path, monkeypatch, suffix):
    mesh, parts = cup()
    monkeypatch.chdir(tmp_path)
    path = export_completion(mesh, parts, Path("a") / ".." / "b" / f"cup{suffix}", assets="files")
    assert path.resolve() == tmp_path / "b" / f"cup{suffix}"
    assert path.exists()
    if suffix != ".glb":
        assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 1 + len(parts)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_who_has_an_old_file_open_goes_on_reading_the_old_one(tmp_path, suffix):
    mesh, parts = cup()
    old = export_completion(mesh, parts, tmp_path / f"cup{suffix}").read_bytes()
    with open(tmp_path / f"cup{suffix}", "rb") as reader:
        start = reader.read(100)
        export_completion(mesh.copy().apply_scale(2), parts, tmp_path / f"cup{suffix}", density=500.0)
        assert start + reader.read() == old
    assert (tmp_path / f"cup{suffix}").read_bytes() != old
    assert not list(tmp_path.glob(".*"))


def test_an_export_that_is_refused_leaves_what_was_there(tmp_path):
    mesh, parts = cup()
    export_completion(mesh, parts, tmp_path / "cup.urdf")
    before = {file: file.read_bytes() for file in tmp_path.rglob("*.*")}
    flat = trimesh.creation.box((0.05, 0.05, 1e-9))
    with pytest.raises(InvalidMesh, match="part 2 of 3"):
        export_completion(mesh, [*parts[:2], flat], tmp_path / "cup.urdf")
    assert {file: file.read_bytes() for file in tmp_path.rglob("*.*")} == before


def test_a_place_that_cannot_be_written_to_keeps_no_remains(tmp_path):
    mesh, parts = cup()
    (tmp_path / "cup.xml").mkdir()
    with pytest.raises(OSError, match=r"cup\.xml"):
        export_completion(mesh, parts, tmp_path / "cup.xml")
    assert [file.name for file in tmp_path.iterdir()] == ["cup.xml"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_suffix_in_capitals_spaces_and_new_folders_are_fine(tmp_path, suffix):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "my föld er" / f"a cup{suffix.upper()}")
    assert path.stat().st_size > 500
    if suffix in (".xml", ".urdf"):
        lower = path.rename(path.with_suffix(suffix))  # MuJoCo goes by the suffix
        assert mujoco.MjModel.from_xml_path(str(lower)).ngeom > len(parts)
    else:
        loaded = trimesh.load_mesh(str(path))
        assert loaded.volume == pytest.approx(mesh.volume, rel=1e-4)


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


def test_up_without_length_is_refused(tmp_path):
    mesh, parts = cup()
    with pytest.raises(InvalidOption, match="up"):
        export_completion(mesh, parts, tmp_path / "cup.xml", up=(0, 0, 0))


def test_hulls_collide_and_the_visual_does_not(tmp_path):
    mesh, parts = cup()
    model = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "a.xml", name="a")))
    assert model.geom("a_visual").contype[0] == model.geom("a_visual").conaffinity[0] == 0
    assert all(model.geom(f"a_hull_{i:03d}").contype[0] == 1 for i in range(len(parts)))


def test_urdf_names_its_meshes_by_relative_paths_and_drops_those_of_an_earlier_export(tmp_path):
    mesh, parts = cup()
    export_completion(mesh, parts, tmp_path / "a.urdf")
    (tmp_path / "a_meshes" / "hull_1000.obj").touch()  # as of more than a thousand parts
    path = export_completion(mesh, parts[:2], tmp_path / "a.urdf")
    files = [element.attrib["filename"] for element in ElementTree.parse(path).iter("mesh")]
    assert files == ["a_meshes/visual.obj", "a_meshes/hull_000.obj", "a_meshes/hull_001.obj"]
    assert sorted(f"a_meshes/{file.name}" for file in (tmp_path / "a_meshes").iterdir()) == sorted(files)


def test_mass_of_a_solid_box_is_known():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.apply_translation((1, 2, 3))
    found = mass_properties(box, density=500.0)
    assert found.mass_kg == pytest.approx(3.0)
    np.testing.assert_allclose(found.centre, [1, 2, 3])
    np.testing.assert_allclose(found.inertia, np.diag([0.04 + 0.09, 0.01 + 0.09, 0.01 + 0.04]) * 3 / 12, atol=1e-12)


def test_mass_of_a_spherical_shell_is_known():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    found = mass_properties(sphere, density=2000.0, shell_thickness_m=0.002)
    mass = 4 * np.pi * 0.1**2 * 0.002 * 2000
    assert found.mass_kg == pytest.approx(mass, rel=5e-3)
    np.testing.assert_allclose(found.inertia, np.eye(3) * 2 / 3 * mass * 0.1**2, rtol=1e-2, atol=1e-7)


def askew() -> tuple[trimesh.Trimesh, list[ConvexPart]]:
    """An L of two boxes, turned about a generic axis and off the origin: no product of inertia is zero."""
    boxes = [
        trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.03, 0.03, 0.1]]),
        trimesh.creation.box(bounds=[[0.03, -0.02, 0.0], [0.08, 0.03, 0.02]]),
    ]
    whole = trimesh.boolean.union([*boxes, trimesh.creation.box(bounds=[[0, -0.02, 0], [0.05, 0.03, 0.02]])])
    T = make_T(rotation_about((1, 2, 3), 1.1), (0.3, -0.2, 0.5))
    for mesh in (whole, *boxes):
        mesh.apply_transform(T)
    return whole, [ConvexPart(box.vertices, box.faces) for box in boxes]


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


def test_inertia_of_a_solid_is_that_about_its_centre_in_the_axes_of_the_mesh():
    mesh, _ = askew()
    found = mass_properties(mesh, density=500.0)
    points = trimesh.sample.volume_mesh(mesh, 400_000) - mesh.center_mass
    second = points.T @ points / len(points) * found.mass_kg
    np.testing.assert_allclose(found.inertia, np.trace(second) * np.eye(3) - second, atol=0.03 * np.abs(second).max())


def test_inertia_of_a_shell_is_that_about_its_centre_wherever_it_is():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    here = mass_properties(sphere, density=2000.0, shell_thickness_m=0.002)
    there = mass_properties(sphere.copy().apply_translation((1, 2, 3)), density=2000.0, shell_thickness_m=0.002)
    assert there.mass_kg == pytest.approx(here.mass_kg)
    np.testing.assert_allclose(there.centre, (1, 2, 3), atol=1e-6)
    np.testing.assert_allclose(there.inertia, here.inertia, rtol=1e-6, atol=1e-9)


def test_inertia_of_an_uneven_shell_is_known():
    """A square of side a, 2 m off: m a2/12 about the axes in its plane, m a2/6 about its normal."""
    square = trimesh.Trimesh([[2.0, 0, 0], [2.3, 0, 0], [2.3, 0.3, 0], [2, 0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    found = mass_properties(square, density=100.0, shell_thickness_m=0.01)
    assert found.mass_kg == pytest.approx(0.09)
    np.testing.assert_allclose(found.centre, (2.15, 0.15, 0))
    np.testing.assert_allclose(found.inertia, np.diag([1, 1, 2]) * 0.09 * 0.09 / 12, atol=1e-12)


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


@pytest.mark.parametrize(
    ("density", "thickness", "message"),
    [(0.09, None, "density"), (30_001.0, None, "density"), (500.0, 0.0, "thickness"), (500.0, np.inf, "thickness")],
)
def test_mass_of_no_material_is_refused(density, thickness, message):
    mesh, _ = askew()
    with pytest.raises(InvalidOption, match=message):
        mass_properties(mesh, density=density, shell_thickness_m=thickness)
    assert mass_properties(mesh, density=0.1).mass_kg == pytest.approx(0.1 * mesh.volume)
    assert mass_properties(mesh, density=30_000.0).mass_kg == pytest.approx(30_000 * mesh.volume)


def test_a_mesh_turned_inside_out_has_no_mass():
    mesh, _ = askew()
    mesh.invert()
    with pytest.raises(InvalidMesh):
        mass_properties(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))


def test_formats_say_whether_they_need_parts():
    assert [needs_parts(f"a{suffix}") for suffix in SUFFIXES] == [False, False, False, False, True, True]
    with pytest.raises(InvalidOption, match="no suffix"):
        needs_parts("a")


def test_unknown_suffix_is_refused_with_the_legal_ones(tmp_path):
    mesh, parts = cup()
    with pytest.raises(InvalidOption) as refusal:
        export_completion(mesh, parts, tmp_path / "cup.dae")
    assert all(suffix in str(refusal.value) for suffix in SUFFIXES)


def test_an_open_mesh_needs_a_shell_thickness(tmp_path):
    mesh, parts = cup()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    with pytest.raises(InvalidMesh, match="shell_thickness_m"):
        export_completion(mesh, parts, tmp_path / "cup.xml")
    path = export_completion(mesh, parts, tmp_path / "cup.xml", shell_thickness_m=0.002)
    mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"name": "a/../b"}, InvalidOption),
        ({"name": "tasse_à_café"}, InvalidOption),
        ({"name": ""}, InvalidOption),
        ({"name": "world"}, InvalidOption),
        ({"density": 0.0}, InvalidOption),
        ({"density": 1e-12}, InvalidOption),
        ({"density": 1e6}, InvalidOption),
        ({"assets": "cloud"}, InvalidOption),
        ({"density": float("nan")}, InvalidOption),
        ({"shell_thickness_m": -1.0}, InvalidOption),
        ({"colors": np.zeros((3, 3), np.uint8)}, InvalidOption),
    ],
)
def test_illegal_options_are_refused(tmp_path, options, error):
    mesh, parts = cup()
    with pytest.raises(error):
        export_completion(mesh, parts, tmp_path / "cup.xml", **options)


def test_no_parts_are_refused_where_they_are_needed(tmp_path):
    mesh, _ = cup()
    with pytest.raises(InvalidMesh, match="parts"):
        export_completion(mesh, (), tmp_path / "cup.urdf")


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
@pytest.mark.parametrize("z", [1e-9, np.nan])
def test_a_part_that_mujoco_would_not_compile_is_refused_by_its_number(tmp_path, suffix, z):
    mesh, parts = cup()
    box = trimesh.creation.box((0.05, 0.05, 1.0))
    bad = ConvexPart(box.vertices * [1, 1, z], box.faces)
    with pytest.raises(InvalidMesh, match="part 5 of 6"):
        export_completion(mesh, [*parts, bad], tmp_path / f"cup{suffix}")


@pytest.mark.parametrize(
    ("text", "name"), [("mug.v2", "mug.v2"), ("tasse à café", "tasse_caf_"), ("world", "world_"), ("", "object")]
)
def test_any_text_makes_a_name_that_compiles(tmp_path, text, name):
    mesh, parts = cup()
    assert legal_name(text) == legal_name(name) == name
    model = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "a.xml", name=legal_name(text))))
    assert model.body(name).mass[0] == pytest.approx(1000 * mesh.volume)
