"""The comparison with other networks: on blocks whose truth is known, and with parts that tell what they were asked."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from peer_bench import Parts, Shipped, few_methods, methods_that_are_asked, score_row, write_block, write_blocks

from gfp_grasp.bench import CompletionConfig, PeersConfig, bench_completion, bench_peers, peer_groups, peers
from gfp_grasp.bench.peer_trials import packed, unpacked
from gfp_grasp.errors import InvalidOption, NoSurface
from gfp_grasp.peers import PEERS, TRUE_BOX
from gfp_grasp.shapes import HOUSEHOLD, IN_PAPER, TRAFFIC
from gfp_grasp.types import CompletedShape, Detection, OrientedBox


@pytest.fixture
def blocks(tmp_path: Path) -> Path:
    return write_blocks(tmp_path / "blocks")


@pytest.fixture
def weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Shipped:
    return Shipped(monkeypatch, tmp_path / "shipped")


@pytest.fixture
def known_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A peer that is told the true box says that box; around what was seen it says a cube that is far away."""

    def complete(detection: Detection, name: str, *, box: OrientedBox | None = None) -> CompletedShape:
        mesh = trimesh.creation.box(np.full(3, 0.05) if box is None else box.extents)
        if box is None and name != "pcn":
            raise NoSurface("nothing solid")
        mesh.apply_transform(trimesh.transformations.translation_matrix((9, 0, 0)) if box is None else box.T_world_box)
        count = len(mesh.vertices)
        return CompletedShape(mesh, np.zeros(count, dtype=bool), np.full(count, 0.01))

    monkeypatch.setattr("gfp_grasp.peers.complete_by_peer", complete, raising=False)


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    return Parts(monkeypatch)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    few_methods(monkeypatch)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int, str]]:
    return methods_that_are_asked(monkeypatch)


def test_a_peer_whose_answer_is_the_truth_is_nearest_and_one_that_is_far_away_loses(
    blocks: Path, weights: Callable, known_answers: None, parts: Parts, few: None
) -> None:
    weights("pcn", "pcn_true_box", "scrg")
    report = bench_peers(config=PeersConfig(("pcn", "scrg"), data=blocks, with_score=False))
    assert list(report["groups"]) == ["cup", "household", "unknown"]
    for group, figures in report["groups"].items():
        told = ("told-pcrnet",) if group != "unknown" else ()
        assert tuple(figures) == ("partial", *told, "pcn", "pcn-true-box", "scrg", "gfpnet")
        truth, ours = figures["pcn-true-box"], figures["gfpnet"]
        assert truth["cd_m"] < 0.003  # what two samplings of one surface are apart
        assert truth["f_score"] > 0.99
        assert truth["cd_m"] < figures["partial"]["cd_m"]
        assert figures["pcn"]["cd_m"] == pytest.approx(18, abs=0.3)
        assert (figures["pcn"]["f_score"], figures["pcn"]["failed"]) == (0.0, 0)
        assert (figures["scrg"]["cd_m"], figures["scrg"]["failed"]) == (None, figures["scrg"]["views"])
        paired = report["paired"][group]
        assert set(paired) == set(figures) - {"gfpnet"}
        assert paired["pcn"]["gain_m"] == pytest.approx(figures["pcn"]["cd_m"] - ours["cd_m"], abs=1e-4)
        assert paired["pcn"]["wins"] == 1.0
        assert paired["pcn"]["ci95_m"][0] > 17
        assert paired["pcn-true-box"]["gain_m"] <= 0
        assert paired["scrg"] == {"pairs": 0}
    assert report["groups"]["household"]["partial"]["views"] == 2
    assert list(report["occlusion"]) == ["0.6"]
    assert report["occlusion"]["0.6"]["partial"]["cd_m"] > report["groups"]["cup"]["partial"]["cd_m"]
    assert [one["method"] for one in report["left_out"]] == ["scrg-true-box"]
    assert "gfp-grasp train peer scrg --true-box" in report["left_out"][0]["why"]


def test_groups_of_the_test_split_are_seen_as_the_paper_s_table_and_vehicles_by_a_lidar(
    weights: Callable, parts: Parts, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def bench(sources, *, methods, config, known, workers, progress):
        asked.append((progress, {s.family for s in sources}, len(sources), config, methods))
        figures = dict.fromkeys(peers._FIGURES, 0) | {"views": 1}
        return {"settings": {}, "rows": {"all": dict.fromkeys(methods, figures)}, "trials": []}

    monkeypatch.setattr(peers, "bench_completion", bench)
    config = PeersConfig(views=2, seed=3, limit=40, with_score=False)
    report = bench_peers(config=config, progress=lambda part: part)  # type: ignore[arg-type, return-value]
    shares = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9)
    hidden = [f"hidden {share}" for share in shares]
    assert [name for name, *_ in asked] == [*IN_PAPER, "household", "unknown", *hidden]
    for name, families, count, config, methods in asked:
        assert count == 40
        assert (config.views, config.seed, config.split) == (2, 3, "test")
        assert methods == (*peers.BEFORE, *peers.AFTER)
        if name in IN_PAPER:
            assert families == {name}
            assert config.protocol == ("lidar" if name in TRAFFIC else "standard")
    assert asked[4][1] == set(HOUSEHOLD)
    assert not asked[5][1] & set(HOUSEHOLD)
    assert [config.hidden_share for *_, config, _ in asked[6:]] == list(shares)
    assert all(families == {"cup", "bottle"} and c.protocol == "hidden" for _, families, _, c, _ in asked[6:])
    assert [one["method"] for one in report["left_out"]] == [f"{name}{way}" for name in PEERS for way in ("", TRUE_BOX)]
    assert list(report["occlusion"]) == [str(share) for share in shares]
    assert (report["score"], report["kitti"]) == ({}, {})


def test_the_share_that_is_asked_for_is_hidden(blocks: Path, weights: Callable, parts: Parts, asked: list) -> None:
    bench_peers(config=PeersConfig(data=blocks, with_score=False))
    seen = [points for given, points, method in asked if given == "cup" and method == "partial"]
    cup, household, *hidden = seen  # the same view in each
    assert cup == household == hidden[0]
    assert [points / cup for points in hidden] == pytest.approx([1 - share for share in peer_groups.HIDDEN], abs=0.01)


def test_grasps_of_peers_stand_between_the_brackets_with_paired_tests(
    blocks: Path, weights: Callable, parts: Parts, asked: list, few: None
) -> None:
    weights("pcn")
    report = bench_peers(config=PeersConfig(("pcn",), 2, 7, 5, data=blocks))
    config = parts.score["config"]
    assert (config.views, config.limit, config.seed, config.classes) == (2, 7, 5, HOUSEHOLD)
    assert parts.score["objects"] == str(blocks)
    figures = report["score"]["completers"]
    assert (figures["pcn"]["successes"], figures["oracle"]["successes"]) == (0, 1)
    pair = report["score"]["paired"]["pcn"]["oracle"]
    assert (pair["pairs"], pair["only_other"], pair["margin"]) == (1, 1, -1.5)
    assert set(report["score"]["paired"]["pcn"]) == {"observed", "classfree", "gfpnet", "oracle"}
    trials = [trial for trial in report["trials"] if trial["group"] == "score"]
    assert trials[0] == {"group": "score", **asdict(score_row("observed"))}
    assert report["settings"]["score"]["objects"] == "blocks"


def test_kitti_s_rows_are_figures_alone(blocks: Path, weights: Callable, parts: Parts, asked: list, few: None) -> None:
    weights("topnet_true_box")
    report = bench_peers(config=PeersConfig(("topnet",), data=blocks, kitti=blocks, with_score=False))
    rows = ("partial", "whole-in-box", *peers.PAPER, "topnet-true-box", "registration", "gfpnet")
    assert parts.methods["kitti"] == [rows]
    assert report["kitti"] == {row: {"things": 2, "mmd_m": 0.1} for row in rows}
    assert report["settings"]["kitti"]["tree"] == "blocks"


def test_a_folder_of_vehicles_alone_has_no_grasps_and_nothing_behind_a_board(
    weights: Callable, parts: Parts, asked: list, tmp_path: Path
) -> None:
    trimesh.creation.box((4.0, 1.8, 1.5)).export(tmp_path / "car__a.ply")
    report = bench_peers(config=PeersConfig(data=tmp_path))
    assert list(report["groups"]) == ["car"]
    assert report["occlusion"] == report["score"] == {}
    assert report["groups"]["car"]["gfpnet"]["views"] == 1


def test_records_give_back_the_rows_that_they_were_packed_from() -> None:
    rows = [
        {"object": name, "category": "cup", "view": view, "method": method, "ms": 1.5, "cd_m": 0.1, "f_score": 0.5}
        for name in "ab"
        for view in (0, 1)
        for method in ("one", "two")
    ]
    rows[3] |= {"cd_m": None, "f_score": 0.0, "error": "NoSurface"}
    records = packed("cup", rows, ("one", "two"))
    assert [record["method"] for record in records] == ["one", "two"]
    assert "error" not in records[0]
    back = list(
        unpacked(json.loads(json.dumps(records)), {"objects": ["a", "b"], "views": 2}, {"a": "cup", "b": "cup"})
    )
    by_method = sorted(rows, key=lambda row: row["method"])
    assert back == [{"error": None, **row} for row in by_method]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"peers": ("magic",)}, "no peer 'magic'"),
        ({"peers": ("pcn", "pcn")}, "each but once"),
        ({"peers": ()}, "some of pcn"),
        ({"limit": 0}, "limit 0"),
        ({"views": 0}, "views is 0"),
        ({"data": Path("nowhere")}, "nowhere is no folder"),
        ({"kitti": Path("nowhere")}, "nowhere is no folder"),
    ],
)
def test_nonsense_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidOption, match=message):
        PeersConfig(**wrong)


def test_a_folder_without_these_classes_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    write_block(other / "whistle__a.ply", 0.1, 0.1, 0.1)
    with pytest.raises(InvalidOption, match=r"no object of .*other is of a class that is compared"):
        bench_peers(config=PeersConfig(data=other))


@pytest.mark.parametrize(("protocol", "share"), [("hidden", 1.0), ("hidden", -0.1), ("standard", 0.3)])
def test_a_share_that_cannot_be_hidden_is_refused(protocol: str, share: float) -> None:
    with pytest.raises(InvalidOption, match="hidden_share is"):
        CompletionConfig(protocol=protocol, hidden_share=share)


def test_things_of_no_class_are_completed_by_all_that_are_not_told_one(blocks: Path, asked: list) -> None:
    report = bench_completion(str(blocks), methods=("partial", "told-pcrnet"), config=CompletionConfig(1))
    assert report["rows"]["unknown"]["partial"]["views"] == 1
    assert report["rows"]["unknown"]["told-pcrnet"]["views"] == 0
    assert report["rows"]["all"]["partial"]["views"] == 3
    assert ("", "told-pcrnet") not in {(given, method) for given, _, method in asked}
    told = bench_completion("unknown", methods=("partial",), config=CompletionConfig(1, limit=2, give_category=True))
    assert told["rows"]["all"]["partial"]["views"] == 2


def test_a_share_other_than_half_is_named_in_the_settings(blocks: Path, asked: list) -> None:
    for share, named in ((0.5, False), (0.3, True)):
        config = CompletionConfig(1, protocol="hidden", hidden_share=share)
        settings = bench_completion(str(blocks), methods=("partial",), config=config)["settings"]
        assert ("hidden_share" in settings) is named
