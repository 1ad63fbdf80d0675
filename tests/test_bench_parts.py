"""The bench of convex parts, on an L whose parts are known."""

from dataclasses import asdict
from typing import Any

import mujoco  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import pytest
from bodies import box_part, l_parts, l_shape
from clocks import SteadyClock

from gfp_grasp.bench import bench_collision, collision
from gfp_grasp.bench.collision import METHODS, PartsRow, held_steps_per_s
from gfp_grasp.collision import DecomposeConfig
from gfp_grasp.completion import Completion
from gfp_grasp.errors import FitDiverged, InvalidMesh
from gfp_grasp.transforms import make_T
from gfp_grasp.types import CollisionMesh, CompletedShape, Grasp, PointCloud

BAR, STUB = l_parts()
GRASP = Grasp(make_T(None, (0.05, 0.01, 0.2)), 0.03)
VIEWPOINT = np.array([0.3, 0.4, 0.5])


def made(parts: Any, by: Any) -> CollisionMesh:
    return CollisionMesh(tuple(parts), (0.0, 0.0, 0.0), by, 0.0)


@pytest.fixture
def folder(tmp_path):
    """An L of a known class and a box of none."""
    l_shape().export(tmp_path / "mug__ell.ply")
    box_part([0, 0, 0], [0.02, 0.03, 0.04]).to_trimesh().export(tmp_path / "plain.ply")
    return tmp_path


@pytest.fixture
def asked(monkeypatch) -> dict[str, list]:
    """The bench without a camera, a network or an engine; what each of them was asked."""
    asked: dict[str, list] = {"seen": [], "completed": [], "planned": [], "decomposed": [], "carried": [], "held": []}

    class View:
        cloud = PointCloud(np.arange(30.0).reshape(10, 3), VIEWPOINT)

    def view_object(mesh, rng):
        asked["seen"].append((mesh.extents.round(3).tolist(), float(rng.uniform())))
        return View()

    def complete(points, **how):
        asked["completed"].append((points, how))
        mesh = l_shape()
        shape = CompletedShape(mesh, np.ones(len(mesh.vertices), bool), np.zeros(len(mesh.vertices)))
        return Completion(shape, None)  # type: ignore[arg-type]

    def carried(shape):
        asked["carried"].append(shape.mesh.volume)
        return made([BAR, STUB], "carried")

    def decomposed(mesh, *, config):
        asked["decomposed"].append((round(float(mesh.volume), 9), config))
        if config.threshold == 0.02:
            raise InvalidMesh("it is too thin")
        return made([BAR], "coacd")

    def plan(completion, **how):
        asked["planned"].append(how)
        return (GRASP,)

    def held(parts, grasp):
        asked["held"].append((len(parts), grasp))
        return 1000.0 * len(parts)

    fakes = {
        "view_object": view_object,
        "complete_to_mesh": complete,
        "collision_of": carried,
        "decompose": decomposed,
        "plan_grasps": plan,
        "held_steps_per_s": held,
        "time": SteadyClock(0.25),
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(collision, name, fake)
    return asked


def test_each_method_is_measured_on_the_completed_mesh_and_on_the_true_one(folder, asked):
    report = bench_collision(str(folder), truth=True, seed=3)
    assert report["settings"] == {
        "objects": folder.name,
        "num_objects": 2,
        "seed": 3,
        "methods": ["carried", "coacd_0.05", "coacd_0.02", "vhacd", "hull"],
    }
    trials = report["trials"]
    assert [(t["mesh"], t["object"], t["category"], t["method"]) for t in trials] == [
        (mesh, name, category, method)
        for name, category in (("ell", "mug"), ("plain", ""))
        for mesh, methods in (("completed", METHODS), ("true", METHODS[1:]))
        for method in methods
    ]
    carried, coarse, failed, vhacd, whole = trials[:5]
    assert failed == {
        **{"mesh": "completed", "object": "ell", "category": "mug", "method": "coacd_0.02"},
        "failed": "InvalidMesh: it is too thin",
    }
    assert [row["made_by"] for row in (carried, coarse, vhacd, whole)] == ["carried", "coacd", "coacd", "hull"]
    assert [row["ms"] for row in (carried, coarse, vhacd, whole)] == [250.0] * 4
    assert [(row["parts"], row["vertices"]) for row in (carried, coarse, whole)] == [(2, 16), (1, 8), (1, 10)]
    assert [row["steps_per_s"] for row in (carried, coarse, whole)] == [2000.0, 1000.0, 1000.0]
    assert carried["iou"] == pytest.approx(1.0, abs=1e-3)
    assert coarse["iou"] == pytest.approx(40 / 56, abs=0.01)  # volumes of the bar and of the L, cm^3
    assert whole["iou"] == pytest.approx(28 / 44, abs=0.01)  # areas of the L and of its hull, cm^2
    assert len(carried["error_mm"]) == 3
    assert max(carried["error_mm"][:2]) < 0.01
    assert carried["error_mm"][2] < 1.0
    assert coarse["error_mm"][2] == pytest.approx(40.0, abs=1.0)  # the stub's end is so far from the bar
    assert all("steps_per_s" not in row for row in trials if row["mesh"] == "true")
    assert set(report["rows"]) == {"completed", "true"}
    assert set(report["rows"]["completed"]) == {"mug", "", "all"}
    assert report["ratio"] == {"mug": 1.0, "": 1.0, "all": 1.0}


def test_the_same_view_seed_and_engines_are_asked_for(folder, asked):
    bench_collision(str(folder), seed=3)
    draws = [float(np.random.default_rng([3, number]).uniform()) for number in (0, 1)]
    assert asked["seen"] == [([0.1, 0.06, 0.02], draws[0]), ([0.02, 0.03, 0.04], draws[1])]
    for points, how in asked["completed"]:
        np.testing.assert_array_equal(points, np.arange(30.0).reshape(10, 3))
        assert list(how) == ["viewpoint"]
        np.testing.assert_array_equal(how["viewpoint"], VIEWPOINT)
    assert asked["planned"] == [{"num": 1, "seed": 3}] * 2
    assert len(asked["carried"]) == 4  # once before it is measured, once measured, for each object
    assert [config for _, config in asked["decomposed"][:3]] == [
        DecomposeConfig(threshold=0.05, cache=False),
        DecomposeConfig(threshold=0.02, cache=False),
        DecomposeConfig(engine="vhacd", max_convex_hull=64, cache=False),
    ]
    assert {grasp for _, grasp in asked["held"]} == {GRASP}


def test_an_object_that_is_not_completed_has_rows_of_its_true_mesh_alone(folder, asked, monkeypatch):
    def fails(points, **how):
        raise FitDiverged("nothing fits")

    monkeypatch.setattr(collision, "complete_to_mesh", fails)
    assert bench_collision(str(folder), methods=("carried", "hull"), limit=1)["trials"] == []
    report = bench_collision(str(folder), methods=("carried", "hull"), limit=1, truth=True)
    assert [(t["object"], t["mesh"], t["method"]) for t in report["trials"]] == [("ell", "true", "hull")]
    assert report["ratio"] == {}


def test_the_same_seed_counts_the_same_places(asked, monkeypatch):
    counted = []
    within = collision.within_parts
    monkeypatch.setattr(
        collision, "within_parts", lambda places, parts: (counted.append(places), within(places, parts))[1]
    )
    first, again, other = (collision._measure(l_shape(), lambda: made([BAR], "cuts"), (), seed) for seed in (5, 5, 6))
    assert first == again != other
    assert [len(places) for places in counted] == [40_000] * 3
    np.testing.assert_allclose(counted[0].min(axis=0), [0, 0, 0], atol=1e-4)
    np.testing.assert_allclose(counted[0].max(axis=0), [0.1, 0.06, 0.02], atol=1e-4)
    assert (first["made_by"], first["steps_per_s"]) == ("cuts", None)


def test_places_are_counted_wherever_parts_stand_out_of_the_mesh():
    apart = box_part([0.2, 0, 0], [0.24, 0.02, 0.02])
    box = box_part([0, 0, 0], [0.04, 0.02, 0.02]).to_trimesh()
    assert collision._iou([apart], box, np.random.default_rng(0)) == 0.0
    half = box_part([0.02, 0, 0], [0.06, 0.02, 0.02])
    assert collision._iou([half], box, np.random.default_rng(0)) == pytest.approx(1 / 3, abs=0.01)


def test_steps_are_timed_after_the_jaws_have_closed(monkeypatch):
    steps, models = [], []

    def step(model, data, count):
        models.append((model, data.ctrl.copy(), data.time))
        steps.append(count)
        data.time += count * model.opt.timestep

    class Mujoco:
        mj_step = staticmethod(step)

    monkeypatch.setattr(collision, "mujoco", Mujoco)
    monkeypatch.setattr(collision, "time", SteadyClock(0.5))
    placed = []

    class Seen(collision.Handles):
        def place(self, T, opening):
            placed.append(opening)
            super().place(T, opening)

        def set_opening(self, opening):
            placed.append(opening)
            super().set_opening(opening)

    monkeypatch.setattr(collision, "Handles", Seen)
    assert held_steps_per_s((BAR, STUB), GRASP) == 800.0
    assert held_steps_per_s((BAR, STUB), GRASP, steps=30) == 60.0
    assert steps == [400, 400, 30, 30]
    assert placed == pytest.approx([0.04, 0.0] * 2)
    model = models[0][0]
    assert isinstance(model, mujoco.MjModel)  # pyright: ignore[reportAttributeAccessIssue]
    assert 0.2 in model.body_mass.round(6)
    assert 0.8 in model.geom_friction[:, 0].round(6)


def test_figures_of_failures_alone_are_counts():
    failed = PartsRow(mesh="true", object="a", category="cup", method="hull", failed="InvalidMesh: flat")
    assert collision._figures([failed, failed]) == {"objects": 2, "failed": 2}
    row = PartsRow(mesh="true", object="a", category="cup", method="hull", ms=1.0, parts=1, vertices=8, iou=0.5)
    done = PartsRow(**{**asdict(row), "error_mm": (1.0, 2.0, 9.0)})
    figures = collision._figures([failed, done])
    assert figures == {
        **{"objects": 2, "failed": 1, "ms": 1.0, "parts": 1.0, "vertices": 8.0, "iou": 0.5},
        **{"error_mm": [1.0, 2.0], "steps_per_s": None},
    }
