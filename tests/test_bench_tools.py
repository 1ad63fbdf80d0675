"""Views, methods, pictures and the smaller benches."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gfp_grasp.bench import (
    BRIEF,
    METHODS,
    CompletionConfig,
    bench_completion,
    bench_speed,
    bench_stability,
)
from gfp_grasp.bench.methods import PROTOCOLS, config_of, in_sight, view_object
from gfp_grasp.bench.speed import SIZES
from gfp_grasp.drawing import write_bars, write_curves, write_operating_curve
from gfp_grasp.errors import InvalidOption, TooFewPoints
from gfp_grasp.meshes import sample_surface
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LIDAR


def test_protocols_show_the_same_object_as_they_say():
    mesh = make_shape("bottle", 3).mesh
    tabletop = [name for name in PROTOCOLS if name != "lidar"]
    sights = {name: view_object(mesh, np.random.default_rng(4), protocol=name) for name in tabletop}
    points = {name: len(sight.cloud.points) for name, sight in sights.items()}
    assert 0.4 * points["standard"] < points["hidden"] < 0.6 * points["standard"]
    tall = {name: float(np.ptp(sight.mesh.vertices[:, 2])) for name, sight in sights.items()}
    assert tall["standard"] == pytest.approx(tall["noisy"]) == pytest.approx(np.ptp(mesh.vertices[:, 2]))
    turned = [view_object(mesh, np.random.default_rng(i), protocol="fallen").T_world_object[2, 2] for i in range(12)]
    assert {round(float(z)) for z in turned} == {-1, 0}  # upside down, and lying
    for sight in sights.values():  # all of the cloud belongs to the object, within the noise
        extent = np.ptp(sight.mesh.vertices, axis=0)
        assert (sight.cloud.points > sight.mesh.bounds[0] - 0.02 - 0.05 * extent).all()


def test_a_car_is_scanned_where_it_stands_from_a_road_s_distance():
    mesh = make_shape("car", 3).mesh
    for seed in range(4):
        sight = view_object(mesh, np.random.default_rng(seed), protocol="lidar")
        assert sight.sensor is LIDAR
        assert sight.image is None
        assert sight.cloud.viewpoint is not None
        assert sight.cloud.viewpoint[2] == 1.73
        np.testing.assert_allclose(sight.mesh.bounds[0, 2], 0.0, atol=1e-9)
        nearest = np.linalg.norm(sight.cloud.points[:, :2] - sight.cloud.viewpoint[:2], axis=1).min()
        assert 6.9 < nearest < 19
        local = apply_T(invert_T(sight.T_world_object), sight.cloud.points)
        assert (local > mesh.bounds[0] - 0.12).all()  # noise of 2 cm along the ray
        assert (local < mesh.bounds[1] + 0.12).all()
    with pytest.raises(TooFewPoints, match="in each of 20 scans"):
        view_object(make_shape("cup", 3).mesh, np.random.default_rng(0), protocol="lidar")


def test_points_behind_the_object_are_not_in_sight():
    sight = view_object(make_shape("bottle", 3).mesh, np.random.default_rng(4))
    points, normals, _ = sample_surface(sight.mesh, 2000, np.random.default_rng(0))
    viewpoint = sight.cloud.viewpoint
    assert viewpoint is not None
    seen = in_sight(sight.mesh, points, normals, viewpoint)
    assert 0.25 < seen.mean() < 0.6
    assert (np.einsum("ni,ni->n", viewpoint - points, normals)[seen] > 0).all()


def test_every_method_has_a_config_or_needs_none():
    sight = view_object(make_shape("mug", 3).mesh, np.random.default_rng(4))
    assert len(METHODS) == len(set(METHODS))
    assert set(BRIEF) <= set(METHODS)
    for name in METHODS:
        if name not in ("truth", "partial", "observed", "mirror", "classfree"):
            config, tells_class = config_of(name, sight, "mug")
            assert tells_class == name.startswith("told-")
            assert (config.fit.size not in (None, (1.0, 1.0, 1.0))) == name.endswith("-sized")
    off = config_of("gfpnet-no-modes")[0].fit
    assert not off.quick.estimate_modes
    assert not off.thorough.estimate_modes
    assert config_of("gfpnet-paper-7")[0].deform.iterations == 7


def test_rows_say_whether_observed_and_sigma_are_honest():
    report: Any = bench_completion("cup", methods=("registration",), config=CompletionConfig(views=2, limit=1))
    row = report["rows"]["all"]["registration"]
    for name in ("seen_precision", "seen_recall", "two_sigma", "iou", "f_score"):
        assert 0 < row[name] <= 1, name
    assert -1 <= row["sigma_rank"] <= 1
    with pytest.raises(InvalidOption, match="hidden"):
        CompletionConfig(protocol="upside")


def test_charts_are_drawings_with_every_row(tmp_path: Path):
    rows = {c: {"gfpnet": {"cd_m": 0.004}, "a <b>": {"cd_m": 0.012}, "none": {"cd_m": None}} for c in ("cup", "all")}
    words = _words(write_bars(rows, tmp_path / "rows.svg", title="Rows & columns"))
    assert {"cup", "all", "gfpnet", "a <b>", "4.00", "12.00", "Rows & columns"} <= words
    assert "none" not in words
    words = _words(
        write_curves({"wide": {"3 layers": [3.0, 2.0, 1.5]}}, tmp_path / "lines.svg", title="T", axis="iterations")
    )
    assert {"wide", "3 layers", "iterations", "1", "2", "3"} <= words


def test_an_operating_curve_marks_the_threshold_that_was_chosen(tmp_path: Path):
    points = [
        {"threshold": 0.2, "lost": 0.3, "caught_mixture": 1.0},  # more is lost than is shown
        {"threshold": 0.5, "lost": 0.1, "caught_mixture": 0.75},
        {"threshold": 0.9, "lost": 0.05, "caught_mixture": 0.5},
        {"threshold": 0.95, "lost": 0.05, "caught_mixture": 0.45},  # no more is lost
        {"threshold": 1.0, "lost": 0.0, "caught_mixture": 0.25},
    ]
    path = write_operating_curve({"plain": points}, 0.9, tmp_path / "curve.svg")
    assert {"plain views, of no class: unknown", "20%", "75%"} <= _words(path)
    root = ElementTree.parse(path).getroot()
    (mark,) = (element for element in root.iter() if element.tag.endswith("circle"))
    (line,) = (element for element in root.iter() if element.tag.endswith("polyline"))
    places = [tuple(map(float, place.split(","))) for place in str(line.get("points")).split()]
    assert len(places) == 4  # in the order of the thresholds
    assert (float(str(mark.get("cx"))), float(str(mark.get("cy")))) == places[1]
    widths, heights = np.diff(places, axis=0).T
    assert widths[0] == pytest.approx(widths[2])  # a twentieth of the known each
    assert widths[1] == 0
    assert heights == pytest.approx(heights[0] * np.array([1.0, 0.2, 0.8]))  # of a quarter of the others
    assert widths[0] < 0 < heights[0]


def _words(path: Path) -> set[str]:
    return {element.text or "" for element in ElementTree.parse(path).getroot().iter()}


def test_speed_and_stability_report_what_they_ran():
    speed: Any = bench_speed("bottle", limit=1, calls=2)
    assert set(speed["sizes"]) == {str(size) for size in SIZES}
    for figures in (*speed["sizes"].values(), speed["all"]):
        assert figures["median_ms"] >= sum(figures["stages_ms"].values()) * 0.5
        assert {"detect", "register", "deform", "parts"} <= set(figures["stages_ms"])
    assert set(speed["registration_ms"]) == {"icp", "pcrnet", "registration"}
    assert len(speed["memory"]["rss_mb"]) == 2
    stable: Any = bench_stability("bottle", motions=2, limit=1)
    assert stable["same_bits"]
    assert stable["motions"] == 2
    assert stable["moved_mm"][2] < 2.0
    with pytest.raises(InvalidOption):
        bench_stability(motions=0)
    with pytest.raises(InvalidOption):
        bench_speed(limit=0)
