"""Learning curves on disk: points that a killed run left, and cards that keep them."""

import json
from pathlib import Path

import pytest
import torch
from torch import nn

from gfp_grasp.errors import CannotWrite, UnreadableFile
from gfp_grasp.train import curves_of_cards
from gfp_grasp.train.curves import LearningCurve, some_of


def curve(path: Path) -> LearningCurve:
    """A curve whose validation loss is 6: three times the batch's mean of 2."""
    network = nn.Linear(1, 1, bias=False)
    nn.init.constant_(network.weight, 3.0)
    held_out = (torch.tensor([[1.0], [3.0]]),)
    return LearningCurve(network, lambda net, batch: net(batch[0]).mean(), held_out, False, path)


def test_a_curve_goes_on_where_it_was_and_drops_what_is_done_again(tmp_path: Path) -> None:
    path = tmp_path / "new" / "curve.json"
    for step in (10, 20):
        curve(path)(step, 0.5)
    again = curve(path)
    assert again.points == [(10, 0.5, 6.0), (20, 0.5, 6.0)]
    again(20, 0.25)
    assert json.loads(path.read_text()) == [[10, 0.5, 6.0], [20, 0.25, 6.0]]


@pytest.mark.parametrize("left", ["", "[[10, 0.5, 6.0], [20, 0.", "[[10, 0.5]]", '{"a": 1}', "7", "\xff"])
def test_a_curve_that_cannot_be_read_is_begun_anew(left: str, tmp_path: Path) -> None:
    path = tmp_path / "curve.json"
    path.write_text(left, encoding="latin-1")
    found = curve(path)
    assert found.points == []
    found(30, 0.125)
    assert json.loads(path.read_text()) == [[30, 0.125, 6.0]]


def test_a_curve_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = curve(tmp_path / "curve.json")
    found(10, 0.5)

    def stop(self: Path, target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", stop)
    with pytest.raises(CannotWrite, match=r"curve\.json cannot be written"):
        found(20, 0.25)
    assert curve(tmp_path / "curve.json").points == [(10, 0.5, 6.0)]


def test_curves_of_cards_are_told_by_file_and_part(tmp_path: Path) -> None:
    (tmp_path / "plain.json").write_text('{"hours": 1}')
    card = {"learning_curve": [[2, 0.5, 0.75]], "learning_curve_of_prior": [[1, 1.5, 1.25]], "hours": 2}
    (tmp_path / "peer.json").write_text(json.dumps(card))
    assert curves_of_cards(tmp_path) == {"peer": [(2, 0.5, 0.75)], "peer of prior": [(1, 1.5, 1.25)]}
    (tmp_path / "peer.json").unlink()
    with pytest.raises(UnreadableFile, match=r"no card in .* has a learning curve"):
        curves_of_cards(tmp_path)


@pytest.mark.parametrize(("content", "message"), [('{"hours', "no readable JSON"), ("[1]", "holds a list")])
def test_a_card_that_is_none_is_named(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "own.json").write_text(content)
    with pytest.raises(UnreadableFile, match=rf"own\.json {message}|own\.json is {message}"):
        curves_of_cards(tmp_path)


def test_a_curve_is_measured_on_samples_from_all_of_a_batch() -> None:
    batch = (torch.arange(10), torch.arange(10.0) / 4)
    index, quarter = some_of(batch, 4)
    assert index.tolist() == [0, 3, 6, 9]
    assert quarter.tolist() == [0.0, 0.75, 1.5, 2.25]
    assert some_of(batch, 50)[0].tolist() == list(range(10))
