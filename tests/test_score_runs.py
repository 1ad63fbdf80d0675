"""A score as a run: its jobs, its settings and its journal, with rows that are made at once."""

import json
from dataclasses import asdict
from types import SimpleNamespace
from typing import Any

import pytest
import trimesh

from gfp_grasp import __version__
from gfp_grasp.envs import TrialSettings
from gfp_grasp.errors import InvalidMesh, InvalidOption, WorkerLost
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.score import BRACKETED, Report, ScoreConfig, score
from gfp_grasp.score import rows as score_rows
from gfp_grasp.score import run as score_run
from gfp_grasp.score.rows import RowJob, lost_row, make_row


@pytest.fixture
def folder(tmp_path):
    """A bottle, a mug, a jug, whose class has no primitive, and a thing of unknown class."""
    for name in ("bottle__a", "jug__b", "mug__c", "plain"):
        trimesh.creation.box(bounds=[[0, 0, 0], [0.05, 0.04, 0.1]]).export(tmp_path / f"{name}.ply")
    return tmp_path


@pytest.fixture
def mapped(monkeypatch) -> list:
    """How jobs were mapped; every job gives its row, and the gripper can carry all but the bottle."""
    mapped = []

    def pmap(function, jobs, **how):
        mapped.append((function, list(jobs), how))
        return [job if isinstance(job, RowJob) else "" if job else "no_grip" for job in jobs]

    monkeypatch.setattr(score_run, "pmap", pmap)
    return mapped


def test_every_view_of_every_object_that_can_be_grasped_goes_through_every_method(folder, mapped):
    config = ScoreConfig(views=2, grasps=3, seed=4, limit=3)
    watch: Any = object()
    report = score(folder, ("oracle", "mirror/top-down"), config=config, workers=5, ray="auto", progress=watch)
    assert report.settings == {
        "objects": folder.name,
        "split": "test",
        "num_objects": 2,
        "no_grip": ["a"],
        "too_heavy": [],
        "classes": sorted(("", *PrimitiveLibrary.shipped().categories)),
        "completers": ["oracle", "mirror/top-down"],
        **{"views": 2, "clutter": 0, "grasps": 3, "seed": 4},
        "trial": asdict(TrialSettings()),
    }
    jobs = [
        RowJob(str(folder), number, name, method, view, config)
        for number, name in ((2, "c"), (3, "plain"))
        for view in (0, 1)
        for method in ("oracle", "mirror/top-down")
    ]
    (fits, numbers, how), (function, made, how_made) = mapped
    assert (fits.func, fits.keywords) == (score_run._hindrance, {"objects": str(folder), "split": "test"})
    assert (numbers, how) == ([0, 2, 3], {"workers": 5, "ray": "auto"})
    assert (function, made) == (make_row, jobs)
    assert how_made == {"lost": lost_row, "progress": watch, "workers": 5, "ray": "auto"}
    assert report.rows == tuple(jobs)


def test_the_limit_is_taken_before_what_cannot_be_grasped_is_left_out(folder, mapped):
    config = ScoreConfig(views=1, limit=1, classes=("*",))
    with pytest.raises(InvalidOption, match=r"\(no grip: a\): are they in metres"):
        score(folder, ("oracle",), config=config)
    report = score(folder, ("oracle",), config=ScoreConfig(views=1, limit=2, classes=("*",)))
    assert [job.object_name for job in report.rows] == ["b"]  # type: ignore[attr-defined]
    assert report.settings["classes"] == ["*"]


def test_a_detector_and_primitives_of_ones_own_stand_in_the_settings(folder, mapped, monkeypatch):
    monkeypatch.setattr(score_run, "get_detector", lambda name: name)
    library = SimpleNamespace(folders=("shipped", folder / "mine"), categories=("mug",))
    fake = SimpleNamespace(from_option=lambda option: library)
    monkeypatch.setattr(score_run, "PrimitiveLibrary", fake)
    monkeypatch.setattr(score_rows, "PrimitiveLibrary", fake)
    settings = score(folder, ("oracle",), config=ScoreConfig(views=1, detector="own:one", gps="mine")).settings
    assert (settings["detector"], settings["gps"], settings["classes"]) == ("own:one", ["mine"], ["", "mug"])


def test_rows_are_written_down_as_they_come_under_the_version_and_the_settings(folder, monkeypatch, tmp_path):
    journal = tmp_path / "deep" / "journal.jsonl"
    journal.parent.mkdir()
    monkeypatch.setattr(score_run, "_hindrance", lambda number, objects, split: "")
    monkeypatch.setattr(score_run, "make_row", lambda job: lost_row(job, WorkerLost("x")))
    report = score(folder, ("oracle",), config=ScoreConfig(views=1), journal=journal)
    settings, *rows = (json.loads(line) for line in journal.read_text().splitlines())
    assert settings == {"version": __version__, **report.settings}
    assert [row["object"] for row in rows] == ["a", "c", "plain"] == [row.object for row in report.rows]
    assert Report(report.settings, report.rows).to_json() == report.to_json()


def test_broken_files_are_all_named_before_anything_is_scored(folder):
    for name in ("mug__d", "bottle__e"):
        (folder / f"{name}.ply").write_text("no mesh")
    with pytest.raises(InvalidMesh, match=r"2 of 5 files cannot be scored.*bottle__e\.ply \(.*; mug__d\.ply \("):
        score(folder, ("oracle",))


def test_what_the_gripper_holds_is_asked_of_the_object_of_that_number(folder, monkeypatch):
    asked = []
    monkeypatch.setattr(
        score_run, "hindrance", lambda truth: (asked.append(truth.name), "" if truth.name == "c" else "no_grip")[1]
    )
    assert [score_run._hindrance(n, objects=str(folder), split="test") for n in (0, 2)] == ["no_grip", ""]
    assert asked == ["a", "c"]
    (folder / "mug__c.ply").write_text("no mesh")
    assert score_run._hindrance(2, objects=str(folder), split="test") == ""


def test_the_defaults_are_the_bracketed_methods_on_four_views():
    assert BRACKETED[0] == "observed"
    assert BRACKETED[1:3] == ("observed/top-down", "mirror")
    assert BRACKETED[3:] == ("gfs", "registration", "gfpnet-paper", "gfpnet", "oracle")
    assert asdict(ScoreConfig()) == {
        **{"views": 4, "grasps": 5, "seed": 0, "split": "test", "clutter": 0, "limit": None, "classes": None},
        **{"gps": "", "detector": "tabletop"},
    }
    assert ScoreConfig(views=1, grasps=1, limit=1, classes=("a", "b", "a")).wanted() == {"a", "b"}
