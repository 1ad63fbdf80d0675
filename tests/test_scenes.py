"""Scenes compile, objects rest, the gripper opens, closes, follows and holds."""

import numpy as np
import pytest
import real_data
import trimesh

mujoco = pytest.importorskip("mujoco")

from gfp_grasp import scenes  # noqa: E402
from gfp_grasp.assets import data_dir  # noqa: E402
from gfp_grasp.collision import CACHE_VARIABLE, cut_parts, hull  # noqa: E402
from gfp_grasp.errors import InvalidMesh, InvalidOption, InvalidScene, UnreadableFile  # noqa: E402
from gfp_grasp.scenes import handles, objects  # noqa: E402
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about  # noqa: E402
from gfp_grasp.types import CollisionMesh, ConvexPart  # noqa: E402


def cylinder(radius=0.03, height=0.12):
    mesh = trimesh.creation.cylinder(radius=radius, height=height, sections=48)
    mesh.apply_translation([0, 0, height / 2])
    return mesh


def truth(mesh, name="thing", seed=0):
    return scenes.true_object(mesh, name, "bottle", np.random.default_rng(seed), hull)


def simulate(model, data, seconds):
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)


def started(spec):
    model = scenes.compile_scene(spec)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("height", [0.0, 0.4])
def test_an_object_rests_on_the_table_within_a_millimetre(height):
    thing = scenes.SceneObject.of(truth(cylinder()), make_T(None, [0.05, -0.02, height]))
    model, data = started(scenes.build_scene([thing], table_height=height))
    simulate(model, data, 0.5)
    assert np.linalg.norm(data.body("thing").xpos - [0.05, -0.02, height]) < 1e-3
    assert data.body("thing").xquat == pytest.approx([1, 0, 0, 0], abs=1e-3)


def test_mass_centre_and_inertia_are_those_of_the_visual_mesh():
    mesh = trimesh.creation.box((0.04, 0.06, 0.1))
    mesh.apply_translation([0.01, 0.02, 0.05])
    thing = scenes.SceneObject("box", hull(mesh).parts, mesh, np.eye(4), 0.3, 0.5)
    model, _ = started(scenes.build_scene([thing]))
    body = model.body("box")
    assert body.mass == pytest.approx(0.3)
    assert body.ipos == pytest.approx([0.01, 0.02, 0.05], abs=1e-9)
    squares = np.array([0.04, 0.06, 0.1]) ** 2
    assert sorted(body.inertia) == pytest.approx(sorted(0.3 / 12 * (squares.sum() - squares)))


def test_inertia_of_parts_alone_is_that_of_the_whole():
    halves = []
    for z in (0.025, 0.075):
        half = trimesh.creation.box((0.04, 0.06, 0.05))
        half.apply_translation([0, 0, z])
        halves.append(ConvexPart(half.vertices, half.faces))
    model, _ = started(scenes.build_scene([scenes.SceneObject("box", tuple(halves), None, np.eye(4), 0.3, 0.5)]))
    squares = np.array([0.04, 0.06, 0.1]) ** 2
    assert sorted(model.body("box").inertia) == pytest.approx(sorted(0.3 / 12 * (squares.sum() - squares)))
    assert set(model.geom_group[model.geom_bodyid == model.body("box").id]) == {2}  # nothing else would be seen


def test_a_fixed_object_stays_in_the_air():
    thing = scenes.SceneObject("held", hull(cylinder()).parts, None, make_T(None, [0, 0, 0.5]), 0.2, 0.5, fixed=True)
    model, data = started(scenes.build_scene([thing]))
    simulate(model, data, 0.1)
    assert data.body("held").xpos[2] == 0.5


def test_slivers_and_double_names_are_refused_by_name():
    flat = ConvexPart(
        np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0.1, 0.1, 1e-6]]), np.array([[0, 1, 2], [1, 3, 2]])
    )
    with pytest.raises(InvalidScene, match="leaf_part_000"):
        scenes.build_scene([scenes.SceneObject("leaf", (flat,), None, np.eye(4), 0.1, 0.5)])
    thing = scenes.SceneObject.of(truth(cylinder()), np.eye(4))
    with pytest.raises(InvalidScene, match="'thing' is taken"):
        scenes.build_scene([thing, thing])
    with pytest.raises(InvalidScene, match="'table' is taken"):
        scenes.build_scene([scenes.SceneObject.of(truth(cylinder()), np.eye(4), name="table")])


@pytest.mark.parametrize(
    "wrong",
    [
        {"parts": ()},
        {"mass_kg": 0.0},
        {"friction": -1.0},
        {"T_world_object": np.eye(3)},
        {"T_world_object": 2 * np.eye(4)},
    ],
)
def test_impossible_objects_are_refused(wrong):
    right = dict(
        name="x", parts=hull(cylinder()).parts, visual=None, T_world_object=np.eye(4), mass_kg=1.0, friction=1.0
    )
    with pytest.raises(InvalidScene, match="x"):
        scenes.SceneObject(**{**right, **wrong})


def test_a_clutter_of_six_stands_apart_and_rests():
    rng = np.random.default_rng(3)
    things = [truth(cylinder(rng.uniform(0.02, 0.045), rng.uniform(0.08, 0.2)), f"thing{i}", i) for i in range(6)]
    poses = scenes.place_clutter(things, rng, gap_m=0.01)
    for i, (a, T_a) in enumerate(zip(things, poses, strict=True)):
        for b, T_b in zip(things[:i], poses[:i], strict=True):
            apart = np.linalg.norm(T_a[:2, 3] - T_b[:2, 3])
            assert apart >= a.mesh.extents[0] / 2 + b.mesh.extents[0] / 2 + 0.0099
    model, data = started(
        scenes.build_scene([scenes.SceneObject.of(t, T) for t, T in zip(things, poses, strict=True)], gripper=True)
    )
    before = data.xpos.copy()
    simulate(model, data, 0.5)
    assert np.linalg.norm(data.xpos - before, axis=1).max() < 1e-3


def test_placing_is_the_same_for_a_seed_and_says_when_there_is_no_room():
    meshes = [cylinder()] * 4
    first, again = (scenes.place_clutter(meshes, np.random.default_rng(5), lying_share=0.5) for _ in range(2))
    assert np.array_equal(first, again)
    for T in first:
        assert apply_T(T, meshes[0].vertices)[:, 2].min() == pytest.approx(0, abs=1e-12)
    with pytest.raises(InvalidScene, match="do not fit"):
        scenes.place_clutter([cylinder(0.2)] * 6, np.random.default_rng(0))


def test_the_gripper_closes_opens_and_follows():
    model, data = started(scenes.build_scene([], gripper=True))
    T = make_T(rotation_about([0.3, 1, 0.2], 2.5), [0.1, 0.05, 0.4])
    scenes.place_gripper(model, data, T, 0.08)
    assert handles.gripper_pose(model, data)[1] == pytest.approx(0.08)
    data.ctrl[:] = 0.0
    simulate(model, data, 0.5)
    assert handles.gripper_pose(model, data)[1] == pytest.approx(0.0, abs=5e-4)
    data.ctrl[:] = 0.08
    simulate(model, data, 0.5)
    pose, opening = handles.gripper_pose(model, data)
    assert opening == pytest.approx(0.08, abs=5e-4)
    assert np.abs(pose - T).max() < 1e-5
    goal = make_T(T[:3, :3], [0.0, 0.1, 0.5])
    handles.move_gripper(model, data, goal)
    simulate(model, data, 0.3)
    assert np.abs(handles.gripper_pose(model, data)[0] - goal).max() < 1e-5


def test_pads_meet_where_a_grasp_says_they_do():
    model, data = started(scenes.build_scene([], gripper=True))
    scenes.place_gripper(model, data, make_T(None, [0, 0, 1.0]), 0.05)
    left, right = (data.geom(name) for name in handles.PADS)
    assert (left.xpos + right.xpos) / 2 == pytest.approx([0, 0, 1.0], abs=1e-9)
    inner = left.xpos[1] - model.geom("pad_left").size[1]
    assert 2 * inner == pytest.approx(0.05, abs=1e-9)
    assert data.geom("palm").xpos[2] < 1.0  # behind the pads: z is the approach


def test_a_lifted_cylinder_slips_less_than_a_tenth_of_a_millimetre():
    thing = scenes.SceneObject.of(truth(cylinder()), np.eye(4))
    model, data = started(scenes.build_scene([thing], gripper=True))
    R = np.column_stack([[0, 0, 1.0], [0, 1, 0], [-1.0, 0, 0]])
    T = make_T(R, [0, 0.004, 0.06])  # 4 mm off the middle: the first finger to touch pushes it there
    scenes.place_gripper(model, data, T, 0.08)
    assert data.ncon == 4 or all(data.contact.dist > -1e-3)
    data.ctrl[:] = handles.SQUEEZE
    simulate(model, data, 0.6)
    before = invert_T(handles.gripper_pose(model, data)[0]) @ np.append(data.body("thing").xpos, 1)
    for height in np.linspace(0, 0.2, 500):
        handles.move_gripper(model, data, make_T(R, [0, 0.004, 0.06 + height]))
        mujoco.mj_step(model, data)
    simulate(model, data, 1.0)
    after = invert_T(handles.gripper_pose(model, data)[0]) @ np.append(data.body("thing").xpos, 1)
    assert data.body("thing").xpos[2] == pytest.approx(0.2, abs=1e-3)
    assert np.linalg.norm(after - before) < 1e-4
    assert abs(data.actuator_force[0]) <= handles.FORCE_N + 1e-9


def test_the_grip_is_as_slippery_as_the_object():
    mesh = cylinder()
    thing = scenes.SceneObject("ice", hull(mesh).parts, mesh, np.eye(4), 0.5, 0.02)
    model, data = started(scenes.build_scene([thing], gripper=True))
    R = np.column_stack([[0, 0, 1.0], [0, 1, 0], [-1.0, 0, 0]])
    scenes.place_gripper(model, data, make_T(R, [0, 0, 0.06]), 0.08)
    data.ctrl[:] = handles.SQUEEZE
    simulate(model, data, 0.4)
    for height in np.linspace(0, 0.2, 500):
        handles.move_gripper(model, data, make_T(R, [0, 0, 0.06 + height]))
        mujoco.mj_step(model, data)
    assert data.body("ice").xpos[2] < 0.1


def test_a_gripper_is_asked_for_where_there_is_none():
    model, data = started(scenes.build_scene([]))
    with pytest.raises(InvalidScene, match="gripper=True"):
        scenes.place_gripper(model, data, np.eye(4), 0.05)


def test_saved_scenes_open_again_without_any_other_file(tmp_path):
    spec = scenes.build_scene([scenes.SceneObject.of(truth(cylinder()), np.eye(4))], gripper=True, table_height=0.2)
    model = scenes.compile_scene(spec)
    scenes.save_scene(spec, tmp_path / "scene.xml")
    again = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert (again.nq, again.ngeom, again.nu, again.ncam) == (model.nq, model.ngeom, model.nu, model.ncam)
    assert again.body("thing").mass == pytest.approx(model.body("thing").mass)


@pytest.mark.parametrize("name", ["world", "table", "single", "clutter", "gripper"])
def test_every_template_opens_by_itself(name):
    model = mujoco.MjModel.from_xml_path(str(data_dir("sim_scenes") / f"{name}.xml"))
    assert model.opt.timestep == 0.002
    assert (model.opt.cone, model.opt.impratio, model.opt.noslip_iterations) == (mujoco.mjtCone.mjCONE_ELLIPTIC, 10, 10)


def test_uncompilable_specs_are_a_named_error():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="massless").add_freejoint()
    with pytest.raises(InvalidScene, match="does not compile"):
        scenes.compile_scene(spec)


def test_true_objects_rest_on_the_ground_with_a_plausible_mass():
    high = cylinder(0.035, 0.2)
    high.apply_translation([0.5, 0, 1.0])
    thing = truth(high)
    assert thing.mesh.bounds[0, 2] == pytest.approx(0, abs=1e-12)
    assert thing.mesh.bounds[:, :2].mean(axis=0) == pytest.approx([0, 0], abs=1e-9)
    assert 0.1 < thing.mass_kg < 0.9
    assert thing.mass_kg == truth(high).mass_kg != truth(high, seed=1).mass_kg
    assert high.bounds[0, 2] == pytest.approx(1.0)  # the caller's mesh is left alone


def test_a_decomposition_is_made_once_and_read_back_from_disk(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    calls = []

    def counted(mesh) -> CollisionMesh:
        calls.append(mesh)
        return hull(mesh)

    for forget in (False, False, True):
        if forget:
            monkeypatch.setattr(objects, "_memory", {})
        found = objects.decompose_cached(cylinder(), counted, maker="test")
    assert len(calls) == 1
    assert found.parts[0].vertices == pytest.approx(hull(cylinder()).parts[0].vertices)
    (file,) = tmp_path.glob("*.npz")
    file.write_bytes(b"torn")
    monkeypatch.setattr(objects, "_memory", {})
    objects.decompose_cached(cylinder(), counted, maker="test")
    assert len(calls) == 2


def test_a_cache_that_cannot_be_written_costs_nothing_but_time(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "below"))
    with pytest.warns(RuntimeWarning, match=CACHE_VARIABLE):
        assert objects.decompose_cached(cylinder(0.02, 0.05), hull, maker="nowhere").made_by == "hull"


def test_a_folder_gives_its_meshes_by_class_and_name(tmp_path):
    for name in ("cup__b", "a", "mug__c"):
        cylinder().export(tmp_path / f"{name}.ply")
    (tmp_path / "notes.txt").write_text("not a mesh")
    sources = scenes.load_objects(tmp_path)
    assert [(s.name, s.category) for s in sources] == [("a", ""), ("b", "cup"), ("c", "mug")]
    assert len(scenes.load_objects(tmp_path, limit=2)) == 2
    thing = sources[1].load(decompose=hull)
    assert (thing.name, thing.category) == ("b", "cup")
    assert thing.mass_kg == sources[1].load(decompose=hull).mass_kg
    assert str(tmp_path) not in thing.name
    (single,) = scenes.load_objects(tmp_path / "a.ply")
    assert single.load_mesh().is_volume


def test_families_come_split_by_seed_and_take_turns():
    test, train = scenes.load_objects("cup"), scenes.load_objects("cup", split="train")
    assert not {s.seed for s in test} & {s.seed for s in train}
    assert [s.category for s in scenes.load_objects("cup,bottle", limit=4)] == ["cup", "bottle", "cup", "bottle"]
    mesh = test[0].load_mesh()
    assert mesh.is_volume
    assert mesh.bounds[0, 2] == pytest.approx(0, abs=1e-9)


def test_what_cannot_be_loaded_is_said(tmp_path):
    with pytest.raises(InvalidOption, match="bottle"):
        scenes.load_objects("boat")
    with pytest.raises(InvalidOption, match="train, val, test"):
        scenes.load_objects("cup", split="holdout")
    with pytest.raises(InvalidOption, match="at least 1"):
        scenes.load_objects("cup", limit=0)
    with pytest.raises(UnreadableFile, match="no mesh"):
        scenes.load_objects(tmp_path)


def test_real_meshes_become_sources():
    sources = scenes.load_objects(real_data.folder() / "meshes")
    assert {"mug", "bottle", "cup"} <= {source.category for source in sources}
    assert all(source.load_mesh().is_volume for source in sources[:3])


def test_a_cut_cup_stays_hollow_and_a_box_stays_whole():
    outer, inner = cylinder(0.04, 0.1), cylinder(0.037, 0.1)
    inner.apply_translation([0, 0, 0.003])
    cup = trimesh.boolean.difference([outer, inner])
    collision = cut_parts(cup)
    assert collision.error_m[0] < 5e-4
    assert 1.0 < sum(part.to_trimesh().volume for part in collision.parts) / cup.volume < 1.25
    hollow = np.array([[0, 0, 0.05], [0.03, 0, 0.09], [0, -0.03, 0.02]])
    assert not any(part.to_trimesh().contains(hollow).any() for part in collision.parts)
    again = cut_parts(cup)
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(collision.parts, again.parts, strict=True))
    assert len(cut_parts(trimesh.creation.box((0.05, 0.06, 0.1))).parts) == 1
    with pytest.raises(InvalidMesh, match="watertight"):
        cut_parts(trimesh.Trimesh(cup.vertices, cup.faces[5:]))


def test_a_mug_too_winding_for_few_parts_gets_more_of_them_not_coacd(monkeypatch):
    def too_slow(*_, **__):
        raise AssertionError("CoACD takes half a minute")

    monkeypatch.setenv(CACHE_VARIABLE, "off")
    monkeypatch.setattr("gfp_grasp.collision.decompose", too_slow)
    mug = next(source for source in scenes.load_objects("mug") if source.name == "mug-57")
    assert cut_parts(mug.load_mesh()).error_m[0] > 0.001
    collision = mug.load().collision
    assert collision.made_by == "cuts"
    assert collision.error_m[0] < 0.0005
