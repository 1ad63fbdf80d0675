"""The scan of a street that ships: what is in it, and that its command makes it."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import STREET_FILE, read_capture
from gfp_grasp.datasets import Scan, read_scans
from gfp_grasp.demo.quickstart import write_street
from gfp_grasp.detect import find_road

FILE = data_dir("sim_scenes") / STREET_FILE


@pytest.fixture(scope="module")
def street() -> Scan:
    (found,) = read_scans(FILE.parent)
    return found


def test_the_street_is_small_and_holds_vehicles_and_people_of_several_classes(street: Scan) -> None:
    assert FILE.stat().st_size < 700_000
    assert street.name == "street"
    assert street.points.shape[0] > 100_000
    counts = Counter(box.category for box in street.boxes)
    assert 10 <= counts.total() <= 20
    assert counts["car"] >= 4
    assert counts["van"] >= 1
    assert counts["truck"] + counts["bus"] >= 1
    assert counts["pedestrian"] >= 2
    assert counts["cyclist"] >= 1


def test_nearly_all_of_its_boxes_hold_enough_points_to_be_completed(street: Scan) -> None:
    num_points = np.array([box.inside(street.points).sum() for box in street.boxes])
    assert (num_points > 0).all()
    assert (num_points >= 30).sum() >= len(street.boxes) - 1


def test_its_road_lies_173_cm_under_the_sensor_with_z_up(street: Scan) -> None:
    road = find_road(street.points, np.array([0.0, 0.0, 1.0]), viewpoint=np.zeros(3))
    assert road.heights(np.zeros((1, 3)))[0] == pytest.approx(1.73, abs=0.01)


def test_it_is_read_by_its_name_and_by_its_file(street: Scan) -> None:
    for name in ("street", FILE):
        capture = read_capture(name)
        assert capture.points is not None
        np.testing.assert_array_equal(capture.points, street.points)
        assert capture.up_is_assumed


def test_its_command_makes_it(street: Scan, tmp_path: Path) -> None:
    write_street(tmp_path / STREET_FILE)
    (made,) = read_scans(tmp_path)
    assert [box.category for box in made.boxes] == [box.category for box in street.boxes]
    for new, old in zip(made.boxes, street.boxes, strict=True):
        np.testing.assert_allclose([*new.centre, *new.size_m, new.yaw_rad], [*old.centre, *old.size_m, old.yaw_rad])
    assert abs(len(made.points) - len(street.points)) < 100  # ray casters differ at a few edges
