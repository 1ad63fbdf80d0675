"""Completions by name, in files and in scenes of the user's own, one by one and as the objects of one picture."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from compiled import bounds_of, pose_of
from recorded_calls import recorded
from toy_completions import EXTENTS, toy_completion, toy_fit, toy_image

from gfp_grasp.completion import CompletedScene, Completion, free_name
from gfp_grasp.errors import InvalidOption
from gfp_grasp.overlap import Apart, GaveWay
from gfp_grasp.transforms import make_T, rotation_between
from gfp_grasp.types import SupportPlane, get_sensor

Place = tuple[float, float, float]

VOLUME_M3 = float(np.prod(EXTENTS))
UP = (0.6, 0.0, 0.8)
PLACES = ((0.2, 0.1, 0.05), (-0.3, 0.2, 0.06), (0.1, -0.4, 0.07))


def toy_scene(*categories: str, up: Place = (0.0, 0.0, 1.0)) -> CompletedScene:
    """Boxes that stand apart, over a support 0.02 m along up."""
    support = SupportPlane(np.array(up), 0.02)
    made = [
        toy_completion(place, category=category, up=up, support=support)
        for place, category in zip(PLACES, categories, strict=False)
    ]
    return CompletedScene(tuple(made), toy_image(), support)


def heavy() -> Any:
    """A fit whose card says 800 to 1000 kg/m3."""
    fit = toy_fit()
    fit.primitive.spec = SimpleNamespace(density_kg_m3=(800.0, 1000.0))
    return fit


def foot_of(completion: Completion, up: Place = (0.0, 0.0, 1.0)) -> np.ndarray:
    """T_world_body (4, 4) of a box, from its corners."""
    R = rotation_between((0.0, 0.0, 1.0), up)
    level = np.asarray(completion.mesh.vertices) @ R
    middle = (level.min(axis=0) + level.max(axis=0)) / 2
    return make_T(R, R @ (middle[0], middle[1], level[:, 2].min()))


def empty_spec(*names: str) -> mujoco.MjSpec:
    """A scene of the user's own with fixed bodies of these names."""
    spec = mujoco.MjSpec()
    for name in names:
        spec.worldbody.add_body(name=name)
    return spec


@pytest.mark.parametrize(("fit", "kg_m3", "own"), [(None, 600.0, "pot"), (heavy(), 900.0, "mug")])
def test_a_completion_weighs_what_its_card_says_and_has_the_name_of_its_class_or_the_one_given(
    tmp_path: Path, fit: Any, kg_m3: float, own: str
) -> None:
    completion = toy_completion(PLACES[0], category="pot", fit=fit)
    assert completion.density_kg_m3 == kg_m3
    for name in (None, "kettle.2"):
        for suffix in (".xml", ".urdf"):
            path = completion.export(tmp_path / f"a{suffix}", name=name)
            spec = mujoco.MjSpec.from_file(str(path))
            body = spec.body(name or own)
            if suffix == ".urdf":  # or the body is welded to the world and has no mass of its own
                body.add_freejoint()
            assert spec.compile().body(name or own).mass[0] == pytest.approx(kg_m3 * VOLUME_M3)
    with pytest.raises(InvalidOption, match="name is 'a kettle'"):
        completion.export(tmp_path / "b.xml", name="a kettle")


def test_a_completion_s_body_stands_in_its_foot_along_the_up_of_its_detection() -> None:
    completion = toy_completion(PLACES[0], category="pot", up=UP, fit=heavy())
    body = completion.body("kettle")
    assert body.name == "kettle"
    np.testing.assert_allclose(body.T_world_body, foot_of(completion, UP), atol=1e-12)
    assert body.weight.mass_kg == pytest.approx(900 * VOLUME_M3)
    back = body.mesh.copy().apply_transform(body.T_world_body)
    np.testing.assert_allclose(back.vertices, completion.mesh.vertices, atol=1e-12)
    assert len(body.parts) == 2


def test_a_completion_is_added_to_a_scene_as_a_free_body_where_it_is() -> None:
    completion = toy_completion(PLACES[0], category="tea pot", up=UP)
    spec = empty_spec("cup")
    assert completion.add_to(spec) == "tea_pot"
    model = spec.compile()
    assert (model.nbody, model.nq, model.nmesh) == (3, 7, 3)
    np.testing.assert_allclose(pose_of(model.body("tea_pot")), foot_of(completion, UP), atol=1e-9)
    assert model.body("tea_pot").mass[0] == pytest.approx(600 * VOLUME_M3)
    assert model.joint("tea_pot_free").type[0] == mujoco.mjtJoint.mjJNT_FREE
    shapes = {"visual": completion.mesh, "hull_000": completion.parts[0], "hull_001": completion.parts[1]}
    for name, shape in shapes.items():
        np.testing.assert_allclose(bounds_of(model, f"tea_pot_{name}"), shape.bounds, atol=1e-7)
    inertia = np.sort(np.diag(completion.mesh.moment_inertia)) * 600
    np.testing.assert_allclose(np.sort(model.body("tea_pot").inertia), inertia, rtol=1e-6)


@pytest.mark.parametrize("contact", [True, False])
def test_added_parts_carry_contact_parameters_unless_they_are_not_wanted(contact: bool) -> None:
    spec = empty_spec()
    toy_completion(PLACES[0]).add_to(spec, contact=contact)
    geom = spec.compile().geom("mug_hull_001")
    np.testing.assert_allclose(geom.solref, (0.004, 1.0) if contact else (0.02, 1.0))
    assert geom.priority[0] == (1 if contact else 0)


def test_names_that_are_taken_get_a_number_and_a_prefix_makes_room_of_its_own() -> None:
    spec = empty_spec("mug_3", "b_mug")
    mug = toy_completion(PLACES[0])
    assert [mug.add_to(spec) for _ in range(3)] == ["mug", "mug_2", "mug_4"]
    assert [mug.add_to(spec, "a_") for _ in range(2)] == ["a_mug", "a_mug_2"]  # b_mug, as long, is no mug of a_
    assert mug.add_to(spec, prefix="b_") == "b_mug_2"
    assert mug.add_to(spec, "b_", name="jar") == "b_jar"
    model = spec.compile()
    assert model.nbody == 3 + 7
    assert model.joint("a_mug_2_free").type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert model.geom("b_jar_hull_000").contype[0] == 1
    np.testing.assert_allclose(pose_of(model.body("b_jar")), foot_of(mug), atol=1e-9)


@pytest.mark.parametrize(
    ("prefix", "name", "message"),
    [
        ("", "mug", "the scene has a body 'mug' already"),
        ("a_", "jar", "the scene has a body 'a_jar' already"),
        ("", "my mug", "name is 'my mug'"),
    ],
)
def test_a_name_that_is_taken_or_illegal_is_refused_and_the_scene_left_as_it_was(
    prefix: str, name: str, message: str
) -> None:
    spec = empty_spec("mug", "a_jar")
    with pytest.raises(InvalidOption, match=message):
        toy_completion(PLACES[0]).add_to(spec, prefix, name=name)
    assert [body.name for body in spec.bodies] == ["world", "mug", "a_jar"]
    assert len(spec.meshes) == 0


def test_a_free_name_is_the_name_or_the_first_number_from_2_on() -> None:
    assert free_name("mug", ()) == "mug"
    assert free_name("mug", {"mug_2"}) == "mug"
    assert free_name("mug", {"mug", "mug_2", "mug_4"}) == "mug_3"


def test_a_scene_is_a_sequence_of_its_completions() -> None:
    scene = toy_scene("mug", "cup", "mug")
    made = scene.completions
    assert len(scene) == 3
    assert list(scene) == list(made)
    assert (scene[0], scene[-1]) == (made[0], made[2])
    assert scene[1:] == made[1:]
    assert made[1] in scene
    assert scene.index(made[2]) == 2
    assert list(reversed(scene)) == list(made[::-1])
    with pytest.raises(IndexError):
        scene[3]
    assert scene.gave_way == ()


def test_objects_of_a_scene_have_names_of_their_own() -> None:
    assert toy_scene("mug", "cup", "mug").names == ("mug", "cup", "mug_2")
    assert toy_scene("mug", "mug_2", "mug").names == ("mug", "mug_2", "mug_3")
    assert toy_scene("mug", "mug", "mug_2").names == ("mug", "mug_2", "mug_2_2")
    assert toy_scene("tea pot", "", "world").names == ("tea_pot", "object", "world_")
    scene = toy_scene("mug", "mug")
    bodies = scene.bodies()
    assert [body.name for body in bodies] == ["mug", "mug_2"]
    np.testing.assert_allclose(bodies[1].T_world_body, foot_of(scene[1]), atol=1e-12)


def test_up_is_the_support_s_or_what_the_detection_says() -> None:
    scene = toy_scene("mug", "cup", up=UP)
    np.testing.assert_allclose(scene.up, UP)
    leaning = toy_completion(up=(0.0, 0.6, 0.8))
    np.testing.assert_allclose(CompletedScene((leaning,), toy_image(), None).up, (0.0, 0.6, 0.8))
    np.testing.assert_allclose(CompletedScene((leaning,), toy_image(), scene.support).up, UP)
    np.testing.assert_allclose(CompletedScene((), toy_image(), None).up, (0.0, 0.0, 1.0))


@pytest.mark.parametrize("assets", ["embedded", "files"])
def test_a_scene_is_written_as_one_model_on_the_support(tmp_path: Path, assets) -> None:
    scene = toy_scene("mug", "mug", up=UP)
    path = scene.export(tmp_path / "table.xml", assets=assets, contact=assets == "files")
    assert (tmp_path / "table_meshes").is_dir() == (assets == "files")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nbody, model.nq) == (3, 14)
    np.testing.assert_allclose(model.geom("floor").pos, np.multiply(0.02, UP), atol=1e-9)
    np.testing.assert_allclose(model.opt.gravity, np.multiply(-9.81, UP), atol=1e-7)
    for name, completion in zip(("mug", "mug_2"), scene, strict=True):
        np.testing.assert_allclose(pose_of(model.body(name)), foot_of(completion, UP), atol=1e-8)
        np.testing.assert_allclose(bounds_of(model, f"{name}_visual"), completion.mesh.bounds, atol=1e-6)
        np.testing.assert_allclose(bounds_of(model, f"{name}_hull_001"), completion.parts[1].bounds, atol=1e-6)
        assert model.geom(f"{name}_hull_001").priority[0] == (1 if assets == "files" else 0)
        assert model.body(name).mass[0] == pytest.approx(600 * VOLUME_M3)


def test_without_a_support_the_floor_touches_the_lowest_object(tmp_path: Path) -> None:
    scene = replace(toy_scene("mug", "cup"), support=None)
    lower = CompletedScene((scene[0], toy_completion((-0.3, 0.2, 0.01))), scene.view, None)
    model = mujoco.MjModel.from_xml_path(str(lower.export(tmp_path / "a.xml")))
    np.testing.assert_allclose(model.geom("floor").pos, (0, 0, -0.04), atol=1e-9)


def test_a_scene_is_written_as_nodes_links_or_one_mesh(tmp_path: Path) -> None:
    scene = toy_scene("mug", "cup")
    nodes = trimesh.load_scene(scene.export(tmp_path / "a.glb"))
    assert set(nodes.graph.nodes_geometry) == {"mug", "cup"}
    together = np.vstack([completion.mesh.vertices for completion in scene])
    np.testing.assert_allclose(nodes.bounds, [together.min(axis=0), together.max(axis=0)], atol=1e-6)
    model = mujoco.MjModel.from_xml_path(str(scene.export(tmp_path / "a.urdf")))
    np.testing.assert_allclose(pose_of(model.body("cup")), foot_of(scene[1]), atol=1e-8)
    mesh = trimesh.load_mesh(scene.export(tmp_path / "a.obj"))
    assert mesh.volume == pytest.approx(2 * VOLUME_M3)
    np.testing.assert_allclose(mesh.bounds, nodes.bounds, atol=1e-6)


def test_a_scene_of_no_objects_and_an_unknown_suffix_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidOption, match="at least one is expected"):
        CompletedScene((), toy_image(), None).export(tmp_path / "a.xml")
    with pytest.raises(InvalidOption, match=r"\.dae"):
        toy_scene("mug").export(tmp_path / "a.dae")
    assert list(tmp_path.iterdir()) == []


def test_a_scene_is_added_to_one_of_the_user_s_own() -> None:
    scene, spec = toy_scene("mug", "cup", "mug", up=UP), empty_spec("cup")
    assert scene.add_to(spec) == ("mug", "cup_2", "mug_2")
    assert scene.add_to(spec, "right_", contact=False) == ("right_mug", "right_cup", "right_mug_2")
    model = spec.compile()
    assert (model.nbody, model.nq) == (2 + 6, 6 * 7)
    for name, completion in (("cup_2", scene[1]), ("right_mug_2", scene[2])):
        np.testing.assert_allclose(pose_of(model.body(name)), foot_of(completion, UP), atol=1e-9)
        assert model.geom(f"{name}_hull_000").priority[0] == (1 if name == "cup_2" else 0)


def test_a_scene_of_completions_holds_what_makes_way_and_where_parts_end(monkeypatch: pytest.MonkeyPatch) -> None:
    noisy = replace(get_sensor("tabletop"), sigma_m=0.002)
    support, view = SupportPlane(np.array(UP), 0.02), toy_image()
    loose = toy_completion(PLACES[0], category="mug", support=None, sensor=noisy, up=(0.0, 0.6, 0.8))
    placed = toy_completion(PLACES[1], category="cup", support=support)
    shapes = [replace(completion.shape, timings_s={"way": 1.0}) for completion in (loose, placed)]
    bounds = [np.array([[0.0, 0.6, 0.8, 0.3]]), np.empty((0, 4))]
    gave = [GaveWay(0, 1, 0.004, 0.001, moved=True)]
    make_way = recorded(monkeypatch, "gfp_grasp.completion.make_way", Apart(shapes, bounds, gave))
    scene = CompletedScene.of([loose, placed], view)
    (asked,), named = make_way.only
    assert asked == [loose.shape, placed.shape]
    np.testing.assert_allclose(named.pop("up"), UP)
    assert named == {"floors_m": [None, 0.02], "sigma_m": 0.002}
    assert (scene.view, scene.support, scene.gave_way) == (view, support, tuple(gave))
    assert [completion.shape for completion in scene] == shapes
    assert [completion.detection for completion in scene] == [loose.detection, placed.detection]
    assert [completion.bounds is own for completion, own in zip(scene, bounds, strict=True)] == [True, True]
    CompletedScene.of([loose, loose], view)
    np.testing.assert_allclose(make_way.calls[1][1].pop("up"), (0.0, 0.6, 0.8))
    assert make_way.calls[1][1] == {"floors_m": [None, None], "sigma_m": 0.002}


def test_objects_that_reach_into_each_other_are_parted_half_way() -> None:
    """Boxes of 60 mm that overlap by 10 mm along x: either ends 0.05 mm before the middle, and so do its parts."""
    unseen = [
        replace(made, shape=replace(made.shape, observed=np.zeros(8, dtype=bool)))
        for made in (toy_completion((0.0, 0.0, 0.05)), toy_completion((0.05, 0.01, 0.05), category="cup"))
    ]
    scene = CompletedScene.of(unseen, toy_image())
    left, right = scene
    assert left.mesh.bounds[1, 0] == pytest.approx(0.025 - 0.00005, abs=1e-9)
    assert right.mesh.bounds[0, 0] == pytest.approx(0.025 + 0.00005, abs=1e-9)
    assert [mesh.is_volume for mesh in (left.mesh, right.mesh)] == [True, True]
    np.testing.assert_allclose(left.bounds, [[0, 0, -1, 0], [1, 0, 0, 0.02495]], atol=1e-9)
    assert max(part.bounds[1, 0] for part in left.parts) <= 0.02495 + 1e-9
    assert [(way.index, way.other, way.moved, way.seen_m) for way in scene.gave_way] == [
        (0, 1, True, 0.0),
        (1, 0, True, 0.0),
    ]
    assert [way.depth_m for way in scene.gave_way] == pytest.approx([0.00505, 0.00505])


def test_a_scene_of_nothing_is_an_empty_one() -> None:
    view = toy_image()
    scene = CompletedScene.of([], view)
    assert (len(scene), scene.names, scene.support, scene.gave_way) == (0, (), None, ())
    assert scene.view is view
