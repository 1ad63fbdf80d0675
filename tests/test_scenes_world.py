"""Worlds of bent bodies and blocks as MuJoCo has them: how they settle, what they weigh, what collides and is seen."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest
import trimesh
from scene_things import TILTED, as_part, block, box, l_shape
from scipy.spatial.transform import Rotation

from gfp_grasp.errors import InvalidScene
from gfp_grasp.scenes import SceneObject, World, build_scene, compile_scene, gripper_pose, place_gripper
from gfp_grasp.scenes import handles as gripper_handles
from gfp_grasp.transforms import make_T, rotation_about

# Worlds


def test_a_world_settles_from_where_it_is_told_and_comes_back_to_that():
    world = World([block("one"), block("two", at=(0.2, 0))])
    T = make_T(rotation_about((0, 0, 1), 0.7), (-0.1, 0.1, 0.002))
    world.settle({"one": T})
    rest = {name: world.pose(name) for name in world.names}
    np.testing.assert_allclose(rest["one"], make_T(T[:3, :3], (-0.1, 0.1, 0.0)), atol=1e-4)
    np.testing.assert_allclose(rest["two"][:3, 3], (0.2, 0, 0), atol=1e-4)
    world.data.qpos[:] = 0.5
    world.data.qvel[:] = 1.0
    mujoco.mj_step(world.model, world.data, 20)
    world.restore()
    for name, pose in rest.items():
        np.testing.assert_array_equal(world.pose(name), pose)
    assert not world.data.qvel[: 2 * 6 + 6].any()
    world.settle()
    np.testing.assert_allclose(world.pose("one")[:3, 3], 0.0, atol=1e-4)


def test_settling_goes_on_until_all_objects_have_come_to_rest():
    """One stands at once, the other falls 0.1 m first."""
    world = World([block("one"), block("two", at=(0.2, 0))])
    world.settle({"two": make_T(t=(0.2, 0, 0.1))})
    assert world.pose("two")[2, 3] == pytest.approx(0.0, abs=1e-4)
    assert 0.15 < world.data.time < 1.0


def test_a_thing_that_never_rests_is_taken_as_it_is_after_two_seconds():
    rolling = trimesh.creation.icosphere(radius=0.03)
    slope = box((0.6, 0.6, 0.02))
    slope.apply_transform(make_T(rotation_about((0, 1, 0), 0.3), (0, 0, 0.2)))
    world = World(
        [
            SceneObject("ball", (as_part(rolling),), None, make_T(t=(-0.1, 0, 0.3)), 0.1, 0.5),
            SceneObject("slope", (as_part(slope),), None, np.eye(4), 1.0, 0.5, fixed=True),
        ]
    )
    world.settle()
    assert world.data.time == pytest.approx(2.0)
    assert not world.data.qvel[world.model.joint("ball_free").dofadr[0] :][:6].any()


def test_names_that_are_not_there_and_things_that_are_fixed_are_refused():
    world = World([block("one"), block("two", at=(0.2, 0), fixed=True)])
    for ask in (world.pose, world.geoms, lambda name: world.set_mass_and_friction(name, 1.0, 0.5)):
        with pytest.raises(InvalidScene, match="no object 'table'; there are one, two"):
            ask("table")
    with pytest.raises(InvalidScene, match="no object 'teapot'"):
        world.settle({"teapot": np.eye(4)})
    with pytest.raises(InvalidScene, match="'two' is fixed"):
        world.settle({"two": np.eye(4)})


def test_mass_and_friction_are_those_of_one_object_and_of_all_its_geoms():
    parts, solid = l_shape()
    world = World([SceneObject("bent", parts, solid, np.eye(4), 0.2, 0.5), block("other", at=(0.2, 0), mass_kg=0.4)])
    before = world.model.body_inertia[world.model.body("bent").id].copy()
    world.set_mass_and_friction("bent", 0.5, 0.9)
    assert world.model.body("bent").mass[0] == pytest.approx(0.5)
    np.testing.assert_allclose(world.model.body("bent").inertia, before * 2.5)
    assert set(world.model.geom_friction[world.geoms("bent"), 0]) == {0.9}
    assert world.geoms("bent").sum() == 3
    assert world.model.body("other").mass[0] == pytest.approx(0.4)
    assert 0.9 not in world.model.geom_friction[~world.geoms("bent"), 0]
    assert world.model.body_subtreemass[world.model.body("bent").id] == pytest.approx(0.5)  # what depends on it, too


def test_a_settled_object_presses_on_the_table_with_its_new_weight():
    world = World([block()])
    world.set_mass_and_friction("block", 0.7, 0.5)
    world.settle()
    forces = np.zeros((world.data.ncon, 6))
    for i in range(world.data.ncon):
        mujoco.mj_contactForce(world.model, world.data, i, forces[i])
    assert forces[:, 0].sum() == pytest.approx(0.7 * 9.81, rel=0.01)


def test_a_saved_world_holds_its_objects_where_they_rest(tmp_path):
    world = World([block("one"), block("two", at=(0.2, 0), fixed=True)])
    T = make_T(rotation_about((0, 0, 1), 0.7), (-0.1, 0.1, 0.002))
    world.settle({"one": T})
    at_rest = world.pose("one")
    world.data.qpos[world.model.joint("one_free").qposadr[0]] = 9.0
    mujoco.mj_forward(world.model, world.data)
    world.save(tmp_path / "scene.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    np.testing.assert_allclose(model.body("one").pos, at_rest[:3, 3], atol=1e-6)
    assert {model.joint(i).name for i in range(model.njnt)} >= {"one_free", "gripper_free"}
    assert "two_free" not in {model.joint(i).name for i in range(model.njnt)}


# Building


def inertia_of(model, name):
    """Mass, centre (3,) and inertia (3, 3) about the centre of a body, in the body's frame."""
    body = model.body(name)
    R = Rotation.from_quat(body.iquat, scalar_first=True).as_matrix()
    return body.mass[0], body.ipos, R @ np.diag(body.inertia) @ R.T


@pytest.mark.parametrize("visual", [True, False])
def test_mass_is_spread_evenly_over_a_bent_body_whether_by_its_mesh_or_its_parts(visual):
    parts, solid = l_shape()
    if not visual:  # parts that do not overlap, of the same shape
        foot, post = box((0.06, 0.02, 0.01), (0.03, 0.01, 0.005)), box((0.01, 0.02, 0.08), (0.005, 0.01, 0.05))
        parts = as_part(foot), as_part(post)
    model = compile_scene(build_scene([SceneObject("bent", parts, solid if visual else None, TILTED, 0.25, 0.5)]))
    mass, centre, tensor = inertia_of(model, "bent")
    density = 0.25 / solid.volume
    assert mass == pytest.approx(0.25)
    np.testing.assert_allclose(centre, solid.center_mass, atol=1e-8)
    np.testing.assert_allclose(tensor, density * solid.moment_inertia, atol=1e-9)
    assert abs(tensor[0, 2]) > 1e-6  # a product that a symmetric body has not
    np.testing.assert_allclose(model.body("bent").pos, TILTED[:3, 3])
    R = Rotation.from_quat(model.body("bent").quat, scalar_first=True).as_matrix()
    np.testing.assert_allclose(R, TILTED[:3, :3], atol=1e-9)


def test_an_open_picture_has_the_mass_of_its_parts():
    parts, solid = l_shape()
    opened = solid.copy()
    opened.update_faces(np.arange(len(opened.faces)) > 1)
    model = compile_scene(build_scene([SceneObject("bent", parts, opened, np.eye(4), 0.25, 0.5)]))
    np.testing.assert_allclose(inertia_of(model, "bent")[1], solid.center_mass, atol=1e-8)


def test_parts_collide_and_the_picture_does_not():
    parts, solid = l_shape()
    model = compile_scene(build_scene([SceneObject("bent", parts, solid, np.eye(4), 0.25, 0.37)]))
    collide = [model.geom(f"bent_part_{i:03d}") for i in range(2)]
    for geom in collide:
        assert (geom.contype[0], geom.conaffinity[0], geom.group[0], geom.condim[0], geom.priority[0]) == (
            1,
            1,
            3,
            4,
            1,
        )
        assert geom.friction == pytest.approx([0.37, 0.005, 0.0001])
        assert geom.solref == pytest.approx([0.008, 1.0])
        assert geom.solimp == pytest.approx([0.95, 0.99, 0.001, 0.5, 2.0])
    picture = model.geom("bent_visual")
    assert (picture.contype[0], picture.conaffinity[0], picture.group[0]) == (0, 0, 2)
    assert picture.rgba == pytest.approx(collide[0].rgba)


def test_neighbours_have_colours_of_their_own_and_nine_share_eight():
    things = [block(f"b{i}", at=(0.1 * i, 0)) for i in range(9)]
    model = compile_scene(build_scene(things))
    colours = [tuple(model.geom(f"b{i}_visual").rgba) for i in range(9)]
    assert len(set(colours[:8])) == 8
    assert colours[8] == colours[0]
    assert colours[0] == pytest.approx((0x4F / 255, 0x7C / 255, 0xAC / 255, 1.0))


def test_table_cameras_and_gripper_go_up_with_the_table():
    low, high = (compile_scene(build_scene([block()], gripper=True, table_height=h)) for h in (0.0, 0.4))
    for kind in ("cam", "body"):
        for i in range(getattr(low, f"n{kind}")):
            name = (low.cam if kind == "cam" else low.body)(i).name
            at = [(m.cam if kind == "cam" else m.body)(i).pos for m in (low, high)]
            moves = name not in ("world", "block", "finger_left", "finger_right")
            np.testing.assert_allclose(at[1] - at[0], (0, 0, 0.4 * moves), err_msg=name)
    np.testing.assert_allclose(low.body("gripper").pos, (0, 0, 1.5))
    sites = {low.site(i).name: high.site(i).pos - low.site(i).pos for i in range(low.nsite)}
    np.testing.assert_allclose(sites["grip_center"], 0.0)
    np.testing.assert_allclose(sites["spot_0"], (0, 0, 0.4))


def test_one_object_has_the_near_cameras_and_two_have_the_far_ones():
    one = compile_scene(build_scene([block()]))
    two = compile_scene(build_scene([block("a"), block("b", at=(0.2, 0))]))
    assert np.linalg.norm(one.camera("front").pos) < 0.7 < np.linalg.norm(two.camera("front").pos)
    bare = compile_scene(build_scene([block()], table=False))
    names = {bare.body(i).name for i in range(bare.nbody)}
    assert names == {"world", "block"}


@pytest.mark.parametrize(("thickness_m", "refused"), [(1.5e-5, True), (3e-5, False)])
def test_parts_are_refused_from_their_thickness_on_in_any_pose(thickness_m, refused):
    sheet = box((0.05, 0.04, thickness_m))
    sheet.apply_transform(TILTED)
    leaf = SceneObject("leaf", (as_part(sheet),), None, np.eye(4), 0.1, 0.5)
    if refused:
        with pytest.raises(InvalidScene, match="leaf_part_000"):
            build_scene([leaf])
    else:
        compile_scene(build_scene([leaf]))


def test_parts_are_refused_from_their_volume_on():
    for extent, refused in ((2.1e-4, True), (2.3e-4, False)):  # 0.93e-11 and 1.2e-11 m3
        crumb = SceneObject("crumb", (as_part(box((extent,) * 3)),), None, np.eye(4), 0.1, 0.5)
        if refused:
            with pytest.raises(InvalidScene, match="crumb_part_000"):
                build_scene([crumb])
        else:
            build_scene([crumb])


# The gripper


def test_the_gripper_is_put_at_rest_and_no_wider_than_it_opens():
    world = World([])
    world.data.qvel[:] = 1.0
    for width_m, opening_m in ((0.05, 0.05), (0.2, 0.08), (-0.1, 0.0)):
        place_gripper(world.model, world.data, TILTED, width_m)
        T, opening = gripper_pose(world.model, world.data)
        np.testing.assert_allclose(T, TILTED, atol=1e-9)
        assert opening == pytest.approx(opening_m)
        assert world.data.ctrl[0] == pytest.approx(opening_m)
    assert not world.data.qvel.any()
    np.testing.assert_allclose(world.data.mocap_pos[0], TILTED[:3, 3])
    mujoco.mj_step(world.model, world.data, 50)
    np.testing.assert_allclose(gripper_pose(world.model, world.data)[0], TILTED, atol=1e-4)
    gripper_handles.move_gripper(world.model, world.data, make_T(t=(0.1, 0, 0.5)))
    np.testing.assert_allclose(world.data.mocap_quat[0], (1, 0, 0, 0))
