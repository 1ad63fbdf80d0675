"""The report of a score: every figure of it from rows that are written by hand."""

import json
from dataclasses import replace

import pytest
from hand_rows import a_row

from gfp_grasp.score import BRACKETS, Report, mcnemar_p, wilson_interval
from gfp_grasp.score.report import method_names


@pytest.mark.parametrize(
    ("successes", "attempts", "low", "high"),
    [(8, 10, 0.4902, 0.9433), (0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (0, 0, 0.0, 1.0)],
)
def test_wilson_intervals_are_those_of_the_tables(successes, attempts, low, high):
    assert wilson_interval(successes, attempts) == pytest.approx((low, high), abs=1e-4)


def test_a_report_counts_each_world_by_itself():
    row = Report({}, (a_row("mirror", 0, False, True),)).completers()["mirror"]
    assert (row["successes"], row["completed_world"]["successes"]) == (0, 1)
    assert (row["completed_world"]["precision"], row["completed_world"]["recall"]) == (0.0, None)
    assert row["cd_m"] == 0.01


def test_precision_recall_and_the_best_few_are_counted():
    kinds = [(True, True, 1), (True, True, 1), (False, True, 3), (True, False, 1), (False, False, None)]
    row = Report({}, tuple(a_row("mirror", i, *kind) for i, kind in enumerate(kinds))).completers()["mirror"]
    assert row["any_of_best"] == 4
    assert row["completed_world"]["precision"] == row["completed_world"]["recall"] == pytest.approx(2 / 3)


def test_completers_are_paired_with_those_that_bracket_them_view_by_view():
    held = {
        "mirror": [True, False, False, False, False, False, False],
        "oracle": [True, True, True, True, True, True, True],
    }
    rows = [a_row(name, view, truth, True) for name, line in held.items() for view, truth in enumerate(line)]
    paired = Report({}, tuple(rows)).paired()
    assert paired["mirror"] == {
        "oracle": {
            **{"pairs": 7, "only_this": 0, "only_other": 6, "p": 2 * 0.5**6},
            # One object alone has no spread.
            **{"margin": pytest.approx(-18 / 7), "margin_ci95": pytest.approx([-18 / 7, -18 / 7])},
        }
    }
    back = paired["oracle"]["mirror"]
    assert (back["only_this"], back["only_other"], back["margin"]) == (6, 0, pytest.approx(18 / 7))


@pytest.mark.parametrize(("first", "second", "p"), [(0, 0, 1.0), (1, 1, 1.0), (0, 5, 0.0625), (10, 2, 0.03857)])
def test_the_exact_test_of_mcnemar_is_that_of_the_tables(first, second, p):
    assert mcnemar_p(first, second) == pytest.approx(p, abs=1e-5)


def test_a_method_is_a_completer_and_a_planner():
    assert method_names("gfpnet/top-down") == ("gfpnet", "top-down")
    assert method_names("gfpnet") == ("gfpnet", "antipodal")
    assert method_names("mod:complete/mod:plan") == ("mod:complete", "mod:plan")


def test_the_brackets_are_the_truth_above_and_the_seen_points_below():
    assert set(BRACKETS) == {"oracle", "observed"}


def test_a_summary_has_means_over_completed_views_and_counts_over_all():
    rows = (
        replace(a_row("mirror", 0, True, True, 1), cd_m=0.002, timings_s={"plan": 1.0, "execute": 2.0}),
        replace(a_row("mirror", 1, False, True, 2), cd_m=0.006, timings_s={"plan": 3.0, "execute": 2.0}),
        replace(a_row("mirror", 2, False, False), cd_m=None, timings_s={"plan": 2.0, "execute": 5.0}),
    )
    summary = Report({}, rows).completers()["mirror"]
    assert summary["attempts"] == 3
    assert summary["successes"] == 1
    assert summary["success_rate"] == pytest.approx(1 / 3)
    assert summary["ci95"] == pytest.approx([0.0615, 0.7923], abs=1e-4)
    assert summary["reasons"] == {"held": 1, "no_contact": 2}
    assert summary["cd_m"] == pytest.approx(0.004)
    assert summary["num_completed"] == 2
    assert summary["any_of_best"] == 2
    assert summary["timings_s"] == {"plan": pytest.approx(2.0), "execute": pytest.approx(3.0)}
    completed = summary["completed_world"]
    assert (completed["successes"], completed["precision"], completed["recall"]) == (2, 0.5, 1.0)


def test_the_margin_of_views_is_resampled_by_object():
    """Four octaves on each view of one object, one and three on those of another: 3 of 12 in the mean."""
    margins = {("a", 0): 4.0, ("a", 1): 4.0, ("b", 0): 1.0, ("b", 1): 3.0}
    rows = [
        replace(a_row("mirror", view, True, True), object=name, margin=margin)
        for (name, view), margin in margins.items()
    ]
    summary = Report({}, tuple(rows)).completers()["mirror"]
    assert summary["margin"] == pytest.approx(3.0)
    assert summary["margin_ci95"] == pytest.approx([2.0, 4.0])
    oracle = [replace(row, completer="oracle", margin=4.0) for row in rows]
    paired = Report({}, (*rows, *oracle)).paired()["mirror"]["oracle"]
    assert (paired["margin"], paired["margin_ci95"]) == (pytest.approx(-1.0), pytest.approx([-2.0, 0.0]))
    before = Report({}, tuple(replace(row, margin=None) for row in rows))
    assert "margin" not in before.completers()["mirror"]
    assert before.table()[0]["margin"] == "-"


def test_precision_and_recall_divide_by_different_counts():
    worlds = [(True, True), (True, False), (True, False), (False, True)]
    rows = tuple(a_row("mirror", view, *held) for view, held in enumerate(worlds))
    completed = Report({}, rows).completers()["mirror"]["completed_world"]
    assert (completed["precision"], completed["recall"]) == (pytest.approx(1 / 2), pytest.approx(1 / 3))


def test_nothing_that_held_leaves_precision_and_recall_open():
    completed = Report({}, (a_row("mirror", 0, False, False),)).completers()["mirror"]["completed_world"]
    assert (completed["precision"], completed["recall"]) == (None, None)


def test_success_is_told_by_class_and_method_and_classes_come_in_order():
    rows = (
        replace(a_row("mirror", 0, True, True), category="mug"),
        replace(a_row("mirror", 1, False, True), category="mug"),
        replace(a_row("mirror", 0, False, True), category="cup"),
        replace(a_row("oracle", 0, True, True), category="cup"),
    )
    classes = Report({}, rows).classes()
    assert list(classes) == ["cup", "mug"]
    assert list(classes["cup"]) == ["mirror", "oracle"]
    assert list(classes["mug"]) == ["mirror"]
    assert [classes["cup"][name]["successes"] for name in ("mirror", "oracle")] == [0, 1]
    assert (classes["mug"]["mirror"]["successes"], classes["mug"]["mirror"]["attempts"]) == (1, 2)


def test_every_method_is_paired_with_every_other_the_brackets_first():
    names = ("gfpnet", "mirror", "observed", "oracle")
    paired = Report({}, tuple(a_row(name, 0, True, True) for name in names)).paired()
    assert list(paired) == list(names)
    assert list(paired["gfpnet"]) == ["oracle", "observed", "mirror"]
    assert list(paired["oracle"]) == ["observed", "gfpnet", "mirror"]


def test_pairs_are_views_of_one_object_that_both_methods_have():
    rows = (
        a_row("mirror", 0, True, True),
        a_row("mirror", 1, False, True),
        replace(a_row("mirror", 0, True, True), object="b"),
        a_row("oracle", 0, False, True),
        a_row("oracle", 1, True, True),
        replace(a_row("oracle", 7, True, True), object="b"),
    )
    paired = Report({}, rows).paired()["mirror"]["oracle"]
    known = {"pairs": 2, "only_this": 1, "only_other": 1, "p": 1.0, "margin": 0.0, "margin_ci95": [0.0, 0.0]}
    assert paired == known


def test_the_table_tells_each_method_in_words():
    rows = (a_row("mirror", 0, True, True, 1), a_row("mirror", 1, False, True, 3))
    assert Report({}, rows).table() == [
        {
            "completer": "mirror",
            "true world": "1/2 = 0.50 [0.09, 0.91]",
            "margin": "1.50 [1.50, 1.50]",
            "of best few": "2/2",
            "completed world": "2/2 = 1.00 [0.34, 1.00]",
            "precision, recall": "0.50, 1.00",
            "CD mm": "10.0",
            "failures": "no_contact 1",
        }
    ]
    lost = Report({}, (replace(a_row("mirror", 0, False, False), cd_m=None),)).table()[0]
    assert (lost["CD mm"], lost["precision, recall"]) == ("-", "-, -")
    assert Report({}, (a_row("mirror", 0, True, True),)).table()[0]["failures"] == "-"


def test_reasons_come_in_the_order_of_a_trial_whatever_the_order_of_the_rows():
    rows = tuple(
        replace(a_row("mirror", view, False, True), reason=reason)
        for view, reason in enumerate(["unstable", "no_contact", "collided_on_approach", "no_contact"])
    )
    reasons = Report({}, rows).completers()["mirror"]["reasons"]
    assert list(reasons.items()) == [("collided_on_approach", 1), ("no_contact", 2), ("unstable", 1)]


def test_the_json_has_rows_in_order_and_settings_as_they_are():
    report = Report({"seed": 3}, (a_row("mirror", 1, True, True), a_row("mirror", 0, True, True)))
    content = json.loads(report.to_json())
    assert content["settings"] == {"seed": 3}
    assert [row["view"] for row in content["trials"]] == [1, 0]
    assert content["completers"] == report.completers()
    assert content["classes"] == report.classes()
    assert content["paired"] == report.paired()
