"""What an earlier report of the comparison with other networks still holds, and what is made again."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from peer_bench import Parts, Shipped, few_methods, methods_that_are_asked, write_block, write_blocks
from test_bench_committed import json_of

from gfp_grasp.bench import (
    CompletionConfig,
    KittiConfig,
    PeersConfig,
    bench_completion,
    bench_kitti,
    bench_peers,
    peers,
)
from gfp_grasp.errors import InvalidOption, UnreadableFile

PLAIN = ("partial", "told-pcrnet", "gfpnet")


@pytest.fixture
def blocks(tmp_path: Path) -> Path:
    return write_blocks(tmp_path / "blocks")


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Shipped:
    return Shipped(monkeypatch, tmp_path / "shipped")


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    return Parts(monkeypatch)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    few_methods(monkeypatch)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int, str]]:
    return methods_that_are_asked(monkeypatch)


def test_what_is_known_is_kept_and_a_peer_that_was_trained_since_is_added(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None
) -> None:
    config = PeersConfig(("pcn",), data=blocks, kitti=blocks)
    shipped("pcn")
    first = bench_peers(config=config)
    assert {method for *_, method in asked} == {"partial", "told-pcrnet", "pcn", "gfpnet"}
    assert parts.methods["score"] == [(name,) for name in ("observed", "pcn", "classfree", "gfpnet", "oracle")]
    asked.clear()
    again = bench_peers(config=config, known=json_of(first))
    assert not asked
    assert json_of(again) == json_of(first)
    shipped("pcn_true_box")
    more = bench_peers(config=config, known=json_of(first))
    assert {method for *_, method in asked} == {"pcn-true-box"}
    assert [calls[-1] for calls in parts.methods.values()] == [("pcn-true-box",)] * 3
    assert list(more["score"]["completers"]) == ["observed", "pcn", "pcn-true-box", "classfree", "gfpnet", "oracle"]
    assert more["left_out"] == []
    shipped("pcn", content="trained anew")
    asked.clear()
    anew = bench_peers(config=replace(config, peers=("pcn",)), known=json_of(more))
    assert {method for *_, method in asked} == {"pcn"}
    assert [calls[-1] for calls in parts.methods.values()] == [("pcn",)] * 3
    assert [len(calls) for calls in parts.methods.values()] == [3, 7, 3]
    assert anew["cost"]["pcn"]["made_in"] == 3
    assert anew["cost"]["gfpnet"]["made_in"] == 1
    assert set(anew["groups"]["cup"]) == set(more["groups"]["cup"])
    asked.clear()
    bench_peers(config=replace(config, seed=1), known=json_of(anew))
    assert {method for *_, method in asked} == {"partial", "told-pcrnet", "pcn", "pcn-true-box", "gfpnet"}


def test_a_run_that_was_stopped_goes_on_and_loses_nothing_of_what_was_there_before(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None
) -> None:
    saved: list[dict] = []

    def stop(report: dict) -> None:
        saved.append(json_of(report))
        if len(saved) == 2:
            raise KeyboardInterrupt

    config = PeersConfig(("pcn",), data=blocks)
    with pytest.raises(KeyboardInterrupt):
        bench_peers(config=config, save=stop)
    assert list(saved[-1]["groups"]) == ["cup", "household"]
    asked.clear()
    whole = bench_peers(config=config, known=saved[-1])
    assert {given for given, *_ in asked} == {"", "cup"}  # things of no class, and what is hidden
    shipped("pcn")
    saved.clear()
    with pytest.raises(KeyboardInterrupt):
        bench_peers(config=config, known=json_of(whole), save=stop)
    assert set(saved[-1]["groups"]["household"]) == {*PLAIN, "pcn"}
    assert set(saved[-1]["groups"]["unknown"]) == {"partial", "gfpnet"}
    assert saved[-1]["score"] == json_of(whole)["score"]
    asked.clear()
    bench_peers(config=config, known=saved[-1])
    assert {method for *_, method in asked} == {"pcn"}
    assert {given for given, *_ in asked} == {"", "cup"}


@pytest.mark.parametrize(
    ("file", "completed", "grasped", "driven"),
    [
        ("weights/classfree.safetensors", {"gfpnet"}, {"classfree", "gfpnet"}, {"registration", "gfpnet"}),
        ("weights/gfpnet.json", {"gfpnet"}, {"gfpnet"}, {"gfpnet"}),
        ("weights/gfpnet_paper.safetensors", set(), set(), {"told-pcrnet-gfpnet-paper"}),
        ("weights/pcrnet_lidar.safetensors", {"told-pcrnet"}, set(), set(peers.PAPER)),
        ("weights/openset.json", {"told-pcrnet", "gfpnet"}, {"gfpnet"}, {*peers.PAPER, "registration", "gfpnet"}),
        ("gps/cup.ply", {"told-pcrnet", "gfpnet"}, {"gfpnet"}, {*peers.PAPER, "registration", "gfpnet"}),
        ("weights/instances.safetensors", set(), set(), set()),
    ],
)
def test_what_reads_a_file_that_is_another_now_is_made_again(
    file: str, completed: set[str], grasped: set[str], driven: set[str],
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None,
) -> None:  # fmt: skip
    shipped("pcn")
    shipped.write(file, "first")
    config = PeersConfig(("pcn",), data=blocks, kitti=blocks)
    first = bench_peers(config=config)
    for calls in (asked, *parts.methods.values()):
        calls.clear()
    shipped.write(file, "other")
    bench_peers(config=config, known=json_of(first))
    assert {method for *_, method in asked} == completed
    assert {name for (name,) in parts.methods["score"]} == grasped
    assert {row for rows in parts.methods["kitti"] for row in rows} == driven
    assert {name for names in parts.methods["cost"] for name in names} == completed


def test_rows_of_a_mesh_that_is_another_now_are_made_again(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None, tmp_path: Path
) -> None:
    """The other folder has the same names, its own too; only the cup in it is another."""
    other = write_blocks(tmp_path / "elsewhere" / "blocks")
    first = bench_peers(config=PeersConfig(data=blocks))
    for calls in (asked, *parts.methods.values()):
        calls.clear()
    same = bench_peers(config=PeersConfig(data=other), known=json_of(first))
    assert not asked
    assert not parts.methods["score"]
    write_block(other / "cup__a.ply", 0.06, 0.05, 0.09)
    bench_peers(config=PeersConfig(data=other), known=json_of(same))
    assert {given for given, *_ in asked} == {"cup", "box"}  # of one group with the cup; not what is of no class
    assert {name for (name,) in parts.methods["score"]} == {"observed", "classfree", "gfpnet", "oracle"}
    assert not parts.methods["kitti"]


@pytest.mark.parametrize(("name", "again"), [("0.bin", True), ("0.txt", True), ("1.npz", True), ("0.png", False)])
def test_scans_that_are_others_now_are_completed_again(
    name: str, again: bool, blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None, tmp_path: Path
) -> None:
    tree = tmp_path / "tree" / "velodyne"
    tree.mkdir(parents=True)
    (tree / "0.bin").write_bytes(b"first")
    config = PeersConfig(data=blocks, kitti=tree.parent, with_score=False)
    first = bench_peers(config=config)
    (tree / name).write_bytes(b"other")
    bench_peers(config=config, known=json_of(first))
    assert parts.methods["kitti"] == [("partial", "whole-in-box", *peers.PAPER, "registration", "gfpnet")] * (1 + again)


def test_parts_that_are_not_asked_for_stay_as_they_are(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None
) -> None:
    shipped("pcn")
    shipped.write("weights/gfpnet.json", "first")
    first = json_of(bench_peers(config=PeersConfig(("pcn",), data=blocks, kitti=blocks)))
    saved: list[dict] = []
    neither = PeersConfig(("pcn",), data=blocks, with_score=False)
    again = json_of(bench_peers(config=neither, known=first, save=lambda so_far: saved.append(json_of(so_far))))
    assert again == first
    assert all(report == first for report in saved)
    # Of other settings than the rest, they still say their own.
    moved = json_of(bench_peers(config=replace(neither, seed=1), known=first))
    assert moved["settings"]["score"]["seed"] == 0
    assert [moved[part] for part in ("score", "kitti")] == [first[part] for part in ("score", "kitti")]
    # What a method answered goes with the weights that it had, and so does what it was compared in.
    shipped.write("weights/gfpnet.json", "other")
    changed = bench_peers(config=neither, known=first)
    assert set(first["kitti"]) - set(changed["kitti"]) == {"gfpnet"}
    assert list(changed["score"]["completers"]) == ["observed", "pcn", "classfree", "oracle"]
    assert changed["settings"]["score"]["completers"] == ["observed", "pcn", "classfree", "oracle"]
    assert set(changed["score"]["paired"]["pcn"]) == {"observed", "classfree", "oracle"}
    rows = [trial["completer"] for trial in changed["trials"] if trial["group"] == "score"]
    assert rows == ["observed", "pcn", "classfree", "oracle"]
    parts.methods["score"].clear()
    whole = json_of(bench_peers(config=PeersConfig(("pcn",), data=blocks, kitti=blocks), known=json_of(changed)))
    assert parts.methods["score"] == [("gfpnet",)]
    assert whole["score"] == first["score"]


def test_gains_over_weights_of_yesterday_are_gone_before_they_are_measured_anew(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None
) -> None:
    shipped.write("weights/gfpnet.json", "first")
    config = PeersConfig(data=blocks, with_score=False)
    first = json_of(bench_peers(config=config))
    shipped.write("weights/gfpnet.json", "other")
    saved: list[dict] = []
    bench_peers(config=config, known=first, save=lambda so_far: saved.append(json_of(so_far)))
    assert list(saved[0]["paired"]) == ["cup"]
    assert set(saved[0]["groups"]["unknown"]) == {"partial"}
    assert list(saved[-1]["paired"]) == list(first["paired"])


def test_a_score_that_was_stopped_goes_on_with_the_trials_of_the_same_weights_only(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None, tmp_path: Path
) -> None:
    """Stopped at the class-free completion; then a peer is trained, another trained anew."""
    shipped("pcn", "scrg")
    config, saved = PeersConfig(("pcn", "scrg"), data=blocks), []
    parts.stop_at = "classfree"

    def run(**more: Any) -> dict[str, Path | None]:
        with pytest.raises(KeyboardInterrupt):
            bench_peers(config=config, save=lambda so_far: saved.append(json_of(so_far)), journals=tmp_path, **more)
        return dict(parts.journals)

    before = run()
    assert list(before) == ["observed", "pcn", "scrg", "classfree"]
    assert len(set(before.values())) == 4
    assert all(path is not None and path.parent == tmp_path and path.suffix == ".jsonl" for path in before.values())
    assert run(known=saved[-1]) == before
    shipped("pcn", content="trained anew")
    shipped("pcn_true_box")
    after = run(known=saved[-1])
    assert {name for name in after if after[name] != before.get(name)} == {"pcn", "pcn-true-box"}
    write_block(blocks / "cup__a.ply", 0.06, 0.05, 0.09)
    assert not set(run(known=saved[-1]).values()) & set(after.values())
    parts.stop_at = ""
    whole = bench_peers(config=config, known=saved[-1], journals=tmp_path)
    peers_of_both = ["pcn", "pcn-true-box", "scrg"]
    assert list(whole["score"]["completers"]) == ["observed", *peers_of_both, "classfree", "gfpnet", "oracle"]


def test_weights_that_are_none_are_told_before_anything_is_measured(
    blocks: Path, shipped: Shipped, asked: list, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gfp_grasp.peers.weights import load_network

    load_network.cache_clear()
    monkeypatch.setattr("gfp_grasp.peers.load_network", load_network)
    monkeypatch.setattr("gfp_grasp.peers.weights.data_file", lambda name, file: shipped.folder / name / file)
    shipped("topnet_true_box", content="no tensors")
    runs: list[Callable[[], object]] = [
        lambda: bench_peers(config=PeersConfig(("topnet",), data=blocks)),
        lambda: bench_completion(str(blocks), methods=("topnet-true-box",), config=CompletionConfig(1)),
        lambda: bench_kitti(blocks, config=KittiConfig(("topnet-true-box",))),
    ]
    for run in runs:
        with pytest.raises(UnreadableFile, match=r"peer_topnet_true_box\.safetensors holds no weights of a network"):
            run()
    assert not asked


def test_what_is_no_report_of_this_bench_is_refused(
    blocks: Path, shipped: Shipped, parts: Parts, asked: list, few: None
) -> None:
    config = PeersConfig(data=blocks, with_score=False)
    report = json_of(bench_peers(config=config))
    others: list[Any] = [{}, [report], {**report, "settings": []}, {**report, "settings": {"seed": 0}}]
    for lacks in ("cost", "score", "settings", "trials"):
        others.append({name: part for name, part in report.items() if name != lacks})
    asked.clear()
    for other in others:
        with pytest.raises(InvalidOption, match="was not written by this bench: name a file of its own"):
            bench_peers(config=config, known=other)
    assert not asked
