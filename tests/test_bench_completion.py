"""The bench of completions measures what it says."""

from typing import Any

import pytest

from gfp_grasp.bench import CompletionConfig, bench_completion
from gfp_grasp.bench.rows import CompletionRow, paired_gain, table_one
from gfp_grasp.errors import InvalidOption


def test_bench_measures_every_method_on_every_view_and_pairs_them_with_the_undeformed_fit():
    methods = ("partial", "registration", "gfs")
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
