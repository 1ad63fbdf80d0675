"""The search for networks of the paper's kind: its front, its genes, and what is not trained twice."""

import importlib.util
import json

import pytest
import torch

from gfp_grasp.bench import SearchConfig, bench_search, paper_nets, search
from gfp_grasp.bench.paper_nets import PAPER, Architecture, num_parameters
from gfp_grasp.bench.search import GENES, express, front_of, name_of
from gfp_grasp.errors import InvalidOption

CONFIG = SearchConfig(steps=5, batch=4, limit=3, views=2, seed=1, trials=14, population=4)


def row(ms: float, cd_units: float) -> dict[str, float]:
    return {"ms": ms, "cd_units": cd_units}


def test_the_front_has_what_no_other_network_matches_in_both():
    quick, near, between = row(1.0, 9.0), row(50.0, 2.0), row(4.0, 5.0)
    as_quick_but_worse, slower_but_as_near, beaten = row(4.0, 5.5), row(60.0, 2.0), row(10.0, 6.0)
    rows = [near, beaten, between, as_quick_but_worse, quick, slower_but_as_near]
    assert front_of(rows) == [quick, between, near]
    assert front_of([between, dict(between)]) == [between]
    assert front_of([row(1.0, 1.0), row(2.0, 2.0)]) == [row(1.0, 1.0)]


def test_inner_genes_are_silent_where_there_are_fewer_layers():
    genes = {"first": 16, "inner_1": 32, "inner_2": 64, "inner_3": 128, "code": 256, "iterations": 2, "hidden": 512}
    widths = [express({**genes, "layers": layers}).widths for layers in (2, 3, 4, 5)]
    assert widths == [(16, 256), (16, 32, 256), (16, 32, 64, 256), (16, 32, 64, 128, 256)]
    found = express({**genes, "layers": 4})
    assert (found.iterations, found.hidden) == (2, (512, 256, 128))
    assert name_of(found) == "16-32-64-256, 512-256-128, m = 2"
    assert express(search._PAPER_GENES) == PAPER == Architecture()
    assert all(value in GENES[name] for name, value in search._PAPER_GENES.items())
    assert set(GENES) == set(search._PAPER_GENES)


@pytest.fixture
def trained(monkeypatch) -> list[Architecture]:
    """The bench without patches and training, whose networks are the slower and the nearer the more they hold."""
    trained: list[Architecture] = []

    def measure(architecture, patches, config, folder):
        trained.append(architecture)
        size = num_parameters(architecture.make(0))
        parts = {"widths": list(architecture.widths), "hidden": list(architecture.hidden)}
        figures = {"ms": size / 1e5 * architecture.iterations, "cd_units": 1e6 / size}
        return {"name": name_of(architecture), "iterations": architecture.iterations, **parts, **figures}

    monkeypatch.setattr(search, "_measure", measure)
    monkeypatch.setattr(search, "read_patches", lambda budget, **where: "patches")
    return trained


def test_a_search_begins_with_the_papers_network_and_measures_as_many_as_were_asked_for(trained, tmp_path):
    told: list[str] = []
    report = bench_search(config=CONFIG, runs=tmp_path, report=told.append)
    assert trained[0] == PAPER
    assert len(set(trained)) == len(trained) == len(report["trials"]) == 14
    assert report["paper"] == report["trials"][0]
    assert report["front"] == front_of(report["trials"])
    assert told[0] == "1 of 14: 64-128-1024, 1024-512-256, m = 5"
    assert report["settings"] == {
        **{"steps": 5, "batch": 4, "limit": 3, "views": 2, "seed": 1},
        **{"trials": 14, "population": 4},
    }
    assert json.loads(json.dumps(report)) == report


def test_later_generations_are_nearer_to_the_front_than_the_first(trained, tmp_path):
    """With these figures a network that loops its answer back is slower and no nearer."""
    report = bench_search(config=SearchConfig(trials=64, population=8, seed=2), runs=tmp_path)
    iterations = [trial["iterations"] for trial in report["trials"]]
    assert sum(iterations[-24:]) / 24 < 3.2  # at random it is 4


def test_what_was_measured_is_read_back_and_a_search_that_was_stopped_goes_on_as_it_would_have_gone(trained, tmp_path):
    whole = bench_search(config=CONFIG, runs=tmp_path / "whole")
    (journal,) = (tmp_path / "whole").rglob("*.jsonl")
    cut = tmp_path / "cut" / journal.relative_to(tmp_path / "whole")
    cut.parent.mkdir(parents=True)
    lines = journal.read_text().splitlines(keepends=True)
    cut.write_text("".join(lines[:7]) + lines[7][:20])  # settings, six networks, and a piece of one
    trained.clear()
    assert bench_search(config=CONFIG, runs=tmp_path / "cut") == whole
    assert len(trained) == 14 - 6
    trained.clear()
    assert bench_search(config=CONFIG, runs=tmp_path / "cut") == whole
    assert trained == []


def test_one_network_is_trained_and_measured(tmp_path, monkeypatch):
    patches = tuple(torch.randn(40, 64, 3, generator=torch.Generator().manual_seed(i)) for i in range(3))
    sets = (*patches, torch.full((40,), 0.05))
    architecture = Architecture((8, 16), 2, (32, 16, 8))
    monkeypatch.setattr(paper_nets, "_CALLS", 3)
    found = search._measure(architecture, paper_nets.PatchSets(sets, sets), CONFIG, tmp_path)
    assert list(found) == ["name", "widths", "iterations", "hidden", "parameters", "ms", "cd_units", "hours"]
    assert (found["name"], found["widths"], found["hidden"]) == ("8-16, 32-16-8, m = 2", [8, 16], [32, 16, 8])
    assert found["parameters"] == num_parameters(architecture.make(0))
    assert 0 < found["ms"] < 1000
    assert 0 < found["cd_units"] < 20
    assert not list(tmp_path.iterdir())  # its checkpoint is gone
    assert search._architecture(found) == architecture


def test_a_search_without_optuna_is_refused_with_the_command_that_installs_it(tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InvalidOption, match=r'pip install "gfp-grasp\[search\]"'):
        bench_search(runs=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"population": 1}, {"steps": 0}, {"seed": -1}])
def test_a_search_of_nothing_is_refused(wrong):
    with pytest.raises(InvalidOption, match="expected"):
        SearchConfig(**wrong)
    assert SearchConfig(trials=1, population=2).steps == SearchConfig().steps
