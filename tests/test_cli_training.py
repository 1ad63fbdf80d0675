"""`gfp-grasp gps` and `gfp-grasp train`: every option arrives, and what was made is told."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from recorded_calls import recorded, rows_of, run

from gfp_grasp.primitives import BuildConfig, PrimitiveLibrary
from gfp_grasp.train import (
    GFPNET_CONFIG,
    PAPER_CONFIGS,
    PCRNET_CONFIG,
    PEER_CONFIGS,
    ClassfreeConfig,
    OpenSetConfig,
    PointRCNNConfig,
    ProposalConfig,
    peer_config,
)
from gfp_grasp.types import LIDAR, TABLETOP

MADE = SimpleNamespace(vertices=[0] * 5, modes=[0] * 2, parts=[0] * 3, part_errors_m=((1, 1), (0.00123, 0.0046)))


@pytest.fixture(autouse=True)
def named_bars(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the progress bars that were made; each is known by its name."""
    made: list[str] = []

    class Bar(str):
        def __call__(self, names: list[str], total: int) -> list[str]:
            made.append(f"{self}: {total}")
            return names

    monkeypatch.setattr("gfp_grasp.cli.primitives.track", Bar)
    return made


def test_list_has_sizes_in_millimetres_and_counts(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("gps list") == 0
    rows = {row.split()[0]: row for row in rows_of(capsys.readouterr().out)}
    library = PrimitiveLibrary.shipped()
    assert tuple(rows) == library.names
    mug = library.primitive("mug")
    x, y, z = 1000 * (mug.vertices.max(axis=0) - mug.vertices.min(axis=0))
    counts = [str(len(mug.vertices)), str(len(mug.modes)), str(len(mug.parts))]
    cells = [cell.strip() for cell in rows["mug"].split("│")]
    assert cells == ["mug", f"{x:.0f} x {y:.0f} x {z:.0f}", *counts, mug.licence]
    assert rows["mug"].startswith("mug  ")


def test_show_prints_the_card(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("gps show mug") == 0
    assert json.loads(capsys.readouterr().out)["category"] == "mug"


@pytest.mark.parametrize("words", ["gps list", "gps show mug"])
def test_classes_of_a_user_are_listed_and_shown(words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    library = PrimitiveLibrary.shipped()
    asked = recorded(monkeypatch, "gfp_grasp.primitives.PrimitiveLibrary.with_shipped", library)
    assert run(f"{words} --gps {tmp_path} --gps other") == 0
    assert asked.only == ((tmp_path, Path("other")), {})


def test_build_from_meshes_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    build = recorded(monkeypatch, "gfp_grasp.train.build_from_folder", MADE)
    save = recorded(monkeypatch, "gfp_grasp.primitives.save_primitive", "[b]own.json")
    (tmp_path / "spec.json").write_text('{"alike": ["cup"]}')
    words = "gps build own --meshes meshes --out cards --orientation upright --licence CC0 --seed 6 --spec"
    assert run(words, tmp_path / "spec.json") == 0
    config = BuildConfig(orientation="upright", licence="CC0")
    received = {"seed": 6, "config": config, "spec": {"alike": ["cup"]}, "progress": "primitive of own"}
    assert build.only == ((Path("meshes"), "own"), received)
    assert save.only == ((MADE, Path("cards")), {})
    assert capsys.readouterr().out == "[b]own.json: 5 vertices, 2 modes\n"


def test_build_without_meshes_takes_procedural_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    build = recorded(monkeypatch, "gfp_grasp.train.build_from_shapes", MADE)
    save = recorded(monkeypatch, "gfp_grasp.primitives.save_primitive")
    assert run("gps build mug --limit 7 --seed 6") == 0
    assert run("gps build mug") == 0
    told = {"spec": {}, "progress": "primitive of mug"}
    assert build.calls == [
        (("mug",), {"members": 7, "seed": 6, **told}),
        (("mug",), {"members": None, "seed": 0, **told}),
    ]
    assert save.calls[0] == ((MADE, Path("gps")), {})


def test_build_without_a_class_builds_all_that_ship(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    build = recorded(monkeypatch, "gfp_grasp.train.build_shipped")
    assert run("gps build --workers 2 --seed 3 --out cards") == 0
    ((names, folder), told) = build.only
    assert names[:3] == ("cup", "cup.lidded", "cup.stemmed")
    assert folder == Path("cards")
    assert told == {"seed": 3, "workers": 2, "progress": "primitives"}
    assert run("gps build --limit 7") == 2
    assert "name it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"), [("{", "not JSON"), ("[1]", "holds a list"), (b"\xff\xfe\xff", "not JSON")]
)
def test_a_broken_spec_is_refused_before_anything_is_built(
    content: str | bytes, words: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "spec.json"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert run("gps build mug --spec", file) == 2
    assert words in capsys.readouterr().err
    assert run("gps build mug --spec", tmp_path / "nowhere.json") == 2
    assert run("gps build mug --spec", tmp_path) == 2


def test_parts_are_made_of_the_named_or_of_all_and_their_errors_are_in_millimetres(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], named_bars: list[str]
) -> None:
    make = recorded(monkeypatch, "gfp_grasp.primitives.with_parts", MADE)
    save = recorded(monkeypatch, "gfp_grasp.primitives.save_primitive")
    assert run("gps parts mug cup --out cards") == 0
    assert [call[0][0].name for call in make.calls] == ["mug", "cup"]
    assert save.calls == [((MADE, Path("cards")), {})] * 2
    assert rows_of(capsys.readouterr().out)[0] == "mug   │     3 │               1.23 │         4.60"
    make.calls.clear()
    assert run("gps parts") == 0
    assert tuple(call[0][0].name for call in make.calls) == PrimitiveLibrary.shipped().names
    assert save.calls[-1] == ((MADE, Path("gps")), {})
    assert named_bars == ["convex parts: 2", f"convex parts: {len(make.calls)}"]


@pytest.mark.parametrize("shapes", [True, False])
def test_prototypes_hand_on_every_option(
    shapes: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    named_bars: list[str],
    tmp_path: Path,
) -> None:
    folder = tmp_path / "[b]"
    folder.symlink_to(PrimitiveLibrary.shipped().folders[0])
    make = recorded(monkeypatch, "gfp_grasp.train.with_prototypes", MADE)
    save = recorded(monkeypatch, "gfp_grasp.primitives.save_primitive")
    members = recorded(monkeypatch, "gfp_grasp.train.procedural_members", ["mesh"])
    flag = ("--shapes",) if shapes else ()
    assert run("gps prototypes mug --seed 6 --gps", folder, *flag) == 0
    (primitive,), named = make.only
    assert primitive.name == "mug"
    assert named == {"meshes": ["mesh"] if shapes else None, "seed": 6}
    assert members.calls == ([(("mug",), {})] if shapes else [])
    assert save.only == ((MADE, folder), {})
    assert "[b]: prototypes of mug" in capsys.readouterr().out.replace("\n", "")
    assert named_bars == ["prototypes: 1"]


TRAINED = "--classes cup,,mug --data meshes --steps 7 --limit 6 --device cuda --runs elsewhere --seed 5"


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Name and length of the bars that were shown."""
    shown: list[tuple[str, int]] = []

    class Bar:
        def __init__(self, name: str, steps: int) -> None:
            shown.append((name, steps))

        def __enter__(self) -> str:
            return "report"

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr("gfp_grasp.cli.training._bar", Bar)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    return shown


def test_training_of_the_proposal_network_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    train = recorded(monkeypatch, "gfp_grasp.train.train_proposal", "metrics")
    assert run(f"train proposal --out weights --workers 3 {TRAINED}") == 0
    assert run("train proposal") == 0
    ((config,), named), ((default,), defaults) = train.calls
    assert config == ProposalConfig(seed=5, device="cuda", limit=6, steps=7)
    received = {"classes": ("cup", "mug"), "data": Path("meshes"), "out": Path("weights"), "workers": 3}
    assert named == {**received, "cache": Path("elsewhere/proposal"), "report": "report"}
    assert default == ProposalConfig()
    received = {"classes": None, "data": None, "out": Path("gfp_grasp/weights"), "workers": 1}
    assert defaults == {**received, "cache": Path("runs/proposal"), "report": "report"}
    assert bars == [("proposal", 7), ("proposal", ProposalConfig().steps)]
    assert capsys.readouterr().out == "metrics\nmetrics\n"


RECEIVED = {
    **{"classes": ("cup", "mug"), "num_views": 3, "limit": 6, "data": Path("meshes"), "out": Path("own.safetensors")},
    **{"runs": Path("elsewhere"), "report": "report"},
}
DEFAULTS = {
    **{"classes": None, "num_views": 4, "limit": None, "data": None, "out": None, "runs": Path("runs")},
    "report": "report",
}


def test_training_of_the_registration_network_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    train = recorded(monkeypatch, "gfp_grasp.train.train_pcrnet", Path("[b]card.json"))
    assert run(f"train pcrnet --file own.safetensors --views 3 --sensor lidar {TRAINED}") == 0
    assert run("train pcrnet") == 0
    config = replace(PCRNET_CONFIG, seed=5, device="cuda", steps=7)
    assert train.calls == [
        ((), {**RECEIVED, "config": config, "sensor": LIDAR}),
        ((), {**DEFAULTS, "config": PCRNET_CONFIG, "sensor": TABLETOP}),
    ]
    assert bars == [("pcrnet", 7), ("pcrnet", PCRNET_CONFIG.steps)]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"


def test_training_of_the_deformation_network_hands_on_every_option(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    patch = recorded(monkeypatch, "gfp_grasp.train.train_gfpnet", Path("[b]card.json"))
    paper = recorded(monkeypatch, "gfp_grasp.train.train_paper", Path("[b]card.json"))
    start = tmp_path / "start.safetensors"
    start.touch()
    words = f"--variant paper-oneshot --file own.safetensors --views 3 --workers 2 --rate 0.25 --start {start}"
    assert run(f"train gfpnet {words} {TRAINED}") == 0
    assert run("train gfpnet") == 0
    config = replace(PAPER_CONFIGS["paper-oneshot"], seed=5, device="cuda", steps=7, rate=0.25)
    assert paper.calls == [(("paper-oneshot",), {**RECEIVED, "config": config, "workers": 2, "start": start})]
    assert patch.calls == [((), {**DEFAULTS, "config": GFPNET_CONFIG, "workers": 1, "start": None})]
    assert bars == [("gfpnet paper-oneshot", 7), ("gfpnet patch", GFPNET_CONFIG.steps)]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"
    assert run("train gfpnet --rate 0") != 0
    assert "rate" in capsys.readouterr().err


def test_training_of_the_class_free_completion_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    train = recorded(monkeypatch, "gfp_grasp.train.train_classfree", Path("[b]card.json"))
    words = "--without cup,,mug --file own.safetensors --steps 7 --members 3 --mixtures 6 --runs elsewhere"
    assert run(f"train classfree {words} --device cuda --workers 2 --seed 5") == 0
    assert run("train classfree") == 0
    config = ClassfreeConfig(seed=5, device="cuda", steps=7, members=3, mixtures=6)
    given = {"without": ("cup", "mug"), "out": Path("own.safetensors"), "runs": Path("elsewhere"), "workers": 2}
    default = {"without": (), "out": None, "runs": Path("runs"), "workers": 1}
    assert train.calls == [
        ((), {**given, "config": config, "report": "report"}),
        ((), {**default, "config": ClassfreeConfig(), "report": "report"}),
    ]
    assert bars == [("classfree", 7), ("classfree", ClassfreeConfig().steps)]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"


def test_training_of_the_detector_of_scans_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    train = recorded(monkeypatch, "gfp_grasp.train.train_pointrcnn", Path("[b]card.json"))
    words = "--data kitti --file own.safetensors --steps 7 --streets 3 --runs elsewhere"
    assert run(f"train pointrcnn {words} --device cuda --workers 2 --seed 5") == 0
    assert run("train pointrcnn") == 0
    config = PointRCNNConfig(seed=5, device="cuda", steps=7, streets=3)
    given = {"data": Path("kitti"), "out": Path("own.safetensors"), "runs": Path("elsewhere"), "workers": 2}
    default = {"data": None, "out": None, "runs": Path("runs"), "workers": 1}
    assert train.calls == [
        ((), {**given, "config": config, "report": "report"}),
        ((), {**default, "config": PointRCNNConfig(), "report": "report"}),
    ]
    assert bars == [("pointrcnn", 7), ("pointrcnn", PointRCNNConfig().steps)]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"


def test_training_of_a_peer_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], bars: list[tuple[str, int]]
) -> None:
    train = recorded(monkeypatch, "gfp_grasp.train.train_peer", Path("[b]card.json"))
    words = "--true-box --classes cup,,mug --file own.safetensors --steps 7 --members 3 --runs elsewhere"
    assert run(f"train peer 3d-epn {words} --device cuda --workers 2 --seed 5") == 0
    assert run("train peer pcn") == 0
    config = replace(peer_config("3d-epn", true_box=True), seed=5, device="cuda", steps=7, members=3)
    given = {"classes": ("cup", "mug"), "out": Path("own.safetensors"), "runs": Path("elsewhere"), "workers": 2}
    default = {"classes": None, "out": None, "runs": Path("runs"), "workers": 1}
    assert train.calls == [
        (("3d-epn",), {**given, "true_box": True, "config": config, "report": "report"}),
        (("pcn",), {**default, "true_box": False, "config": PEER_CONFIGS["pcn"], "report": "report"}),
    ]
    assert bars == [("3d-epn", 7), ("pcn", PEER_CONFIGS["pcn"].steps)]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"
    assert run("train peer magic") != 0
    assert "choose one of pcn" in capsys.readouterr().err


def test_training_of_known_and_unknown_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("gfp_grasp.cli.training.track", lambda description: f"bar of {description}")
    train = recorded(monkeypatch, "gfp_grasp.train.train_openset", Path("[b]card.json"))
    assert run("train openset --file own.json --members 2 --mixtures 5 --workers 3") == 0
    assert run("train openset") == 0
    own = {"config": OpenSetConfig(members=2, mixtures=5), "out": Path("own.json"), "workers": 3}
    assert train.calls == [
        ((), {**own, "progress": "bar of things"}),
        ((), {"config": OpenSetConfig(), "out": None, "workers": 1, "progress": "bar of things"}),
    ]
    assert capsys.readouterr().out == "[b]card.json\n[b]card.json\n"
