"""Files of a simulator whose objects stand, tilt, travel and overlap by known amounts; completed bodies in a scene."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from pathlib import Path

import mujoco
import numpy as np
import pytest
from bodies import AWAY, TURN, l_parts, l_shape

from gfp_grasp.errors import InvalidOption, InvalidScene, UnreadableFile
from gfp_grasp.export import CONTACT_PRIORITY, CONTACT_SOLREF, export_completion, make_body
from gfp_grasp.scenes import BodyCheck, add_body, check_file, check_model
from gfp_grasp.transforms import make_T, rotation_about

FLOOR = '<geom name="floor" type="plane" size="2 2 0.1"/>'
BOX = '<geom type="box" size="0.02 0.03 0.05"/>'


def model_of(*bodies: str, floor: str = FLOOR, option: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(mjcf(*bodies, floor=floor, option=option))


def mjcf(*bodies: str, floor: str = FLOOR, option: str = "") -> str:
    return f"<mujoco>{option}<worldbody>{floor}{''.join(bodies)}</worldbody></mujoco>"


def free(name: str, pos: str, geom: str = BOX, more: str = "") -> str:
    return f'<body name="{name}" pos="{pos}" {more}><freejoint/>{geom}</body>'


def link(name: str, z: float, size: str = "0.04 0.06 0.1") -> str:
    box = f'<collision><origin xyz="0.3 -0.2 {z}"/><geometry><box size="{size}"/></geometry></collision>'
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    return (
        f'<link name="{name}"><inertial><origin xyz="0.3 -0.2 {z}"/><mass value="1"/>{inertia}</inertial>{box}</link>'
    )


def urdf(folder: Path, *elements: str) -> Path:
    path = folder / "own.urdf"
    path.write_text(f'<robot name="own">{"".join(elements)}</robot>')
    return path


def test_a_box_stands_and_one_that_leans_falls_onto_its_side():
    R = rotation_about((0.0, 1.0, 0.0), np.radians(30.0))  # beyond the balance of its half widths, 20 by 50 mm
    height = float(np.abs(R[2]) @ [0.02, 0.03, 0.05])
    leaning = free("leans", f"0.5 0 {height}", more='euler="0 30 0"')
    stands, falls = check_model(model_of(free("stands", "0 0 0.05"), leaning))
    assert (stands.name, stands.stands) == ("stands", True)
    assert stands.tilt_deg < 0.1
    assert stands.travel_m < 0.0005
    assert (falls.name, falls.stands) == ("leans", False)
    assert falls.tilt_deg == pytest.approx(60.0, abs=1.0)


def test_a_body_in_the_air_travels_by_its_fall():
    found = check_model(model_of(free("falls", "0 0 5")), seconds=0.5)
    assert found[0].travel_m == pytest.approx(0.5 * 9.81 * 0.25, rel=0.01)
    assert found[0].tilt_deg == 0.0
    assert not found[0].stands


def test_a_fall_is_no_tilt_whichever_way_gravity_points():
    (found,) = check_model(model_of(free("a", "0 0 1"), option='<option gravity="-9.81 0 0"/>'), seconds=0.1)
    assert found.tilt_deg == 0.0
    assert found.travel_m == pytest.approx(0.5 * 9.81 * 0.01, rel=0.03)


@pytest.mark.parametrize(("gravity", "tilts"), [("0 0 -1e-9", False), ("1e-9 0 0", True), ("0 0 0", False)])
def test_tilt_is_that_of_the_direction_against_gravity(gravity: str, tilts: bool):
    """A spring turns the body by a quarter about z, which is upright unless gravity is along x."""
    twist = '<equality><weld body1="a" relpose="0 0 0.05 0.7071068 0 0 0.7071068"/></equality>'
    xml = mjcf(free("a", "0 0 0.05"), floor="", option=f'<option gravity="{gravity}"/>')
    found = check_model(mujoco.MjModel.from_xml_string(xml.replace("</mujoco>", f"{twist}</mujoco>")))
    assert found[0].tilt_deg == pytest.approx(90.0 if tilts else 0.0, abs=2.0)


def test_way_is_the_longer_of_origin_and_centre_of_mass():
    """The body falls over about its own centre of mass, which stays; its origin is 0.3 m aside."""
    geom = '<geom type="box" size="0.02 0.03 0.05" pos="0.3 0 0"/>'
    twist = '<equality><weld body1="a" relpose="0.3 -0.3 0 0.7071068 0 0 0.7071068"/></equality>'
    xml = mjcf(free("a", "0 0 0", geom), floor="", option='<option gravity="0 0 0"/>')
    found = check_model(mujoco.MjModel.from_xml_string(xml.replace("</mujoco>", f"{twist}</mujoco>")))
    assert found[0].travel_m == pytest.approx(0.3 * np.sqrt(2), rel=0.02)


def test_overlap_is_the_deepest_with_anything_at_the_start():
    boxes = free("a", "0 0 0.048"), free("b", "0.037 0 0.2"), free("c", "0.07 0 0.2"), free("d", "1 0 0.06")
    found = check_model(model_of(*boxes), seconds=0.002)
    assert [body.name for body in found] == ["a", "b", "c", "d"]
    assert [body.overlap_m for body in found] == pytest.approx([0.002, 0.007, 0.007, 0.0], abs=1e-6)
    assert [body.neighbour_m for body in found] == pytest.approx([0.0, 0.007, 0.007, 0.0], abs=1e-6)


def test_what_can_move_is_a_neighbour_and_what_is_fixed_to_the_world_is_none():
    fixed = f'<body name="fixed" pos="0 0 0.2">{BOX}</body>'
    hinged = '<body name="door" pos="0.037 0.5 0.2"><joint type="hinge" axis="0 0 1"/>BOX</body>'.replace("BOX", BOX)
    found = check_model(model_of(fixed, free("a", "0.035 0 0.2"), hinged, free("b", "0 0.5 0.2")), seconds=0.002)
    assert [body.name for body in found] == ["a", "b"]
    assert [body.overlap_m for body in found] == pytest.approx([0.005, 0.003], abs=1e-6)
    assert [body.neighbour_m for body in found] == pytest.approx([0.0, 0.003], abs=1e-6)


def test_bodies_without_a_name_are_numbered_and_others_than_free_ones_left_out():
    hinged = '<body name="door" pos="1 0 1"><joint type="hinge"/><geom type="sphere" size="0.1"/></body>'
    found = check_model(model_of(hinged, free("", "0 0 0.05").replace('name=""', "")), seconds=0.01)
    assert [body.name for body in found] == ["body 2"]


@pytest.mark.parametrize(
    ("tilt_deg", "travel_m", "stands"),
    [(4.99, 0.00499, True), (5.01, 0.0, False), (0.0, 0.00501, False), (np.inf, np.inf, False)],
)
def test_standing_is_less_than_five_degrees_and_five_millimetres(tilt_deg: float, travel_m: float, stands: bool):
    assert BodyCheck("a", tilt_deg, travel_m, overlap_m=0.1).stands == stands


@pytest.mark.parametrize("autoreset", ["enable", "disable"])
def test_a_simulation_that_breaks_down_ends_and_nothing_of_it_stands(autoreset: str, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo keeps a log of it there
    ball = '<geom size="0.02" mass="1e-6"/>'
    spring = f'<body pos="0.3 0 0.5"><joint type="slide" axis="0 0 1" stiffness="-1e12"/>{ball}</body>'
    option = f'<option><flag autoreset="{autoreset}" contact="disable"/></option>'
    found = check_model(model_of(free("a", "0 0 0.05"), spring, option=option))
    assert found == (BodyCheck("a", np.inf, np.inf, 0.0),)


def test_a_scene_of_fixed_bodies_is_refused():
    with pytest.raises(InvalidScene, match="free joint"):
        check_model(model_of(f"<body>{BOX}</body>"))


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.nan, np.inf])
def test_a_time_that_is_none_is_refused(seconds: float):
    with pytest.raises(InvalidOption, match=r"seconds is .*finite positive"):
        check_model(model_of(free("a", "0 0 0.05")), seconds=seconds)


def test_files_that_mujoco_does_not_read_are_refused_with_its_words(tmp_path: Path):
    with pytest.raises(UnreadableFile, match=r"none\.xml is no file"):
        check_file(tmp_path / "none.xml")
    with pytest.raises(UnreadableFile, match="is no file"):
        check_file(tmp_path)
    (tmp_path / "torn.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(UnreadableFile, match=r"MuJoCo does not read .*torn\.xml: XML parse error"):
        check_file(tmp_path / "torn.xml")
    geom = '<geom type="mesh" mesh="a"/>'
    missing = mjcf(free("a", "0 0 1", geom)).replace(
        "<worldbody>", '<asset><mesh name="a" file="gone.obj"/></asset><worldbody>'
    )
    (tmp_path / "missing.xml").write_text(missing)
    with pytest.raises(UnreadableFile, match=r"gone\.obj"):
        check_file(tmp_path / "missing.xml")


def test_a_file_is_checked_as_it_is(tmp_path: Path):
    path = tmp_path / "own.xml"
    path.write_text(mjcf(free("a", "0 0 0.05"), free("b", "0.5 0 1"), option='<option timestep="0.01"/>'))
    still, falls = check_file(path, seconds=0.2)
    assert still.stands
    assert falls.travel_m == pytest.approx(0.5 * 9.81 * 0.04, rel=0.1)


def test_a_urdf_gets_a_floor_below_its_lowest_point_and_its_root_is_free(tmp_path: Path):
    (found,) = check_file(urdf(tmp_path, link("a", 0.7)))
    assert found.name == "a"
    assert found.stands
    assert found.overlap_m < 1e-6


def test_the_floor_of_a_urdf_is_below_what_collides(tmp_path: Path):
    seen = '<visual><geometry><box size="0.1 0.1 3"/></geometry></visual></link>'
    kept = '<mujoco><compiler discardvisual="false"/></mujoco>'
    (found,) = check_file(urdf(tmp_path, kept, link("a", 0.05).replace("</link>", seen)))
    assert found.stands


def test_several_roots_of_a_urdf_are_free_and_the_higher_one_falls(tmp_path: Path):
    still, falls = check_file(urdf(tmp_path, link("a", 0.05), link("b", 1.05).replace("0.3 -0.2", "0.6 0.2")))
    assert (still.name, falls.name) == ("a", "b")
    assert still.stands
    assert falls.travel_m > 0.9


@pytest.mark.parametrize("world", ['<link name="world"/>', "<link\n name = 'world' />"])
def test_a_link_that_is_fixed_to_the_world_stays_and_a_floating_one_is_free(world: str, tmp_path: Path):
    def joint(kind: str, child: str, z: float) -> str:
        place = f'<parent link="world"/><child link="{child}"/><origin xyz="0 0 {z}"/>'
        return f'<joint name="{child}_joint" type="{kind}">{place}</joint>'

    table = link("table", 0.5, "0.6 0.6 0.1")
    elements = world, table, link("mug", 0.0), joint("fixed", "table", 0.0), joint("floating", "mug", 0.6)
    (found,) = check_file(urdf(tmp_path, *elements))  # on the table, half a metre above the floor
    assert found.name == "mug"
    assert found.stands
    with pytest.raises(InvalidScene, match="free joint"):
        check_file(urdf(tmp_path, world, table, joint("fixed", "table", 0.0)))


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
def test_an_exported_l_stands_and_its_meshes_carry_it(suffix: str, tmp_path: Path):
    mesh, parts = l_shape(), [part.to_trimesh() for part in l_parts()]
    path = export_completion(mesh, parts, tmp_path / f"l{suffix}", name="l")
    (found,) = check_file(path)
    assert found.name == "l"
    assert found.stands
    if suffix == ".urdf":
        for file in (tmp_path / "l_meshes").glob("hull_*.obj"):
            file.unlink()
        with pytest.raises(UnreadableFile, match="hull_"):
            check_file(path)


T_WORLD_BODY = make_T(TURN, AWAY)


def added(*, contact: bool = True) -> mujoco.MjModel:
    """A scene of the user's with the L, turned and away."""
    mesh = l_shape().apply_transform(T_WORLD_BODY)
    parts = [part.to_trimesh().apply_transform(T_WORLD_BODY) for part in l_parts()]
    spec = mujoco.MjSpec.from_string(mjcf(free("own", "0 0 0.05")))
    body = make_body(mesh, parts, name="l", density=500.0, T_world_body=T_WORLD_BODY)
    add_body(spec, body, prefix="left_", contact=contact)
    return spec.compile()


def test_an_added_body_has_its_pose_mass_and_inertia_in_the_scene():
    model = added()
    body = model.body("left_l")
    np.testing.assert_allclose(body.pos, AWAY, atol=1e-9)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, body.quat)
    np.testing.assert_allclose(R.reshape(3, 3), TURN, atol=1e-9)
    solid = l_shape()
    solid.density = 500.0
    assert body.mass[0] == pytest.approx(solid.mass)
    np.testing.assert_allclose(body.ipos, solid.center_mass, atol=1e-9)
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, body.iquat)
    axes = axes.reshape(3, 3)
    np.testing.assert_allclose(axes * body.inertia @ axes.T, solid.moment_inertia, atol=1e-12)
    assert model.joint("left_l_free").type[0] == mujoco.mjtJoint.mjJNT_FREE


def test_the_parts_of_an_added_body_collide_where_they_are_and_its_mesh_is_only_seen():
    model = added()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    names = [model.geom(g).name for g in range(model.ngeom) if model.geom(g).name.startswith("left_")]
    assert names == ["left_l_visual", "left_l_hull_000", "left_l_hull_001"]
    for name, shape in zip(names, (l_shape(), *l_parts()), strict=True):
        geom = model.geom(name)
        seen = name == "left_l_visual"
        assert (geom.contype[0], geom.conaffinity[0], geom.group[0]) == ((0, 0, 2) if seen else (1, 1, 3))
        start, count = model.mesh_vertadr[geom.dataid[0]], model.mesh_vertnum[geom.dataid[0]]
        own = model.mesh_vert[start : start + count] @ data.geom(name).xmat.reshape(3, 3).T + data.geom(name).xpos
        local = (own - AWAY) @ TURN
        np.testing.assert_allclose([local.min(axis=0), local.max(axis=0)], np.asarray(shape_bounds(shape)), atol=1e-6)


def shape_bounds(shape) -> list[np.ndarray]:
    return [np.min(shape.vertices, axis=0), np.max(shape.vertices, axis=0)]


@pytest.mark.parametrize("contact", [True, False])
def test_parts_carry_contact_parameters_unless_the_scene_keeps_its_own(contact: bool):
    geom, own = added(contact=contact).geom("left_l_hull_001"), added().geom("floor")
    assert geom.priority[0] == (CONTACT_PRIORITY if contact else own.priority[0])
    np.testing.assert_allclose(geom.solref, CONTACT_SOLREF if contact else own.solref)
