"""Hostile meshes: every kind comes out as a valid result or as a named error, and the bench tells what does not."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gfp_grasp.bench import HostileConfig, bench_hostile, hostile
from gfp_grasp.bench.hostile import BAD, HostileRow, measure_mesh
from gfp_grasp.bench.hostile_meshes import KINDS, hostile_mesh
from gfp_grasp.cli import main
from gfp_grasp.collision import hull
from gfp_grasp.errors import GfpGraspError, InvalidMesh, InvalidOption
from gfp_grasp.meshes import make_solid
from gfp_grasp.types import ConvexPart

REFUSED = ("nan", "inf", "bad_indices", "empty", "single_face")
# Repairing these takes seconds to half a minute each.
SLOW = ("soup", "self_crossing", "open", "non_manifold")


def raw(vertices: object, faces: object) -> trimesh.Trimesh:
    return trimesh.Trimesh(np.array(vertices), np.array(faces), process=False, validate=False)


def test_the_same_number_is_the_same_mesh_and_another_is_another():
    for number in range(2 * len(KINDS)):
        kind, mesh = hostile_mesh(number, seed=3)
        again, other = hostile_mesh(number, seed=3)[1], hostile_mesh(number, seed=4)[1]
        assert kind == tuple(KINDS)[number % len(KINDS)]
        np.testing.assert_array_equal(mesh.vertices, again.vertices)
        np.testing.assert_array_equal(mesh.faces, again.faces)
        assert kind == "empty" or not np.array_equal(mesh.vertices, other.vertices)


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_mesh_is_refused_by_name_before_any_work(kind: str):
    number = tuple(KINDS).index(kind)
    for step in ("validate", "decompose"):
        row = measure_mesh(step, number, seed=0)
        assert (row.outcome, row.kind) == ("InvalidMesh", kind)
        assert row.s < 1


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in SLOW])
def test_every_kind_is_valid_or_refused_by_name(kind: str):
    for number in range(tuple(KINDS).index(kind), 4 * len(KINDS), len(KINDS)):
        assert measure_mesh("validate", number, seed=1).outcome in ("valid", "InvalidMesh")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_decomposed_or_refused_by_name(kind: str):
    outcome = measure_mesh("decompose", tuple(KINDS).index(kind), seed=2).outcome
    assert outcome in ("valid", "InvalidMesh", "DecompositionFailed")


def test_a_solid_whose_every_face_touches_a_crossing_is_no_crash():
    kind, mesh = hostile_mesh(164, seed=0)
    solid, _ = make_solid(mesh)
    assert kind == "stray"
    assert solid.is_volume


@pytest.mark.slow
def test_a_soup_whose_thinning_fails_becomes_a_solid_that_can_be_worked_with():
    kind, mesh = hostile_mesh(20, seed=0)
    solid, _ = make_solid(mesh)
    assert kind == "soup"
    assert solid.is_volume
    assert len(solid.faces) < 100_000  # 700 000 with the fine grid


CORNERS = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]
TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
STORED: dict[str, tuple[Callable[[], trimesh.Trimesh], bool]] = {
    "a tetrahedron": (lambda: raw(CORNERS, TETRAHEDRON), True),
    "two that share a corner": (
        lambda: raw([*CORNERS, *np.negative(CORNERS[1:])], [*TETRAHEDRON, [0, 4, 5], [0, 6, 4], [0, 5, 6], [4, 6, 5]]),
        True,
    ),
    "a fin on an edge": (lambda: raw([*CORNERS, [0.1, 0.1, -0.1]], [*TETRAHEDRON, [0, 1, 4]]), True),
    "one face turned": (lambda: raw(CORNERS, [[0, 1, 2], *TETRAHEDRON[1:]]), True),
    "each face thrice": (lambda: raw(CORNERS, TETRAHEDRON * 3), True),
    "a face of one corner": (lambda: raw(CORNERS, [*TETRAHEDRON, [2, 2, 2]]), True),
    "a vertex at a hair's breadth": (lambda: raw([*CORNERS, [1e-13, 0, 0]], [*TETRAHEDRON, [4, 1, 3]]), True),
    "a million kilometres away": (lambda: raw(np.add(CORNERS, 1e9), TETRAHEDRON), False),
    "as large as the earth": (lambda: raw(np.multiply(CORNERS, 1e8), TETRAHEDRON), False),
    "as small as an atom": (lambda: raw(np.multiply(CORNERS, 1e-9), TETRAHEDRON), False),
    "numbers that overflow when squared": (lambda: raw(np.multiply(CORNERS, 1e200), TETRAHEDRON), False),
    "denormal numbers": (lambda: raw(np.multiply(CORNERS, 1e-310), TETRAHEDRON), False),
    "nothing but one point": (lambda: raw(np.ones((4, 3)), TETRAHEDRON), False),
    "points on a line": (lambda: raw([[i, i, i] for i in range(4)], TETRAHEDRON), False),
    "an index beyond int32": (lambda: raw(CORNERS, [*TETRAHEDRON, [0, 1, 2**40]]), False),
}


@pytest.mark.parametrize("name", STORED)
def test_stored_meshes_are_taken_or_refused(name: str):
    make, taken = STORED[name]
    if taken:
        assert hostile._fault(hull(make())) is None
        assert hostile._validated(make(), hulled=False) is None
    else:
        with pytest.raises(InvalidMesh):
            hull(make())


coordinates = st.one_of(
    st.integers(-3, 3).map(lambda n: 0.03 * n),
    st.floats(-0.1, 0.1),
    st.sampled_from([0.05, 0.1, 1e-9, 5e-324, -0.0, 1e5, 1e9, 1e300, np.inf, np.nan]),
)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    vertices=st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=9),
    faces=st.lists(st.tuples(*[st.integers(-1, 9)] * 3), max_size=12),
    legal=st.booleans(),
)
def test_any_numbers_give_a_valid_hull_or_a_named_error(vertices: list, faces: list, legal: bool):
    corners = np.reshape(np.array(faces, dtype=np.int64), (-1, 3))
    if legal:
        corners %= max(1, len(vertices))
    with np.errstate(all="ignore"):
        mesh = raw(np.reshape(vertices, (-1, 3)), corners)
        try:
            found = hull(mesh)
        except GfpGraspError:
            return
        assert hostile._fault(found) is None


@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    cells=st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=5),
    turned=st.integers(0, 59),
    dropped=st.integers(0, 3),
)
def test_any_pile_of_boxes_becomes_a_solid_or_is_refused_by_name(cells: list, turned: int, dropped: int):
    cube = trimesh.creation.box((0.03, 0.03, 0.03))
    vertices = np.concatenate([cube.vertices + 0.03 * np.array(cell) for cell in cells])
    faces = np.concatenate([cube.faces + 8 * number for number in range(len(cells))])[dropped:]
    faces[turned % len(faces)] = faces[turned % len(faces)][::-1]
    try:
        fault = hostile._validated(raw(vertices, faces), hulled=False)
    except GfpGraspError:
        return
    assert fault is None


def test_parts_that_are_not_convex_not_finite_or_crumbs_are_told():
    cube = trimesh.creation.box((0.1, 0.1, 0.1))
    dented = np.array(cube.vertices)
    dented[0] *= 0.1
    assert hostile._convex(ConvexPart(cube.vertices, cube.faces))
    assert not hostile._convex(ConvexPart(dented, cube.faces))
    assert hostile._refused((ConvexPart(cube.vertices, cube.faces),)) is None
    crumb = hostile._refused((ConvexPart(cube.vertices * 1e-6, cube.faces),))
    assert crumb is not None
    assert "MuJoCo" in crumb


def test_a_mistake_of_ours_is_a_crash_and_a_wrong_result_is_invalid(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hostile, "check_mesh", lambda mesh: 1 / 0)
    row = measure_mesh("validate", 0, seed=0)
    assert (row.outcome, row.why) == ("crash", "ZeroDivisionError: division by zero")
    monkeypatch.setattr(hostile, "check_mesh", lambda mesh: mesh)
    halved = trimesh.creation.box().slice_plane((0, 0, 0), (0, 0, 1))
    monkeypatch.setattr(hostile, "make_solid", lambda mesh: (halved, 0.0))
    assert measure_mesh("validate", 0, seed=0).outcome == "invalid"


@pytest.mark.slow
def test_crashes_and_hangs_of_a_process_are_figures_and_the_rest_goes_on(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(hostile, "_work", _crash_and_hang)
    monkeypatch.setattr(hostile, "_VALIDATION_LIMIT_S", 1.0)
    monkeypatch.setattr(hostile, "_MARGIN_S", 0.0)
    report: Any = bench_hostile(config=HostileConfig(4, 0), workers=2)
    assert report["bad"] == {"crash": 1, "hang": 1, "invalid": 0, "zombie": 0}
    assert report["outcomes"]["validate"] == {"crash": 1, "hang": 1, "valid": 2}


def _crash_and_hang(pipe: Any, seed: int) -> None:
    import os
    import time

    pipe.send("ready")
    while True:
        try:
            step, number = pipe.recv()
        except EOFError:
            return
        if number == 1:
            os.abort()
        if number == 2:
            time.sleep(60)
        pipe.send(HostileRow(step=step, number=number, kind=tuple(KINDS)[number], outcome="valid", s=0.0))


def test_a_run_that_was_stopped_goes_on_with_the_rows_it_lacks(tmp_path: Path):
    file = tmp_path / "hostile.json"
    words = ["bench", "hostile", "--coacd", "1", "--json", str(file)]
    codes = []
    for count, more in ((4, []), (6, ["--resume"])):
        with pytest.raises(SystemExit) as stop:
            main([*words, "--count", str(count), *more])
        codes.append(stop.value.code)
    report = json.loads(file.read_text())
    assert codes == [0, 0]
    assert report["done"] == {"validate": 6, "decompose": 1}
    assert sum(report["bad"][name] for name in BAD) == 0
    assert len(report["trials"]) == 7
    report["trials"][3] |= {"outcome": "crash", "why": "a mistake that has been mended"}
    mended: Any = bench_hostile(config=HostileConfig(6, 1), known=report)
    assert mended["bad"]["crash"] == 0
    report["trials"][3] = mended["trials"][3]
    again: Any = bench_hostile(config=HostileConfig(6, 1), known=report, progress=_none)
    assert again["trials"] == report["trials"]


def _none(stream: Any, total: int) -> Any:
    assert total == 0
    return stream


def test_the_exit_status_tells_of_what_went_wrong(monkeypatch: pytest.MonkeyPatch):
    wrong = {"rows": {}, "bad": {"crash": 1, "hang": 0}}
    monkeypatch.setattr(hostile, "bench_hostile", lambda **_: wrong)
    with pytest.raises(SystemExit) as stop:
        main(["bench", "hostile", "--count", "1"])
    assert stop.value.code == 1


def test_negative_counts_are_refused():
    with pytest.raises(InvalidOption):
        HostileConfig(-1, 0)
    with pytest.raises(InvalidOption, match="workers"):
        bench_hostile(workers=0)


def test_a_soup_of_which_joining_leaves_nothing_is_refused_by_name():
    with pytest.raises(InvalidMesh, match="no solid could be made"):
        make_solid(hostile_mesh(3286)[1])
