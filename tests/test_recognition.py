"""Which classes a detection may be of, how sure that is, and which primitives are fitted to it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from recorded_calls import recorded
from toy_completions import toy_completion

from gfp_grasp import recognition
from gfp_grasp.errors import FitDiverged
from gfp_grasp.recognition import (
    SURE_SCORE,
    candidate_primitives,
    fit_likeliest,
    likeliest,
    recognise,
    sureness,
)
from gfp_grasp.register import FitConfig
from gfp_grasp.types import LIDAR, TABLETOP, OrientedBox, Proposal

PROPOSAL = Proposal(
    OrientedBox(np.eye(4), np.array([0.08, 0.07, 0.1])), {"upright": 0.9, "lying": 0.1}, 0.4, ("cup",), np.ones(2)
)
CARDS = {
    "bottle": (0.0, ()),
    "cup": (0.5, ("mug",)),
    "cup.lidded": (1.5, ()),
    "mug": (0.25, ("cup", "jug")),
}


class ToyLibrary:
    """Classes with the costs and the look-alikes of the table."""

    categories = ("bottle", "cup", "mug")

    def spec(self, name: str) -> Any:
        return SimpleNamespace(alike=CARDS[name][1])

    def primitive(self, name: str) -> Any:
        return SimpleNamespace(name=name, spec=SimpleNamespace(cost=CARDS[name][0]))

    def members_of(self, category: str) -> tuple[Any, ...]:
        return tuple(self.primitive(name) for name in CARDS if name.split(".")[0] == category)

    def __contains__(self, name: str) -> bool:
        return name in CARDS


LIBRARY: Any = ToyLibrary()


def candidates(
    category: str, scores: dict[str, float], share: float, subcategories: bool, *, looked: Proposal | None = None
) -> list[tuple[str, float]]:
    detection = replace(toy_completion(category=category, scores=scores).detection, proposal=looked)
    found = candidate_primitives(detection, LIBRARY, rival_share=share, subcategories=subcategories)
    return [(primitive.name, float(odds)) for primitive, odds in found]


def test_the_likely_classes_come_first_each_with_its_odds_and_its_cost() -> None:
    scores = {"bottle": 0.04, "cup": 0.16, "mug": 0.8, "teapot": 0.9}  # nobody knows a teapot
    assert candidates("mug", scores, 0.19, False) == [
        ("mug", pytest.approx(-np.log(0.8) + 0.25)),
        ("cup", pytest.approx(-np.log(0.16) + 0.5)),
    ]
    assert [name for name, _ in candidates("mug", scores, 0.19, True)] == ["mug", "cup", "cup.lidded"]
    assert [name for name, _ in candidates("mug", scores, 0.04, False)] == ["mug", "cup", "bottle"]
    assert [name for name, _ in candidates("mug", scores, 0.21, False)] == ["mug"]


def test_a_class_that_was_given_costs_nothing_but_its_own_and_odds_have_an_end() -> None:
    assert candidates("cup", {}, 0.5, True) == [("cup", 0.5), ("cup.lidded", 1.5)]
    tiny = candidates("cup", {"cup": 0.0}, 0.5, False)
    assert tiny == [("cup", pytest.approx(-np.log(1e-6) + 0.5))]


def test_of_a_class_those_primitives_are_tried_that_one_look_finds_likely(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = recorded(monkeypatch, "gfp_grasp.detect.shares_in", {"cup": 0.05, "cup.lidded": 0.95})
    lidded = ("cup.lidded", pytest.approx(-np.log(0.6) - np.log(0.95)))
    mug, cup = ("mug", pytest.approx(-np.log(0.1) + 0.25)), ("cup", pytest.approx(-np.log(0.6) - np.log(0.05)))
    scores = {"cup": 0.6, "mug": 0.1, "bottle": 0.01}
    assert candidates("cup", scores, 0.1, True, looked=PROPOSAL) == [lidded, mug]
    assert candidates("cup", scores, 0.05, True, looked=PROPOSAL) == [lidded, mug, cup]
    assert candidates("cup", {}, 0.1, True, looked=PROPOSAL) == [("cup.lidded", pytest.approx(-np.log(0.95)))]
    assert candidates("cup", scores, 0.1, False, looked=PROPOSAL)[0] == ("cup", pytest.approx(-np.log(0.6) + 0.5))
    assert len(asked.calls) == 3
    (embedding, members, sensor), _ = asked.calls[0]
    assert (embedding is PROPOSAL.embedding, sensor) == (True, TABLETOP)
    assert [primitive.name for primitive in members] == ["cup", "cup.lidded"]


def test_a_class_is_as_sure_as_it_and_those_that_it_is_taken_for_are_together() -> None:
    assert sureness({}, LIBRARY) == 1.0
    assert sureness({"mug": 0.4, "cup": 0.35, "bottle": 0.25}, LIBRARY) == pytest.approx(0.75)
    assert sureness({"bottle": 0.6, "cup": 0.1, "mug": 0.3}, LIBRARY) == pytest.approx(0.6)
    assert sureness({"teapot": 0.9, "cup": 0.1}, LIBRARY) == pytest.approx(0.9)
    assert SURE_SCORE == 0.5


def test_what_is_known_is_not_asked_for_again_and_else_the_best_class_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    ask = recorded(monkeypatch, "gfp_grasp.detect.look", PROPOSAL)
    score = recorded(monkeypatch, "gfp_grasp.detect.scores_in", {"cup": 0.3, "mug": 0.7})
    for known in (toy_completion(category="cup"), toy_completion(category="", scores={"cup": 1.0})):
        made = recognise(known.detection, LIBRARY)
        assert made.proposal is PROPOSAL
        assert (made.category, made.scores) == (known.detection.category, known.detection.scores)
    assert not score.calls
    ask.calls.clear()
    detection = replace(toy_completion(category="").detection, sensor=LIDAR)
    made = recognise(detection, LIBRARY)
    assert (made.category, made.scores) == ("mug", {"cup": 0.3, "mug": 0.7})
    assert made.proposal is PROPOSAL
    (points, up, support), named = ask.only
    assert (points is detection.cloud.points, up is detection.up) == (True, True)
    assert support is detection.support
    assert (named["viewpoint"] is detection.cloud.viewpoint, named["sensor"]) == (True, LIDAR)
    assert score.only == ((PROPOSAL.embedding, LIBRARY, LIDAR), {})
    other = replace(PROPOSAL, sure_of_front=0.1)
    assert recognise(replace(detection, proposal=other), LIBRARY).proposal is other
    assert len(ask.calls) == 1


def test_the_likeliest_classes_come_highest_first():
    scores = {"bottle": 0.1, "cup": 0.6, "mug": 0.3}
    assert likeliest(scores, 2) == [("cup", 0.6), ("mug", 0.3)]
    assert likeliest(scores, 5) == [("cup", 0.6), ("mug", 0.3), ("bottle", 0.1)]


@pytest.mark.parametrize(
    ("costs", "numbers", "answer"),
    [
        ([59.0], [3], 59.0),
        ([61.0, 30.0], [3, 16], 30.0),
        ([61.0, 70.0], [3, 16], 61.0),
        ([None, 70.0], [3, 16], 70.0),
        ([61.0, None], [3, 16], 61.0),
    ],
)
def test_where_no_likely_class_fits_unlikely_ones_are_tried(costs, numbers, answer, monkeypatch) -> None:
    asked = []

    def some(detection, library, *, rival_share, subcategories):
        return list(range({0.2: 3, 0.001: 30}[round(rival_share, 9)]))

    def fit_best(view, candidates, *, config):
        cost = costs[len(asked)]
        asked.append(len(candidates))
        if cost is None:
            raise FitDiverged("none fits")
        return SimpleNamespace(cost=cost)

    def ask() -> Any:
        return fit_likeliest(view, detection, library, config=FitConfig(), rival_share=0.2, subcategories=False)

    view, detection, library = cast(Any, "view"), cast(Any, "detection"), cast(Any, "library")
    monkeypatch.setattr(recognition, "candidate_primitives", some)
    monkeypatch.setattr(recognition, "fit_best", fit_best)
    assert (ask().cost, asked) == (answer, numbers)
    monkeypatch.setattr(recognition, "candidate_primitives", lambda *_, **__: [0])
    costs = [None]
    asked.clear()
    with pytest.raises(FitDiverged, match="none fits"):  # and the same candidates are not tried again
        ask()
    assert asked == [1]
