"""What an engine is asked for attempt by attempt, with an engine in its place that tells what it was asked."""

import numpy as np
import pytest
import trimesh
from bodies import l_parts, l_shape

from gfp_grasp.collision import DecomposeConfig, attempts, decompose, hull
from gfp_grasp.collision.attempts import _variation
from gfp_grasp.collision.engines.guard import ChildLostError
from gfp_grasp.errors import DecompositionFailed

L, PARTS = l_shape(), l_parts()
DIAGONAL_M = float(np.linalg.norm([0.1, 0.06, 0.02]))


class Engine:
    """Loses the attempts that it is told to lose, then gives hulls."""

    def __init__(self, monkeypatch, *, lost=(), hulls=PARTS, memory_limit=True, unknown=()):
        self.asked: list[dict] = []
        self._lost, self._hulls = list(lost), hulls
        self._said = {"memory_limit": memory_limit, "unknown_options": list(unknown)}
        monkeypatch.setattr(attempts, "run_guarded", self.run)

    def run(self, vertices, faces, options, **limits):
        self.asked.append({"vertices": vertices, "options": options, **limits})
        if self._lost:
            raise ChildLostError("lost", out_of_time=self._lost.pop(0) == "time")
        return [(part.vertices, part.faces) for part in self._hulls], self._said

    def thresholds(self) -> list[float]:
        return [asked["options"]["threshold"] for asked in self.asked]


def config(**options) -> DecomposeConfig:
    return DecomposeConfig(cache=False, **options)


def test_an_attempt_is_as_asked_then_jittered_then_coarser_then_remeshed():
    asked = config(threshold=0.05, mcts_iterations=999, mcts_nodes=30, resolution=5000)
    tried = [_variation(L, asked, step) for step in range(4)]
    moved = [np.abs(vertices - L.vertices).max() / DIAGONAL_M for vertices, _ in tried]
    assert moved[0] == 0
    for step in (1, 2, 3):
        assert 0.5e-6 * step < moved[step] <= 1e-6 * step
    options = [options for _, options in tried]
    assert options[0] == options[1] == {**asked.coacd_options(), "preprocess_mode": "off"}
    assert [option["threshold"] for option in options] == pytest.approx([0.05, 0.05, 0.075, 0.1125])
    assert [option["preprocess_mode"] for option in options] == ["off", "off", "off", "on"]
    searches = [(option["mcts_nodes"], option["mcts_iterations"], option["resolution"]) for option in options]
    assert searches == [(30, 999, 5000)] * 2 + [(10, 60, 1000)] * 2
    again = _variation(L, asked, 1)[0]
    np.testing.assert_array_equal(again, tried[1][0])
    assert np.abs(_variation(L, config(seed=1), 1)[0] - again).max() > 0


def test_a_coarser_threshold_is_a_share_and_ends_at_one_but_in_metres_it_does_not():
    assert _variation(L, config(threshold=0.8), 3)[1]["threshold"] == 1.0
    assert _variation(L, config(threshold=0.8, real_metric=True), 3)[1]["threshold"] == pytest.approx(1.8)


@pytest.mark.parametrize("mode", ["on", "off"])
def test_a_mode_that_was_asked_for_is_kept_until_only_remeshing_is_left(mode: str):
    modes = [_variation(L, config(preprocess_mode=mode), step)[1]["preprocess_mode"] for step in range(4)]
    assert modes == [mode, mode, mode, "on"]


def test_vhacd_is_asked_for_a_quarter_of_the_voxels_each_time_and_for_no_fewer_than_it_can_do_with():
    asked = config(engine="vhacd", vhacd_resolution=400_000)
    voxels = [_variation(L, asked, step)[1]["resolution"] for step in range(5)]
    assert voxels == [400_000, 400_000, 100_000, 25_000, 10_000]


def test_a_crash_is_followed_by_jitter_and_a_lack_of_time_by_something_coarser(monkeypatch):
    crashed, slow = Engine(monkeypatch, lost=["crash", "crash"]), None
    decompose(L, config=config(threshold=0.04))
    assert crashed.thresholds() == pytest.approx([0.04, 0.04, 0.06])
    slow = Engine(monkeypatch, lost=["time", "time"])
    found = decompose(L, config=config(threshold=0.04))
    assert slow.thresholds() == pytest.approx([0.04, 0.06, 0.09])
    assert found.notes["attempts"] == 3
    assert found.notes["lost"] == ("lost", "lost")
    assert found.notes["threshold"] == pytest.approx(0.09)
    assert found.notes["preprocess_mode"] == "on"


def test_an_attempt_may_take_three_fifths_of_the_time_that_is_left_and_the_last_one_all_of_it(monkeypatch):
    engine = Engine(monkeypatch, lost=["crash", "crash"])
    decompose(L, config=config(attempts=3, time_limit_s=100.0))
    limits = [asked["time_limit_s"] for asked in engine.asked]
    assert 55 < limits[0] <= 60
    assert limits[1] == pytest.approx(limits[0], rel=0.05)  # a crash takes no time
    assert 90 < limits[2] <= 100


def test_engine_memory_and_cancel_sign_are_handed_on(monkeypatch):
    engine = Engine(monkeypatch)
    found = decompose(L, config=config(memory_limit_mb=777))
    assert engine.asked[0]["engine"] == "coacd"
    assert engine.asked[0]["memory_limit_mb"] == 777
    assert found.notes["memory_limit"] is True
    assert found.error_m[0] < 1e-4
    assert found.notes["volume_ratio"] == pytest.approx(1)
    assert found.notes["union_volume_ratio"] == pytest.approx(1)
    assert decompose(L, config=config(memory_limit_mb=None)).notes["memory_limit"] is False


def test_a_limit_that_the_platform_does_not_keep_is_told(monkeypatch):
    Engine(monkeypatch, memory_limit=False)
    with pytest.warns(RuntimeWarning, match="does not enforce memory_limit_mb"):
        assert decompose(L, config=config()).notes["memory_limit"] is False


def test_an_option_that_the_engine_ignores_is_told_only_where_it_was_set(monkeypatch, recwarn):
    Engine(monkeypatch, unknown=["extrude"])
    decompose(L, config=config())
    assert not recwarn
    with pytest.warns(RuntimeWarning, match="no extrude: ignored"):
        decompose(L, config=config(extrude=True))


def test_more_hulls_than_were_asked_for_are_merged_and_slivers_dropped(monkeypatch):
    third = trimesh.creation.box(bounds=[[0, 0.06, 0], [0.02, 0.061, 0.02]])
    sliver = trimesh.creation.box((1e-5, 1e-5, 1e-5))
    Engine(monkeypatch, hulls=(*PARTS, third))
    found = decompose(L, config=config(max_convex_hull=2))
    assert len(found.parts) == 2
    bounds = sorted(np.ptp(part.vertices, axis=0).round(6).tolist() for part in found.parts)
    assert bounds == [[0.02, 0.041, 0.02], [0.1, 0.02, 0.02]]
    assert len(decompose(L, config=config()).parts) == 3
    Engine(monkeypatch, hulls=(*PARTS, sliver))
    assert decompose(L, config=config()).notes["dropped"] == 1
    Engine(monkeypatch, hulls=(sliver,))
    with pytest.raises(DecompositionFailed, match="all 1 parts were slivers"):
        decompose(L, config=config(attempts=1))


def test_parts_far_out_are_what_float32_leaves_of_them(monkeypatch):
    far = L.copy().apply_translation([123.4, 0, 0])
    hulls = [trimesh.Trimesh(np.add(part.vertices, [123.4, 0, 0]), part.faces, process=False) for part in PARTS]
    Engine(monkeypatch, hulls=hulls)
    for part in decompose(far, config=config()).parts:
        np.testing.assert_array_equal(part.vertices, part.vertices.astype(np.float32))


def test_the_hull_of_an_l_has_its_known_volume_and_that_of_an_open_mesh_no_ratio():
    # The rectangle around it, less the triangle over the inner corner.
    volume = (0.1 * 0.06 - 0.5 * 0.08 * 0.04) * 0.02
    found = hull(L)
    assert found.made_by == "hull"
    assert found.notes["volume_ratio"] == pytest.approx(volume / L.volume)
    assert found.notes["union_volume_ratio"] == found.notes["volume_ratio"]
    opened = trimesh.Trimesh(L.vertices, L.faces[2:], process=False)
    assert np.isnan(hull(opened).notes["volume_ratio"])  # pyright: ignore
    assert len(hull(L, max_vertices=5).parts[0].vertices) == 5
