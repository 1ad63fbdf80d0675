"""Each numbered example asks the library for what its text says, with toys in the place of what takes long."""

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import trimesh
from recorded_calls import Recorder, recorded
from toy_completions import toy_completion, toy_grasps, toy_image
from toy_street import toy_street

import gfp_grasp
from gfp_grasp.captures import Capture
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.score import ScoreConfig

CAPTURE = Capture("own", points=np.eye(3), view=toy_image(), viewpoint=np.array([1.0, 2.0, 3.0]), up=np.ones(3))


@pytest.fixture(autouse=True)
def empty_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    return recorded(monkeypatch, "gfp_grasp.captures.read_capture", CAPTURE)


def run(monkeypatch: pytest.MonkeyPatch, name: str, *words: str) -> dict[str, Any]:
    """Run an example as a program; its names."""
    monkeypatch.setattr("sys.argv", [name, *words])
    return runpy.run_module(f"gfp_grasp.examples.{name}", run_name="__main__")


def test_a_cloud_is_completed_and_written(
    read: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], empty_folder: Path
) -> None:
    complete = recorded(monkeypatch, "gfp_grasp.complete.complete_to_mesh", toy_completion(scores={"mug": 0.9}))
    run(monkeypatch, "01_complete_a_cloud")
    run(monkeypatch, "01_complete_a_cloud", "own.ply")
    assert read.calls == [(("sample",), {}), (("own.ply",), {})]
    assert complete.calls[0] == ((CAPTURE.points,), {"viewpoint": CAPTURE.viewpoint})
    assert capsys.readouterr().out.splitlines()[:5] == [
        "class mug, 90% sure",
        "watertight: True, size [0.06 0.08 0.1 ] m",
        "50% of the vertices were seen; the others are guessed",
        "standard deviation of a vertex: 1.7 mm on average",
        "wrote completed.glb",
    ]
    assert (empty_folder / "completed.glb").is_file()
    complete.answer = toy_completion()
    run(monkeypatch, "01_complete_a_cloud")
    assert "class mug, 100% sure" in capsys.readouterr().out  # the class was given


def test_a_picture_is_completed_object_by_object(
    read: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], empty_folder: Path
) -> None:
    objects = (toy_completion(), toy_completion(category="cup"))
    complete = recorded(monkeypatch, "gfp_grasp.complete.complete_scene", objects)
    run(monkeypatch, "02_whole_picture")
    run(monkeypatch, "02_whole_picture", "own.npz")
    assert read.calls == [(("sample",), {}), (("own.npz",), {})]
    assert complete.calls[0] == ((CAPTURE.view,), {"up": CAPTURE.up})
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "object 0: mug at [0. 0. 0.] m, 1.25 s"
    assert told[2].startswith("object 1: cup")
    assert (empty_folder / "object_1.ply").is_file()


def test_a_completion_falls_onto_a_floor(
    read: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = toy_completion((0.0, 0.0, 0.05))
    asked: list[CollisionConfig] = []
    monkeypatch.setattr(
        "gfp_grasp.completion.Completion.collide", lambda self, config: asked.append(config) or self.collision
    )
    complete = recorded(monkeypatch, "gfp_grasp.complete.complete_to_mesh", own)
    names = run(monkeypatch, "03_export_and_simulate")
    assert read.only == (("sample",), {})
    assert complete.only == ((CAPTURE.points,), {"viewpoint": CAPTURE.viewpoint})
    assert asked == [CollisionConfig(max_parts=24, max_vertices_per_part=32)]
    told = capsys.readouterr().out
    assert "2 convex parts by cuts, 0.1 mm off the mesh on average" in told
    assert "after 2 s" in told
    start, model, data = names["start"], names["model"], names["data"]
    assert model.body(1).name == "mug"
    assert names["fell_mm"] == pytest.approx(1000 * (start - data.xipos[1])[2])
    assert start[2] > data.xipos[1][2] - 1e-9
    assert 2.0 <= data.time < 2.0 + 2 * model.opt.timestep


@pytest.mark.parametrize(("words", "seed"), [((), 0), (("5",), 5)])
def test_the_best_grasp_is_tried(
    words: tuple[str, ...], seed: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    info = {"object": "red", "mass_kg": 0.1234, "num_observed": 55}
    step = Recorder(("seen", 1.0, True, False, {"reason": "held", "lift_m": 0.2}))
    encode = Recorder("action")
    env = SimpleNamespace(
        reset=Recorder(("seen", info)), completion="own", step=step, action_code=SimpleNamespace(encode=encode)
    )
    made = recorded(monkeypatch, "gfp_grasp.envs.GfpGraspEnv", env)
    grasps = toy_grasps(2)
    plan = recorded(monkeypatch, "gfp_grasp.grasps.plan_grasps", grasps)
    run(monkeypatch, "04_plan_and_try_a_grasp", *words)
    assert made.only == ((), {"completer": "gfpnet", "limit": 6})
    assert env.reset.only == ((), {"seed": seed})
    assert plan.only == (("own",), {"num": 8, "seed": seed})
    assert encode.only == ((grasps[0],), {})
    assert step.only == (("action",), {})
    assert capsys.readouterr().out.splitlines() == [
        "red, 123 g, 55 points seen",
        "grasp 0: quality 0.87, opening 70 mm, at [0.01 0.02 0.1 ] m",
        "grasp 1: quality 0.82, opening 68 mm, at [0.01 0.02 0.11] m",
        "reward 1: held, lifted by 200 mm",
    ]
    plan.answer = ()
    run(monkeypatch, "04_plan_and_try_a_grasp", *words)
    assert len(step.calls) == 1
    env.completion, info["completion_error"] = None, "too far"
    with pytest.raises(SystemExit, match="too far"):
        run(monkeypatch, "04_plan_and_try_a_grasp", *words)


@pytest.mark.parametrize(("words", "limit"), [((), 6), (("2",), 2)])
def test_a_completer_of_one_s_own_is_scored_between_its_brackets(
    words: tuple[str, ...], limit: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = "gfp_grasp.examples.05_score_your_completer:upright_box"
    row = {"completer": "own", "true world": "3/4", "CD mm": "4.2", "failures": "none"}
    write = Recorder()
    pairs = {"oracle": {"only_this": 1, "only_other": 2}}
    report = SimpleNamespace(table=lambda: [row], paired=lambda: {mine: pairs}, write=write)
    score = recorded(monkeypatch, "gfp_grasp.score.score", report)
    names = run(monkeypatch, "05_score_your_completer", *words)
    assert score.only == (("all", ("observed", mine, "oracle")), {"config": ScoreConfig(views=1, limit=limit)})
    assert write.only == (("score.json",), {})
    assert capsys.readouterr().out.splitlines() == [
        "own: held 3/4, CD 4.2 mm, failures: none",
        "beside oracle: 1 held by yours alone, 2 by the other alone",
    ]
    detection = toy_completion().detection
    box = names["upright_box"](detection)
    points = detection.cloud.points
    np.testing.assert_allclose(box.bounds, [points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize(("words", "num"), [((), 12), (("3",), 3)])
def test_a_class_of_urns_is_made_of_a_folder_and_one_more_is_completed(
    words: tuple[str, ...], num: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    build = recorded(monkeypatch, "gfp_grasp.train.build_from_folder", "primitive")
    save = recorded(monkeypatch, "gfp_grasp.primitives.save_primitive")
    library = CompleteConfig().library
    with_shipped = recorded(monkeypatch, "gfp_grasp.primitives.PrimitiveLibrary.with_shipped", library)
    complete = recorded(monkeypatch, "gfp_grasp.complete.complete_to_mesh", toy_completion(category="urn"))
    names = run(monkeypatch, "06_add_a_class", *words)
    assert build.only == ((Path("urns"), "urn"), {})
    assert save.only == (("primitive", Path("my_gps")), {})
    assert with_shipped.only == ((Path("my_gps"),), {})
    meshes = [trimesh.load_mesh(f"urns/urn_{number}.off") for number in range(num)]
    assert len(list(Path("urns").iterdir())) == num
    assert all(mesh.is_volume for mesh in meshes)
    (points,), named = complete.only
    np.testing.assert_allclose(named.pop("viewpoint"), (0.45, -0.35, 0.35))
    assert named == {"config": CompleteConfig(library=library)}
    assert len(points) > 500
    assert np.linalg.norm(points[:, :2], axis=1).max() < 0.05  # of the urn, not of the table
    told = capsys.readouterr().out
    assert "completed as urn, watertight: True" in told
    assert Path("urn.glb").is_file()
    generator = np.random.default_rng(0)
    first = names["urn"](generator)
    np.testing.assert_allclose(meshes[0].vertices, first.vertices, atol=1e-6)
    assert names["view"].depth_m.shape == (240, 320)
    run(monkeypatch, "06_add_a_class", "1")  # its folders are there already
    assert len(build.calls) == 2


def test_urns_have_the_documented_sizes_and_a_wall() -> None:
    urn = runpy.run_module("gfp_grasp.examples.06_add_a_class", run_name="names")["urn"]
    low, high = (urn(SimpleNamespace(uniform=pick)) for pick in (lambda a, b: a, lambda a, b: b))
    for mesh, height, belly, neck in ((low, 0.14, 0.03, 0.014), (high, 0.2, 0.04, 0.02)):
        np.testing.assert_allclose(mesh.bounds[:, 2], (0.0, height), atol=1e-9)
        radius = np.linalg.norm(mesh.vertices[:, :2], axis=1)
        assert radius.max() == pytest.approx(belly, rel=0.01)
        rim = radius[np.isclose(mesh.vertices[:, 2], height)]
        at_rim = neck + (belly - neck) * np.exp(-((0.65 / 0.3) ** 2))
        assert (rim.max(), rim.min()) == (pytest.approx(at_rim), pytest.approx(at_rim - 0.004))
        widest = mesh.vertices[np.argmax(radius), 2] / height
        assert widest == pytest.approx(0.35, abs=0.03)
        foot = mesh.vertices[np.isclose(radius, 0.0)]
        np.testing.assert_allclose(sorted(foot[:, 2]), (0.0, 0.004), atol=1e-9)
        assert len(mesh.vertices) == 2 + 48 * 48


@pytest.mark.parametrize(("words", "steps"), [((), "20"), (("3",), "3")])
def test_a_network_is_trained_for_a_few_steps(
    words: tuple[str, ...], steps: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    command = recorded(monkeypatch, "gfp_grasp.cli.main")
    run(monkeypatch, "07_train", *words)
    line = f"train pcrnet --steps {steps} --limit 4 --views 1 --runs runs --file pcrnet.safetensors"
    assert command.only == ((line.split(),), {})


@pytest.mark.parametrize(("words", "seed"), [((), 4), (("5",), 5)])
def test_a_street_becomes_a_scene_of_its_vehicles_that_stand(
    words: tuple[str, ...],
    seed: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    empty_folder: Path,
) -> None:
    made = toy_street()
    drawn = recorded(monkeypatch, "gfp_grasp.scenes.streets.draw_street", SimpleNamespace(things=range(5)))
    scanned = recorded(monkeypatch, "gfp_grasp.scenes.streets.scan_street", (made.view, None))
    complete = recorded(monkeypatch, "gfp_grasp.complete.complete_scene", made)
    names = run(monkeypatch, "08_a_street", *words)
    (rng,), options = drawn.only
    assert rng.bit_generator.state == np.random.default_rng(seed).bit_generator.state
    assert options == {"num_things": 10, "split": "test"}
    assert scanned.only[0][1] is rng
    assert complete.only == ((made.view,), {})
    assert names["vehicles"].names == ("car", "car_2")  # the pedestrian is none
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "5 things in the street, 3 found, 2 of them vehicles"
    assert told[1].startswith("car: 10 m away, seen 4.0 x 1.8 x 1.6 m, ")
    assert told[-1] == "2 of 2 vehicles stand still in street.xml"
    assert (empty_folder / "street.glb").is_file()


def test_names_of_the_package_come_from_their_rooms_and_the_environment_is_registered() -> None:
    from gfp_grasp import collision, complete, envs, grasps

    assert gfp_grasp.Completion is complete.Completion
    assert gfp_grasp.complete_scene is complete.complete_scene
    assert gfp_grasp.complete_to_mesh is complete.complete_to_mesh
    assert gfp_grasp.decompose is collision.decompose
    assert gfp_grasp.plan_grasps is grasps.plan_grasps
    spec = gymnasium.spec("GfpGrasp-v0")
    assert (spec.id, spec.entry_point) == ("GfpGrasp-v0", "gfp_grasp.envs:GfpGraspEnv")
    assert envs.GfpGraspEnv.__name__ == "GfpGraspEnv"
    assert set(gfp_grasp.__all__) < set(dir(gfp_grasp))
    assert dir(gfp_grasp) == sorted(dir(gfp_grasp))
    with pytest.raises(AttributeError, match="'magic'"):
        gfp_grasp.magic  # noqa: B018
