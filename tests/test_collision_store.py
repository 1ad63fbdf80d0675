"""Parts kept on disk: found again, kept apart, and never in the way."""

import hashlib
import multiprocessing
import os
import time
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.collision import CACHE_VARIABLE, DecomposeConfig, decompose, hull, key_of, read_parts, store, write_parts
from gfp_grasp.collision.engines.guard import ChildLostError, run_guarded
from gfp_grasp.collision.store import decomposition_key
from gfp_grasp.types import CollisionMesh

QUICK = DecomposeConfig(mcts_iterations=60, mcts_nodes=10, resolution=1000)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "parts"))
    return tmp_path / "parts"


def box(size: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.box((size, 0.08, 0.06))


def same(one: CollisionMesh, other: CollisionMesh) -> bool:
    return (one.error_m, one.made_by, len(one.parts)) == (other.error_m, other.made_by, len(other.parts)) and all(
        np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)
        for a, b in zip(one.parts, other.parts, strict=True)
    )


def test_the_same_call_is_answered_from_disk_with_the_same_bits():
    first, again = decompose(box(), config=QUICK), decompose(box(), config=QUICK)
    assert (first.notes["cached"], again.notes["cached"]) == (False, True)
    assert same(first, again)
    assert {**again.notes, "cached": False} == dict(first.notes)
    assert again.seconds < first.seconds


def test_without_the_cache_nothing_is_read_or_written(folder: Path):
    for _ in range(2):
        assert decompose(box(), config=replace(QUICK, cache=False)).notes["cached"] is False
    assert not folder.exists()


def test_every_option_and_every_number_of_the_mesh_makes_another_key(monkeypatch: pytest.MonkeyPatch):
    moved = box()
    moved.vertices[0, 0] += 1e-12
    fewer = trimesh.Trimesh(box().vertices, box().faces[:-1], process=False)
    keys = [decomposition_key(mesh, QUICK) for mesh in (box(), moved, fewer)]
    others = ({"seed": 1}, {"threshold": 0.06}, {"engine": "vhacd"}, {"max_convex_hull": 4})
    keys += [decomposition_key(box(), replace(QUICK, **other)) for other in others]
    monkeypatch.setattr(store, "version", lambda wheel: "99")
    keys.append(decomposition_key(box(), QUICK))
    assert len(set(keys)) == len(keys) == 8
    assert decomposition_key(box(), QUICK) == decomposition_key(box(), replace(QUICK, cache=False, time_limit_s=10.0))


@pytest.mark.parametrize("spoil", [b"", b"torn", None])
def test_a_broken_file_is_made_anew(folder: Path, spoil: bytes | None):
    first = decompose(box(), config=QUICK)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if spoil is None else spoil)
    assert decompose(box(), config=QUICK).notes["cached"] is False
    found = read_parts(file.stem)
    assert found is not None
    assert same(first, found)


def test_notes_come_back_as_plain_values(folder: Path):
    notes = {"a": np.float64(1.5), "b": np.bool_(True), "c": Path("x"), "d": ("lost", "again"), "e": None, "f": 3}
    write_parts(key_of("notes"), replace(hull(box()), notes=notes))
    found = read_parts(key_of("notes"))
    assert found is not None
    assert found.notes == {**notes, "a": 1.5, "b": True, "c": "x"}
    assert [type(value) for value in found.notes.values()] == [float, bool, str, tuple, type(None), int]


def test_no_single_wrong_byte_raises_or_changes_what_comes_back(folder: Path):
    key, kept = key_of("box"), hull(box())
    write_parts(key, kept)
    file = folder / f"{key}.npz"
    whole, rng, refused = file.read_bytes(), np.random.default_rng(0), 0
    for place in rng.choice(len(whole), 150, replace=False):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :])
        found = read_parts(key)
        refused += found is None
        assert found is None or (same(found, kept) and found.notes == kept.notes)
    assert 75 < refused < 150  # the rest are dates and the like in the archive


@pytest.mark.parametrize(
    "change",
    [
        {"part_vertices": np.full((8, 3), np.nan)},
        {"part_vertices": np.zeros((7, 3))},
        {"part_faces": np.full((12, 3), 8, np.int32)},
        {"part_faces": np.full((12, 3), -1, np.int32)},
        {"part_sizes": np.zeros((0, 2), int)},
        {"part_sizes": np.array([[7, 12]])},
        {"part_sizes": np.array([[8, 3]])},
        {"meta": np.array("[]")},
        {"meta": np.array("{}")},
    ],
)
def test_a_foreign_file_is_not_believed(folder: Path, change: dict[str, np.ndarray]):
    key = key_of("box")
    write_parts(key, hull(box()))
    with np.load(folder / f"{key}.npz") as file:
        arrays = dict(file)
    np.savez(folder / f"{key}.npz", **{**arrays, **change})  # pyright: ignore[reportArgumentType]
    assert read_parts(key) is None


def test_a_file_under_another_key_is_not_believed(folder: Path):
    write_parts(key_of("one"), hull(box()))
    os.replace(folder / f"{key_of('one')}.npz", folder / f"{key_of('other')}.npz")
    assert read_parts(key_of("other")) is None


def test_a_folder_that_cannot_be_is_told_once_and_done_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "file" / "below"))
    with pytest.warns(RuntimeWarning, match=CACHE_VARIABLE) as caught:
        found = [decompose(box(), config=QUICK) for _ in range(2)]
    assert [result.notes["cached"] for result in found] == [False, False]
    assert len(caught) == 1


def test_what_was_asked_for_longest_ago_goes_first_and_nothing_of_others(folder: Path, monkeypatch: pytest.MonkeyPatch):
    keys = [key_of(str(number)) for number in range(4)]
    for number, key in enumerate(keys[:3]):
        write_parts(key, hull(box()))
        os.utime(folder / f"{key}.npz", (1000 + number, 1000 + number))
    assert read_parts(keys[0]) is not None  # and is thereby the youngest
    (folder / "mine.npz").write_bytes(bytes(10_000))
    (folder / f"{keys[0]}-abandoned.tmp").write_bytes(b"half")
    os.utime(folder / f"{keys[0]}-abandoned.tmp", (1000, 1000))
    size = (folder / f"{keys[0]}.npz").stat().st_size
    monkeypatch.setattr(store, "LARGEST_BYTES", int(2.5 * size))
    write_parts(keys[3], hull(box()))
    left = {path.name for path in folder.iterdir()}
    assert left == {f"{keys[0]}.npz", f"{keys[3]}.npz", "mine.npz"}


def test_parts_made_coarse_by_a_lack_of_time_are_not_kept(folder: Path, monkeypatch: pytest.MonkeyPatch):
    for out_of_time, kept in ((True, 0), (False, 1)):
        calls = []

        def lost_once(*given, calls=calls, out_of_time=out_of_time, **limits):
            calls.append(given)
            if len(calls) == 1:
                raise ChildLostError("lost", out_of_time=out_of_time)
            return run_guarded(*given, **limits)

        monkeypatch.setattr("gfp_grasp.collision.attempts.run_guarded", lost_once)
        assert decompose(box(), config=QUICK).notes["attempts"] == 2
        assert len(list(folder.glob("*"))) == kept


def _write_and_read(number: int) -> bool:
    key = key_of("shared")
    for _ in range(20):
        write_parts(key, hull(box()))
        if read_parts(key) is None:
            return False
    return number >= 0


@pytest.mark.slow
def test_processes_that_share_a_folder_never_read_half_a_file(folder: Path):
    with multiprocessing.get_context("spawn").Pool(3) as pool:
        assert all(pool.map(_write_and_read, range(3)))
    assert [path.suffix for path in folder.iterdir()] == [".npz"]


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "HOME"])
def test_the_user_folder_is_the_platforms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str):
    monkeypatch.setattr(store.sys, "platform", "linux")
    for name in (CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    found = store.cache_folder()
    assert found == tmp_path / (".cache" if variable == "HOME" else "") / "gfp_grasp" / "parts"
    monkeypatch.setenv(CACHE_VARIABLE, "off")
    assert store.cache_folder() is None


def test_a_lookup_takes_milliseconds():
    decompose(box(), config=QUICK)
    started = time.perf_counter()
    for _ in range(5):
        decompose(box(), config=QUICK)
    assert (time.perf_counter() - started) / 5 < 0.1


def test_keys_are_digests_of_the_format_the_versions_the_options_and_the_mesh(monkeypatch: pytest.MonkeyPatch):
    """Whoever changes what a key is made of, or what the files hold, raises the format."""
    assert key_of("a") == hashlib.sha256(b"4/a").hexdigest()
    wheels: list[str] = []
    monkeypatch.setattr(store, "version", lambda wheel: (wheels.append(wheel), "1.2")[1])
    monkeypatch.setattr(store, "__version__", "0.1")
    mesh = trimesh.creation.box((0.5, 0.25, 0.125))
    for engine, known in (("coacd", "d16a95ebaf0793aa"), ("vhacd", "6085640cf2357f04")):
        config = DecomposeConfig(engine=engine)  # pyright: ignore[reportArgumentType]
        assert decomposition_key(mesh, config)[:16] == known
    assert wheels == ["coacd", "vhacdx"]

    def missing(wheel: str) -> str:
        raise PackageNotFoundError(wheel)

    monkeypatch.setattr(store, "version", missing)
    assert decomposition_key(mesh, DecomposeConfig())[:16] == "ab3b5e514b847b8e"


@pytest.mark.parametrize(("age_s", "stays"), [(3500.0, True), (3700.0, False)])
def test_a_file_half_written_is_abandoned_after_an_hour(folder: Path, age_s: float, stays: bool):
    write_parts(key_of("first"), hull(box()))
    half = folder / f"{key_of('half')}-abc.tmp"
    half.write_bytes(b"half")
    os.utime(half, (time.time() - age_s, time.time() - age_s))
    write_parts(key_of("second"), hull(box()))
    assert half.exists() == stays
    assert len(list(folder.glob("*.npz"))) == 2


def test_the_cache_holds_a_quarter_of_a_gibibyte():
    assert store.LARGEST_BYTES == 268_435_456


@pytest.mark.parametrize(
    ("platform", "variables", "below"),
    [
        ("win32", {"LOCALAPPDATA": "{home}/local"}, "local"),
        ("win32", {}, "AppData/Local"),
        ("darwin", {"XDG_CACHE_HOME": "/elsewhere"}, "Library/Caches"),
        ("linux", {}, ".cache"),
    ],
)
def test_every_platform_has_its_own_folder(tmp_path: Path, monkeypatch, platform: str, variables: dict, below: str):
    for name in (CACHE_VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value.format(home=tmp_path))
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    monkeypatch.setattr(store.sys, "platform", platform)
    assert store.cache_folder() == tmp_path / below / "gfp_grasp" / "parts"

    def nobody() -> Path:
        raise RuntimeError("no home")

    if not variables:
        monkeypatch.setattr(Path, "home", nobody)
        assert store.cache_folder() is None
    monkeypatch.setenv(CACHE_VARIABLE, "OFF")
    assert store.cache_folder() is None


def test_a_file_is_whole_or_not_there_and_its_temporary_name_is_its_own(folder: Path, monkeypatch: pytest.MonkeyPatch):
    names: list[str] = []

    def fail(file, **arrays):
        names.extend(path.name for path in folder.iterdir())
        raise KeyboardInterrupt

    monkeypatch.setattr(store.np, "savez_compressed", fail)
    with pytest.raises(KeyboardInterrupt):
        write_parts(key_of("torn"), hull(box()))
    assert len(names) == 1
    assert names[0].startswith(f"{key_of('torn')}-")
    assert names[0].endswith(".tmp")
    assert list(folder.iterdir()) == []
