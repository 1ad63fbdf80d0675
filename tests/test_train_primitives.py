"""Primitives of families and folders: which shapes are built from, which are held out, and what the card says."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from moments import assert_known
from toy_primitive import toy_cup_primitive

from gfp_grasp.errors import InvalidMesh, InvalidOption, UnknownCategory
from gfp_grasp.primitives import BuildConfig
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.train import build_from_folder, build_from_shapes, procedural_members
from gfp_grasp.train import primitives as module
from gfp_grasp.train.primitives import _hold_out, _posed


@pytest.fixture
def built(monkeypatch) -> SimpleNamespace:
    """A build that gives the toy cup at once, and what it was asked for."""
    seen = SimpleNamespace(builds=[], measured=[], known_by=[])

    def build(meshes, name, *, config, seed, progress):
        seen.builds.append(SimpleNamespace(meshes=list(meshes), name=name, config=config, seed=seed, progress=progress))
        return replace(toy_cup_primitive(), card={"members_used": len(meshes)})

    def measure(primitive, held_out, *, progress):
        seen.measured.append((len(held_out), held_out, progress))
        return SimpleNamespace(figures=lambda: {"held_out": len(held_out)})

    def recognisable(primitive, seed, meshes=None):
        seen.known_by.append((seed, meshes))
        return primitive

    monkeypatch.setattr(module, "build_primitive", build)
    monkeypatch.setattr(module, "measure_primitive", measure)
    monkeypatch.setattr(module, "_recognisable", recognisable)
    return seen


def _same(meshes, family: str, seeds) -> bool:
    return [m.volume for m in meshes] == [make_shape(family, seed).mesh.volume for seed in seeds]


def _of_the_class(split: str) -> list[int]:
    return [seed for seed in split_seeds("cup", split) if make_shape("cup", seed).kind not in ("lidded", "stemmed")]


def test_a_family_is_built_from_the_train_split_and_measured_on_the_other(built) -> None:
    progress = lambda stream, total: stream  # noqa: E731
    primitive = build_from_shapes("cup", members=6, held_out=3, seed=4, progress=progress)
    (build,), ((count, held_out, told),) = built.builds, built.measured
    assert _same(build.meshes, "cup", _of_the_class("train")[:6])
    assert (build.name, build.seed, build.progress, told) == ("cup", 4, progress, progress)
    assert build.config == BuildConfig(licence="Apache-2.0")
    assert count == 3
    assert _same(held_out, "cup", _of_the_class("val")[:3])
    assert primitive.card == {
        "command": "gfp-grasp gps build cup --limit 6 --seed 4",
        "seed": 4,
        "data": "procedural shapes of cup, the first 6 of the train split",
        "held_out_data": "procedural shapes of cup, the first 3 of the val split",
        "members_used": 6,
        "held_out": 3,
        "build_s": 0,
    }
    assert built.known_by[0][0] == 4
    assert built.known_by[0][1] == build.meshes


def test_a_variant_is_built_from_those_among_a_thousand(built, monkeypatch) -> None:
    kinds = {seed: ("footed", "tapered", "plain")[seed % 3] for seed in range(5000)}
    monkeypatch.setattr(
        module, "make_shape", lambda family, seed: SimpleNamespace(kind=kinds[seed], mesh=f"{family}-{seed}")
    )
    config = BuildConfig(rounds=1)
    primitive = build_from_shapes("cup.footed", members=1000, held_out=4, config=config, spec={"hollow": True})
    train = [seed for seed in split_seeds("cup", "train", 1000) if kinds[seed] == "footed"]
    val = [seed for seed in split_seeds("cup", "val") if kinds[seed] == "footed"][:4]
    assert built.builds[0].meshes == [f"cup-{seed}" for seed in train]
    assert len(train) > 300
    assert built.builds[0].config is config
    assert built.measured[0][1] == [f"cup-{seed}" for seed in val]
    assert primitive.card["data"] == f"procedural shapes of cup.footed, the first {len(train)} of the train split"
    assert procedural_members("cup.footed", 5) == [f"cup-{seed}" for seed in train[:5]]
    build_from_shapes("cup.tapered", members=7)
    assert len(built.builds[1].meshes) == 7


@pytest.mark.parametrize("knobs", [{"members": 0}, {"held_out": 0}])
def test_no_shapes_are_refused(knobs: dict) -> None:
    with pytest.raises(InvalidOption, match="at least 1 of each"):
        build_from_shapes("cup", **knobs)


def test_a_class_is_built_without_its_variants(built, monkeypatch) -> None:
    kinds = ("stemmed", "tapered", "lidded", "straight")
    monkeypatch.setattr(module, "make_shape", lambda _, seed: SimpleNamespace(kind=kinds[seed % 4], mesh=seed))
    build_from_shapes("cup", members=7, held_out=5)
    train, val = split_seeds("cup", "train", 1000), split_seeds("cup", "val")
    assert built.builds[0].meshes == [seed for seed in train if seed % 2][:7]
    assert built.measured[0][1] == [seed for seed in val if seed % 2][:5]
    assert procedural_members("cup", 3, split="test") == [seed for seed in split_seeds("cup", "test") if seed % 2][:3]


def test_all_shapes_of_the_splits_may_be_used(built, monkeypatch) -> None:
    monkeypatch.setattr(module, "make_shape", lambda family, seed: SimpleNamespace(kind="a", mesh=seed))
    build_from_shapes("cup", members=5000, held_out=5000)
    build_from_shapes("cup")
    build_from_shapes("cup", members=1, held_out=1)
    counts = [(len(b.meshes), count) for b, (count, _, _) in zip(built.builds, built.measured, strict=True)]
    assert counts == [(1000, len(split_seeds("cup", "val"))), (120, 40), (1, 1)]
    assert len(procedural_members("cup")) == 120
    with pytest.raises(UnknownCategory):
        build_from_shapes("boat.odd")


def _folder(tmp_path: Path, count: int) -> Path:
    for number in range(count):
        mesh = trimesh.creation.box((0.1, 0.05, 0.02 + 0.001 * number))
        mesh.export(tmp_path / f"{number:02d}.{('ply', 'STL')[number % 2]}", file_type=("ply", "stl")[number % 2])
    (tmp_path / "broken.off").write_text("OFF\n3 1 0\nnot a mesh")
    (tmp_path / "notes.txt").write_text("no mesh")
    return tmp_path


def test_a_small_folder_is_used_up_by_the_build(built, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match=r"broken\.off is left out: "):
        primitive = build_from_folder(_folder(tmp_path, 14), "box", seed=2, spec={"hollow": False})
    (build,) = built.builds
    heights = [float(m.extents[2]) for m in build.meshes]
    np.testing.assert_allclose(heights, 0.02 + 0.001 * np.arange(14))
    assert (build.name, build.seed, build.config) == ("box", 2, BuildConfig(orientation="any"))
    assert built.measured == []
    assert primitive.spec.hollow is False
    assert primitive.card == {
        "command": "gfp-grasp gps build box --meshes FOLDER --seed 2",
        "seed": 2,
        "data": "14 mesh files of a folder, 0 more held out, 1 more unreadable",
        "members_used": 14,
    }
    assert built.known_by == [(2, None)]


@pytest.mark.filterwarnings("ignore:broken.off")
def test_a_fifth_of_a_larger_folder_is_held_out(built, tmp_path: Path, monkeypatch) -> None:
    posed: list = []
    monkeypatch.setattr(
        module, "_posed", lambda meshes, primitive, config, seed: (posed.append((len(meshes), seed)), meshes)[1]
    )
    config = BuildConfig(orientation="upright")
    primitive = build_from_folder(_folder(tmp_path, 16), "box", seed=3, config=config, progress=None)
    assert posed == [(3, 3)]
    assert built.builds[0].config is config
    assert len(built.builds[0].meshes) == 13
    assert built.measured[0][0] == 3
    assert primitive.card["held_out"] == 3
    assert primitive.card["data"] == "13 mesh files of a folder, 3 more held out, 1 more unreadable"
    monkeypatch.setattr(module, "_posed", lambda *_: [])
    assert "held_out" not in build_from_folder(tmp_path, "box", config=config).card


@pytest.mark.parametrize(("scale", "said"), [(1000.0, "100 m across"), (0.01, "0.001 m across")])
def test_a_folder_that_is_not_in_metres_is_refused(built, tmp_path: Path, scale: float, said: str) -> None:
    for number in range(5):
        trimesh.creation.box(scale * np.array([0.1, 0.05, 0.02])).export(tmp_path / f"{number}.ply")
    with pytest.raises(InvalidOption, match=f"{said}, 0.005 to 25 m are expected"):
        build_from_folder(tmp_path, "box")
    assert not built.builds


def test_what_is_held_out_is_drawn_by_the_seed_and_keeps_its_order() -> None:
    kept, held = _hold_out(list(range(15)), np.random.default_rng(0))  # pyright: ignore[reportArgumentType]
    assert (len(kept), len(held)) == (12, 3)
    assert (kept, held) == (sorted(kept), sorted(held))
    assert sorted(kept + held) == list(range(15))
    assert_known("held out", held)
    assert _hold_out(list(range(14)), np.random.default_rng(0)) == (list(range(14)), [])  # pyright: ignore[reportArgumentType]


def test_held_out_members_are_repaired_and_turned_onto_the_mean(monkeypatch) -> None:
    sound = trimesh.creation.box((0.1, 0.05, 0.02))
    opened = trimesh.Trimesh(sound.vertices, sound.faces[:-2], process=False)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    asked: list = []

    def turned(solids, orientation, rng, *, reference):
        asked.append((solids, orientation, rng.integers(1000), reference))
        return solids

    def solid(mesh):
        if mesh is flat:
            raise InvalidMesh("flat")
        return sound, 0.0

    monkeypatch.setattr(module, "bring_into_one_pose", turned)
    monkeypatch.setattr(module, "make_solid", solid)
    primitive = toy_cup_primitive()
    found = _posed([sound, flat, opened], primitive, BuildConfig(orientation="upright"), 5)
    ((solids, orientation, drawn, reference),) = asked
    assert found is solids
    assert [mesh is sound for mesh in solids] == [True, True]
    assert (orientation, drawn) == ("upright", np.random.default_rng(5).integers(1000))
    np.testing.assert_array_equal(reference.vertices, primitive.vertices)
    np.testing.assert_array_equal(reference.faces, primitive.faces)


def test_a_class_is_known_by_the_prototypes_of_the_shipped_network(monkeypatch) -> None:
    asked: list = []
    monkeypatch.setattr(
        "gfp_grasp.train.prototypes.with_prototypes",
        lambda primitive, *, meshes, seed: (asked.append((meshes, seed)), primitive)[1],
    )
    module._recognisable(toy_cup_primitive(), 4, [])
    module._recognisable(toy_cup_primitive(), 5)
    assert asked == [([], 4), (None, 5)]
