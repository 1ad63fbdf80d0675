"""The demonstration's street: its figures, its files, its page, and what is refused."""

import base64
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from recorded_calls import recorded
from toy_street import ROAD_M, THINGS, toy_street

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import Capture, read_capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.datasets import read_scans
from gfp_grasp.demo import run_demo
from gfp_grasp.demo.page import write_page
from gfp_grasp.demo.street import HEADINGS, street_row, street_scene
from gfp_grasp.detect import GivenBoxes
from gfp_grasp.drawing import ClassColours, Item, paled
from gfp_grasp.errors import InvalidOption
from gfp_grasp.types import OrientedBox

CAPTURE = Capture("own.bin", points=np.eye(3))
CONFIG = CompleteConfig(rival_share=0.5)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    recorded(monkeypatch, "gfp_grasp.demo.street.complete_capture", toy_street())
    return street_scene(CAPTURE, folder=tmp_path / "street")


def test_figures_are_class_distance_size_points_guessed_share_and_seconds() -> None:
    one = toy_street()[0]
    row = dict(zip(HEADINGS, street_row(Item("car-1", one)), strict=True))
    points = str(len(one.detection.cloud.points))
    away = np.linalg.norm((9.0, 3.0, ROAD_M + 0.8))
    guessed = f"{1 - one.observed.mean():.0%}"
    assert row == {
        "object": "car-1",
        "class": "car 0.90",
        "distance, m": f"{away:.1f}",
        "size, m": "4.0 x 1.8 x 1.6",
        "points": points,
        "guessed": guessed,
        "complete, s": "0.5",
    }


def test_a_street_writes_its_picture_its_scene_and_a_file_for_each_object(made, tmp_path: Path) -> None:
    assert made.title == "own.bin"
    assert [item.name for item in made.items] == ["car", "car_2", "pedestrian"]
    folder = tmp_path / "street"
    for name in ("street.xml", "car_completed.glb", "pedestrian_completed.xml", "car_2_cloud.ply", "figures.json"):
        assert (folder / name).is_file(), name
    assert list(json.loads((folder / "figures.json").read_text())[0]) == list(HEADINGS)
    (caption,) = made.pictures.values()
    assert caption.endswith("3 of 3 objects stand.")
    with Image.open(folder / "street.jpg") as picture:
        assert picture.width == 1600


def test_the_page_has_the_scan_in_centimetres_over_its_road_and_the_colours_of_the_classes(made) -> None:
    page = write_page([made], command="gfp-grasp demo --street")
    assert "<h1>One scan in, whole vehicles and people out</h1>" in page
    assert "data:image/jpeg;base64," in page
    assert "best grasp" not in page[page.index("<section") : page.index("</section>")]
    found = re.search(r'<script type="application/json" id="scenes">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    (shapes,) = json.loads(found.group(1))
    points = np.frombuffer(base64.b64decode(shapes["scan"]), "<i2").reshape(-1, 3)
    assert made.street is not None
    assert len(points) == len(made.street.points)
    np.testing.assert_allclose(points / 100 + (0.0, 0.0, ROAD_M), made.street.points, atol=0.006)
    colours = ClassColours.of([category for category, *_ in THINGS]).rgb
    for item, (category, *_) in zip(shapes["items"], THINGS, strict=True):
        assert item["colours"] == [colours[category].tolist(), paled(colours[category]).tolist()]
    for rgb in colours.values():
        assert f"--dot:#{bytes(rgb).hex()}" in page
    vertices = np.frombuffer(base64.b64decode(shapes["items"][0]["completed"]["v"]), "<f4").reshape(-1, 3)
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)


def test_what_is_no_whole_scan_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    recorded(monkeypatch, "gfp_grasp.demo.street.complete_capture", (toy_street()[0],))
    with pytest.raises(InvalidOption, match=r"own\.bin is no whole LiDAR scan: leave out --street"):
        street_scene(CAPTURE, folder=tmp_path)


def test_the_demonstration_shows_the_street_that_ships_alone_or_the_user_s_scans(
    made, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    read = recorded(monkeypatch, "gfp_grasp.demo.run.read_capture", CAPTURE)
    scene = recorded(monkeypatch, "gfp_grasp.demo.run.street_scene", made)
    assert run_demo(tmp_path, street=True, config=CONFIG, seed=3) == (made,)
    assert run_demo(tmp_path, street=True, recordings=(Path("far/a.bin"),)) == (made,)
    assert read.calls == [((Path("street"),), {}), ((Path("far/a.bin"),), {})]
    ((first,), named), ((second,), other) = scene.calls
    assert (first.name, second.name) == ("A street", "own.bin")
    assert named == {"folder": tmp_path / "street", "config": CONFIG, "seed": 3}
    assert other["folder"] == tmp_path / "a"
    assert "gfp-grasp demo --street --capture a.bin --seed 0" in (tmp_path / "index.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_things_of_the_shipped_street_are_completed_as_what_they_are_and_most_stand(tmp_path: Path) -> None:
    (truth,) = read_scans(data_dir("sim_scenes"))
    given = GivenBoxes([OrientedBox(box.T_scan_box, box.size_m) for box in truth.boxes])
    made = partial(street_scene, detector=given)(read_capture("street"), folder=tmp_path)
    assert len(made.items) >= len(truth.boxes) - 1
    right = 0
    for item in made.items:
        middle = item.completion.mesh.bounds.mean(axis=0)
        nearest = min(truth.boxes, key=lambda box: float(np.linalg.norm(box.centre[:2] - middle[:2])))
        right += item.completion.category == nearest.category
        assert item.completion.mesh.is_watertight
        assert np.linalg.norm(nearest.centre[:2] - middle[:2]) < 1.0
    assert right >= len(made.items) - 2
    (caption,) = made.pictures.values()
    standing = re.search(r"(\d+) of (\d+) objects stand", caption)
    assert standing is not None
    assert int(standing[1]) >= int(standing[2]) - 5  # two-wheelers fall over
