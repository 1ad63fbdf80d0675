"""Benches that run MuJoCo: the trial at several time steps, collision parts side by side."""

import pytest

from gfp_grasp.bench import bench_collision, bench_trial
from gfp_grasp.bench.collision import METHODS
from gfp_grasp.errors import InvalidOption


@pytest.mark.slow
def test_outcomes_at_half_and_a_quarter_of_the_step_are_counted():
    report = bench_trial("cup", limit=1, grasps=2)
    assert report["attempts"] == len(report["trials"]) == 2
    assert report["held"].keys() == {"1/1", "1/2", "1/4"}
    assert all(0 <= share <= 1 for share in report["agreement"])
    assert 0 <= report["creep_mm_per_s"][0] <= report["creep_mm_per_s"][1] < 0.02
    assert 0 < report["episodes_per_s"] < report["attempts_per_s"]
    assert 0.3 < report["share_in_mj_step"] < 1


@pytest.mark.parametrize("options", [{"limit": 0}, {"grasps": 0}])
def test_a_trial_of_nothing_is_refused(options):
    with pytest.raises(InvalidOption, match="at least 1"):
        bench_trial(**options)


@pytest.mark.slow
def test_carried_parts_stand_beside_the_hull_of_the_same_mesh():
    report = bench_collision("mug", methods=("carried", "hull"), limit=1)
    rows = report["rows"]["completed"]["mug"]  # type: ignore[index]
    assert rows["carried"]["failed"] == rows["hull"]["failed"] == 0
    assert rows["carried"]["iou"] > 0.75 > rows["hull"]["iou"]
    assert rows["carried"]["error_mm"][0] < 1 < rows["hull"]["error_mm"][0]
    assert 1 == rows["hull"]["parts"] < rows["carried"]["parts"] <= 80
    assert rows["carried"]["steps_per_s"] > 100


def test_an_unknown_way_to_parts_is_refused():
    with pytest.raises(InvalidOption, match=METHODS[0]):
        bench_collision("mug", methods=("magic",))
