"""The operating curve and the figures of known and unknown, from rows whose answers are known by hand."""

from typing import Any

import pytest

from gfp_grasp.bench import openset as room
from gfp_grasp.bench.openset import is_unknown, report_of
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.train import OpenSetRow


def row(sort: str, doubt: float, *, cd_m: float | None = 0.004, **more: Any) -> OpenSetRow:
    """A view whose probability of being of no class is `doubt`; by the look alone it is a tenth less."""
    values: dict[str, Any] = {
        "kind": "mug",
        "number": 3,
        "sight": "plain",
        "cut_off": False,
        "hull_cd_m": 0.01,
        "classfree_cd_m": 0.005,
    }
    fit = {"fit": (doubt,), "misfit": (0.01, 0.0, 0.0, 0.2), "named": "mug"} if cd_m is not None else {}
    return OpenSetRow(sort=sort, cd_m=cd_m, **{**values, "look": (doubt - 0.1,), **fit, **more})


@pytest.fixture(autouse=True)
def models(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "probability_by_look", lambda look: look[0])
    monkeypatch.setattr(room, "probability_unknown", lambda look, fit: fit[0])


@pytest.mark.parametrize(
    ("made", "threshold", "unknown"),
    [
        (row("known", 0.4), 0.5, False),
        (row("known", 0.5), 0.5, True),
        (row("known", 0.2, look=(0.5,)), 0.5, True),  # by the look alone
        (row("known", 0.2, look=(0.8,)), 0.95, True),  # which need not be as sure as look and fit
        (row("known", 0.2, look=(0.79,)), 0.95, False),
        (row("known", 0.2, look=(0.94,), cut_off=True), 0.95, False),  # unless an end is hidden
        (row("known", 0.2, look=(0.95,), cut_off=True), 0.95, True),
        (row("known", 0.99, look=(0.99,)), 1.0, False),  # never
        (row("known", 0.5, misfit=(0.0, 0.15, 0.0, 0.0)), 0.9, True),  # in doubt, it misses too many points
        (row("known", 0.4, misfit=(0.0, 0.15, 0.0, 0.0)), 0.9, False),
        (row("known", 0.5, misfit=(0.0, 0.15, 0.0, 0.0)), 1.0, False),
        (row("known", 0.1, misfit=(0.0, 0.0, 0.6, 0.0)), 1.0, True),  # it contradicts what was seen
        (row("known", 0.1, cd_m=None), 0.5, True),  # nothing fits
    ],
)
def test_a_view_is_answered_without_a_class_as_the_package_does(
    made: OpenSetRow, threshold: float, unknown: bool
) -> None:
    assert is_unknown(made, threshold) is unknown


def test_a_curve_tells_what_is_lost_and_what_is_caught_and_rows_what_that_is_worth() -> None:
    threshold = CompleteConfig().unknown_above
    rows = [
        row("known", 0.0, cd_m=0.002),
        row("known", 0.001),
        row("known", 0.001),
        row("known", 0.94, cd_m=0.0045, classfree_cd_m=0.008),
        row("left_out", 0.0, cd_m=0.0059),  # good
        row("left_out", 0.0, cd_m=0.02),
        row("mixture", 0.94, cd_m=0.03),
        row("mixture", 0.94, cd_m=None),
        row("known", 0.0, sight="varied"),
    ]
    report = report_of(rows)
    assert report["threshold"] == threshold
    point = next(p for p in report["curve"]["plain"] if p["threshold"] == threshold)
    assert point == {
        "threshold": threshold,
        "lost": 0.25,
        "caught_left_out": 0.0,
        "caught_or_good_left_out": 0.5,
        "caught_mixture": 1.0,
        "caught_or_good_mixture": 1.0,
    }
    last = report["curve"]["plain"][-1]
    assert (last["threshold"], last["lost"], last["caught_mixture"]) == (1.0, 0.0, 0.5)
    known = report["rows"]["plain"]["known"]
    assert (known["views"], known["unknown"]) == (4, 0.25)
    assert known["class"] == {"cd_m": 0.00362, "of_hull": 0.362, "worst_of_hull": 0.45}
    assert known["answer"] == {"cd_m": 0.0045, "of_hull": 0.45, "worst_of_hull": 0.8}
    assert known["hull"] == {"cd_m": 0.01, "of_hull": 1.0, "worst_of_hull": 1.0}
    mixture = report["rows"]["plain"]["mixture"]
    assert (mixture["views"], mixture["answer"]["cd_m"], mixture["class"]["cd_m"]) == (2, 0.005, 0.03)
    assert report["rows"]["varied"]["known"]["views"] == 1
