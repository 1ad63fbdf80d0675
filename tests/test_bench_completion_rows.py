"""Rows of the bench of completions, for answers whose errors are known."""

import hashlib
import zlib
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import box_part
from clocks import SteadyClock
from toy_bodies import refined

from gfp_grasp.bench import CompletionConfig, bench_completion, completion
from gfp_grasp.bench.methods import Answer, ObjectView
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import CategorySpec, OptionalPart, PointCloud

METHODS = ("partial", "told-icp", "registration", "gfs", "gfpnet")
VIEWPOINT = np.array([1.0, 0.6, 0.9])


def block(low=(0.0, 0.0, 0.0), high=(0.1, 0.06, 0.08), edge_m=0.008) -> trimesh.Trimesh:
    return refined(box_part(list(low), list(high)).to_trimesh(), edge_m)


def view(mesh: trimesh.Trimesh, points: np.ndarray | None = None) -> ObjectView:
    """The three sides of a block that the viewpoint sees, or some points."""
    if points is None:
        all_points, normals, _ = sample_surface(mesh, 20_000, np.random.default_rng(0))
        points = all_points[np.einsum("ni,ni->n", VIEWPOINT - all_points, normals) > 0]
    return ObjectView(mesh, np.eye(4), PointCloud(points, VIEWPOINT))


def answer(mesh: trimesh.Trimesh, observed: np.ndarray, sigma_m: np.ndarray) -> Answer:
    done: Any = SimpleNamespace(mesh=mesh, observed=observed, sigma_m=sigma_m, category="mug")
    return Answer(mesh, done)


def seen_sides(mesh: trimesh.Trimesh) -> np.ndarray:
    """Vertices within the three sides that the viewpoint sees, off the edges."""
    v, (low, high) = mesh.vertices, mesh.bounds
    inner = ((v > low + 1e-6).sum(axis=1) + (v < high - 1e-6).sum(axis=1)) == 5
    return inner & (v > high - 1e-6).any(axis=1)


def calibration(mesh, observed, sigma_m, one) -> dict[str, float]:
    return completion._calibration(answer(mesh, observed, sigma_m).completion, one, np.random.default_rng(0))  # type: ignore[arg-type]


def test_a_true_answer_that_marks_what_was_seen_is_right_everywhere():
    mesh = block()
    observed = seen_sides(mesh)
    found = calibration(mesh, observed, np.full(len(mesh.vertices), 0.01), view(mesh))
    assert found["seen_precision"] == 1.0
    assert found["seen_recall"] > 0.7  # edges were seen as well
    assert found["two_sigma"] == 1.0
    assert found["sigma_rank"] == 0.0


def test_precision_and_recall_tell_of_vertices_that_are_marked_wrongly():
    mesh = block()
    right = seen_sides(mesh)
    sure = np.full(len(mesh.vertices), 0.01)
    all_seen = calibration(mesh, np.ones_like(right), sure, view(mesh))
    none_seen = calibration(mesh, np.zeros_like(right), sure, view(mesh))
    assert 0.4 < all_seen["seen_precision"] < 0.7
    assert all_seen["seen_recall"] == 1.0
    assert (none_seen["seen_precision"], none_seen["seen_recall"]) == (0.0, 0.0)
    blind = calibration(mesh, right, sure, view(mesh, np.full((3, 3), 9.0)))
    assert (blind["seen_precision"], blind["seen_recall"]) == (0.0, 0.0)


@pytest.mark.parametrize(("away_m", "seen"), [(0.008, True), (0.013, False)])
def test_a_place_counts_as_seen_where_a_point_came_back_within_a_centimetre(away_m, seen):
    mesh = block()
    top = seen_sides(mesh) & (mesh.vertices[:, 2] > 0.079)
    grid = np.stack(np.meshgrid(np.linspace(0, 0.1, 60), np.linspace(0, 0.06, 40)), -1).reshape(-1, 2)
    points = np.column_stack([grid, np.full(len(grid), 0.08 + away_m)])
    found = calibration(mesh, top, np.full(len(top), 0.01), view(mesh, points))
    assert (found["seen_precision"] > 0.95) == seen
    assert (found["seen_precision"] < 0.05) != seen


def test_sigma_is_compared_with_the_distance_across_the_true_surface():
    """Each side of the answer is 1 to 6 mm off, and sigma is a half more than half of that: all within two sigma."""
    true = block()
    off = {(axis, end): 1e-3 * (1 + 2 * axis + end) for axis in range(3) for end in range(2)}
    low = true.bounds[0] - [off[axis, 0] for axis in range(3)]
    high = true.bounds[1] + [off[axis, 1] for axis in range(3)]
    mesh = block(low, high)
    side = np.full(len(mesh.vertices), np.nan)
    for (axis, end), away in off.items():
        side[np.abs(mesh.vertices[:, axis] - (low, high)[end][axis]) < 1e-6] = away
    observed = np.ones(len(side), bool)
    found = calibration(mesh, observed, 0.75 * side, view(true))
    assert found["sigma_rank"] > 0.8
    assert found["two_sigma"] > 0.9
    assert calibration(mesh, observed, 0.3 * side, view(true))["two_sigma"] < 0.35
    assert calibration(mesh, observed, 1.0 / side, view(true))["sigma_rank"] < -0.8


def test_both_sides_of_a_thin_wall_are_told_apart():
    """A wall of 3 mm whose front alone was seen: no vertex of its back counts, near as it is."""
    wall = block((0, 0, 0), (0.003, 0.06, 0.08))
    front = wall.vertices[:, 0] > 0.002
    found = calibration(wall, front, np.full(len(front), 0.01), view(wall))
    back = calibration(wall, ~front, np.full(len(front), 0.01), view(wall))
    assert found["seen_precision"] > 0.9
    assert back["seen_precision"] < 0.25  # the upper and the right edge


@pytest.mark.parametrize(("b", "rank"), [([1, 2, 30], 1.0), ([9, 5, 0], -1.0), ([1, 1, 1], 0.0), ([1, 5, 2], 0.5)])
def test_ranks_are_correlated_whatever_the_values(b, rank):
    assert completion._rank_correlation(np.array([0.1, 0.2, 0.9]), np.array(b)) == pytest.approx(rank)
    assert completion._rank_correlation(np.ones(3), np.array(b)) == 0.0


def test_an_answer_is_compared_with_the_truth_by_surface_size_and_volume():
    true, wider = block(edge_m=1.0), block(high=(0.12, 0.06, 0.08), edge_m=1.0)
    one, rng = view(true), np.random.default_rng
    surface = sample_surface(true, 8192, rng(1))[0]
    same = completion._errors(Answer(true), one, surface, rng(2))
    assert set(same) == {"cd_m", "f_score", "scale_error", "iou"}
    assert same["cd_m"] == pytest.approx(2 * 0.5 * (true.area / 8192) ** 0.5, rel=0.05)  # of even samples, both ways
    assert (same["f_score"], same["scale_error"], same["iou"]) == (1.0, 0.0, 1.0)
    other = completion._errors(Answer(wider), one, surface, rng(2))
    assert other["scale_error"] == round(1.2 ** (1 / 3) - 1, 5)
    assert other["iou"] == round(1 / 1.2, 5)
    assert other["cd_m"] > same["cd_m"] + 0.001
    points = completion._errors(Answer(surface), one, surface, rng(2))
    assert (points["cd_m"], points["f_score"]) == (0.0, 1.0)
    assert set(points) == {"cd_m", "f_score", "scale_error"}
    open_box = true.copy()
    open_box.update_faces(np.arange(len(true.faces)) > 1)
    assert "iou" not in completion._errors(Answer(open_box), one, surface, rng(2))
    whole = completion._errors(answer(true, np.ones(8, bool), np.ones(8)), one, surface, rng(2))
    assert whole["class_found"] == "mug"
    assert set(whole) - set(same) == {"class_found", "seen_precision", "seen_recall", "sigma_rank", "two_sigma"}


@pytest.fixture
def folder(tmp_path):
    """Two mugs, a cup, and a thing of no class."""
    for name, height in (("mug__a", 0.05), ("mug__b", 0.06), ("cup__c", 0.1), ("plain", 0.15)):
        box_part([0, 0, 0], [0.06, 0.04, height]).to_trimesh().export(tmp_path / f"{name}.ply")
    return tmp_path


@pytest.fixture
def asked(monkeypatch) -> dict[str, list]:
    """The bench without views and methods; what was asked. Method number m is m mm off, the last has no answer."""
    asked: dict[str, list] = {"views": [], "sampled": [], "methods": [], "errors": []}

    def view_object(mesh, rng, **how):
        asked["views"].append((round(float(mesh.extents[2]), 3), float(rng.uniform()), how))
        return SimpleNamespace(mesh=mesh, number=len(asked["views"]))

    def samples(mesh, count, rng):
        asked["sampled"].append((count, float(rng.uniform())))
        return "truth"

    def run(method, one, told, category, *, library):
        asked["methods"].append((method, one.number, told, category, library))
        if method == "gfpnet":
            raise FitDiverged("nothing fits")
        return method

    def errors(found, one, truth, rng):
        asked["errors"].append((found, one.number, truth, float(rng.uniform())))
        return {"cd_m": 0.001 * METHODS.index(found), "f_score": 0.5, "iou": 0.25}

    fakes = {"view_object": view_object, "visible_surface": samples, "run_method": run, "_errors": errors}
    for name, fake in {**fakes, "time": SteadyClock(0.5)}.items():
        monkeypatch.setattr(completion, name, fake)
    return asked


CONFIG = CompletionConfig(views=2, seed=5, limit=2, noise_m=0.002, protocol="noisy")


def test_every_object_is_seen_by_every_method_in_every_view(folder, asked):
    report = bench_completion(str(folder), methods=METHODS, config=CONFIG)
    assert report["settings"] == {
        "objects": ["c", "a"],
        "samples": 8192,
        **{"views": 2, "seed": 5, "split": "test", "limit": 2, "give_category": False, "noise_m": 0.002},
        "protocol": "noisy",
    }
    objects = (("c", "cup"), ("a", "mug"))
    done = {"f_score": 0.5, "iou": 0.25}
    assert report["trials"] == [
        {"object": name, "category": category, "view": number, "method": method, "ms": 500.0}
        | (
            {"cd_m": None, "f_score": 0.0, "error": "FitDiverged"}
            if method == "gfpnet"
            else {"cd_m": 0.001 * METHODS.index(method), **done}
        )
        for name, category in objects
        for number in (0, 1)
        for method in METHODS
    ]
    assert list(report["rows"]) == list(report["paired"]) == ["cup", "mug", "all"]
    assert all(tuple(rows) == METHODS for rows in report["rows"].values())
    assert (report["rows"]["cup"]["gfs"]["views"], report["rows"]["all"]["gfs"]["views"]) == (2, 4)
    assert list(report["paired"]["all"]) == ["gfs", "gfpnet"]
    assert report["paired"]["all"]["gfs"]["gain_m"] == -0.001
    assert report["paired"]["all"]["gfpnet"] == {"pairs": 0}
    assert report["paper_table_one"]["PCRNet"]["cup"]["paper_m"] == 0.109


def test_views_samples_and_errors_are_drawn_from_seed_view_object_and_method(folder, asked):
    bench_completion(str(folder), methods=METHODS, config=CONFIG)
    names = [(name, view) for name in "ca" for view in (0, 1)]
    seeds = [[5, view, int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "little")] for name, view in names]
    draws = [np.random.default_rng(seed).uniform(size=2).tolist() for seed in seeds]
    how = {"protocol": "noisy", "noise_m": 0.002, "hidden_share": 0.5}
    heights = (0.1, 0.1, 0.05, 0.05)
    assert asked["views"] == [(h, first, how) for h, (first, _) in zip(heights, draws, strict=True)]
    assert asked["sampled"] == [(8192, second) for _, second in draws]
    expected = [
        (method, number + 1, "truth", float(np.random.default_rng([*seed, zlib.crc32(method.encode())]).uniform()))
        for number, seed in enumerate(seeds)
        for method in METHODS[:-1]
    ]
    assert asked["errors"] == expected


@pytest.mark.parametrize("give", [False, True])
def test_methods_are_told_the_class_where_the_config_says_so(folder, asked, give):
    config = CompletionConfig(views=1, limit=1, give_category=give)
    bench_completion(str(folder), methods=("gfs",), config=config)
    assert [(method, told, category) for method, _, told, category, _ in asked["methods"]] == [
        ("gfs", "cup" if give else None, "cup")
    ]
    assert asked["methods"][0][4].categories == completion.PrimitiveLibrary.shipped().categories


def test_rows_of_an_earlier_run_are_kept_under_their_names_of_today(folder, asked):
    first = bench_completion(str(folder), methods=("partial", "told-icp"), config=CONFIG)
    for row in first["trials"]:
        row["method"] = {"told-icp": "icp"}.get(row["method"], row["method"])
        row["ms"] = 1.5
    asked["methods"].clear()
    again = bench_completion(str(folder), methods=("gfs", "partial"), config=CONFIG, known=first)
    assert list(again["rows"]["all"]) == ["partial", "told-icp", "gfs"]
    assert [method for method, *_ in asked["methods"]] == ["gfs"] * 4
    assert [row["ms"] for row in again["trials"][:3]] == [1.5, 1.5, 500.0]
    assert again["paired"] == {"cup": {}, "mug": {}, "all": {}}
    asked["methods"].clear()
    for changed in ({**first, "settings": {**first["settings"], "seed": 6}}, {"trials": first["trials"]}):
        assert len(bench_completion(str(folder), methods=("gfs",), config=CONFIG, known=changed)["trials"]) == 4


def test_the_folders_of_ones_own_primitives_are_named_in_the_settings(folder, asked, monkeypatch):
    shipped = completion.PrimitiveLibrary.shipped()
    library = SimpleNamespace(categories=("mug",), folders=(shipped.folders[0], folder / "mine"))
    options = []
    fake = SimpleNamespace(from_option=lambda option: (options.append(option), library)[1])
    monkeypatch.setattr(completion, "PrimitiveLibrary", fake)
    report = bench_completion(str(folder), methods=("gfs",), config=CompletionConfig(views=1, gps="mine"))
    assert report["settings"]["gps"] == ["mine"]
    assert report["settings"]["objects"] == ["a", "b", "plain"]
    assert options == ["mine"] * 4
    assert all(library_of is library for *_, library_of in asked["methods"])


def test_no_view_is_refused():
    with pytest.raises(InvalidOption, match="views is 0"):
        CompletionConfig(views=0)
    assert CompletionConfig(views=1).gps == ""


def test_what_has_a_part_that_tells_its_class_is_right_under_its_own_name_alone():
    known: dict[str, Any] = {"size_range_m": ((0.05, 0.05, 0.1), (0.1, 0.1, 0.2)), "alike": ("mug", "glass")}
    assert completion._right_classes(CategorySpec("cup", **known)) == {"cup", "mug", "glass"}
    told = CategorySpec("pitcher", **known, optional_parts=(OptionalPart("handle"),))
    assert completion._right_classes(told) == {"pitcher"}
