"""Results that are on disk before a run is over."""

from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.errors import CannotWrite, InvalidOption, UnreadableFile
from gfp_grasp.journal import Journal, check_place, read_figures, write_arrays, write_file, write_whole


def test_a_journal_goes_on_after_the_last_whole_line(tmp_path):
    path = tmp_path / "run" / "a.part.jsonl"
    first = Journal(path, {"seed": 1})
    first.add({"n": 1})
    first.add({"n": 2})
    with path.open("ab") as file:
        file.write(b'{"n": 3')  # stopped in the middle of a line
    second = Journal(path, {"seed": 1})
    assert second.records == [{"n": 1}, {"n": 2}]
    second.add({"n": 4})
    assert Journal(path, {"seed": 1}).records == [{"n": 1}, {"n": 2}, {"n": 4}]


def test_a_journal_of_other_settings_is_left_alone(tmp_path):
    path = tmp_path / "a.jsonl"
    Journal(path, {"seed": 1}).add({"n": 1})
    before = path.read_bytes()
    with pytest.raises(InvalidOption, match="another run"):
        Journal(path, {"seed": 2})
    assert path.read_bytes() == before
    path.write_bytes(b"\xff\xfe\n")
    with pytest.raises(InvalidOption, match="holds no results"):
        Journal(path, {"seed": 1})


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full, which is a disk without room")
def test_a_full_disk_is_named_and_costs_nothing_that_was_written(tmp_path, monkeypatch):
    path = tmp_path / "a.jsonl"
    journal = Journal(path, {"seed": 1})
    journal.add({"n": 1})
    monkeypatch.setattr(journal, "path", Path("/dev/full"))
    with pytest.raises(CannotWrite, match="No space left"):
        journal.add({"n": 2})
    assert Journal(path, {"seed": 1}).records == [{"n": 1}]


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "new" / "a.json"
    write_whole(path, "1")
    write_whole(path, "2")
    assert path.read_text() == "2"
    assert [file.name for file in path.parent.iterdir()] == ["a.json"]
    (tmp_path / "file").touch()
    with pytest.raises(CannotWrite, match=r"b\.json cannot be written"):
        write_whole(tmp_path / "file" / "b.json", "3")


def test_the_order_of_settings_makes_no_other_run(tmp_path):
    Journal(tmp_path / "a.jsonl", {"b": 1, "a": 2}).add({"n": 1})
    assert Journal(tmp_path / "a.jsonl", {"a": 2, "b": 1}).records == [{"n": 1}]


def test_a_number_that_is_none_is_not_written_down(tmp_path):
    journal = Journal(tmp_path / "a.jsonl", {})
    before = journal.path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        journal.add({"n": float("nan")})
    assert journal.path.read_bytes() == before


def test_letters_of_every_alphabet_come_back(tmp_path):
    Journal(tmp_path / "a.jsonl", {"class": "чашка"}).add({"name": "Tasse, Öl"})
    assert Journal(tmp_path / "a.jsonl", {"class": "чашка"}).records == [{"name": "Tasse, Öl"}]


def test_a_file_of_half_a_line_is_begun_anew(tmp_path):
    (tmp_path / "a.jsonl").write_bytes(b'{"seed"')
    assert Journal(tmp_path / "a.jsonl", {"seed": 1}).records == []
    assert (tmp_path / "a.jsonl").read_bytes() == b'{"seed": 1}\n'


def test_a_file_that_cannot_take_its_place_leaves_nothing_beside_it(tmp_path):
    (tmp_path / "a.json" / "full").mkdir(parents=True)
    with pytest.raises(CannotWrite, match=r"a\.json"):
        write_whole(tmp_path / "a.json", "1")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_arrays_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "new" / "a.npz"
    write_arrays(path, low=np.array([1, 2], dtype=np.int16), name=np.array("cup"))
    with np.load(path) as stored:
        assert stored["low"].tolist() == [1, 2]
        assert stored["low"].dtype == np.int16
        assert str(stored["name"]) == "cup"
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(CannotWrite, match=r"a\.npz cannot be written \(No space"):
        write_arrays(path, low=np.zeros(2))
    assert path.read_bytes() == before
    assert [file.name for file in path.parent.iterdir()] == ["a.npz"]


def test_a_function_that_fails_half_way_leaves_what_was_there(tmp_path):
    path = tmp_path / "new" / "a.bin"
    write_file(path, lambda file: file.write(b"first"))

    def half(file):
        file.write(b"se")
        raise OSError(28, "No space left on device")

    with pytest.raises(CannotWrite, match=r"new/a\.bin cannot be written \(No space"):
        write_file(path, half)
    assert path.read_bytes() == b"first"
    assert [file.name for file in path.parent.iterdir()] == ["a.bin"]


def test_a_place_is_known_to_be_none_before_anything_is_written(tmp_path):
    (tmp_path / "file").write_text("1")
    check_place(tmp_path / "file")
    check_place(tmp_path / "new" / "folder" / "a.json")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    for place, why in ((tmp_path, "Is a directory"), (tmp_path / "file" / "new" / "a.json", "Not a directory")):
        with pytest.raises(CannotWrite, match=f"cannot be written \\({why}\\): make room or name another place"):
            check_place(place)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc, where nobody may write")
def test_a_place_without_the_right_to_write_is_refused():
    with pytest.raises(CannotWrite, match="/proc/a/b cannot be written"):
        check_place("/proc/a/b")


def test_figures_are_an_object_of_json_or_a_named_error(tmp_path):
    path = tmp_path / "a.json"
    with pytest.raises(UnreadableFile, match=r"a\.json is no readable JSON .*No such file"):
        read_figures(path)
    path.write_text('{"Öl": [1, 2.5]}', encoding="utf-8")
    assert read_figures(path) == {"Öl": [1, 2.5]}
    for content, message in (
        (b'{"a": 1', "is no readable JSON"),
        (b"\xff", "is no readable"),
        (b"[1]", "holds a list"),
    ):
        path.write_bytes(content)
        with pytest.raises(UnreadableFile, match=rf"a\.json {message}"):
            read_figures(path)
