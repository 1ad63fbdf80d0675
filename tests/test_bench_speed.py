"""The benches of calls, with completions whose times, sizes and places are known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import l_shape
from clocks import SteadyClock
from scipy.spatial import KDTree

from gfp_grasp.bench import bench_resets, bench_speed, bench_stability, memory, speed
from gfp_grasp.bench.memory import peak_mb, resident_mb
from gfp_grasp.errors import InvalidOption
from gfp_grasp.register import FitConfig, icp_config, pcrnet_config
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import PointCloud

VIEWPOINT = np.array([0.3, 0.4, 0.5])


def cloud(count: int = 40) -> PointCloud:
    return PointCloud(np.random.default_rng(1).uniform(size=(count, 3)), VIEWPOINT)


@pytest.fixture
def folder(tmp_path):
    """A mug, a cup and a thing of no class."""
    for name, height in (("mug__a", 0.05), ("cup__b", 0.1), ("plain", 0.15)):
        trimesh.creation.box(bounds=[[0, 0, 0], [0.06, 0.04, height]]).export(tmp_path / f"{name}.ply")
    return tmp_path


@pytest.fixture
def seen(monkeypatch) -> list:
    """Heights and draws of the objects that were seen; each is seen as the same 40 points."""
    seen = []

    def view(mesh, rng, **how):
        seen.append((round(float(mesh.extents[2]), 3), float(rng.uniform()), how))
        return SimpleNamespace(cloud=cloud())

    monkeypatch.setattr(speed, "view_object", view)
    return seen


def test_a_completion_is_timed_to_its_mesh_and_to_its_parts(monkeypatch):
    asked = []

    def complete(points, **how):
        asked.append((points, how))
        return SimpleNamespace(timings_s={"detect": 0.125, "deform": 0.25}, parts=("part",))

    monkeypatch.setattr(speed, "complete_to_mesh", complete)
    monkeypatch.setattr(speed, "time", SteadyClock(0.5))
    one = cloud()
    assert speed._timed(one) == {"detect": 0.125, "deform": 0.25, "parts": 0.5, "total": 1.0}
    assert asked == [(one.points, {"viewpoint": one.viewpoint})]


def test_figures_are_medians_in_milliseconds():
    laps = [{"detect": d, "parts": 0.01, "total": t} for d, t in ((0.1, 1.0), (0.3, 2.0), (0.20012, 5.0))]
    assert speed._figures(laps) == {
        "median_ms": 2000.0,
        "p95_ms": 4700.0,
        "stages_ms": {"detect": 200.1, "parts": 10.0},
    }


def test_a_stage_that_an_answer_does_without_takes_it_no_time():
    laps = [{"detect": 0.1, "total": 0.2}, {"detect": 0.1, "classfree": 0.3, "total": 0.5}] * 2 + [
        {"detect": 0.1, "classfree": 0.4, "total": 0.5}
    ]
    stages = speed._figures(laps)["stages_ms"]
    assert stages == {"detect": 100.0, "classfree": 300.0}
    assert speed._figures(laps[:3])["stages_ms"]["classfree"] == 0.0


def test_clouds_of_three_sizes_are_timed_after_a_lap_that_loads_what_is_loaded_once(folder, seen, monkeypatch):
    timed, registered, remembered, watched = [], [], [], []

    def lap(one):
        timed.append(len(one.points))
        return {"detect": 1e-6 * len(one.points), "total": 1e-3 * len(one.points)}

    def watch(stream, total):
        watched.append(total)
        return stream

    monkeypatch.setattr(speed, "_timed", lap)
    monkeypatch.setattr(speed, "_registrations", lambda clouds: (registered.append(clouds), {"icp": 3.0})[1])
    monkeypatch.setattr(speed, "_memory", lambda *which: (remembered.append(which), "memory")[1])
    report = bench_speed(str(folder), limit=2, seed=4, progress=watch)
    assert report == {
        "objects": 2,
        "sizes": {
            str(n): {"median_ms": 1.0 * n, "p95_ms": 1.0 * n, "stages_ms": {"detect": n / 1000}}
            for n in (2000, 5000, 20_000)
        },
        "all": {"median_ms": 5000.0, "p95_ms": 20_000.0, "stages_ms": {"detect": 5.0}},
        "registration_ms": {"icp": 3.0},
    }
    assert timed == [40, 40, 2000, 2000, 5000, 5000, 20_000, 20_000]
    assert watched == [2, 2, 2]
    draws = [float(np.random.default_rng([4, number]).uniform()) for number in (0, 1)]
    assert seen == [(0.1, draws[0], {"protocol": "standard"}), (0.05, draws[1], {"protocol": "standard"})]
    assert [category for category, _ in registered[0]] == ["cup", "mug"]
    assert remembered == []
    assert bench_speed(str(folder), calls=7, progress=watch)["memory"] == "memory"
    (clouds, calls, progress) = remembered[0]
    assert ([len(one.points) for one in clouds], calls, progress) == ([40] * 3, 7, watch)
    assert timed[8:12] == [40, 40, 40, 2000]


@pytest.mark.parametrize("options", [{"limit": 0}, {"calls": -1}])
def test_a_bench_of_no_object_or_of_negative_calls_is_refused(options):
    with pytest.raises(InvalidOption, match="at least one object"):
        bench_speed("cup", **options)


def test_registrations_are_timed_on_the_same_evidence_class_given(monkeypatch):
    detected, fitted = [], []

    def detect(points, **how):
        detected.append((len(points), how))
        return how["category"]

    def fit(view, primitives, *, config):
        fitted.append((view, [(p.category, share) for p, share in primitives], config))

    monkeypatch.setattr(speed, "detect_single", detect)
    monkeypatch.setattr(speed, "make_level_view", lambda found: f"view of a {found}")
    monkeypatch.setattr(speed, "fit_best", fit)
    monkeypatch.setattr(speed, "time", SteadyClock(0.25))
    one = cloud()
    assert speed._registrations([("cup", one), ("mug", one)]) == {"icp": 250.0, "pcrnet": 250.0, "registration": 250.0}
    assert detected == [(40, {"viewpoint": one.viewpoint, "category": name}) for name in ("cup", "mug")]
    names, configs = ("cup", "cup", "mug"), (icp_config(), pcrnet_config(), FitConfig())
    assert fitted == [(f"view of a {name}", [(name, 0.0)], config) for config in configs for name in names]


@pytest.mark.parametrize(("calls", "measured"), [(3, 3), (10, 10), (25, 12)])
def test_memory_is_measured_about_ten_times(monkeypatch, calls, measured):
    asked, collected = [], []
    clouds = [PointCloud(np.full((4, 3), float(number)), VIEWPOINT + number) for number in range(3)]

    def complete(points, *, viewpoint):
        asked.append((points[0, 0], viewpoint[0] - VIEWPOINT[0]))
        return SimpleNamespace(mesh=l_shape())

    def watch(stream, total):
        assert total == calls
        return stream

    monkeypatch.setattr(speed, "complete_to_mesh", complete)
    monkeypatch.setattr(speed, "resident_mb", lambda: float(len(asked)))
    monkeypatch.setattr(speed.gc, "collect", lambda: collected.append(len(asked)))
    report = speed._memory(clouds, calls, watch)
    every = max(1, calls // 10)
    assert report == {"calls": calls, "rss_mb": [float(every * (i + 1)) for i in range(measured)]}
    assert collected == report["rss_mb"]
    assert asked == [(pytest.approx(n % 3), pytest.approx(n % 3)) for n in range(calls)]


def test_a_cloud_is_thinned_by_drawing_and_filled_between_neighbours():
    few = cloud(300)
    same = speed._of_size(few, 300)
    assert sorted(map(tuple, same.points)) == sorted(map(tuple, few.points))
    thinned = speed._of_size(few, 120)
    assert len(np.unique(thinned.points, axis=0)) == 120
    assert KDTree(few.points).query(thinned.points)[0].max() == 0.0
    filled = speed._of_size(few, 5000)
    np.testing.assert_array_equal(filled.points[:300], few.points)
    assert len(np.unique(filled.points, axis=0)) == 5000
    for made in (thinned, filled):
        np.testing.assert_array_equal(made.viewpoint, VIEWPOINT)
    # Each new point lies on the way from a point to one of its three nearest neighbours.
    ways = []
    near = np.asarray(KDTree(few.points).query(few.points, k=5)[1])
    for number, point in enumerate(few.points):
        ways += [(point, few.points[other], rank) for rank, other in enumerate(near[number][1:], start=1)]
    starts, ends = (np.array([way[i] for way in ways]) for i in (0, 1))
    ranks = np.array([way[2] for way in ways])
    used, along = [], []
    for point in filled.points[300:1300]:
        t = np.einsum("ni,ni->n", point - starts, ends - starts) / np.einsum("ni,ni->n", ends - starts, ends - starts)
        apart = np.linalg.norm(starts + np.clip(t, 0, 1)[:, None] * (ends - starts) - point, axis=1)
        assert apart.min() < 1e-12
        used.append(ranks[apart < 1e-12].min())
        along.append(t[apart.argmin()])
    assert set(used) == {1, 2, 3}
    assert min(along) == pytest.approx(0.2, abs=0.01)  # not so near to either that it says nothing new
    assert max(along) == pytest.approx(0.8, abs=0.01)


def test_memory_is_told_in_megabytes(monkeypatch, tmp_path):
    told = tmp_path / "statm"
    told.write_text("9000 2500 300 1 0 400 0\n")
    asked = []
    monkeypatch.setattr(memory, "Path", lambda name: (asked.append(name), told)[1])
    monkeypatch.setattr(memory.resource, "getpagesize", lambda: 4096)
    assert resident_mb() == 10.2
    assert asked == ["/proc/self/statm"]
    told.unlink()
    monkeypatch.setattr(memory.resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=123_456.0))
    for system, expected in (("linux", 123.5), ("darwin", 0.1)):
        monkeypatch.setattr(memory, "sys", SimpleNamespace(platform=system))
        assert resident_mb() == peak_mb() == expected


def test_the_most_memory_stays_when_it_was_given_back():
    block = np.ones(30_000_000)  # 240 MB
    del block
    assert peak_mb() > resident_mb() + 200


class Env:
    """An environment of three objects; what it was made of and asked."""

    made: list[Any]

    def __init__(self, **options: Any) -> None:
        self.options, self.sources, self.resets, self.closed = options, ["a", "b", "c"], [], False
        Env.made.append(self)

    def reset(self, **how: Any) -> None:
        self.resets.append(how)

    def close(self) -> None:
        self.closed = True


def test_memory_is_measured_at_ten_points_of_a_run_of_resets(monkeypatch):
    Env.made = []
    watched = []
    monkeypatch.setattr(speed, "GfpGraspEnv", Env)
    monkeypatch.setattr(speed, "time", SteadyClock(0.5))
    monkeypatch.setattr(speed, "resident_mb", lambda: len(Env.made[0].resets) - 3)
    report = bench_resets(
        "cup",
        resets=25,
        completer="gfs",
        limit=8,
        seed=5,
        clutter=2,
        progress=lambda stream, total: (watched.append((stream, total)), stream)[1],
    )
    small = {"image_width": 120, "image_height": 90, "num_points": 256}
    chosen = {"completer": "gfs", "limit": 8, **small, "clutter": 2}
    assert report == {
        "settings": {"objects": "cup", **chosen, "num_objects": 3, "resets": 25, "seed": 5},
        "rss_mb": [2, 5, 7, 10, 12, 15, 17, 20, 22, 25],
        "resets_per_s": 2.0,
    }
    (env,) = Env.made
    assert env.options == {"objects": "cup", **chosen}
    assert env.resets == [
        *({"seed": 5, "options": {"object": number}} for number in range(3)),
        {"seed": 5},
        *[{"seed": None}] * 24,
    ]
    assert env.closed
    assert watched == [(range(1, 26), 25)]
    assert bench_resets("cup", resets=10, num_points=64)["settings"]["num_points"] == 64


def test_motions_are_shared_out_over_the_objects_of_known_classes(folder, monkeypatch):
    jobs = []

    def stability(job, *, seed):
        source, motions, number = job
        jobs.append((source.name, motions, number, seed))
        return number != 1, np.array([0.5, 2.0, 0.1, 0.2, 0.3][:motions])

    monkeypatch.setattr(speed, "_stability", stability)
    report = bench_stability(str(folder), motions=9, seed=3)
    assert jobs == [("b", 5, 0, 3), ("a", 4, 1, 3)]
    assert report == {
        "objects": 2,
        "same_bits": False,
        "motions": 9,
        "moved_mm": [0.3, 2.0, 2.0],
        "share_within_1_mm": 0.7778,
    }
    assert bench_stability(str(folder), motions=1, limit=1)["same_bits"]
    for wrong in ({"motions": 0}, {"limit": 0}):
        with pytest.raises(InvalidOption, match="at least one of each"):
            bench_stability(str(folder), **wrong)


def drifting(monkeypatch, offset_m: float) -> list:
    """Completions that move with the cloud, each later one farther along x by an offset; the clouds."""
    asked: list = []

    def complete(points, *, viewpoint):
        asked.append((points, viewpoint))
        mesh = l_shape()
        # The frame of three points of the cloud, so that the answer moves as the cloud does.
        x = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
        z = np.array([0.0, 0.0, 1.0])
        x = x - x[2] * z
        x /= np.linalg.norm(x)
        T = make_T(np.column_stack([x, np.cross(z, x), z]), points[0])
        shift = make_T(None, (offset_m * max(0, len(asked) - 2), 0.0, 0.0))
        mesh.apply_transform(T @ shift)
        return SimpleNamespace(mesh=mesh)

    monkeypatch.setattr(speed, "complete_to_mesh", complete)
    return asked


def test_a_completion_that_moves_with_its_cloud_is_stable(folder, seen, monkeypatch):
    asked = drifting(monkeypatch, 0.0)
    source = speed.load_objects(str(folder))[0]
    same, moved_mm = speed._stability((source, 3, 7), seed=2)
    assert same
    assert moved_mm.shape == (3,)
    np.testing.assert_allclose(moved_mm, 0.0, atol=1e-6)
    rng = np.random.default_rng([2, 7])
    assert seen == [(0.1, float(rng.uniform()), {})]
    for points, place in asked[2:]:  # a turn about up and a move by up to 2 m, viewpoint and all
        T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), rng.uniform(-2, 2, 3))
        np.testing.assert_allclose(points, apply_T(T, cloud().points))
        np.testing.assert_allclose(place, apply_T(T, VIEWPOINT))
    for points, place in asked[:2]:
        np.testing.assert_array_equal(points, cloud().points)
        np.testing.assert_array_equal(place, VIEWPOINT)


def test_a_completion_that_does_not_is_told_by_how_much(folder, seen, monkeypatch):
    drifting(monkeypatch, 0.001)
    same, moved_mm = speed._stability((speed.load_objects(str(folder))[0], 2, 0), seed=2)
    assert same
    assert 0.2 < moved_mm[0] < 1.0  # of a millimetre along x, faces that look along y and z tell nothing
    assert moved_mm[1] == pytest.approx(2 * moved_mm[0], rel=0.02)


def test_the_distance_of_two_surfaces_is_the_mean_of_both_ways():
    small, large = trimesh.creation.box((0.02, 0.02, 0.02)), trimesh.creation.box((0.04, 0.04, 0.04))
    one_way, other_way = 0.01, np.sqrt(3) * 0.01  # from face to face, and from corner to corner
    assert speed._apart_m(small, large) == pytest.approx((one_way + other_way) / 2)
