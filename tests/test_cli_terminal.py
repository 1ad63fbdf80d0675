"""What all commands share: tables, bars, vectors, outputs, figures, and how the program ends."""

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from recorded_calls import recorded, run

from gfp_grasp.cli import terminal
from gfp_grasp.cli.program import _keep_to_one_thread
from gfp_grasp.cli.training import _bar
from gfp_grasp.errors import InvalidOption, UnreadableFile


def test_words_of_a_table_start_at_the_left_and_figures_end_at_the_right(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.table(("name", "word", "figure"), [("a", "b", "1")], title="T", words=2)
    terminal.table(("name", "word", "figure"), [("a", "b", "1")])
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("│")] == ["│ a    │ b    │      1 │", "│ a    │    b │      1 │"]
    assert lines[0].rstrip() == "T"
    assert lines[6][0] == "┏"  # the second table has no title


def test_an_error_is_one_line_whatever_is_in_it(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.say_error("[red] a\n  b " + "word " * 60)
    assert capsys.readouterr().err == "[red] a b " + " ".join(["word"] * 60) + "\n"


def test_a_bar_counts_what_passes_and_lets_it_through(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(terminal.track("views")(iter("abc"), 3)) == ["a", "b", "c"]
    told = capsys.readouterr().err
    assert "views" in told.split()
    assert "3/3" in told


def test_the_bar_of_a_training_tells_step_and_loss(capsys: pytest.CaptureFixture[str]) -> None:
    with _bar("pcrnet", 8):
        pass
    assert capsys.readouterr().err.split()[:2] == ["pcrnet:", "data"]
    with _bar("pcrnet", 8) as report:
        report(3, 0.12345)
    told = capsys.readouterr().err
    assert told.split()[:3] == ["pcrnet:", "loss", "0.1235"]
    assert "3/8" in told


def test_stages_are_named_beside_a_limit_that_runs(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.stages(90.5) as tell:
        tell("cutting")
    told = capsys.readouterr().err
    assert "cutting" in told.split()
    assert "0 of 90.5 s" in told


@pytest.mark.parametrize(
    ("elapsed_s", "completed_s", "words"),
    [(None, 0.0, "0 of 90.5 s"), (12.4, 12.4, "12 of 90.5 s"), (200.0, 90.5, "200 of 90.5 s")],
)
def test_the_bar_of_stages_fills_with_time_up_to_the_limit(
    elapsed_s: float | None, completed_s: float, words: str
) -> None:
    columns: Any = terminal._TimeBar().render(SimpleNamespace(elapsed=elapsed_s, total=90.5))  # type: ignore[arg-type]
    bar, text = columns.renderables
    assert (bar.total, bar.completed, bar.width, text.plain) == (90.5, completed_s, 40, words)


@pytest.mark.parametrize("words", ["1,2", "1,2,3,4", "a,b,c", ""])
def test_what_is_no_vector_is_refused_by_the_name_of_its_option(words: str) -> None:
    with pytest.raises(InvalidOption, match="--up is"):
        terminal.vector(words, "up")
    assert terminal.vector(None, "up") is None
    assert terminal.vector("0.3,-0.2,5e-1", "up") == [0.3, -0.2, 0.5]


def test_outputs_that_could_not_be_written_are_refused_before_work(tmp_path: Path) -> None:
    terminal.check_outputs([tmp_path / "new" / "folder" / "a.GLB", Path("a.xml")])
    (tmp_path / "folder.obj").mkdir()
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "folder.obj", tmp_path / "file" / "a.obj"):
        with pytest.raises(InvalidOption, match="cannot be written"):
            terminal.check_outputs([Path("a.xml"), path])
    with pytest.raises(InvalidOption, match="suffix"):
        terminal.check_outputs([Path("a.xml"), tmp_path / "a"])


def test_folders_of_primitives_are_one_absolute_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert terminal.gps_option([Path("a"), tmp_path / "b"]) == f"{tmp_path / 'a'}{os.pathsep}{tmp_path / 'b'}"
    assert terminal.gps_option(None) == terminal.gps_option([]) == ""


def test_figures_come_back_and_trials_have_a_line_each(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    assert terminal.read_json(None) is None
    assert terminal.read_json(path) is None
    terminal.save_json(None, {"a": 1})
    terminal.save_json(path, [1, 2])
    assert path.read_text() == "[\n 1,\n 2\n]\n"
    content = {"mean": 0.5, "trials": [{"n": 1, "b": [1, 2]}, {"n": 2, "b": []}], "last": {"c": 3}}
    terminal.save_json(path, content)
    assert terminal.read_json(path) == content
    lines = path.read_text().splitlines()
    assert [json.loads(line.rstrip(",")) for line in lines if '"n"' in line] == content["trials"]
    assert lines[1] == ' "mean": 0.5,'


@pytest.mark.parametrize("content", ["[1, 2]", '{"mean": 0.', "", "3"])
def test_a_file_without_figures_is_a_named_error(content: str, tmp_path: Path) -> None:
    (tmp_path / "figures.json").write_text(content)
    with pytest.raises(UnreadableFile, match=r"figures\.json (is no readable JSON|holds a (list|int))"):
        terminal.read_json(tmp_path / "figures.json")


@pytest.mark.parametrize(("words", "code", "told"), [("gps list", 130, "stopped"), ("gps list", 2, "away: mug.ply")])
def test_program_says_why_it_ended(
    words: str, code: int, told: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def end(*_: object) -> None:
        raise KeyboardInterrupt if code == 130 else OSError(2, "away", "mug.ply")

    monkeypatch.setattr("gfp_grasp.primitives.PrimitiveLibrary.with_shipped", end)
    assert run(words) == code
    assert capsys.readouterr().err.strip() == told


def test_the_words_of_the_process_are_taken_where_none_are_given(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from gfp_grasp.cli import main

    monkeypatch.setattr("sys.argv", ["gfp-grasp", "gps", "--help"])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    assert "Usage: gfp-grasp gps" in capsys.readouterr().out


def test_threads_are_one_unless_the_user_says_otherwise_or_trains(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = recorded(monkeypatch, "gfp_grasp.cli.program.threadpool_limits")
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    _keep_to_one_thread()
    assert not limits.calls
    assert os.environ["OMP_NUM_THREADS"] == "3"
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert run("train --help") == 0
    assert "OMP_NUM_THREADS" not in os.environ
    assert run("gps --help") == 0
    assert os.environ.pop("OMP_NUM_THREADS") == "1"
    assert limits.only == ((1,), {})
