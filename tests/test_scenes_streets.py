"""Streets: what stands where, that nothing stands in anything else, and what a LiDAR sees of it."""

from itertools import combinations

import mujoco
import numpy as np
import pytest

from gfp_grasp.camera import LidarModel, scan_scene
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import compile_street, draw_street, scan_street
from gfp_grasp.transforms import apply_T, invert_T, make_T

COARSE = LidarModel(elevation_deg=tuple(np.linspace(2, -24, 20).tolist()), columns=400)


@pytest.fixture(scope="module")
def street():
    return draw_street(np.random.default_rng(3), num_things=16)


def test_things_fill_their_boxes_and_stand_on_the_ground(street):
    assert len(street.things) >= 12
    for thing in street.things:
        local = apply_T(invert_T(thing.box.T_world_box), np.asarray(thing.mesh.vertices))
        np.testing.assert_allclose(local.min(axis=0), -thing.box.extents / 2, atol=1e-6)
        np.testing.assert_allclose(local.max(axis=0), thing.box.extents / 2, atol=1e-6)
        assert -1e-6 < thing.mesh.bounds[0, 2] < 0.17  # the road, or the pavement


def test_nothing_stands_in_anything_else_nor_where_the_sensor_is(street):
    def outline(thing):
        return thing.mesh.bounds[:, :2]

    for one, other in combinations(map(outline, street.things), 2):
        assert (one[1] < other[0]).any() or (other[1] < one[0]).any()
    for low, high in map(outline, street.things):
        assert not ((low < 0).all() and (high > 0).all())


def test_vehicles_on_the_road_face_along_it_and_those_in_yards_as_they_like():
    """The narrowest road reaches from y = -3.6 to 6.6 m, and no yard begins before -6.9 and 9.9 m."""
    streets = [draw_street(np.random.default_rng(seed), num_things=30) for seed in range(4)]
    vehicles = [t for one in streets for t in one.things if t.category in ("car", "van", "truck", "bus")]
    places = np.array([thing.box.T_world_box[:2, 3] for thing in vehicles])
    ahead = np.abs([thing.box.T_world_box[0, 0] for thing in vehicles])
    on_road = (places[:, 1] > -3.6) & (places[:, 1] < 6.6)
    in_yards = (places[:, 1] < -6.9) | (places[:, 1] > 9.9)
    assert (ahead[on_road] > 0.95).all()
    assert on_road.sum() > 25
    assert in_yards.sum() > 5
    assert (ahead[in_yards] < 0.9).any()


def test_a_street_is_the_same_for_the_same_seed_and_another_for_another():
    one, same, other = (draw_street(np.random.default_rng(seed), num_things=4) for seed in (5, 5, 6))
    assert [thing.category for thing in one.things] == [thing.category for thing in same.things]
    np.testing.assert_array_equal(one.things[0].mesh.vertices, same.things[0].mesh.vertices)
    assert not np.allclose(one.things[0].box.T_world_box, other.things[0].box.T_world_box)


def test_shots_that_are_told_to_meet_a_thing_lie_on_its_box(street):
    image, index = scan_street(street, None, lidar=COARSE)
    points, met = image.points(), np.unique(index[index >= 0])
    assert len(met) >= 5
    for number in met:
        box = street.things[number].box
        local = apply_T(invert_T(box.T_world_box), points[index == number])
        assert (np.abs(local) < box.extents / 2 + 0.01).all()
    road = points[(index < 0) & (np.abs(points[..., 2]) < 0.02)]
    assert len(road) > 1000
    assert image.viewpoint[2] == COARSE.height_m


def test_mujoco_holds_the_same_street(street):
    model = compile_street(street)
    data = mujoco.MjData(model)  # pyright: ignore[reportAttributeAccessIssue]
    mujoco.mj_forward(model, data)  # pyright: ignore[reportAttributeAccessIssue]
    T = make_T(None, (0.0, 0.0, COARSE.height_m))
    by_mujoco, geom = scan_scene(model, data, T_world_sensor=T, lidar=COARSE)
    by_embree, index = scan_street(street, None, lidar=COARSE)
    names = [model.body(model.geom_bodyid[g]).name if g >= 0 else "" for g in geom.ravel()]
    expected = [f"thing_{i}" if i >= 0 else "" for i in index.ravel()]
    agree = [name == want if want else not name.startswith("thing") for name, want in zip(names, expected, strict=True)]
    assert np.mean(agree) > 0.995
    both = (by_mujoco.range_m > 0) & (by_embree.range_m > 0)
    assert np.quantile(np.abs(by_mujoco.range_m - by_embree.range_m)[both], 0.99) < 0.02


def test_nonsense_is_refused():
    with pytest.raises(InvalidOption, match="split 'all'"):
        draw_street(np.random.default_rng(0), split="all")
    with pytest.raises(InvalidOption, match="num_things is -1"):
        draw_street(np.random.default_rng(0), num_things=-1)
