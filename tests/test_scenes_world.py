"""Worlds, masses, friction, poses and places of objects that are not symmetric."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from gfp_grasp.collision import hull
from gfp_grasp.errors import DecompositionFailed, InvalidMesh, InvalidOption, InvalidScene
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.scenes import (
    SceneObject,
    World,
    build_scene,
    compile_scene,
    gripper_pose,
    load_objects,
    objects,
    place_clutter,
    place_gripper,
    true_object,
)
from gfp_grasp.scenes import handles as gripper_handles
from gfp_grasp.scenes import objects as scene_objects
from gfp_grasp.scenes import world as scene_world
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import CategorySpec, CollisionMesh, ConvexPart

TILTED = make_T(rotation_about((1, -2, 0.5), 0.8), (0.1, -0.05, 0.4))


def as_part(mesh):
    return ConvexPart(mesh.vertices, mesh.faces)


def box(extents, at=(0, 0, 0)):
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(at)
    return mesh


def l_shape():
    """A foot of 60 by 20 by 10 mm with a post of 10 by 20 by 80 mm at one end, as two parts and as one solid."""
    foot, post = box((0.06, 0.02, 0.01), (0.03, 0.01, 0.005)), box((0.01, 0.02, 0.08), (0.005, 0.01, 0.05))
    return (as_part(foot), as_part(post)), trimesh.boolean.union([foot, post])


def block(name="block", extents=(0.04, 0.06, 0.1), at=(0.0, 0.0), mass_kg=0.3, **knobs):
    mesh = box(extents, (0, 0, extents[2] / 2))
    T = make_T(t=(*at, 0))
    return SceneObject(name, (as_part(mesh),), mesh, T, mass_kg, 0.5, **knobs)


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


@pytest.mark.parametrize(("height_m", "lifted_m"), [(-0.03, 0.03), (0.05, 0.0)])
def test_parts_of_the_world_frame_are_lifted_out_of_the_table_and_not_put_down(height_m, lifted_m):
    (foot, post), _ = l_shape()
    shift = np.array([0.1, 0.2, height_m])
    thing = SceneObject.of_parts(
        tuple(ConvexPart(part.vertices + shift, part.faces) for part in (foot, post)), 0.2, 0.6
    )
    assert (thing.name, thing.mass_kg, thing.friction, thing.visual) == ("object", 0.2, 0.6, None)
    for part, before in zip(thing.parts, (foot, post), strict=True):
        stands = apply_T(thing.T_world_object, part.vertices)
        np.testing.assert_allclose(stands, before.vertices + shift + (0, 0, lifted_m), atol=1e-12)
    with pytest.raises(InvalidScene, match="no convex parts"):
        SceneObject.of_parts((), 0.2, 0.6)


def test_an_object_may_be_without_friction_and_not_below_it():
    assert block().friction == 0.5
    assert replace(block(), friction=0.0).friction == 0.0
    for wrong in ({"friction": -1e-9}, {"mass_kg": np.inf}, {"T_world_object": np.diag([1.0, 1, 1.001, 1])}):
        with pytest.raises(InvalidScene, match="block"):
            replace(block(), **wrong)


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


# True objects


class Told(np.random.Generator):
    """A generator that notes its ranges and gives a place in them."""

    def __init__(self, share):
        super().__init__(np.random.PCG64())
        self.share, self.asked = share, []

    def uniform(self, low, high):  # pyright: ignore[reportIncompatibleMethodOverride]
        self.asked.append((low, high))
        return low + self.share * (high - low)


def open_cylinder():
    outer, inner = trimesh.creation.cylinder(0.04, 0.1), trimesh.creation.cylinder(0.037, 0.1)
    inner.apply_translation((0, 0, 0.003))
    return trimesh.boolean.difference([outer, inner])


def test_an_open_vessel_weighs_as_its_walls_and_a_closed_one_as_filled():
    cup = open_cylinder()
    for mesh, densities in ((cup, (900.0, 2400.0)), (box((0.05, 0.06, 0.12)), (150.0, 1050.0))):
        for share in (0.0, 0.5, 1.0):
            rng = Told(share)
            thing = true_object(mesh, "x", "cup", rng, hull)
            assert rng.asked == [densities, (0.4, 1.0)]
            assert thing.mass_kg == pytest.approx(mesh.volume * (densities[0] + share * np.ptp(densities)))
            assert thing.friction == pytest.approx(0.4 + 0.6 * share)


@pytest.mark.parametrize(
    ("hollow", "is_open", "densities"),
    [
        (True, True, (10.0, 20.0)),
        (False, False, (10.0, 20.0)),
        (True, False, (150.0, 1050.0)),  # a cup with its lid on
        (False, True, (900.0, 2400.0)),  # a bottle cut open
    ],
)
def test_the_card_of_a_class_says_how_dense_its_members_are(hollow, is_open, densities):
    spec = CategorySpec("bowl", hollow=hollow, density_kg_m3=(10.0, 20.0))
    rng = Told(0.0)
    true_object(open_cylinder() if is_open else box((0.05, 0.06, 0.12)), "x", "bowl", rng, hull, spec=spec)
    assert rng.asked[0] == densities


def test_a_source_asks_the_library_that_it_is_given(tmp_path):
    """The shipped bottle at twice the density, in a folder of its own."""
    shipped = PrimitiveLibrary.shipped()
    low, high = shipped.spec("bottle").density_kg_m3
    heavy = replace(shipped.spec("bottle"), density_kg_m3=(2 * low, 2 * high))
    save_primitive(replace(shipped.primitive("bottle"), spec=heavy), tmp_path)
    box((0.05, 0.06, 0.12)).export(tmp_path / "bottle__square.ply")
    (source,) = load_objects(tmp_path / "bottle__square.ply")
    plain, doubled = (source.load(decompose=hull, library=library) for library in (None, PrimitiveLibrary(tmp_path)))
    assert doubled.mass_kg == pytest.approx(2 * plain.mass_kg)
    unknown = replace(source, category="teapot").load(decompose=hull)
    assert unknown.mass_kg == plain.mass_kg


def test_half_a_hull_of_material_is_a_filled_body_and_less_a_vessel():
    """A block with a well: it fills 0.49 or 0.51 of its hull."""
    for fill, low in ((0.49, 900.0), (0.51, 150.0)):
        well = box((0.04, 0.04, 0.1 * (1 - fill) / 0.64))
        well.apply_translation((0, 0, 0.05 - well.extents[2] / 2 + 1e-4))
        mesh = trimesh.boolean.difference([box((0.05, 0.05, 0.1)), well])
        rng = Told(0.0)
        true_object(mesh, "x", "", rng, hull)
        assert mesh.volume / mesh.convex_hull.volume == pytest.approx(fill, abs=2e-3)
        assert rng.asked[0][0] == low


def test_masses_stay_between_twenty_grams_and_a_kilogram():
    assert true_object(box((0.02, 0.02, 0.02)), "x", "", Told(0.0), hull).mass_kg == 0.02
    assert true_object(box((0.2, 0.2, 0.2)), "x", "", Told(1.0), hull).mass_kg == 1.0


@pytest.mark.parametrize(("length_m", "refused"), [(0.0099, True), (0.0101, False), (0.99, False), (1.01, True)])
def test_what_is_no_size_for_a_hand_is_refused(length_m, refused):
    mesh = box((length_m / 2, length_m / 3, length_m))
    if refused:
        with pytest.raises(InvalidMesh, match="scale it to metres"):
            objects.solid_mesh(mesh)
    else:
        assert objects.solid_mesh(SimpleNamespace(mesh=mesh)).is_volume


def test_an_object_is_put_on_the_ground_and_keeps_its_own_axis_if_that_passes_through_it():
    through = box((0.04, 0.06, 0.1), (0.015, -0.02, 0.3))
    np.testing.assert_allclose(objects.rested(through).bounds[0], (-0.005, -0.05, 0.0), atol=1e-12)
    for shift in ((0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0), (0, -0.5, 0)):
        beside = box((0.04, 0.06, 0.1), np.add(shift, (0, 0, -0.7)))
        moved = objects.rested(beside)
        np.testing.assert_allclose(moved.bounds, [(-0.02, -0.03, 0.0), (0.02, 0.03, 0.1)], atol=1e-12)
        assert beside.bounds[0, 2] < -0.7
    ready = box((0.04, 0.06, 0.1), (0, 0, 0.05))
    assert objects.rested(ready) is ready


def test_plane_cuts_are_taken_where_they_are_true_enough_and_coacd_where_it_is_better(monkeypatch):
    part = as_part(box((0.05, 0.05, 0.05)))

    def found(mean, high, maker: Any = "cuts"):
        return CollisionMesh((part,), (mean, high, 2 * high), maker, 0.0)

    def choice(few, many, coacd):
        asked = []

        def cut(mesh, *, max_parts):
            asked.append(max_parts)
            return found(*(few if max_parts == 96 else many))

        def whole(mesh):
            asked.append("coacd")
            if coacd is None:
                raise DecompositionFailed("crashed")
            return found(*coacd, maker="coacd")

        monkeypatch.setattr("gfp_grasp.collision.decompose", whole)
        monkeypatch.setattr("gfp_grasp.collision.cut_parts", cut, raising=False)
        result = objects._decompose(box((0.05, 0.05, 0.05)))
        return result.made_by, result.error_m[0], asked

    good, worse, bad = (0.0004, 0.001), (0.0009, 0.003), (0.003, 0.01)
    assert choice(good, bad, bad) == ("cuts", 0.0004, [96])
    assert choice((0.0004, 0.0021), worse, bad) == ("cuts", 0.0009, [96, 256])
    assert choice((0.0006, 0.001), worse, bad) == ("cuts", 0.0009, [96, 256])
    assert choice((0.0012, 0.001), (0.0011, 0.003), (0.0008, 0.01)) == ("coacd", 0.0008, [96, 256, "coacd"])
    assert choice((0.0006, 0.001), (0.0007, 0.004), bad) == ("cuts", 0.0006, [96, 256, "coacd"])
    assert choice(bad, bad, None)[0] == "cuts"


def test_parts_are_kept_by_mesh_and_by_maker_and_few_at_a_time(monkeypatch):
    monkeypatch.setattr(scene_objects, "_memory", {})
    monkeypatch.setattr(scene_objects, "_KEPT", 2)
    monkeypatch.setenv("GFP_GRASP_CACHE", "off")
    calls = []

    def made(mesh):
        calls.append(mesh.extents[0])
        return hull(mesh)

    meshes = [box((0.05 + 0.01 * i, 0.05, 0.05)) for i in range(3)]
    first = scene_objects.decompose_cached(meshes[0], made, maker="a")
    assert scene_objects.decompose_cached(meshes[0].copy(), made, maker="a") is first
    scene_objects.decompose_cached(meshes[0], made, maker="b")
    assert len(calls) == 2
    scene_objects.decompose_cached(meshes[1], made, maker="a")
    assert len(scene_objects._memory) == 2
    scene_objects.decompose_cached(meshes[0], made, maker="a")  # the first was dropped
    assert len(calls) == 4


def test_a_mesh_has_the_hash_of_its_single_precision_bytes():
    mesh = box((0.05, 0.06, 0.07))
    assert scene_objects.mesh_sha256(mesh) == scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices.astype(np.float32), mesh.faces, process=False)
    )
    assert scene_objects.mesh_sha256(mesh) != scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices + 1e-6, mesh.faces, process=False)
    )
    assert scene_objects.mesh_sha256(mesh) != scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices, mesh.faces[::-1], process=False)
    )


# Placing


def wedge():
    """A body whose middle is far from its own axis."""
    mesh = box((0.1, 0.03, 0.05), (0.06, 0.01, 0.025))
    return mesh


def test_footprints_are_circles_about_the_middles_of_what_stands_there():
    """Bodies far off their axes: their boxes' middles keep apart, and stay within the circle."""
    meshes = [wedge(), wedge(), box((0.04, 0.04, 0.08), (0, 0, 0.04))]
    for seed in range(10):
        poses = place_clutter(meshes, np.random.default_rng(seed), radius_m=0.2, gap_m=0.02, table_height=0.3)
        circles = []
        for mesh, T in zip(meshes, poses, strict=True):
            stands = apply_T(T, mesh.vertices)
            assert stands[:, 2].min() == pytest.approx(0.3)
            np.testing.assert_allclose(T[:3, :3] @ (0, 0, 1), (0, 0, 1), atol=1e-12)
            middle = (stands.min(axis=0) + stands.max(axis=0))[:2] / 2
            circles.append((middle, np.linalg.norm(stands[:, :2] - middle, axis=1).max()))
        for i, (middle, radius) in enumerate(circles):
            assert np.linalg.norm(middle) + radius <= 0.2 + 1e-9
            for other, its in circles[:i]:
                assert np.linalg.norm(middle - other) >= radius + its + 0.02 - 1e-9


def test_the_circle_is_widened_where_they_do_not_fit_and_no_more_than_needed():
    meshes = [trimesh.creation.cylinder(0.05, 0.1) for _ in range(4)]
    for radius_m in (0.3, 0.11):
        poses = place_clutter(meshes, np.random.default_rng(1), radius_m=radius_m)
        reach = max(np.linalg.norm(T[:2, 3]) + 0.05 for T in poses)
        assert reach <= 2 * radius_m
        assert (reach > radius_m) == (radius_m < 0.2)


def test_places_are_even_over_the_disc_and_turns_over_the_circle():
    mesh = trimesh.creation.cylinder(0.01, 0.1)
    poses = np.stack([place_clutter([mesh], np.random.default_rng(i), radius_m=0.21)[0] for i in range(400)])
    reach = np.linalg.norm(poses[:, :2, 3], axis=1) / 0.2
    assert reach.max() <= 1
    assert (reach < np.sqrt(0.5)).mean() == pytest.approx(0.5, abs=0.08)  # half of the area
    yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    assert np.histogram(yaw, 4, (-np.pi, np.pi))[0].min() > 70
    assert np.abs(np.corrcoef(yaw, np.arctan2(poses[:, 1, 3], poses[:, 0, 3]))[0, 1]) < 0.15


def test_the_largest_is_placed_first():
    """The first draw of an angle and a reach is that of the largest, whatever the order."""
    circles = [(np.zeros(2), radius) for radius in (0.01, 0.05, 0.02)]
    centres = scene_world._scatter(circles, np.random.default_rng(4), 0.2, 0.0)
    rng = np.random.default_rng(4)
    angle, reach = rng.uniform(0, 2 * np.pi), 0.15 * np.sqrt(rng.random())
    assert centres is not None
    np.testing.assert_allclose(centres[1], reach * np.array([np.cos(angle), np.sin(angle)]))


def test_so_many_lie_on_their_side_as_are_asked_for():
    mesh = box((0.03, 0.04, 0.1), (0, 0, 0.05))
    for share in (0.0, 0.3, 1.0):
        lying = 0
        for seed in range(200):
            (T,) = place_clutter([mesh], np.random.default_rng(seed), lying_share=share)
            assert apply_T(T, mesh.vertices)[:, 2].min() == pytest.approx(0.0, abs=1e-12)
            axis = abs(T[2, 2])
            assert axis == pytest.approx(1.0) or axis == pytest.approx(0.0, abs=1e-12)
            lying += axis < 0.5
        assert lying / 200 == pytest.approx(share, abs=0.08)
    rolls = {round(float(scene_world._turn(mesh.vertices, np.random.default_rng(s), 1.0)[2]), 4) for s in range(20)}
    assert len(rolls) > 5  # lying things are rolled to any side


@pytest.mark.parametrize("knobs", [{"lying_share": 1.1}, {"lying_share": -0.1}, {"radius_m": 0.0}, {"gap_m": -0.01}])
def test_nonsense_placing_is_refused(knobs):
    with pytest.raises(InvalidOption, match=next(iter(knobs))):
        place_clutter([wedge()], np.random.default_rng(0), **knobs)
