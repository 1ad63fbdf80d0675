"""Training views: how objects rest, where cameras stand, what is kept on disk."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train import View, ViewsConfig, render_views
from gfp_grasp.train import views as module
from gfp_grasp.train.views import cached_views, config_id, seed_of, training_sources
from gfp_grasp.transforms import apply_T

SMALL = ViewsConfig(width=80, height=60, num_points=200, hidden_share=0.0, fallen_share=0.0)
VIEWPOINT, HEADING = (-0.0508271, -0.1712869, 0.564025), (0.6207267, 0.784027)
DEFAULT_CONFIG_ID = "afb8a729"


@pytest.fixture(scope="module")
def wedge(tmp_path_factory: pytest.TempPathFactory) -> ObjectSource:
    """A body without any symmetry, 5 by 7 by 11 cm."""
    corners = np.array([[0, 0, 0], [0.05, 0, 0], [0, 0.07, 0], [0.01, 0.01, 0.11]])
    path = tmp_path_factory.mktemp("wedge") / "wedge__one.ply"
    trimesh.Trimesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).export(path)
    return ObjectSource("one", "wedge", path=path)


@pytest.mark.parametrize(("fallen_share", "ways"), [(0.0, {"upright"}), (1.0, {"upside_down", "lying"})])
def test_objects_rest_on_the_table_in_the_ways_that_are_asked_for(
    wedge: ObjectSource, fallen_share: float, ways: set[str]
) -> None:
    mesh = wedge.load_mesh()
    views = render_views(wedge, num_views=16, config=replace(SMALL, fallen_share=fallen_share))
    assert {view.resting for view in views} == ways
    for view in views:
        z = view.T_world_object[:3, 2]
        upright = {"upright": 1.0, "upside_down": -1.0, "lying": 0.0}[view.resting]
        assert z[2] == pytest.approx(upright, abs=1e-9)
        assert np.linalg.det(view.T_world_object[:3, :3]) == pytest.approx(1.0)
        assert apply_T(view.T_world_object, mesh.vertices)[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(view.T_world_object[:2, 3], 0.0)
    heading = np.array([np.arctan2(*view.T_world_object[:2, 0]) for view in views])
    assert np.ptp(heading) > 3.0


def test_views_hold_the_surface_in_its_pose_within_the_noise_of_a_sensor(wedge: ObjectSource) -> None:
    mesh = wedge.load_mesh()
    for view in render_views(wedge, num_views=6, config=SMALL):
        local = (view.points - view.T_world_object[:3, 3]) @ view.T_world_object[:3, :3]
        distance = np.abs(trimesh.proximity.signed_distance(mesh, local))
        assert np.median(distance) < 0.003
        assert 60 <= len(view.points) <= 200


def test_cameras_stand_as_high_and_as_far_as_the_config_says(wedge: ObjectSource) -> None:
    config = replace(SMALL, elevation_deg=(30.0, 31.0), distance_m=(0.6, 0.62))
    mesh = wedge.load_mesh()
    for view in render_views(wedge, num_views=8, config=config):
        middle = apply_T(view.T_world_object, mesh.vertices)
        middle = (middle.min(axis=0) + middle.max(axis=0)) / 2
        away = view.viewpoint - middle  # the camera looks at a place up to 3 cm beside the middle along each axis
        assert 0.6 - 0.052 < np.linalg.norm(away) < 0.62 + 0.052
        assert away[2] == pytest.approx(0.61 * np.sin(np.radians(30.5)), abs=0.03 + 0.01)


def test_an_occluder_hides_part_of_a_view_where_asked(wedge: ObjectSource) -> None:
    whole = render_views(wedge, num_views=8, config=replace(SMALL, num_points=10_000))
    hidden = render_views(wedge, num_views=8, config=replace(SMALL, num_points=10_000, hidden_share=1.0))
    assert np.mean([len(view.points) for view in hidden]) < 0.85 * np.mean([len(view.points) for view in whole])


def test_an_object_out_of_sight_gives_no_view(wedge: ObjectSource) -> None:
    assert render_views(wedge, num_views=2, config=replace(SMALL, distance_m=(2.9, 2.95))) == []


def test_another_first_seed_draws_other_views(wedge: ObjectSource) -> None:
    one, again = (render_views(wedge, num_views=2, config=SMALL) for _ in range(2))
    other = render_views(wedge, num_views=2, config=SMALL, first_seed=1)
    assert np.array_equal(one[1].viewpoint, again[1].viewpoint)
    assert not np.array_equal(one[0].viewpoint, one[1].viewpoint)
    assert not np.array_equal(one[0].viewpoint, other[0].viewpoint)


def test_the_draws_are_those_that_the_shipped_networks_were_trained_on() -> None:
    """A change of these numbers changes what is drawn in training: weights are to be made again then."""
    view = render_views(ObjectSource("cup-3", "cup", family="cup", seed=3), num_views=1, config=SMALL)[0]
    assert view.resting == "upright"
    np.testing.assert_allclose(view.viewpoint, VIEWPOINT, atol=1e-5)
    np.testing.assert_allclose(view.T_world_object[0, :2], HEADING, atol=1e-6)


def test_a_view_is_a_detection_of_its_own_class_on_its_table() -> None:
    points = np.array([[0.1, 0.2, 0.0], [0.3, 0.5, 0.4], [0.2, 0.3, 0.1]])
    source = ObjectSource("mug-7", "mug", family="mug", seed=7)
    view = View(source, points, np.array([1.0, 0.0, 0.5]), np.eye(4), "upright")
    assert (view.family, view.seed) == ("mug", 7)
    found = view.detection()
    assert (found.category, found.scores) == ("mug", {"mug": 1.0})
    assert found.support is not None
    assert found.support.height_m == 0.0
    np.testing.assert_array_equal(found.up, [0, 0, 1])
    np.testing.assert_allclose(found.box.T_world_box[:3, 3], [0.2, 0.35, 0.2])
    np.testing.assert_allclose(found.box.extents, [0.2, 0.3, 0.4])
    np.testing.assert_array_equal(found.cloud.viewpoint, [1.0, 0.0, 0.5])
    other = view.detection(category="cup", support=False)
    assert other.support is None
    assert other.scores == {"cup": 1.0}


def test_views_are_rendered_once_and_read_afterwards(wedge: ObjectSource, tmp_path: Path, monkeypatch) -> None:
    assert wedge.path is not None
    data = wedge.path.parent

    def views(**options) -> list[View]:
        found: list[View] = []
        for split in ("train", "val", "test"):
            found += cached_views("wedge", split, num_views=2, folder=tmp_path, config=SMALL, data=data, **options)
        return found

    first = views()
    assert len(first) == 2
    assert len(list(tmp_path.rglob("*.npz"))) == 1
    monkeypatch.setattr(module, "render_views", lambda *_, **__: pytest.fail("rendered again"))
    again = views()
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
        np.testing.assert_array_equal(a.T_world_object, b.T_world_object)
        np.testing.assert_array_equal(a.viewpoint, b.viewpoint)
        assert a.resting == b.resting == "upright"
        assert b.points.dtype == np.float64


def test_another_config_number_of_views_or_mesh_has_a_file_of_its_own(wedge: ObjectSource, tmp_path: Path) -> None:
    assert wedge.path is not None
    data = tmp_path / "data"
    data.mkdir()
    (data / "wedge__one.ply").write_bytes(wedge.path.read_bytes())

    def fill(num_views: int, config: ViewsConfig) -> int:
        for split in ("train", "val", "test"):
            cached_views("wedge", split, num_views=num_views, folder=tmp_path / "kept", config=config, data=data)
        return len(list((tmp_path / "kept").rglob("*.npz")))

    assert fill(1, SMALL) == 1
    assert fill(2, SMALL) == 2
    assert fill(1, replace(SMALL, num_points=100)) == 3
    mesh = trimesh.load_mesh(data / "wedge__one.ply")
    mesh.apply_scale(1.1)
    mesh.export(data / "wedge__one.ply")
    assert fill(1, SMALL) == 4


def test_sources_are_procedural_seeds_or_the_files_of_a_class(wedge: ObjectSource) -> None:
    assert wedge.path is not None
    procedural = training_sources("mug", "train", 2)
    assert [(s.family, s.seed) for s in procedural] == [("mug", s.seed) for s in procedural]
    assert len(procedural) == 2
    found = [s for split in ("train", "val", "test") for s in training_sources("wedge", split, data=wedge.path.parent)]
    assert [s.path for s in found] == [wedge.path]
    assert not [s for split in ("train", "val", "test") for s in training_sources("cup", split, data=wedge.path.parent)]
    assert seed_of(found[0]) == seed_of(replace(found[0], height_m=0.3)) > 0
    assert seed_of(procedural[0]) == procedural[0].seed


def test_configs_have_names_that_change_with_every_field() -> None:
    assert len(config_id(SMALL)) == 8
    assert config_id(SMALL) == config_id(replace(SMALL))
    changes = ({"fov_y_deg": 36.0}, {"width": 81}, {"hidden_share": 0.5}, {"elevation_deg": (8.0, 74.0)})
    assert len({config_id(SMALL), *(config_id(replace(SMALL, **change)) for change in changes)}) == 5
    assert config_id(ViewsConfig()) == DEFAULT_CONFIG_ID  # else what was rendered for the shipped weights is not found


@pytest.mark.parametrize(
    "nonsense", [{"fallen_share": -0.1}, {"fallen_share": 1.1}, {"hidden_share": -0.1}, {"hidden_share": 1.1}]
)
def test_shares_outside_of_zero_and_one_are_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        ViewsConfig(**nonsense)
