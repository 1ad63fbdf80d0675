"""The training of the detector of scans: what it is shown, and that it learns from it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gfp_grasp.detect import CELL_M, StreetNet
from gfp_grasp.errors import InvalidOption
from gfp_grasp.train import (
    PointRCNNConfig,
    StreetScan,
    measure_pointrcnn,
    read_street,
    render_street,
    street_of_kitti,
    train_pointrcnn,
)
from gfp_grasp.train.pointrcnn import _CROP, _UNSAID, _batches, _crop, pointrcnn_loss
from gfp_grasp.train.street_data import write_street

NAMES = ("car", "pedestrian")


def wall_and_car() -> StreetScan:
    """A car with its points to the left, ahead; a wall to the right; a tram, which is no class of ours."""
    rng = np.random.default_rng(0)
    boxes = np.array([[12.0, 6.0, 0.8, 4.0, 1.8, 1.5, 0.3], [20.0, -9.0, 1.6, 10.0, 2.5, 3.2, 0.0]])
    c, s = np.cos(0.3), np.sin(0.3)
    local = rng.uniform(-0.5, 0.5, (300, 3)) * (3.9, 1.7, 1.4)
    car = local @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + boxes[0, :3]
    tram = rng.uniform(-0.5, 0.5, (200, 3)) * (9.8, 2.4, 3.0) + boxes[1, :3]
    wall = np.column_stack([rng.uniform(-20, 20, 800), np.full(800, -14.0), rng.uniform(0.1, 4.0, 800)])
    things = np.repeat([0, 1, -1], [300, 200, 800])
    return StreetScan(np.concatenate([car, tram, wall]), boxes, np.array(["car", "tram"]), things)


def test_a_scan_is_kept_as_it_was(tmp_path: Path):
    scan = replace(wall_and_car(), labelled=0.7)
    again = read_street(write_street(tmp_path / "scan.npz", scan))
    np.testing.assert_allclose(again.points, scan.points, atol=0.0011)
    np.testing.assert_array_equal(again.things, scan.things)
    np.testing.assert_array_equal(again.boxes, scan.boxes)
    assert again.classes.tolist() == ["car", "tram"]
    assert again.labelled == 0.7


def test_a_crop_tells_of_each_point_what_it_belongs_to():
    scan = wall_and_car()
    number = {name: n for n, name in enumerate(NAMES)}
    for seed in range(8):
        picture, corner, points, things, boxes, classes = _crop(scan, number, np.random.default_rng(seed))
        assert picture.shape[1:] == (_CROP, _CROP)
        assert ((points[:, :2] >= corner - 0.01) & (points[:, :2] <= corner + _CROP * CELL_M + 0.01)).all()
        assert set(np.unique(things)) <= {_UNSAID, -1, 0}  # a tram teaches nothing
        if (things == 0).any():
            assert classes[0] == 0
            away = np.linalg.norm(points[things == 0][:, :2] - boxes[0, :2], axis=1)
            assert away.max() < 0.6 * np.hypot(*boxes[0, 3:5]) + 0.2
        assert (classes[1:] == -1).all()


def test_beside_the_labelled_angle_nothing_is_taught():
    scan = replace(wall_and_car(), labelled=0.3)  # the car is at 0.46 rad
    _, _, _, things, _, classes = _crop(scan, {"car": 0}, np.random.default_rng(1))
    assert 0 not in things
    assert (classes == -1).all()
    assert (things == _UNSAID).any()


def test_the_loss_of_one_street_falls(tmp_path: Path):
    path = write_street(tmp_path / "scan.npz", wall_and_car())
    config = PointRCNNConfig(steps=30, batch=1, width=8, classes=NAMES)
    torch.manual_seed(0)
    network = StreetNet(len(NAMES), 8)
    batches = _batches([path], config, torch.Generator().manual_seed(0))
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(30):
        value = pointrcnn_loss(network, next(batches))
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        losses.append(float(value.detach()))
    assert np.mean(losses[-5:]) < 0.8 * np.mean(losses[:5])


def test_an_untrained_network_is_measured_and_finds_nothing():
    torch.manual_seed(0)
    figures = measure_pointrcnn(StreetNet(2, 4).eval(), [wall_and_car()], NAMES)
    assert set(figures) == {f"{what}_{name}" for what in ("recall", "precision") for name in NAMES}
    assert figures["recall_car"] == 0.0


def test_streets_are_rendered_once_and_the_same_again(tmp_path: Path):
    one = read_street(render_street(("val", 3), folder=tmp_path / "a"))
    before = (tmp_path / "a" / "val_00003.npz").stat().st_mtime_ns
    render_street(("val", 3), folder=tmp_path / "a")
    assert (tmp_path / "a" / "val_00003.npz").stat().st_mtime_ns == before
    other = read_street(render_street(("val", 3), folder=tmp_path / "b"))
    np.testing.assert_array_equal(one.points, other.points)
    assert len(one.boxes) == len(one.classes) >= 5
    own = one.points[one.things == int(np.bincount(one.things[one.things >= 0]).argmax())]
    assert np.ptp(own, axis=0).max() < 20
    assert 0.04 < one.points[:, 2].min() < 0.1


def kitti_tree(folder: Path, count: int) -> Path:
    rng = np.random.default_rng(0)
    road = np.column_stack([rng.uniform(-30, 30, (6000, 2)), rng.normal(-1.73, 0.01, 6000)])
    car = rng.uniform(-0.5, 0.5, (200, 3)) * (3.9, 1.6, 1.3) + (10.0, 2.0, -0.9)
    for n in range(count):
        np.savez(
            folder / f"{n}.npz",
            points=np.concatenate([road, car]).astype(np.float32),
            boxes=np.array([[10.0, 2.0, -0.9, 4.0, 1.7, 1.5, 0.0]]),
            classes=np.array(["Car"]),
        )
    return folder


def test_a_tree_of_kitti_is_learnt_from_by_the_same_command(tmp_path: Path):
    tree = kitti_tree(tmp_path, 3)
    (scan, *_) = list(street_of_kitti(tree))
    assert (scan.things == 0).sum() > 150
    np.testing.assert_allclose(scan.boxes[0, 2], 0.83, atol=0.05)  # from the road on
    assert np.degrees(scan.labelled) == pytest.approx(40.5)
    config = PointRCNNConfig(steps=2, batch=2, width=4, classes=("car",))
    card = train_pointrcnn(config=config, data=tree, out=tmp_path / "own.safetensors", runs=tmp_path / "runs")
    assert '"simulated": false' in card.read_text(encoding="utf-8")


def test_nonsense_is_refused(tmp_path: Path):
    with pytest.raises(InvalidOption, match="width, streets"):
        PointRCNNConfig(width=0)
    with pytest.raises(InvalidOption, match="holds 1 scans; at least 2"):
        train_pointrcnn(data=kitti_tree(tmp_path, 1), runs=tmp_path / "runs")
