"""Training of the class-free completion: its things and views, its samples, its loss, one run from end to end."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from seen_wedge import seen
from torch import nn

from gfp_grasp.classfree import NUM_CHANNELS, REACH, DistanceNet
from gfp_grasp.errors import InvalidOption, NoSurface, UnknownCategory
from gfp_grasp.shapes import FAMILIES, MIXTURES, TRAFFIC, split_seeds
from gfp_grasp.train import (
    ClassfreeConfig,
    HullRow,
    Thing,
    draw_things,
    measure_against_hull,
    summarise_against_hull,
    train_classfree,
)
from gfp_grasp.train.classfree import calibrate_scales, field_batches, field_loss
from gfp_grasp.train.classfree_data import PLAIN, SeenThing, cached_samples, read_sample, sample_of, seen_things
from gfp_grasp.train.classfree_measure import position_errors_m
from gfp_grasp.types import CompletedShape

SMALL = ClassfreeConfig(steps=2, batch=2, width=8, depth=1, members=1, mixtures=1, views=1, bf16=False)


def test_things_are_members_of_all_families_but_those_left_out_and_mixtures() -> None:
    things = draw_things("test", 2, 3, without=("mug", "van"))
    kinds = [thing.kind for thing in things]
    assert set(kinds) == {*FAMILIES, *MIXTURES} - {"mug", "van"}
    assert kinds.count("cup") == 2
    assert kinds.count("shell") == 3
    assert [thing.number for thing in things if thing.kind == "bowl"] == list(split_seeds("bowl", "test", 2))
    assert {thing.split for thing in things} == {"test"}


@pytest.mark.parametrize("kind", ["mug", "bus", "tool-like"])
def test_a_thing_has_the_size_of_things_on_a_table_and_traffic_is_a_toy(kind: str) -> None:
    extents = [Thing(kind, number, "train").load_mesh().extents.max() for number in range(4)]
    assert 0.03 < min(extents) <= max(extents) < 0.45
    assert kind not in TRAFFIC or max(extents) <= 0.35


def test_views_of_a_thing_are_the_same_each_time_and_lie_on_its_surface() -> None:
    first, again = (list(seen_things(Thing("kettle", 5, "train"), 3)) for _ in range(2))
    assert len(first) == 3
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.detection.cloud.points, b.detection.cloud.points)
        assert a.mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-9)
        off = position_errors_m(_as_shape(a), b.mesh, np.random.default_rng(0))
        assert np.median(np.linalg.norm(a.mesh.bounds.mean(axis=0) - a.detection.cloud.points, axis=1)) < 0.4
        assert off.max() < 1e-3


def _as_shape(view: SeenThing) -> CompletedShape:
    """The truth as its own completion, with a sigma of 1 mm."""
    count = len(view.mesh.vertices)
    return CompletedShape(view.mesh, np.zeros(count, bool), np.full(count, 0.001))


def test_some_views_are_whole_some_are_points_with_a_viewpoint_and_some_points_alone() -> None:
    views = [v.detection for n in range(12) for v in seen_things(Thing("union", n, "train"), 3)]
    told = [(v.view is not None, v.cloud.viewpoint is not None, v.support is not None) for v in views]
    assert {row[:2] for row in told} == {(True, True), (False, True), (False, False)}
    assert {row[2] for row in told} == {True, False}
    assert np.mean([row[0] for row in told]) == pytest.approx(0.55, abs=0.2)


def test_a_sample_says_the_surface_where_the_points_are() -> None:
    detection, mesh = seen()
    sample = sample_of(SeenThing(Thing("l", 0, "train"), detection, mesh))
    assert sample.known.shape == (NUM_CHANNELS, *sample.distance.shape)
    assert sample.known.dtype == sample.distance.dtype == np.int8
    distance = sample.distance * (REACH / 127)
    assert np.abs(distance[sample.known[0] > 0]).mean() < 0.6
    # What is free is outside, but for pixels of the outline.
    assert (distance[sample.known[1] > 60] > 0).mean() > 0.9975
    assert np.mean(distance < 0) == pytest.approx(mesh.volume / _grid_volume(detection), rel=0.1)


def _grid_volume(detection) -> float:
    from gfp_grasp.classfree import grid_around
    from gfp_grasp.level import make_level_view

    grid = grid_around(make_level_view(detection))
    return float(np.prod(grid.shape) * grid.cell_m**3)


def test_samples_are_made_once_and_read_as_they_were_made(tmp_path: Path) -> None:
    things = [Thing("cup", 2, "train"), Thing("sweep", 1, "train")]
    found = cached_samples(things, 2, tmp_path)
    assert len(found) == 4
    stamps = [path.stat().st_mtime_ns for path, _ in found]
    assert cached_samples(things, 2, tmp_path) == found
    assert [path.stat().st_mtime_ns for path, _ in found] == stamps
    fresh = [sample_of(view) for view in seen_things(things[1], 2)]
    for (path, number), sample in zip(found[2:], fresh, strict=True):
        stored = read_sample(path, number)
        np.testing.assert_array_equal(stored.known, sample.known)
        np.testing.assert_array_equal(stored.distance, sample.distance)


def test_batches_mirror_what_is_known_and_what_is_true_alike(tmp_path: Path) -> None:
    found = cached_samples([Thing("mug", 2, "train")], 1, tmp_path)
    sample = read_sample(*found[0])
    stream = field_batches(found, replace(SMALL, batch=1))(torch.Generator().manual_seed(0))
    ways = set()
    for _ in range(12):
        known, distance = (part.numpy() for part in next(stream))
        mirrored = not np.array_equal(known, sample.known)
        step = -1 if mirrored else 1
        np.testing.assert_array_equal(known, sample.known[:, :, ::step])
        np.testing.assert_array_equal(distance, sample.distance[:, ::step])
        ways.add(mirrored)
    assert ways == {True, False}


class Says(nn.Module):
    """A network with one answer."""

    def __init__(self, distance: torch.Tensor, log_scale: float) -> None:
        super().__init__()
        self.distance, self.log_scale = distance, log_scale

    def forward(self, known: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.distance[None], torch.full_like(self.distance, self.log_scale)[None]


def test_loss_is_the_mean_error_in_cells_with_the_scale_that_belongs_to_it() -> None:
    truth = torch.full((4, 4, 4), 127, dtype=torch.int8)
    truth[:2] = 0
    batch = (torch.zeros(NUM_CHANNELS, 4, 4, 4, dtype=torch.int8), truth)
    exact = truth.float() * (REACH / 127)
    assert float(field_loss(Says(exact, 0.0), batch)) == pytest.approx(0.0, abs=1e-6)
    near, far = 1.1, float(np.exp(-REACH / 2) + 0.1)
    off = exact.clone()
    off[:2] += 0.5
    wanted = 0.5 * near / (near + far)
    assert float(field_loss(Says(off, 0.0), batch)) == pytest.approx(1.2 * wanted, rel=1e-4)
    # An error of half a cell everywhere belongs to a scale of half a cell: any other costs more.
    all_off = [float(field_loss(Says(exact + 0.5, float(np.log(s))), batch)) for s in (0.4, 0.5, 0.6)]
    assert all_off[1] == min(all_off)
    assert all_off[1] == pytest.approx(0.5 + 0.2 * (1 + np.log(0.5)), rel=1e-4)


def test_loss_of_a_batch_is_the_mean_of_its_samples() -> None:
    rng = np.random.default_rng(0)

    def sample(shape: tuple[int, int, int]) -> tuple[torch.Tensor, torch.Tensor]:
        known = torch.from_numpy(rng.integers(-127, 128, (NUM_CHANNELS, *shape)).astype(np.int8))
        return known, torch.from_numpy(rng.integers(-127, 128, shape).astype(np.int8))

    torch.manual_seed(0)
    network, one, other = DistanceNet(8, 1).eval(), sample((8, 16, 8)), sample((16, 8, 24))
    with torch.no_grad():
        apart = [float(field_loss(network, batch)) for batch in (one, other)]
        both = float(field_loss(network, (*one, *other)))
    assert both == pytest.approx(np.mean(apart), rel=1e-5)


def test_a_few_steps_on_one_sample_bring_the_loss_down(tmp_path: Path) -> None:
    found = cached_samples([Thing("apple-like", 1, "train")], 1, tmp_path)
    torch.manual_seed(0)
    network = DistanceNet(8, 1)
    optimiser = torch.optim.Adam(network.parameters(), lr=5e-3)
    stream = field_batches(found, replace(SMALL, batch=1))(torch.Generator().manual_seed(0))
    losses = []
    for _ in range(12):
        loss = field_loss(network, next(stream))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert np.mean(losses[-3:]) < 0.7 * losses[0]


def test_scales_are_calibrated_so_that_two_sigma_hold_nearly_all(monkeypatch: pytest.MonkeyPatch) -> None:
    views = list(seen_things(Thing("cup", 2, "train"), 2))
    given = iter(views)

    def off(detection, network):
        view = next(given)
        shape = _as_shape(view)
        normals = np.asarray(view.mesh.vertex_normals)
        mesh = view.mesh.copy()
        mesh.vertices = np.asarray(mesh.vertices) + 0.006 * normals
        return CompletedShape(mesh, shape.observed, shape.sigma_m)

    monkeypatch.setattr("gfp_grasp.train.classfree.complete_classfree", off)
    network = DistanceNet(8, 1)
    assert network.head.bias is not None
    before = network.head.bias.detach().clone()
    calibrate_scales(network, views)
    grown = network.head.bias.detach() - before
    assert not grown[:8].any()
    # Vertices are 6 mm off and say 1 mm: two sigma must be three times as large.
    np.testing.assert_allclose(grown[8:].numpy(), np.log(3), atol=0.1)


def test_the_truth_is_far_better_than_the_hull_and_no_answer_is_counted() -> None:
    things = [Thing("mug", 7, "test"), Thing("tool-like", 0, "test")]
    # What was seen tells which thing it is.
    truths = {_mark(view): view for thing in things for view in seen_things(thing, 2, PLAIN)}

    def truth(detection):
        return _as_shape(truths[float(detection.cloud.points.sum())])

    rows = measure_against_hull(truth, things, num_views=2)
    assert [(row.kind, row.view) for row in rows] == [("mug", 0), ("mug", 1), ("tool-like", 0), ("tool-like", 1)]
    assert all(row.cd_m is not None and row.cd_m < 0.5 * row.hull_cd_m for row in rows)
    assert all(row.two_sigma == 1.0 for row in rows)
    found = summarise_against_hull(rows)
    assert found["kinds"]["mug"]["views"] == 2
    assert found["worst"] < 0.5

    def refuses(detection):
        raise NoSurface("nothing is there")

    rows = measure_against_hull(refuses, things[:1], num_views=1)
    assert (rows[0].cd_m, rows[0].error) == (None, "NoSurface")
    assert summarise_against_hull(rows) == {
        "views": 1,
        "failed": 1,
        "kinds": {"mug": {"views": 1, "failed": 1}},
    }


def _mark(view: SeenThing) -> float:
    return float(view.detection.cloud.points.sum())


def test_summary_has_the_ratio_of_the_means_and_the_worst_view() -> None:
    def row(kind: str, cd_m: float, hull_cd_m: float) -> HullRow:
        return HullRow(kind=kind, number=0, view=0, cd_m=cd_m, hull_cd_m=hull_cd_m, two_sigma=0.9, seconds=0.2)

    rows = [row("cup", 0.002, 0.01), row("cup", 0.006, 0.006), row("shell", 0.001, 0.004)]
    found = summarise_against_hull(rows)
    assert (found["views"], found["failed"]) == (3, 0)
    assert found["ratio"] == pytest.approx(0.009 / 0.02, abs=1e-3)
    assert found["worst"] == 1.0
    assert found["worst_99"] == pytest.approx(0.985, abs=1e-3)
    assert found["kinds"]["cup"] == {
        "views": 2, "failed": 0, "cd_m": 0.004, "hull_cd_m": 0.008, "ratio": 0.5, "worst": 1.0,
    }  # fmt: skip
    assert (found["two_sigma"], found["seconds"]) == (0.9, 0.2)


def test_a_run_goes_from_shapes_to_weights_and_their_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = []

    def few(split: str, members: int, mixtures: int, *, without=()):
        drawn.append((split, without))
        return [Thing("cup", split_seeds("cup", split, 1)[0], split), Thing("shell", 0, split)]

    monkeypatch.setattr("gfp_grasp.train.classfree.draw_things", few)
    steps = []
    card = train_classfree(
        config=SMALL,
        without=("mug",),
        out=tmp_path / "w.safetensors",
        runs=tmp_path,
        report=lambda step, loss: steps.append((step, loss)),
    )
    assert drawn == [("train", ("mug",)), ("val", ("mug",)), ("test", ())]
    content = json.loads(card.read_text())
    assert content["data"] == {"without": ["mug"], "split": "train", "things": 2, "samples": 2}
    assert content["config"]["width"] == 8
    assert content["metrics"]["test"]["views"] == 4
    assert content["metrics"]["left_out"] == {"views": 0, "failed": 0, "kinds": {}}
    assert [step for step, _ in steps] == [1, 2]
    network = DistanceNet(8, 1)
    network.load_state_dict({name: tensor.float() for name, tensor in load_file(tmp_path / "w.safetensors").items()})
    stamp = (tmp_path / "w.safetensors").stat().st_mtime_ns
    train_classfree(config=SMALL, without=("mug",), out=tmp_path / "again.safetensors", runs=tmp_path)
    assert (tmp_path / "w.safetensors").stat().st_mtime_ns == stamp
    same = load_file(tmp_path / "again.safetensors")
    assert all(torch.equal(same[name], tensor) for name, tensor in load_file(tmp_path / "w.safetensors").items())


def test_a_family_that_there_is_not_cannot_be_left_out(tmp_path: Path) -> None:
    with pytest.raises(UnknownCategory, match="cup"):
        train_classfree(without=("cups",), runs=tmp_path)


@pytest.mark.parametrize("wrong", [{"width": 12}, {"depth": 0}, {"views": 0}, {"mixtures": 0}, {"members": 0}])
def test_a_schedule_without_sense_is_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(InvalidOption, match="multiple of 8"):
        ClassfreeConfig(**wrong)  # pyright: ignore[reportArgumentType]
