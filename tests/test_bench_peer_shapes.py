"""The picture of `bench peers`: which views it shows, in which frame, and where each shape is drawn."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from peer_bench import Shipped, write_block
from PIL import Image

from gfp_grasp.bench import PeersConfig, methods, peer_shapes, shapes_of_peers
from gfp_grasp.bench.methods import Answer, ObjectView
from gfp_grasp.drawing import draw_completions
from gfp_grasp.errors import NoSurface

PX, STRIP = 180, 26


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, ObjectView]:
    """Views that a peer was asked for, by class; it has no answer to a box, every other method says what is true."""
    monkeypatch.setattr(peer_shapes, "BEFORE", ("partial", "told-pcrnet"))
    monkeypatch.setattr(peer_shapes, "AFTER", ("gfpnet",))
    Shipped(monkeypatch, tmp_path / "shipped")("pcn", "pcn_true_box")
    views: dict[str, ObjectView] = {}

    def run(method: str, view: ObjectView, told: str | None, given: str) -> Answer:
        if method == "pcn":
            views[given] = view
            if given == "box":
                raise NoSurface("nothing")
        return methods.run_method("partial" if method == "partial" else "truth", view, told, given)

    monkeypatch.setattr(peer_shapes, "run_method", run)
    return views


def test_one_view_of_each_class_is_shown_as_its_camera_looks_along_x(seen: dict[str, ObjectView], tmp_path: Path):
    (tmp_path / "blocks").mkdir()
    for name, extents in {"cup__a": (0.06, 0.05, 0.08), "cup__b": (0.1, 0.1, 0.1), "box__c": (0.2, 0.1, 0.1)}.items():
        write_block(tmp_path / "blocks" / f"{name}.ply", *extents)
    found = shapes_of_peers(PeersConfig(("pcn",), data=tmp_path / "blocks"))
    assert {group: list(shapes) for group, shapes in found.items()} == {
        "cup": ["truth", "partial", "told-pcrnet", "pcn", "gfpnet"],
        "household": ["truth", "partial", "told-pcrnet", "gfpnet"],
    }
    for group, category, sides in (("cup", "cup", (0.05, 0.06)), ("household", "box", (0.1, 0.2))):
        truth, points = found[group]["truth"], found[group]["partial"]
        assert isinstance(truth, trimesh.Trimesh)
        assert isinstance(points, np.ndarray)
        np.testing.assert_allclose(truth.bounds[0, 2], 0, atol=1e-9)
        np.testing.assert_allclose(truth.bounds.sum(axis=0)[:2], 0, atol=1e-9)
        level = truth.bounding_box_oriented.primitive.extents
        assert sorted(level)[:2] == pytest.approx(sorted((*sides, truth.extents[2]))[:2], abs=1e-6)
        assert truth.volume == pytest.approx(sides[0] * sides[1] * truth.extents[2], rel=1e-6)
        # What faces the camera is in front of the middle, and as far to the left as to the right.
        reach = truth.extents.max()
        assert points[:, 0].mean() < -0.1 * reach
        view = seen[category]
        away_m = np.linalg.norm((view.mesh.bounds.mean(axis=0) - view.cloud.viewpoint)[:2])
        depth = np.linalg.norm((view.cloud.points - view.cloud.viewpoint)[:, :2], axis=1)
        in_frame = np.linalg.norm(points[:, :2] - [-away_m, 0], axis=1)
        np.testing.assert_allclose(in_frame, depth, atol=1e-9)


def test_shapes_stand_in_the_columns_of_their_methods_and_the_rows_of_their_views(tmp_path: Path) -> None:
    block = trimesh.creation.box(bounds=((-0.02, -0.03, 0), (0.02, 0.03, 0.09)))
    half = trimesh.creation.box(bounds=((-0.02, -0.03, 0), (0.02, 0.03, 0.045)))
    rows = {"high": {"truth": block, "low": half, "dots": block.vertices}, "low": {"truth": half, "all": half}}
    draw_completions(rows, tmp_path / "a.png")
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("L"))
    assert picture.shape == (STRIP + 2 * PX, 4 * PX)
    inner = [
        [(picture[STRIP + PX * r : STRIP + PX * (r + 1) - 20, PX * c : PX * (c + 1)] < 225) for c in range(4)]
        for r in range(2)
    ]
    share = np.array([[panel.mean() for panel in row] for row in inner])
    assert share[0, 0] > 0.2
    assert 0.35 < share[0, 1] / share[0, 0] < 0.75  # half as high, framed alike
    assert 0.001 < share[0, 2] < 0.02
    assert share[0, 3] == 0
    assert share[1, 1] == share[1, 2] == 0
    assert share[1, 3] == pytest.approx(share[1, 0], abs=1e-9)


def test_the_camera_of_the_view_stands_to_the_left_of_that_of_the_picture(tmp_path: Path) -> None:
    plain = trimesh.creation.box(bounds=((-0.05, -0.05, 0), (0.05, 0.05, 0.1)))
    nearer = trimesh.creation.box(bounds=((-0.05, -0.05, 0), (0, 0.05, 0.1)))  # the half before the view's camera
    draw_completions({"a": {"truth": plain, "nearer": nearer}}, tmp_path / "a.png")
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("L"))[STRIP : STRIP + PX - 20]
    columns = np.flatnonzero((picture[:, PX:] < 225).any(axis=0))
    whole = np.flatnonzero((picture[:, :PX] < 225).any(axis=0))
    assert columns.min() == pytest.approx(whole.min(), abs=2)
    assert columns.max() < whole.max() - 20
