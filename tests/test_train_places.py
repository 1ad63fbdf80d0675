"""Every training says that it cannot write where it is to write before it does anything."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gfp_grasp import train
from gfp_grasp.errors import CannotWrite
from gfp_grasp.peers import weights_stem
from gfp_grasp.train import classfree, gfpnet, instances, openset, paper, pcrnet, peers, pointrcnn, proposal
from gfp_grasp.train.loop import weights_place


def _proposal(*, out: Path, runs: Path) -> None:
    train.train_proposal(out=out.parent, cache=runs)


# What each training draws from first, and how it is called.
TRAININGS: dict[str, tuple[Any, str, Callable[..., Any]]] = {
    "classfree": (classfree, "draw_things", train.train_classfree),
    "gfpnet": (gfpnet, "load_objects", train.train_gfpnet),
    "instances": (instances, "pmap", train.train_instances),
    "paper": (paper, "paper_patches", lambda **places: train.train_paper("paper-oneshot", **places)),
    "pcrnet": (pcrnet, "class_views", train.train_pcrnet),
    "peer": (peers, "peer_views", lambda **places: train.train_peer("pcn", **places)),
    "pointrcnn": (pointrcnn, "pmap", train.train_pointrcnn),
    "proposal": (proposal, "class_examples", _proposal),
}


@pytest.mark.parametrize("name", TRAININGS)
@pytest.mark.parametrize("wrong", ["out", "runs"])
def test_a_training_refuses_a_place_before_it_draws(
    name: str, wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, first, start = TRAININGS[name]

    def drawn(*_: object, **__: object) -> None:
        raise AssertionError("drawn")

    monkeypatch.setattr(module, first, drawn)
    (tmp_path / "file").touch()
    places = {"out": tmp_path / "new" / "own.safetensors", "runs": tmp_path / "runs"}
    with pytest.raises(AssertionError, match="drawn"):
        start(**places)
    places[wrong] = tmp_path / "file" / "own.safetensors"
    with pytest.raises(CannotWrite, match=r"file/\S+ cannot be written \(Not a directory\)"):
        start(**places)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_card_of_known_and_unknown_has_a_place_before_anything_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openset, "openset_rows", None)
    with pytest.raises(CannotWrite, match="Is a directory"):
        train.train_openset(out=tmp_path)


def test_a_folder_in_the_place_of_weights_or_card_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "own.safetensors"
    assert weights_place(out, "pcn", runs=tmp_path) == out
    out.with_suffix(".json").mkdir()
    with pytest.raises(CannotWrite, match=r"own\.json cannot be written \(Is a directory\)"):
        weights_place(out, "pcn", runs=tmp_path)


def test_without_a_name_the_place_is_that_of_the_shipped_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gfp_grasp.train.loop.data_dir", lambda name: tmp_path / name)
    place = weights_place(None, weights_stem("3d-sc", true_box=True), runs=tmp_path)
    assert place == tmp_path / "weights" / "peer_3d_sc_true_box.safetensors"
