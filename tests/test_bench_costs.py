"""Costs of methods: measured in processes of their own, and the networks that they are said to have."""

import json
import subprocess
import sys
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gfp_grasp.assets import data_dir
from gfp_grasp.bench import costs
from gfp_grasp.bench.costs import NETWORKS, WITH_PRIMITIVES, measure_costs
from gfp_grasp.completers import PEER_COMPLETERS
from gfp_grasp.errors import InvalidOption, TooFewPoints, WorkerLost

# Completes a household object, a thing of no class and a vehicle, and names the files of weights that were read.
READS = """
import sys, json
import safetensors.torch, numpy as np
read, load = [], safetensors.torch.load_file
safetensors.torch.load_file = lambda path, *more: (read.append(str(path)), load(path, *more))[1]
from pathlib import Path
from gfp_grasp.bench.methods import is_told_class, run_method, view_object
from gfp_grasp.scenes import load_objects
method = sys.argv[1]
for objects, number, protocol in (("mug", 0, "standard"), ("unknown", 1, "standard"), ("car", 0, "lidar")):
    source = load_objects(objects)[number]
    if source.category or not is_told_class(method):
        view = view_object(source.load_mesh(), np.random.default_rng(0), protocol=protocol)
        run_method(method, view, None, source.category)
print(json.dumps(sorted({Path(path).stem for path in read})))
"""


@pytest.mark.parametrize("method", ["observed", "classfree", "told-pcrnet-gfpnet-paper", "registration", "gfpnet"])
def test_a_method_reads_the_networks_that_it_is_said_to_have(method: str) -> None:
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", READS, method], stdout=subprocess.PIPE, check=True)
    assert json.loads(done.stdout) == sorted(NETWORKS.get(method, ()))


def test_a_hull_takes_little_memory_and_no_weights() -> None:
    cost = measure_costs(("observed",), limit=2)["observed"]
    assert 0 <= cost["memory_mb"] < 60
    assert 1 < cost["ms"] < 5000
    assert cost["first_ms"] > 1
    assert (cost["weights_mb"], cost["parameters"]) == (0.0, 0)
    assert "primitives_mb" not in cost


def test_memory_is_what_a_process_has_more_than_one_that_completed_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str | None, int]] = []

    def child(method: str | None, sights: Sequence[Any]) -> dict[str, Any]:
        asked.append((method, len(sights)))
        return {"peak_mb": 100.0 if method is None else 350.5, "ms": [3.0, 1.0, 2.0], "first_ms": 900.0}

    monkeypatch.setattr(costs, "_in_child", child)
    told = measure_costs(("gfpnet", "mirror"), objects="mug", limit=3)
    assert asked == [(None, 3), ("gfpnet", 3), ("mirror", 3)]
    assert (told["gfpnet"]["memory_mb"], told["gfpnet"]["ms"], told["gfpnet"]["first_ms"]) == (250.5, 2.0, 900.0)
    sizes = [(data_dir("weights") / f"{name}.safetensors").stat().st_size for name in NETWORKS["gfpnet"]]
    assert told["gfpnet"]["weights_mb"] == pytest.approx(sum(sizes) / 1e6, abs=0.01)
    # Weights are half floats, but for some: two to four bytes each.
    assert sum(sizes) / 4 < told["gfpnet"]["parameters"] <= sum(sizes) / 2
    assert told["gfpnet"]["primitives_mb"] > 10


def test_the_first_completion_is_none_of_the_median_and_refusals_have_no_time(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    sights = [(number, "mug") for number in range(4)]

    def run(method: str, view: int, told: None, given: str) -> None:
        if view == 2:
            raise TooFewPoints("no")

    peaks = iter([50.0, 70.0])
    monkeypatch.setattr(costs, "run_method", run)
    monkeypatch.setattr(costs, "peak_mb", lambda: next(peaks))
    monkeypatch.setattr(costs.pickle, "load", lambda stream: ("pcn", sights))
    streams = SimpleNamespace(stdin=SimpleNamespace(buffer=None), stdout=SimpleNamespace(write=written.append))
    monkeypatch.setattr(costs, "sys", streams)
    costs.answer_parent()
    told = json.loads(written[0])
    assert told["peak_mb"] == 50.0
    assert len(told["ms"]) == 2
    assert np.isfinite(told["first_ms"])


def test_every_peer_has_its_weights_and_no_primitives() -> None:
    assert NETWORKS["3d-epn-true-box"] == ("peer_3d_epn_true_box",)
    assert set(PEER_COMPLETERS) < set(NETWORKS)
    assert not set(PEER_COMPLETERS) & set(WITH_PRIMITIVES)


def test_other_methods_and_processes_that_die_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidOption, match="methods are partial; some of"):
        measure_costs(("partial",))
    monkeypatch.setattr(costs, "_CHILD", "import sys; sys.exit(3)")
    with pytest.raises(WorkerLost, match="died with 3"):
        measure_costs(("observed",), limit=1)
