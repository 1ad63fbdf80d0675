"""The paper's networks at a small budget, and their ablation, with networks whose errors are known."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from clocks import SteadyClock
from torch import nn

from gfp_grasp.bench import AblationConfig, ablation, bench_ablation, paper_nets
from gfp_grasp.bench.ablation import DIVISORS, ITERATIONS, WIDTHS
from gfp_grasp.bench.paper_nets import Architecture, Budget, call_ms, chamfers, read_patches, train_paper_net
from gfp_grasp.deform import PaperNet
from gfp_grasp.errors import InvalidOption
from gfp_grasp.train import LoopConfig, looped_loss


class Shifting(nn.Module):
    """Moves points by a tenth along x at each iteration."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[int, int | None]] = []

    def forward(self, source, template, *, iterations=None):
        self.asked.append((len(source), iterations))
        return source + torch.tensor([0.1 * (iterations or 5), 0.0, 0.0])


def patches(count: int, unit_m: float = 0.02):
    """S on a line along y with wide gaps, T, the label, which is S, and the unit."""
    line = torch.zeros(count, 3, 3)
    line[:, :, 1] = torch.tensor([0.0, 10.0, 20.0])
    return line, line + 5.0, line.clone(), torch.full((count,), unit_m)


def test_the_distance_of_predicted_sets_is_taken_both_ways_in_the_patches_own_units_after_each_iteration():
    network = Shifting()
    source, template, target, unit_m = patches(40)
    unit_m[::2] = 0.04
    found = chamfers(network, (source, template, target, unit_m), 3)
    assert found == pytest.approx([2 * 0.1 * m for m in (1, 2, 3)], abs=2e-5)
    assert network.asked == [(16, 1), (16, 1), (8, 1)] * 3


def test_sets_that_are_looped_back_by_hand_are_those_of_the_network():
    torch.manual_seed(0)
    network = PaperNet((8, 16), hidden=(16, 8)).eval()
    source, template, target = (torch.randn(40, 64, 3) for _ in range(3))
    with torch.inference_mode():
        pairwise = torch.cdist(network(source, template, iterations=3), target)
    expected = float((pairwise.amin(dim=2).mean(dim=1) + pairwise.amin(dim=1).mean(dim=1)).mean())
    found = chamfers(network, (source, template, target, torch.full((40,), 7.0)), 3)
    assert found[2] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(("noise_m", "deviation"), [(0.0, 0.0), (0.01, 0.5)])
def test_noise_is_added_to_the_template_in_metres(noise_m, deviation):
    batch = patches(400)
    stream = paper_nets._noisy(lambda generator: iter([batch]), noise_m)
    ((source, template, target, unit_m),) = stream(torch.Generator().manual_seed(1))
    assert source is batch[0]
    assert target is batch[2]
    assert unit_m is batch[3]
    assert float((template - batch[1]).std()) == pytest.approx(deviation, rel=0.05)
    assert float((template - batch[1]).mean()) == pytest.approx(0.0, abs=0.05)


def test_a_call_is_timed_by_its_median_for_all_patches_of_a_primitive(monkeypatch):
    network = Shifting()
    monkeypatch.setattr(paper_nets, "time", SteadyClock(0.25))
    assert call_ms(network) == 250.0
    assert network.asked == [(64, None)] * 30


def test_two_thousand_patches_of_the_validation_split_are_measured_whatever_the_seed(monkeypatch):
    asked = []

    def of_split(split, **how):
        asked.append((split, how))
        return tuple(torch.arange(3000.0, dtype=torch.float16) + 2 * part for part in range(4)), {}

    monkeypatch.setattr(paper_nets, "paper_patches", of_split)
    first, second = (read_patches(Budget(limit=24, views=2, seed=seed), runs=Path("r"), workers=6) for seed in (3, 4))
    how = {"num_views": 2, "runs": Path("r"), "workers": 6}
    assert asked[:2] == [("train", {**how, "members": 24}), ("val", {**how, "members": 3})]
    assert len(first.training[0]) == 3000
    for number, part in enumerate(first.held_out):
        assert part.dtype == torch.float32
        assert len(part.unique()) > 1000
        assert torch.equal(part, second.held_out[number])
        assert len(part) == 2048


def test_a_network_is_trained_by_the_common_loop_and_its_patches_are_drawn_anew_with_noise(tmp_path, monkeypatch):
    made = {}

    def train(network, batches, loss, **named):
        made.update(named, loss=loss, batch=next(batches(torch.Generator().manual_seed(0))))
        return network, 0.5

    monkeypatch.setattr(paper_nets, "train", train)
    network, checkpoint = Architecture((8, 16)).make(3), tmp_path / "a.pt"
    budget = Budget(steps=7, batch=5, seed=3)
    found = train_paper_net(
        network, patches(20), budget, checkpoint=checkpoint, noise_m=0.01, reading="CD to T", until=4
    )
    assert found == (network, 0.5)
    loop = LoopConfig(steps=7, batch=5, rate=1e-3, seed=3, checkpoint_s=30.0)
    assert (made["loss"].func, made["loss"].keywords) == (looped_loss, {"reading": "CD to T"})
    assert made["config"] == loop
    assert (made["checkpoint"], made["until"]) == (checkpoint, 4)
    assert len(made["batch"][0]) == 5
    assert 0.3 < float((made["batch"][1] - patches(5)[1]).std()) < 0.7


def test_a_network_is_the_same_for_the_same_seed():
    small = Architecture((8, 16), 4, (32, 16))
    first, again, other = (small.make(seed).state_dict() for seed in (1, 1, 2))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not all(torch.equal(first[name], other[name]) for name in first)
    assert small.make(0).iterations == 4


CONFIG = AblationConfig(steps=7, batch=5, limit=4, views=2, noise_m=0.02, seed=3)
NAMES = [
    *("16-256", "16-32-256", "16-32-128-256", "16-32-64-128-256"),
    *("32-512", "32-64-512", "32-64-256-512", "32-64-128-256-512"),
    *("64-1024", "64-128-1024", "64-128-512-1024", "64-128-256-512-1024"),
    "64-128-1024, 0.02 m noise",
    "64-128-1024, CD to T",
    "64-128-1024, eq. 3 as printed",
]


@pytest.fixture
def trained(monkeypatch) -> dict[str, list]:
    """The bench without patches and without training; what was asked."""
    asked: dict[str, list] = {"nets": [], "runs": [], "patches": []}

    def make(architecture, seed):
        asked["nets"].append((architecture, seed))
        return Shifting()

    def train(network, training, budget, *, checkpoint, noise_m, reading, until):
        asked["runs"].append((checkpoint.name, noise_m, reading, until))
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        checkpoint.touch()
        return network, 0.123456

    def read(budget, *, runs, workers):
        asked["patches"].append((budget, runs, workers))
        return paper_nets.PatchSets(patches(8), patches(12))

    monkeypatch.setattr(Architecture, "make", make)
    monkeypatch.setattr(ablation, "train_paper_net", train)
    monkeypatch.setattr(ablation, "read_patches", read)
    return asked


def test_every_row_is_trained_alike_and_measured_at_each_third_and_each_number_of_iterations(trained, tmp_path):
    begun: list[str] = []
    report = bench_ablation(config=CONFIG, runs=tmp_path, workers=6, report=begun.append)
    assert begun == list(report["rows"]) == NAMES
    cd_units = [2 * 0.1 * m for m in range(1, 8)]
    for name, row in report["rows"].items():
        assert row["cd_units"] == pytest.approx(cd_units, abs=2e-5)
        assert row["thirds"] == pytest.approx([cd_units[4]] * 3, abs=2e-5)
        assert row["widths"] == [int(width) for width in name.split(",")[0].split("-")]
        assert (row["parameters"], row["hours"]) == (0, 0.1235)
        assert row["noise_m"] == (0.02 if "noise" in name else 0.0)
    assert report["settings"] == {**asdict(CONFIG), "iterations": [1, 2, 3, 4, 5, 6, 7]}
    assert trained["patches"] == [(CONFIG, tmp_path, 6)]
    assert trained["nets"] == [(Architecture(tuple(report["rows"][name]["widths"]), 7), 3) for name in NAMES]
    assert trained["runs"][:3] == [("16-256.pt", 0.0, "as taken", until) for until in (2, 4, 7)]
    assert trained["runs"][38::3] == [
        ("64-128-1024_0.02_m_noise.pt", 0.02, "as taken", 7),
        ("64-128-1024_CD_to_T.pt", 0.0, "CD to T", 7),
        ("64-128-1024_eq._3_as_printed.pt", 0.0, "eq. 3 as printed", 7),
    ]
    folder = tmp_path / "ablation" / "7_5_4_2_3"
    assert json.loads((folder / "32-512.json").read_text()) == report["rows"]["32-512"]
    assert not list(folder.glob("*.pt"))


def test_a_row_that_is_finished_is_read_back_and_one_that_was_stopped_goes_on_where_it_was(trained, tmp_path):
    whole = bench_ablation(config=CONFIG, runs=tmp_path)
    folder = tmp_path / "ablation" / "7_5_4_2_3"
    (folder / "16-256.json").unlink()
    (folder / "32-512.json").write_text('{"thirds": [30.5, 20.25]}')
    for calls in trained.values():
        calls.clear()
    begun: list[str] = []
    again = bench_ablation(config=CONFIG, runs=tmp_path, report=begun.append)
    assert begun == ["16-256", "32-512"]
    assert [until for name, *_, until in trained["runs"] if name == "32-512.pt"] == [7]
    assert again["rows"].pop("32-512")["thirds"][:2] == [30.5, 20.25]
    whole["rows"].pop("32-512")
    assert again == whole
    bench_ablation(config=replace(CONFIG, noise_m=0.03), runs=tmp_path, report=begun.append)
    assert begun[2:] == ["64-128-1024, 0.03 m noise"]


def test_a_network_goes_on_from_third_to_third(tmp_path, monkeypatch):
    generator = torch.Generator().manual_seed(0)
    sets = (*(torch.randn(40, 64, 3, generator=generator) for _ in range(3)), torch.full((40,), 0.05))
    monkeypatch.setattr(paper_nets, "paper_patches", lambda *_, **__: (sets, {}))
    monkeypatch.setattr(ablation, "_plan", lambda noise_m: {"8-16": ablation._Kind((8, 16))})
    report = bench_ablation(config=AblationConfig(steps=6, batch=8, limit=1, views=1), runs=tmp_path)
    (row,) = report["rows"].values()
    assert len(row["cd_units"]) == 7
    assert min(row["cd_units"]) > 0
    assert len(set(row["thirds"])) == 3  # the network went on between them
    assert row["thirds"][2] == row["cd_units"][4]
    assert row["parameters"] == sum(p.numel() for p in PaperNet((8, 16)).parameters())


@pytest.mark.parametrize(
    "wrong", [{"batch": 0}, {"limit": 0}, {"views": 0}, {"noise_m": 0.0}, {"steps": 0}, {"seed": -1}]
)
def test_an_ablation_of_nothing_is_refused(wrong):
    with pytest.raises(InvalidOption, match="positive number"):
        AblationConfig(**wrong)
    assert AblationConfig(steps=1, batch=1, limit=1, views=1).seed == 0
    assert [len(widths) for widths in WIDTHS] == [2, 3, 4, 5]
    assert (DIVISORS, ITERATIONS) == ((4, 2, 1), (1, 2, 3, 4, 5, 6, 7))
