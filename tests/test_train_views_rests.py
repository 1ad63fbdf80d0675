"""How the objects of training views rest: as their family's spec says, what lies as a rule on its flat side."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay
from toy_bodies import T_WORLD_OBJECT, l_body

from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import FAMILIES, get_family, make_shape, split_seeds
from gfp_grasp.train import View, ViewsConfig, render_views, shape_source
from gfp_grasp.train import views as module
from gfp_grasp.train.rests import _flattest_roll, draw_stable_rest, ways_of_shape
from gfp_grasp.train.rests import ways_of_resting as ways_of
from gfp_grasp.train.views import views_of_mesh
from gfp_grasp.transforms import apply_T, is_rotation, rotation_about
from gfp_grasp.types import RESTS

SMALL = ViewsConfig(width=80, height=60, num_points=200, hidden_share=0.0, fallen_share=0.0)
FALLEN = replace(SMALL, fallen_share=1.0)
TUBE = ("lying", "upright")


@pytest.fixture(scope="module")
def brick(tmp_path_factory: pytest.TempPathFactory) -> ObjectSource:
    path = tmp_path_factory.mktemp("brick") / "brick__one.ply"
    trimesh.creation.box((0.05, 0.07, 0.11)).export(path)
    return ObjectSource("one", "brick", path=path)


def _views(
    mesh: trimesh.Trimesh, config: ViewsConfig, ways: tuple[str, ...] | None = None, *, count: int = 16
) -> list[View]:
    knobs = {} if ways is None else {"ways": ways}
    found = views_of_mesh(
        ObjectSource("one", "any"), mesh, np.random.default_rng(0), num_views=count, config=config, **knobs
    )
    assert len(found) == count
    return found


def test_the_ways_of_resting_come_the_likeliest_first() -> None:
    assert ways_of({"upright": 0.3, "lying": 0.7}) == ("lying", "upright")
    assert ways_of({"upside_down": 0.005, "upright": 0.93, "lying": 0.065}) == ("upright", "lying", "upside_down")
    assert ways_of({"lying": 0.5, "upright": 0.5}) == ("lying", "upright")


@pytest.mark.parametrize(
    ("family", "ways"),
    [
        *((name, RESTS) for name in ("cup", "mug", "bottle", "")),
        *((name, ("upright",)) for name in ("pedestrian", "box")),
        ("carton", ("upright", "lying", "upside_down")),
        ("plate", ("upright", "upside_down")),
        ("tube", TUBE),
    ],
)
def test_members_of_a_family_rest_as_its_spec_says_and_anything_else_in_every_way(
    brick: ObjectSource, monkeypatch: pytest.MonkeyPatch, family: str, ways: tuple[str, ...]
) -> None:
    asked: list = []

    def views(*args, **knobs) -> list[View]:
        asked.append(knobs["ways"])
        return []

    monkeypatch.setattr(module, "views_of_mesh", views)
    render_views(shape_source(family, 0) if family else brick, num_views=1, config=SMALL)
    assert asked == [ways]


@pytest.mark.parametrize("name", FAMILIES)
def test_every_family_has_a_likeliest_way_of_resting_and_only_known_ways(name: str) -> None:
    rests = get_family(name).spec.get("rests", dict.fromkeys(RESTS, 1.0))
    assert isinstance(rests, dict)
    assert set(ways_of(rests)) == set(rests) <= set(RESTS)
    assert rests[ways_of(rests)[0]] == max(rests.values())


def test_an_object_rests_in_the_first_of_its_ways_and_has_fallen_into_any_other(brick: ObjectSource) -> None:
    mesh = brick.load_mesh()

    def rests(config: ViewsConfig, ways: tuple[str, ...] | None = None) -> set[str]:
        return {view.resting for view in _views(mesh, config, ways)}

    for ways in (RESTS, ("upright",), ("upside_down", "upright"), TUBE, ("upright", "lying", "upside_down")):
        assert rests(SMALL, ways) == {ways[0]}
        assert rests(FALLEN, ways) == set(ways[1:] or ways)
        assert rests(replace(SMALL, fallen_share=0.5), ways) == set(ways)
    assert (rests(SMALL), rests(FALLEN)) == ({"upright"}, {"upside_down", "lying"})


@pytest.mark.parametrize("family", ["pedestrian", "box"])
def test_what_never_falls_stands_upright_though_everything_is_to_fall(family: str) -> None:
    found = render_views(shape_source(family, 0), num_views=6, config=FALLEN)
    assert [view.resting for view in found] == ["upright"] * 6
    for view in found:
        np.testing.assert_allclose(view.T_world_object[:3, 2], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("sides_cm", "height_cm", "flat"),
    [((3, 2, 1), 2, 1), ((3, 1, 2), 1, 1), ((1, 3, 2), 1, 0), ((2, 1, 3), 1, 1), ((1, 2, 3), 1, 0), ((2, 3, 1), 2, 0)],
)
def test_a_flat_box_that_lies_as_a_rule_lies_with_its_least_height_on_either_side(
    sides_cm: tuple[int, int, int], height_cm: int, flat: int
) -> None:
    """Its own z axis is level, so that its height is the smaller of its sides along x and y."""
    box = trimesh.creation.box(0.05 * np.array(sides_cm))
    found = _views(box, SMALL, TUBE)
    for view in found:
        height = apply_T(view.T_world_object, box.vertices)[:, 2]
        assert view.resting == "lying"
        assert view.T_world_object[2, 2] == pytest.approx(0.0, abs=1e-9)
        assert (height.min(), height.max()) == pytest.approx((0.0, 0.05 * height_cm), abs=1e-9)
    up = np.array([view.T_world_object[2, flat] for view in found])
    np.testing.assert_allclose(np.abs(up), 1.0)
    assert 4 <= (up > 0).sum() <= 12
    headings = [np.arctan2(view.T_world_object[1, 2], view.T_world_object[0, 2]) for view in found]
    assert np.ptp(headings) > 3.0
    for view in _views(box, FALLEN, TUBE, count=4):  # has got up
        assert view.resting == "upright"
        assert np.ptp(apply_T(view.T_world_object, box.vertices)[:, 2]) == pytest.approx(0.05 * sides_cm[2])


def test_what_lies_only_where_it_has_fallen_rolls_as_it_will() -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.15))
    heights = [np.ptp(apply_T(view.T_world_object, box.vertices)[:, 2]) for view in _views(box, FALLEN, TUBE[::-1])]
    assert np.ptp(heights) > 0.03


@pytest.mark.parametrize("turn_deg", [0.0, 5.0, 40.0, 90.0, 135.0, 62.5])
def test_the_flattest_roll_turns_back_what_was_turned(turn_deg: float) -> None:
    """Half a turn is none."""
    box = trimesh.creation.box((0.1, 0.3, 0.2)).vertices @ rotation_about((0, 0, 1), np.radians(turn_deg)).T
    off_deg = (np.degrees(_flattest_roll(box)) + turn_deg + 90) % 180 - 90
    assert abs(off_deg) < 1e-6


@pytest.mark.parametrize("seed", [0, 1])
def test_the_crimp_of_a_tube_lies_flat(seed: int) -> None:
    vertices = np.asarray(make_shape("tube", seed).mesh.vertices)
    crimp = vertices[vertices[:, 2] > 0.995 * vertices[:, 2].max()]
    for view in render_views(shape_source("tube", seed), num_views=3, config=SMALL):
        assert view.resting == "lying"
        assert np.ptp(apply_T(view.T_world_object, crimp)[:, 2]) < 0.1 * np.ptp(crimp[:, 0])


def test_a_variant_rests_as_its_own_spec_says() -> None:
    boxes = {make_shape("box", seed).kind: seed for seed in split_seeds("box", "train")[:40]}
    assert ways_of_shape("box", boxes["open"]) == ("upright", "lying", "upside_down")
    assert ways_of_shape("box", boxes["packet"]) == ("upright",)
    assert ways_of_shape("", 0) == RESTS


def test_what_rests_on_any_side_does_not_roll_and_mostly_lies_on_a_large_one() -> None:
    mesh = l_body()
    mesh.apply_transform(T_WORLD_OBJECT)
    heights = []
    for seed in range(40):
        T = draw_stable_rest(mesh, np.random.default_rng(seed))
        assert is_rotation(T[:3, :3])
        placed = apply_T(T, np.asarray(mesh.vertices))
        assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-9)
        foot = Delaunay(placed[placed[:, 2] < 1e-6, :2])
        assert foot.find_simplex(apply_T(T, mesh.center_mass)[:2]) >= 0
        heights.append(round(float(placed[:, 2].max()), 4))
    assert len(set(heights)) >= 3
    assert np.mean(np.array(heights) < 0.06) > 0.5
