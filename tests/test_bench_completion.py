"""The bench of completions measures what it says."""

from typing import Any

import pytest

from gfp_grasp.bench import METHODS, CompletionConfig, bench_completion
from gfp_grasp.bench.methods import FORMER_NAMES
from gfp_grasp.bench.rows import CompletionRow, paired_gain, summarise, table_one
from gfp_grasp.errors import InvalidOption


def test_bench_measures_every_method_on_every_view_and_pairs_them_with_the_undeformed_fit():
    methods = ("truth", "partial", "registration", "gfs")
    report = bench_completion("bottle", methods=methods, config=CompletionConfig(views=2, limit=1))
    rows: Any = report["rows"]
    paired: Any = report["paired"]
    assert set(rows) == {"bottle", "all"}
    for method in methods:
        row = rows["bottle"][method]
        assert row["views"] == 2
        assert row["failed"] == 0
        assert 0.001 < row["cd_m"] < 0.03
    assert rows["all"]["registration"]["cd_m"] < rows["all"]["partial"]["cd_m"]
    assert 0.001 < rows["all"]["truth"]["cd_m"] < rows["all"]["registration"]["cd_m"]
    assert (rows["all"]["truth"]["iou"], rows["all"]["truth"]["scale_error_median"]) == (1.0, 0.0)
    assert paired["all"]["gfs"]["pairs"] == 2


def test_pairs_tell_gain_interval_and_wins():
    def row(name: str, view: int, method: str, cd_m: float | None) -> CompletionRow:
        return CompletionRow(object=name, category="cup", view=view, method=method, ms=1.0, cd_m=cd_m, f_score=0.9)

    rows = [
        row("a", 0, "registration", 0.004),
        row("a", 0, "gfpnet", 0.003),
        row("a", 1, "registration", 0.004),
        row("a", 1, "gfpnet", 0.005),
        row("b", 0, "registration", 0.006),
        row("b", 0, "gfpnet", 0.004),
        row("b", 1, "registration", 0.006),
        row("b", 1, "gfpnet", 0.004),
    ]
    paired = paired_gain(rows, "gfpnet", "registration")
    assert paired["gain_m"] == pytest.approx(0.001)
    assert paired["gain_share"] == pytest.approx(0.2)
    assert paired["wins"] == 0.75
    assert paired["ci95_m"] == pytest.approx([0.0, 0.002])  # two objects: the mean of either alone


def test_a_bench_goes_on_where_an_earlier_one_of_the_same_settings_was_stopped():
    config = CompletionConfig(views=1, limit=1)
    first: Any = bench_completion("bottle", methods=("partial", "registration"), config=config)
    more: Any = bench_completion("bottle", methods=("gfs",), config=config, known=first)
    assert list(more["rows"]["bottle"]) == ["partial", "registration", "gfs"]
    assert more["trials"][:2] == first["trials"]
    other: Any = bench_completion(
        "bottle", methods=("partial",), config=CompletionConfig(1, seed=1, limit=1), known=first
    )
    assert len(other["trials"]) == 1


def test_the_papers_table_stands_beside_the_same_methods_here():
    table = table_one({"cup": {"told-pcrnet": {"cd_m": 0.02}, "told-pcrnet-gfs-sized": {"cd_m": 0.004}}})
    assert table["PCRNet"]["cup"] == {"paper_m": 0.109, "rigid_m": 0.02, "sized_m": None}
    assert table["GFS"]["cup"]["sized_m"] == 0.004
    assert table["GFPNet"]["bottle"] == {"paper_m": 0.009, "rigid_m": None, "sized_m": None}


def test_bench_of_an_unknown_method_is_refused():
    with pytest.raises(InvalidOption, match="registration"):
        bench_completion("cup", methods=("magic",))


def completion_row(view: int, **fields: object) -> CompletionRow:
    known = {"object": "a", "category": "cup", "view": view, "method": "m", "ms": 1.0, "cd_m": 0.01, "f_score": 0.5}
    return CompletionRow(**{**known, **fields})  # type: ignore[arg-type]


def test_a_summary_has_means_medians_and_counts():
    right = {"class_right": True}
    rows = [
        completion_row(0, cd_m=0.002, ms=10.0, scale_error=-0.2, class_found="cup", iou=0.8, f_score=0.9, **right),
        completion_row(1, cd_m=0.004, ms=30.0, scale_error=0.1, class_found="mug", iou=0.6, f_score=0.7, **right),
        completion_row(2, cd_m=0.012, ms=20.0, scale_error=0.4, class_found="jar", class_right=False),
        completion_row(3, cd_m=None, ms=100.0, f_score=0.0, error="FitDiverged"),
    ]
    figures = summarise(rows)
    assert figures["cd_m"] == pytest.approx(0.006)
    assert figures["cd_median_m"] == pytest.approx(0.004)
    assert figures["f_score"] == pytest.approx((0.9 + 0.7 + 0.5 + 0.0) / 4)
    assert figures["iou"] == pytest.approx(0.7)
    assert figures["scale_error_median"] == pytest.approx(0.2)
    assert figures["class_found"] == pytest.approx(1 / 3, abs=1e-4)
    assert figures["class_right"] == pytest.approx(2 / 3, abs=1e-4)
    assert figures["ms"] == 25.0
    assert figures["ms_p95"] == pytest.approx(89.5)
    assert (figures["views"], figures["failed"]) == (4, 1)
    assert figures["sigma_rank"] is None


def test_a_summary_of_nothing_is_empty_and_of_failures_has_no_distance():
    assert summarise([])["ms"] is None
    failed = summarise([completion_row(0, cd_m=None, f_score=0.0, error="InvalidCloud")])
    assert (failed["cd_m"], failed["cd_median_m"], failed["f_score"], failed["failed"]) == (None, None, 0.0, 1)


def test_pairs_need_an_answer_of_both_methods():
    rows = [
        completion_row(0, method="gfpnet", cd_m=0.003),
        completion_row(0, method="registration", cd_m=None),
        completion_row(1, method="gfpnet", cd_m=0.003),
    ]
    assert paired_gain(rows, "gfpnet", "registration") == {"pairs": 0}


def test_a_row_is_written_without_what_does_not_apply_and_comes_back():
    row = completion_row(0, cd_m=None, error="InvalidCloud")
    assert "iou" not in row.to_json()
    assert row.to_json()["cd_m"] is None
    assert CompletionRow(**row.to_json()) == row


def test_rows_of_former_names_are_those_of_the_same_method():
    for former, name in FORMER_NAMES.items():
        assert former not in METHODS
        assert name in METHODS
    assert FORMER_NAMES["hull"] == "observed"
    assert FORMER_NAMES["pcrnet-gfs-sized"] == "told-pcrnet-gfs-sized"
