"""How known and unknown are learnt apart: the rows, the logistic model of the largest likelihood, the card."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gfp_grasp.errors import FitDiverged, InvalidOption, NoSurface
from gfp_grasp.openset import LogisticModel
from gfp_grasp.train import SIGHTS, OpenSetConfig, OpenSetRow, Thing, train_openset
from gfp_grasp.train import openset as room
from gfp_grasp.train.openset import fit_logistic, fit_models, rows_of_thing


def row(sort: str, cd_m: float | None = 0.004, **more: Any) -> OpenSetRow:
    values: dict[str, Any] = {
        "kind": "mug",
        "number": 3,
        "sight": "plain",
        "cut_off": False,
        "look": (1.0, 2.0),
        "hull_cd_m": 0.01,
    }
    fit = (
        {"fit": (0.5, 0.5, -4.0, 0.0, 0.0), "misfit": (0.01, 0.0, 0.0, 0.2), "named": "mug"} if cd_m is not None else {}
    )
    return OpenSetRow(sort=sort, cd_m=cd_m, **{**values, **fit, **more})


@pytest.mark.parametrize(("cd_m", "lost"), [(0.006, False), (0.0061, True), (None, True)])
def test_a_completion_is_lost_beyond_six_tenths_of_the_hull(cd_m: float | None, lost: bool) -> None:
    assert row("left_out", cd_m).lost is lost
    assert ("cd_m" in row("left_out", cd_m).to_json()) is (cd_m is not None)


def test_two_bells_are_told_apart_by_the_line_between_them_whatever_their_numbers() -> None:
    rng = np.random.default_rng(0)
    known, unknown = rng.normal((-1.0, 3.0), 1.0, (8000, 2)), rng.normal((1.0, 3.0), 1.0, (2000, 2))
    model = fit_logistic(np.concatenate([known, unknown]), np.arange(10_000) >= 8000)
    assert model.weights[0] == pytest.approx(2.0, abs=0.12)
    assert model.weights[1] == pytest.approx(0.0, abs=0.08)
    assert model.bias == pytest.approx(-3 * model.weights[1], abs=0.08)  # where the first is zero both are as likely


def test_models_learn_from_lost_things_of_no_class_and_from_good_answers_to_the_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[np.ndarray, np.ndarray]] = []
    monkeypatch.setattr(room, "fit_logistic", lambda *told: asked.append(told) or LogisticModel((1.0,), 0.0))
    rows = [
        row("known", look=(1.0, 0.0)),
        row("known", 0.009, look=(2.0, 0.0)),  # its own class fits it badly: it teaches nothing
        row("left_out", 0.005, look=(3.0, 0.0)),  # another class serves it well: neither does it
        row("left_out", 0.009, look=(4.0, 0.0)),
        row("mixture", 0.02, look=(5.0, 0.0)),
        row("mixture", None, look=(6.0, 0.0)),  # nothing fits it: nobody will have to decide
    ]
    assert list(fit_models(rows)) == ["look", "both"]
    (look, unknown), (both, again) = asked
    np.testing.assert_array_equal(look[:, 0], [1.0, 4.0, 5.0])
    np.testing.assert_array_equal(unknown, [False, True, True])
    np.testing.assert_array_equal(both, np.column_stack([look, np.tile((0.5, 0.5, -4.0, 0.0, 0.0), (3, 1))]))
    np.testing.assert_array_equal(again, unknown)


def no_surface(view: Any) -> Any:
    raise NoSurface("nothing")


def test_a_thing_of_a_class_is_seen_with_its_class_and_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    libraries = []
    whole = room.by_class

    def by_class(view: Any, detection: Any, config: Any, clock: Any) -> Any:
        libraries.append(config.library)
        assert set(detection.scores) == set(config.library.categories)
        if len(libraries) == 2:
            raise FitDiverged("nothing fits")
        return whole(view, detection, config, clock)

    monkeypatch.setattr(room, "by_class", by_class)
    seen = room.seen_things
    monkeypatch.setattr(room, "complete_level", no_surface)
    monkeypatch.setattr(room, "seen_things", lambda thing, num, sight: seen(thing, num, room.PLAIN))
    found = rows_of_thing(Thing("mug", 6, "val"))
    assert [(r.sort, r.sight) for r in found] == [(sort, name) for name in SIGHTS for sort in ("known", "left_out")]
    assert ["mug" in library for library in libraries] == [True, False] * 3
    first, second, third, *_ = found
    assert first.named is not None
    assert first.named.startswith("mug")
    assert (second.named, second.cd_m, second.lost) == (None, None, True)
    assert first.cd_m == third.cd_m  # the same view, in this test
    assert first.cd_m is not None
    assert 0.0015 < first.cd_m < 0.5 * first.hull_cd_m
    assert first.classfree_cd_m is None
    assert first.look[0] < second.look[0]
    assert not any(each.cut_off for each in found)  # as all of them are seen plainly here


def test_mixtures_are_of_no_class_of_the_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "complete_level", no_surface)
    (found, *_) = rows_of_thing(Thing("toy-like", 2, "val"))
    assert found.sort == "mixture"


def test_the_card_says_what_was_learnt_from_what(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [row("known"), row("known", look=(1.2, 2.2)), row("left_out", 0.009, look=(3.0, 4.0)), row("mixture", 0.02)]
    asked = []
    monkeypatch.setattr(room, "openset_rows", lambda *told, **named: asked.append((told, named)) or rows)
    path = train_openset(config=OpenSetConfig(2, 5), out=tmp_path / "card.json", workers=3)
    assert asked == [(("val", OpenSetConfig(2, 5)), {"workers": 3, "progress": None})]
    card = json.loads(path.read_text())
    assert card["config"] == {"members": 2, "mixtures": 5}
    assert card["data"] == {
        "split": "val",
        "views": {"known": 2, "left_out": 1, "mixture": 1},
        "lost": {"left_out": 1, "mixture": 1},
    }
    assert [len(card["models"][name]["weights"]) for name in ("look", "both")] == [2, 7]


@pytest.mark.parametrize("config", [{"members": 0}, {"mixtures": 0}])
def test_at_least_one_of_everything_is_looked_at(config: dict[str, int]) -> None:
    with pytest.raises(InvalidOption, match="at least 1"):
        OpenSetConfig(**config)
