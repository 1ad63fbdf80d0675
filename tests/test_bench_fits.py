"""The bench of registrations, with fits whose errors are known."""

from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import l_shape
from clocks import SteadyClock
from toy_bodies import primitive_of

from gfp_grasp.bench import (
    RegistrationConfig,
    bench_registration,
    registration,
)
from gfp_grasp.bench.registration import FitRow
from gfp_grasp.errors import FitDiverged
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import shipped_families
from gfp_grasp.shapes import split_seeds
from gfp_grasp.train import ViewsConfig, shape_source
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
