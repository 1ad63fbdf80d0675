"""The benches of registrations and of the ablation, with fits and networks whose errors are known."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from bodies import l_shape
from clocks import SteadyClock
from torch import nn
from toy_bodies import primitive_of

from gfp_grasp.bench import (
    AblationConfig,
    RegistrationConfig,
    ablation,
    bench_ablation,
    bench_registration,
    registration,
)
from gfp_grasp.bench.ablation import ITERATIONS, WIDTHS
from gfp_grasp.bench.registration import FitRow
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import shipped_families
from gfp_grasp.shapes import split_seeds
from gfp_grasp.train import LoopConfig, ViewsConfig, paper_loss, shape_source
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import FittedPrimitive

ELL = l_shape()
STANDING = make_T(rotation_about((0, 0, 1), 0.8), (0.3, -0.2, 0.1))
PLAIN = primitive_of(ELL)
HANDLED = replace(
    PLAIN,
    regions=np.where(ELL.vertices[:, 0] > 0.05, 2, 0).astype(np.uint8),
    region_names=(*PLAIN.region_names, "handle"),
)


def view(resting: str = "upright") -> Any:
    return SimpleNamespace(
        source=SimpleNamespace(load_mesh=lambda: ELL), seed=3, T_world_object=STANDING, resting=resting
    )


def errors(T: np.ndarray, *, scale: float = 1.0, primitive=PLAIN, resting: str = "upright") -> dict[str, Any]:
    fit = FittedPrimitive(primitive, T, np.full(3, scale), np.zeros(0), 0.0)
    return registration._errors(fit, view(resting), primitive)


def test_a_fit_at_the_true_place_has_errors_of_the_samples_alone():
    found = errors(STANDING)
    assert set(found) == {"axis_deg", "offset_m", "size", "cd_m", "wrong_rest"}
    assert found["axis_deg"] == pytest.approx(0.0, abs=1e-5)
    assert found["offset_m"] < 5e-4
    assert found["size"] < 5e-3
    assert found["cd_m"] == pytest.approx((ELL.area / 4096) ** 0.5, rel=0.05)  # both ways, of even samples
    assert found["wrong_rest"] is False
    assert errors(STANDING, resting="lying")["wrong_rest"] is True


def test_shift_lean_and_size_are_told_apart():
    away = make_T(None, (0.03, 0.0, 0.04)) @ STANDING
    assert errors(away)["offset_m"] == pytest.approx(0.05, abs=5e-4)
    middle = apply_T(STANDING, ELL.bounds.mean(axis=0))
    lean = make_T(None, middle) @ make_T(rotation_about((1, 0, 0), np.radians(20)), np.zeros(3)) @ make_T(None, -middle)
    assert errors(lean @ STANDING)["axis_deg"] == pytest.approx(20.0)
    for scale in (1.2, 0.8):
        assert errors(STANDING, scale=scale)["size"] == pytest.approx(0.2, abs=5e-3)


@pytest.mark.parametrize("turn_deg", [35.0, -120.0])
def test_the_turn_of_what_has_a_handle_is_measured_about_its_own_axis(turn_deg):
    assert HANDLED.on_part.any()
    about = STANDING @ make_T(rotation_about((0, 0, 1), np.radians(turn_deg)), np.zeros(3))
    found = errors(about, primitive=HANDLED)
    assert found["yaw_deg"] == pytest.approx(abs(turn_deg))
    lean = about @ make_T(rotation_about((1, 0, 0), np.radians(10)), np.zeros(3))
    assert errors(lean, primitive=HANDLED)["axis_deg"] == pytest.approx(10.0)
    assert errors(STANDING @ lean_about_x(25), primitive=HANDLED)["yaw_deg"] == pytest.approx(0.0, abs=1e-5)


def lean_about_x(degrees: float) -> np.ndarray:
    return make_T(rotation_about((1, 0, 0), np.radians(degrees)), np.zeros(3))


def test_the_angle_of_two_directions_needs_no_unit_vectors_and_no_direction_at_all():
    assert registration._degrees(np.array([2.0, 0, 0]), np.array([3.0, 3.0, 0])) == pytest.approx(45.0)
    assert registration._degrees(np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])) == pytest.approx(180.0)
    assert registration._degrees(np.zeros(3), np.ones(3)) == pytest.approx(90.0)


def test_figures_are_medians_of_the_fitted_views_and_rests_are_counted():
    def row(**figures: Any) -> FitRow:
        return FitRow(family="cup", seed=1, view=0, start="box", **figures)

    known = {"offset_m": 0.5, "size": 0.25, "cd_m": 0.125}
    rows = [
        row(ms=1.0, axis_deg=1.0, **known, wrong_rest=True),
        row(ms=2.0, axis_deg=4.0, **known, wrong_rest=False),
        row(ms=9.0, axis_deg=2.0, **known, wrong_rest=False),
        row(ms=100.0, error="nothing fits"),
    ]
    assert registration._summarise(rows) == {
        **{"axis_deg": 2.0, "yaw_deg": None, **known, "ms": 2.0, "wrong_rest": 0.3333, "views": 4, "failed": 1},
    }
    assert registration._summarise(rows[3:])["wrong_rest"] is None
    assert registration._summarise(rows[3:])["ms"] is None


def test_one_view_is_enough():
    assert RegistrationConfig(views=1).limit is None


@pytest.mark.parametrize("mean_size", [False, True])
def test_every_shape_is_fitted_in_every_view_from_every_start(monkeypatch, mean_size):
    rendered, fitted = [], []

    def render(source, **how):
        rendered.append((source, how))
        return [SimpleNamespace(detection=lambda n=n: f"{source.name} {n}") for n in range(how["num_views"])]

    def fit(detection, primitive, *, config):
        fitted.append((detection, primitive.category, config))
        if config.start == "pcrnet" and primitive.category == "mug":
            raise FitDiverged("nothing fits")
        return "fit"

    monkeypatch.setattr(registration, "render_views", render)
    monkeypatch.setattr(registration, "fit_primitive", fit)
    monkeypatch.setattr(registration, "recognise", lambda detection, library: f"{detection}, looked at")
    monkeypatch.setattr(registration, "_errors", lambda fit, view, primitive: {"cd_m": 0.5, "wrong_rest": False})
    monkeypatch.setattr(registration, "time", SteadyClock(0.25))
    config = RegistrationConfig(views=2, limit=1, seed=9, mean_size=mean_size)
    report = bench_registration(config=config)
    shapes = [(family, int(split_seeds(family, "test")[0])) for family in shipped_families()]
    assert rendered == [(shape_source(*shape), {"num_views": 2, "first_seed": 9}) for shape in shapes]
    assert report["trials"] == [
        {"family": family, "seed": seed, "view": number, "start": start, "ms": 250.0}
        | ({"error": "nothing fits"} if (family, start) == ("mug", "pcrnet") else {"cd_m": 0.5, "wrong_rest": False})
        for family, seed in shapes
        for number in (0, 1)
        for start in ("proposal", "box", "pcrnet")
    ]
    size, name = (1.0, 1.0, 1.0) if mean_size else None, f"cup-{shapes[0][1]} 0"
    seen: list[tuple[str, Any]] = [(f"{name}, looked at", "proposal"), (name, "box"), (name, "pcrnet")]
    assert fitted[:3] == [(what, "cup", FitConfig(size=size, start=start)) for what, start in seen]
    assert list(report["rows"]) == [*shipped_families(), "all"]
    assert report["rows"]["mug"]["pcrnet"]["failed"] == report["rows"]["all"]["pcrnet"]["failed"] == 2
    assert report["rows"]["all"]["box"]["views"] == 40
    assert report["rows"]["mug"]["box"]["cd_m"] == 0.5
    assert report["settings"] == {**asdict(config), "view": asdict(ViewsConfig())}


class Shifting(nn.Module):
    """Moves points by one more tenth along x at each iteration."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[int, int]] = []

    def forward(self, source, template, *, iterations):
        self.asked.append((len(source), iterations))
        return source + torch.tensor([0.1 * iterations, 0.0, 0.0])


def patches(count: int, unit_m: float = 0.02):
    """S on a line along y with wide gaps, T, the label, which is S, and the unit."""
    line = torch.zeros(count, 3, 3)
    line[:, :, 1] = torch.tensor([0.0, 10.0, 20.0])
    return line, line + 5.0, line.clone(), torch.full((count,), unit_m)


def test_the_distance_of_predicted_sets_is_taken_both_ways_in_the_patches_own_units():
    network = Shifting()
    source, template, target, unit_m = patches(600)
    unit_m[::2] = 0.04
    found = ablation._chamfer_mm(network, source, template, target, unit_m, 3)
    assert found == pytest.approx(2 * 0.3 * 0.03 * 1000)
    assert network.asked == [(256, 3), (256, 3), (88, 3)]


@pytest.mark.parametrize(("noise_m", "deviation"), [(0.0, 0.0), (0.01, 0.5)])
def test_noise_is_added_to_the_template_in_metres(noise_m, deviation):
    batch = patches(400)
    stream = ablation._noisy(lambda generator: iter([batch]), noise_m)
    ((source, template, target, unit_m),) = stream(torch.Generator().manual_seed(1))
    assert source is batch[0]
    assert target is batch[2]
    assert unit_m is batch[3]
    assert float((template - batch[1]).std()) == pytest.approx(deviation, rel=0.05)
    assert float((template - batch[1]).mean()) == pytest.approx(0.0, abs=0.05)


CONFIG = AblationConfig(steps=7, batch=5, limit=4, views=2, noise_m=0.02, seed=3)


@pytest.fixture
def trained(monkeypatch) -> dict[str, list]:
    """The bench without training; what was asked."""
    trained: dict[str, list] = {"patches": [], "nets": [], "noise": [], "runs": []}

    def of_split(*which):
        trained["patches"].append(which)
        return tuple(part[: (3000 if which[0] == "val" else 8)] for part in patches(3000))

    def net(widths):
        trained["nets"].append((widths, torch.initial_seed()))
        return Shifting()

    def noisy(stream, noise_m):
        trained["noise"].append(noise_m)
        return "stream"

    def train(network, stream, loss, *, config, checkpoint):
        trained["runs"].append((stream, loss, config, checkpoint))
        return network, 0.123456

    fakes = {"patches_of_split": of_split, "PaperNet": net, "_noisy": noisy, "train": train}
    for name, fake in fakes.items():
        monkeypatch.setattr(ablation, name, fake)
    return trained


def test_every_row_is_trained_alike_and_measured_at_each_number_of_iterations(trained, tmp_path):
    begun: list[str] = []
    report = bench_ablation(config=CONFIG, runs=tmp_path, workers=6, report=begun.append)
    names = ["2 layers", "3 layers", "4 layers", "5 layers", "3 layers, 0.02 m noise"]
    assert begun == list(report["rows"]) == names
    row = {"cd_mm": [round(2 * 0.1 * m * 0.02 * 1000, 4) for m in range(1, 8)], "hours": 0.1235}
    for found in report["rows"].values():
        assert found["hours"] == row["hours"]
        assert found["cd_mm"] == pytest.approx(row["cd_mm"], abs=2e-4)
    assert report["settings"] == {**asdict(CONFIG), "iterations": [1, 2, 3, 4, 5, 6, 7]}
    assert trained["patches"] == [("train", 2, 4, tmp_path, 6), ("val", 2, 4, tmp_path, 6)]
    layers = [(64, 1024), (64, 128, 1024), (64, 128, 512, 1024), (64, 128, 256, 512, 1024), (64, 128, 1024)]
    assert trained["nets"] == [(widths, 3) for widths in layers]
    assert trained["noise"] == [0.0, 0.0, 0.0, 0.0, 0.02]
    loop = LoopConfig(steps=7, batch=5, rate=1e-3, seed=3, checkpoint_s=30.0)
    folder = tmp_path / "ablation" / "7_5_4_2_0.02_3"
    files = ["2_layers", "3_layers", "4_layers", "5_layers", "3_layers_0.02_m_noise"]
    assert trained["runs"] == [("stream", paper_loss, loop, folder / f"{name}.pt") for name in files]
    assert json.loads((folder / "2_layers.json").read_text()) == report["rows"]["2 layers"]
    (folder / "3_layers.json").unlink()
    bench_ablation(config=CONFIG, runs=tmp_path, report=begun.append)
    assert begun[5:] == ["3 layers"]
    assert trained["patches"][2:] == [("train", 2, 4, tmp_path, 1), ("val", 2, 4, tmp_path, 1)]


def test_two_thousand_patches_of_the_validation_split_are_measured_whatever_the_seed(trained, tmp_path, monkeypatch):
    measured = []

    def chamfer(network, source, template, target, unit_m, iterations):
        measured.append((source, template, target, unit_m, iterations))
        return 1.23456

    held_out = tuple(torch.arange(3000.0) + 10_000 * part for part in range(4))
    monkeypatch.setattr(ablation, "_chamfer_mm", chamfer)
    for seed in (3, 4):
        row = ablation._row(3, 0.0, patches(8), held_out, replace(CONFIG, seed=seed), tmp_path / "a.pt")
        assert row == {"cd_mm": [1.2346] * 7, "hours": 0.1235}
    picked = torch.randperm(3000, generator=torch.Generator().manual_seed(0))[:2048].float()
    for *parts, _ in measured:
        for number, part in enumerate(parts):
            assert torch.equal(part, picked + 10_000 * number)
    assert [m for *_, m in measured] == [*ITERATIONS, *ITERATIONS]


@pytest.mark.parametrize("wrong", [{"batch": 0}, {"limit": 0}, {"views": 0}, {"noise_m": 0.0}, {"steps": 0}])
def test_an_ablation_of_nothing_is_refused(wrong):
    with pytest.raises(InvalidOption, match="positive numbers"):
        AblationConfig(**wrong)
    assert AblationConfig(steps=1, batch=1, limit=1, views=1).seed == 0
    assert list(WIDTHS) == [2, 3, 4, 5]
