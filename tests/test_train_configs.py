"""Schedules of the networks, and the training runs that they make: what each of them is handed and what is written."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import shipped_families
from gfp_grasp.shapes import FAMILIES, TRAFFIC
from gfp_grasp.train import (
    GFPNET_CONFIG,
    LIDAR_CONFIG,
    PCRNET_CONFIG,
    Example,
    ProposalConfig,
    gfpnet,
    pcrnet,
    proposal,
    train_gfpnet,
    train_pcrnet,
    train_proposal,
)
from gfp_grasp.train.loop import training_key
from gfp_grasp.train.proposal_batches import Targets
from gfp_grasp.train.proposal_data import VIEWS
from gfp_grasp.types import LIDAR, TABLETOP

LIBRARY = PrimitiveLibrary.shipped()
CONFIGS = {
    "proposal": ProposalConfig(),
    "proposal_lidar": LIDAR_CONFIG,
    "pcrnet": PCRNET_CONFIG,
    "pcrnet_lidar": PCRNET_CONFIG,
}
CONFIGS["gfpnet"] = GFPNET_CONFIG


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_the_shipped_weights_were_trained_with_the_schedule_of_today(name: str) -> None:
    card = json.loads((data_dir("weights") / f"{name}.json").read_text(encoding="utf-8"))
    assert asdict(CONFIGS[name]) == card["config"]


def test_the_proposal_network_learns_from_views_of_many_heights_and_distances() -> None:
    assert asdict(VIEWS) == {
        "elevation_deg": (5.0, 70.0),
        "distance_m": (0.4, 1.0),
        "fallen_share": 0.2,
        "hidden_share": 0.25,
        "width": 320,
        "height": 240,
        "fov_y_deg": 35.0,
        "num_points": 1500,
    }


class _Run:
    """Stands in for the loop, the renderers and the writer of a module, and remembers what they were handed."""

    def __init__(self, module, monkeypatch: pytest.MonkeyPatch) -> None:
        self.trained: list = []
        self.written: list = []
        monkeypatch.setattr(module, "train", self._train)
        monkeypatch.setattr(module, "write_weights", self._write)

    def _train(self, network: nn.Module, batches, loss, **knobs):
        self.trained.append(SimpleNamespace(network=network, batches=batches, loss=loss, **knobs))
        return network, 1.5

    def _write(self, network: nn.Module, path: Path, **card) -> Path:
        self.written.append(SimpleNamespace(network=network, path=path, **card))
        return path.with_suffix(".json")


def test_pcrnet_is_trained_on_two_copies_of_each_view_and_measured_on_one(tmp_path: Path, monkeypatch) -> None:
    run, asked, rows, seen_by = _Run(pcrnet, monkeypatch), [], [], []

    def views(category, split, **knobs):
        asked.append((category, split, knobs))
        return [category, split]

    def samples(found, primitive, rng, *, copies, sensor):
        seen_by.append(sensor)
        rows.append((found, primitive.name, rng.integers(1000), copies))
        return [(np.zeros((5, 3)), np.ones((4, 3)), np.eye(3), np.zeros(3), 0.1)] * 3

    monkeypatch.setattr(pcrnet, "class_views", views)
    monkeypatch.setattr(pcrnet, "_samples", samples)
    monkeypatch.setattr(pcrnet, "_measure", lambda network, data: {"val_samples": len(data[0])})
    config = replace(PCRNET_CONFIG, seed=4, batch=2)
    told = print
    card = train_pcrnet(config=config, num_views=3, limit=5, runs=tmp_path, report=told)  # pyright: ignore[reportArgumentType]
    knobs = {"num_views": 3, "limit": 5, "sensor": TABLETOP, "runs": tmp_path, "data": None}
    names = shipped_families()
    assert asked == [(name, split, knobs) for split in ("train", "val") for name in names]
    assert [(found, name, copies) for found, name, _, copies in rows] == [
        ([name, split], name, copies) for split, copies in (("train", 2), ("val", 1)) for name in names
    ]
    assert rows[0][2] == np.random.default_rng(4).integers(1000)
    assert rows[len(names)][2] == np.random.default_rng(5).integers(1000)
    (made,), (written,) = run.trained, run.written
    assert (made.config, made.report.then) == (config, told)
    assert made.checkpoint.parent == tmp_path / "pcrnet"
    assert made.checkpoint.with_suffix("") == Path(str(made.report.path).removesuffix("_curve.json"))
    assert written.extra == {"learning_curve": []}
    assert {len(part) for part in made.report.held_out} == {3 * len(names)}
    batch = next(made.batches(torch.Generator().manual_seed(0)))
    assert [tuple(part.shape) for part in batch] == [(2, 5, 3), (2, 4, 3), (2, 3, 3), (2, 3), (2,)]
    assert {part.dtype for part in batch} == {torch.float32}
    assert written.path == data_dir("weights") / "pcrnet.safetensors"
    assert card == written.path.with_suffix(".json")
    assert (written.config, written.hours, written.metrics) == (config, 1.5, {"val_samples": 3 * len(names)})
    assert written.data == {
        "classes": names,
        "shapes": "procedural",
        "split": "train",
        "views_a_shape": 3,
        "samples": 3 * len(names),
    }
    torch.manual_seed(4)
    fresh = pcrnet.PCRNet().half().float().state_dict()
    assert all(torch.equal(fresh[key], value) for key, value in written.network.state_dict().items())
    monkeypatch.setattr(pcrnet, "layout_of", lambda data: f"laid out as {data}")
    train_pcrnet(classes=["mug"], out=tmp_path / "net.safetensors", runs=tmp_path, data=Path("meshes"))
    assert run.written[1].path == tmp_path / "net.safetensors"
    assert run.written[1].data["shapes"] == "laid out as meshes"
    assert run.written[1].data["classes"] == ("mug",)
    assert asked[-1][2] == {**knobs, "num_views": 4, "limit": None, "data": Path("meshes")}
    assert set(seen_by) == {TABLETOP}
    train_pcrnet(sensor=LIDAR, runs=tmp_path)
    assert run.written[2].path == data_dir("weights") / "pcrnet_lidar.safetensors"
    assert run.written[2].data["classes"] == TRAFFIC
    assert {(name, knobs["sensor"]) for name, _, knobs in asked[-2 * len(TRAFFIC) :]} == {(n, LIDAR) for n in TRAFFIC}
    assert seen_by[-1] is LIDAR
    assert len({made.checkpoint for made in run.trained}) == 3


def _gfpnet_run(monkeypatch) -> tuple[_Run, list, list]:
    run, asked, loaded = _Run(gfpnet, monkeypatch), [], []

    def labels(category, **knobs):
        asked.append((category, knobs))
        return [], {}

    def load(make, table):
        loaded.append(table)
        make("mug")
        unit = torch.full((6,), 0.02)
        zeros = [torch.zeros(6, 2, 3, 3) for _ in range(gfpnet.Objects._fields.index("primitive"))]
        parts = dict(zip(gfpnet.Objects._fields, [*zeros, torch.zeros(6), unit], strict=True))
        return gfpnet.Objects(**parts), {"mug": {"kept": 6}}

    monkeypatch.setattr(gfpnet, "make_labels", labels)
    monkeypatch.setattr(gfpnet, "load_objects", load)
    monkeypatch.setattr(gfpnet, "_measure", lambda network, held_out, table: {"whole": len(held_out.source)})
    return run, asked, loaded


@pytest.mark.parametrize(("limit", "of_val"), [(None, None), (9, 2), (2, 1)])
def test_gfpnet_is_trained_on_whole_objects_and_measured_on_a_quarter_of_them(monkeypatch, limit, of_val) -> None:
    run, asked, loaded = _gfpnet_run(monkeypatch)
    fit = FitConfig()
    train_gfpnet(classes=["mug"], num_views=3, limit=limit, runs=Path("r"), workers=2, fit=fit)
    knobs = {"library": LIBRARY, "num_views": 3, "runs": Path("r"), "workers": 2, "fit": fit, "data": None}
    assert asked == [
        ("mug", {**knobs, "split": "train", "limit": limit}),
        ("mug", {**knobs, "split": "val", "limit": of_val}),
    ]
    assert [table.categories for table in loaded] == [("mug",)] * 2
    (made,), (written,) = run.trained, run.written
    assert made.config is GFPNET_CONFIG
    key = training_key(made.config, ("mug",), LIBRARY, 3, limit, None, fit, None)
    assert made.checkpoint == Path(f"r/gfpnet/patch_{key}.pt")
    assert made.loss.func is gfpnet.point_loss
    assert written.path == data_dir("weights") / "gfpnet.safetensors"
    assert (written.metrics, written.hours, written.config) == ({"whole": 6}, 1.5, made.config)
    assert written.data == {
        "classes": ("mug",),
        "shapes": "procedural",
        "split": "train",
        "shapes_a_class": limit or "all",
        "views_a_shape": 3,
        "samples": 6,
        "labels": {"mug": {"kept": 6}},
    }


def test_gfpnet_goes_on_from_weights_and_their_card_is_part_of_the_new_one(tmp_path: Path, monkeypatch) -> None:
    run, _, _ = _gfpnet_run(monkeypatch)
    start = tmp_path / "start.safetensors"
    torch.manual_seed(7)
    first = gfpnet.make_network("patch")
    save_file({name: tensor.half() for name, tensor in first.state_dict().items()}, start)
    start.with_suffix(".json").write_text('{"hours": 0.25}')
    train_gfpnet(start=start, out=tmp_path / "net.safetensors")
    train_gfpnet(out=tmp_path / "net.safetensors")
    assert [written.extra for written in run.written] == [{"start": {"hours": 0.25}}, None]
    gone_on, anew = (made.network.state_dict() for made in run.trained)
    stored = first.half().float().state_dict()
    assert all(torch.equal(stored[name], value) for name, value in gone_on.items())
    assert not all(torch.equal(stored[name], value) for name, value in anew.items())
    assert run.trained[0].checkpoint != run.trained[1].checkpoint
    save_file({name: tensor[:1] for name, tensor in first.state_dict().items()}, start)
    with pytest.raises(UnreadableFile, match=r"start\.safetensors holds no weights of a network 'patch'"):
        train_gfpnet(start=start)
    start.with_suffix(".json").write_text('{"hours": 0.')
    save_file({name: tensor.half() for name, tensor in first.state_dict().items()}, start)
    with pytest.raises(UnreadableFile, match=r"start\.json is no readable JSON"):
        train_gfpnet(start=start)
    start.with_suffix(".json").unlink()
    with pytest.raises(UnreadableFile, match=r"start\.safetensors has no card start\.json beside it"):
        train_gfpnet(start=start)


def _example(name: str) -> Example:
    points = np.random.default_rng(0).uniform(0.02, 0.1, (40, 3))
    return Example(points, np.ones(3), name, "", (name,), (name,), "upright", None)


@pytest.fixture
def proposal_run(monkeypatch) -> SimpleNamespace:
    """A run of the proposal network's training on nothing, and what was asked for."""
    run = _Run(proposal, monkeypatch)
    seen = SimpleNamespace(run=run, views=[], others=[], targets=[], calibrated=[], measured=[], posed=[])

    def views(name, split, **knobs):
        seen.views.append((name, split, knobs))
        return [_example(name)]

    def others(first, count, **knobs):
        seen.others.append((first, count, knobs))
        return [_example("assorted-1")] * 2

    def targets(examples, assorted, config, cache):
        seen.targets.append((len(examples), len(assorted), config, cache))
        zeros = np.zeros(4)
        pool, R, box = np.zeros((4, 5, 9), np.float16), np.zeros((4, 3, 3)), np.zeros((4, 2, 3))
        classes, class_of = np.zeros((4, 2), np.float32), torch.tensor([0, 1, 0])
        return Targets(pool, zeros, classes, zeros, class_of, zeros, R, box, zeros, 2, 0.006)

    def measured(*args):
        seen.measured.append(args)
        return {"accuracy": 0.5}

    def posed(*args):
        seen.posed.append(args)
        return {"up_deg": 3.0}

    def calibrated(*args):
        seen.calibrated.append(args)
        return SimpleNamespace(temperature=0.123456789, reach=0.987654321)

    for name, fake in (("class_examples", views), ("assorted_examples", others), ("make_targets", targets),
                       ("calibrate", calibrated), ("measure", measured), ("measure_pose", posed)):  # fmt: skip
        monkeypatch.setattr(proposal, name, fake)
    monkeypatch.setattr(proposal, "_prototypes", lambda network, examples, seed: {"p": (len(examples), seed)})
    return seen


def test_the_proposal_network_is_trained_calibrated_and_measured_on_apart_views(proposal_run, tmp_path: Path) -> None:
    config = ProposalConfig(seed=3, kinds=25, members=4, width=8, channels=8, views=5, limit=10)
    metrics = train_proposal(
        config, out=tmp_path, cache=tmp_path / "c", workers=2, report=print, classes=["mug", "cup"]
    )
    seen, names = proposal_run, ("mug", "cup")
    shared = {"data": None, "sensor": TABLETOP, "workers": 2, "folder": tmp_path / "c", "classes": names}
    assert seen.views == [
        (name, split, {**shared, "num_views": count, "limit": limit})
        for split, count, limit in (("train", 5, 10), ("val", 2, 2), ("test", 4, 2))
        for name in names
    ]
    knobs = {"num_views": 2, "sensor": TABLETOP, "workers": 2, "folder": tmp_path / "c"}
    assert seen.others == [
        (0, 25, {**knobs, "num_members": 4}),
        (1000, 2, {**knobs, "num_members": 2}),
        (2000, 2, {**knobs, "num_members": 2}),
    ]
    assert seen.targets == [(2, 2, config, tmp_path / "c")]
    (made,), (written,) = seen.run.trained, seen.run.written
    assert (made.config, made.report) == (config, print)
    assert made.checkpoint.parent == tmp_path / "c"
    assert made.checkpoint.name.startswith("proposal_")
    assert len(made.checkpoint.stem) == len("proposal_") + 10
    torch.manual_seed(3)
    fresh = proposal._WithProxies(config, torch.tensor([0, 1, 0]))
    assert torch.equal(fresh.proxies, made.network.proxies)
    half = fresh.network.half().float().state_dict()
    assert all(torch.equal(half[key], value) for key, value in written.network.state_dict().items())
    assert metrics == written.metrics == {"temperature": 0.12346, "reach": 0.98765, "accuracy": 0.5, "up_deg": 3.0}
    assert (written.path, written.beside) == (tmp_path / "proposal.safetensors", {})
    assert (written.config, written.hours) == (config, 1.5)
    assert written.data == {
        "classes": ["mug", "cup"],
        "shapes": "procedural",
        "views": 2,
        "kinds_of_other_things": 25,
        "views_of_other_things": 2,
    }
    (calibrated,), (measured,), (posed,) = seen.calibrated, seen.measured, seen.posed
    assert (calibrated[1], len(calibrated[2]), len(calibrated[3])) == ({"p": (2, 3)}, 2, 2)
    assert (measured[1], measured[2].reach, len(measured[3]), len(measured[4])) == ({"p": (2, 3)}, 0.987654321, 2, 2)
    assert (posed[0], posed[1]) == (written.network, measured[3])


def test_the_proposal_network_learns_all_families_unless_told(proposal_run, tmp_path: Path) -> None:
    config = ProposalConfig(kinds=3, width=8, channels=8)
    train_proposal(config, out=tmp_path, data=Path("meshes"), cache=tmp_path)
    asked = proposal_run.views
    assert [name for name, split, _ in asked if split == "val"] == list(FAMILIES)
    assert {(split, knobs["limit"]) for _, split, knobs in asked} == {("train", 240), ("val", 60), ("test", 60)}
    assert asked[0][2]["data"] == Path("meshes")
    assert asked[0][2]["classes"] == FAMILIES
    assert [row[:2] for row in proposal_run.others] == [(0, 3), (1000, 1), (2000, 1)]
    assert proposal_run.run.written[0].data["shapes"] == "a folder"
    for limit, of_test in ((3, 1), (None, None)):
        train_proposal(replace(config, limit=limit), out=tmp_path, cache=tmp_path)
        assert asked[-1][2]["limit"] == of_test
    keys = {made.checkpoint for made in proposal_run.run.trained}
    assert len(keys) == 3


def test_the_network_of_a_lidar_learns_traffic_and_keeps_its_prototypes(
    proposal_run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    own = {"car": SimpleNamespace(vectors=np.eye(3))}
    monkeypatch.setattr(proposal, "_prototypes", lambda network, examples, seed: own)
    train_proposal(replace(LIDAR_CONFIG, kinds=3, width=8, channels=8), out=tmp_path, cache=tmp_path)
    assert [name for name, split, _ in proposal_run.views if split == "val"] == list(TRAFFIC)
    assert {knobs["sensor"] for _, _, knobs in proposal_run.views} == {LIDAR}
    assert {knobs["sensor"] for _, _, knobs in proposal_run.others} == {LIDAR}
    (written,) = proposal_run.run.written
    assert written.path == tmp_path / "proposal_lidar.safetensors"
    assert list(written.beside) == ["prototypes.car"]
    np.testing.assert_array_equal(written.beside["prototypes.car"], np.eye(3))
