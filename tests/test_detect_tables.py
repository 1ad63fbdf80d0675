"""The plane that things stand on, in rooms: floors, walls and other tables in view."""

from itertools import islice

import numpy as np
import pytest
import trimesh

from gfp_grasp.bench.finding import clutter_pictures
from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view
from gfp_grasp.detect import DetectConfig, detect_objects, detect_single, label_picture
from gfp_grasp.detect.tables import Table, find_table, keep_on_table, noise_growth
from gfp_grasp.errors import NothingDetected
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import TABLETOP, DepthImage, SupportPlane

TOP_M = 0.72
UP = np.array([0.0, 0.0, 1.0])


def box(size, place) -> trimesh.Trimesh:
    """A box whose middle is above place[:2] and whose bottom is at place[2]."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((place[0], place[1], place[2] + size[2] / 2))
    return mesh


def room(*things: trimesh.Trimesh, wall: bool = True) -> list[trimesh.Trimesh]:
    """A table top of 1.1 by 0.7 m, a floor that is seen beyond it, and a wall behind."""
    rest = [box((1.1, 0.7, 0.03), (0.05, 0.0, TOP_M - 0.03)), box((6.0, 6.0, 0.02), (0.0, 0.0, -0.02))]
    return [*things, *rest, *([box((6.0, 0.02, 2.5), (0.0, 1.2, 0.0))] if wall else [])]


def seen(meshes, *, eye=(0.2, -0.9, 1.35), target=(0.0, 0.0, TOP_M), noise_m=0.001, T=None) -> DepthImage:
    """A noisy picture; T moves room and camera together."""
    T = np.eye(4) if T is None else T
    image, _ = render_mesh_view(
        meshes, T_world_camera=look_at(eye, target), K=intrinsics(320, 240, 60.0), width=320, height=240
    )
    image = apply_sensor(image, SensorModel.gaussian(noise_m), np.random.default_rng(3))
    return DepthImage(image.depth_m, image.K, T @ image.T_world_camera)


CUP = box((0.08, 0.07, 0.11), (-0.2, -0.1, TOP_M))
CAN = box((0.06, 0.06, 0.14), (0.18, 0.05, TOP_M))


@pytest.mark.parametrize("up", [UP, None])
@pytest.mark.parametrize("eye", [(0.2, -0.9, 1.35), (0.25, -0.5, 1.7), (0.1, -0.15, 1.75), (0.5, -1.0, 0.98)])
def test_the_table_is_found_with_floor_and_wall_in_view_at_any_pitch(eye, up) -> None:
    table = find_table(seen(room(CUP, CAN), eye=eye), up, sensor=TABLETOP).best
    assert table is not None
    assert table.plane.normal @ UP > np.cos(np.radians(0.5))
    assert table.plane.height_m == pytest.approx(TOP_M, abs=0.003)


def test_the_table_is_found_wherever_the_world_s_axes_point() -> None:
    T = make_T(rotation_about((1.0, 0.3, -0.2), 2.1), (0.4, -0.6, 0.3))
    table = find_table(seen(room(CUP, CAN), T=T), None, sensor=TABLETOP).best
    assert table is not None
    assert table.plane.normal @ T[:3, 2] > np.cos(np.radians(0.5))
    place = T[:3, :3] @ np.array([0.0, 0.0, TOP_M]) + T[:3, 3]
    assert float(table.plane.distances(place[None])[0]) == pytest.approx(0.0, abs=0.003)


def test_what_stands_on_the_table_is_found_and_what_stands_on_the_floor_is_not() -> None:
    bag = box((0.3, 0.2, 0.3), (1.0, 0.5, 0.0))
    found = detect_objects(seen(room(CUP, CAN, bag)), config=DetectConfig(classify=False))
    middles = sorted(tuple(d.box.T_world_box[:2, 3].round(2)) for d in found)
    assert len(found) == 2
    assert middles[0] == pytest.approx((-0.2, -0.1), abs=0.03)
    assert middles[1] == pytest.approx((0.18, 0.05), abs=0.03)


def test_a_chair_behind_the_table_is_no_object_on_it() -> None:
    chair = box((0.35, 0.04, 1.1), (-0.3, 0.5, 0.0))
    found = detect_objects(seen(room(CUP, CAN, chair)), config=DetectConfig(classify=False))
    assert len(found) == 2


def test_the_plane_on_which_more_is_seen_is_the_support() -> None:
    bags = [box((0.25, 0.2, 0.3), (x, 0.8, 0.0)) for x in (-0.6, -0.2, 0.2)]
    high = (0.2, -0.2, 2.4)
    floor = find_table(seen(room(*bags, wall=False), eye=high, target=(0.0, 0.6, 0.0)), UP, sensor=TABLETOP)
    assert floor.best is not None
    assert floor.best.plane.height_m == pytest.approx(0.0, abs=0.01)
    assert floor.num_planes >= 2


def test_the_flat_lid_of_a_thing_is_not_what_it_stands_on() -> None:
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    circle = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    pot = trimesh.convex.convex_hull(
        np.concatenate([0.08 * circle + [0, 0, TOP_M], 0.17 * circle + [0, 0, TOP_M + 0.24]])
    )
    knob, table = box((0.05, 0.04, 0.05), (0.02, 0.01, TOP_M + 0.24)), box((0.5, 0.4, 0.03), (0.0, 0.0, TOP_M - 0.03))
    image = seen([pot, knob, table], eye=(0.3, -0.5, TOP_M + 0.5), target=(0.0, 0.0, TOP_M + 0.15))
    points = image.points().reshape(-1, 3)
    thing = points[points[:, 2] > TOP_M + 0.01]
    lid_alone = find_table(
        seen([pot, knob], eye=(0.3, -0.5, TOP_M + 0.5), target=(0, 0, TOP_M + 0.2)), UP, sensor=TABLETOP
    )
    assert lid_alone.best is not None  # no other plane is in view
    assert lid_alone.best.plane.height_m == pytest.approx(TOP_M + 0.24, abs=0.005)
    under = find_table(image, UP, sensor=TABLETOP).best
    assert under is not None
    assert under.plane.height_m == pytest.approx(TOP_M, abs=0.003)
    detection = detect_single(thing, view=image, config=DetectConfig(classify=False))
    assert detection.support is not None
    assert detection.support.height_m == pytest.approx(TOP_M, abs=0.003)


def test_an_empty_table_and_a_wall_alone_are_refused_with_the_number_of_their_planes() -> None:
    with pytest.raises(NothingDetected, match=r"of its \d planes there is nothing on any"):
        detect_objects(seen(room()))
    wall = seen([box((6.0, 0.02, 2.5), (0.0, 1.2, 0.0))], target=(0.2, 1.0, 1.3))
    assert find_table(wall, None, sensor=TABLETOP).best is None
    assert find_table(wall, None, sensor=TABLETOP).num_planes == 1


def test_a_picture_with_few_returns_has_no_plane() -> None:
    image = seen(room(CUP))
    depth = np.zeros_like(image.depth_m)
    depth[:9, :9] = image.depth_m[:9, :9]
    found = find_table(DepthImage(depth, image.K, image.T_world_camera), None, sensor=TABLETOP)
    assert (found.best, found.num_planes) == (None, 0)


def test_nine_tenths_of_a_picture_may_be_missing() -> None:
    image = seen(room(CUP, CAN))
    kept = np.random.default_rng(1).random(image.depth_m.shape) < 0.1
    thin = DepthImage(np.where(kept, image.depth_m, 0.0), image.K, image.T_world_camera)
    found = find_table(thin, UP, sensor=TABLETOP)  # an answer, whichever
    assert found.num_planes >= 0


def test_how_far_a_point_is_beyond_the_outline_is_told_on_the_ground() -> None:
    outline = np.array([[1.0, 0.0, -0.3], [-1.0, 0.0, -0.1], [0.0, 1.0, -0.2], [0.0, -1.0, -0.2]])
    table = Table(SupportPlane(UP, 0.5), outline, 0.01, 0.1)
    points = np.array([[0.35, 0.0, 9.0], [0.0, 0.1, 0.0], [-0.3, 0.25, 0.6]])
    assert table.beyond_m(points) == pytest.approx([0.05, -0.1, 0.2])


def test_noise_grows_with_the_square_of_the_distance_beyond_eighty_centimetres() -> None:
    assert noise_growth(np.array([0.3, 0.8, 1.6, 2.4])) == pytest.approx([1.0, 1.0, 4.0, 9.0])


def test_objects_mostly_beside_the_table_are_dropped_and_the_others_numbered_anew() -> None:
    labels = np.array([[1, 1, 1, 1, 1], [2, 2, 2, 2, 2], [3, 3, 3, 0, 0]])
    on_table = np.array([[1, 0, 0, 0, 0], [1, 1, 0, 0, 0], [1, 1, 1, 1, 1]], dtype=bool)
    assert keep_on_table(labels, on_table).tolist() == [[0] * 5, [1] * 5, [2, 2, 2, 0, 0]]


def test_a_film_that_noise_leaves_on_a_far_table_is_no_object_and_a_plate_is_one() -> None:
    K, shape = intrinsics(320, 240, 40.0), (240, 320)
    plane = SupportPlane(np.array([0.0, 0.0, -1.0]), -1.3)
    depth = np.full(shape, 1.3)
    depth[100:140, 100:150] -= 0.03
    depth[40:80, 200:250] -= np.where(np.random.default_rng(0).random((40, 50)) < 0.5, 0.02, 0.0)
    points = DepthImage(depth, K, np.eye(4)).points()
    labels = label_picture(points, plane, np.zeros(3), float(K[0, 0]))
    assert labels[120, 125] == 1
    assert set(np.unique(labels)) == {0, 1}


@pytest.mark.parametrize("seed", range(6))
def test_noise_that_a_small_cup_s_table_leaves_over_is_no_plane_of_its_own(seed: int) -> None:
    cup = trimesh.creation.cylinder(0.027, 0.056).apply_translation((0.0, 0.0, 0.028))
    camera = look_at((0.25, -0.4, 0.35 + 0.02 * seed), (0.0, 0.0, 0.02))
    image, _ = render_mesh_view(
        [cup], T_world_camera=camera, K=intrinsics(320, 240, 35.0), width=320, height=240, table_height=0.0
    )
    image = apply_sensor(image, SensorModel.gaussian(0.0015), np.random.default_rng(seed))
    tables = find_table(image, UP, sensor=TABLETOP)
    assert tables.best is not None
    assert tables.best.plane.normal @ UP > np.cos(np.radians(0.5))
    assert tables.best.plane.height_m == pytest.approx(0.0, abs=0.002)


def test_the_table_is_found_where_a_board_hides_the_near_half_of_the_object_and_its_foot() -> None:
    bottle = trimesh.creation.cylinder(0.04, 0.24).apply_translation((0.0, 0.0, TOP_M + 0.12))
    board = box((0.5, 0.01, 0.14), (0.0, -0.2, TOP_M + 0.05))
    picture = seen(room(bottle, board), eye=(0.05, -0.75, 1.1), target=(0.0, 0.0, TOP_M + 0.05))
    table = find_table(picture, UP, sensor=TABLETOP).best
    assert table is not None
    assert table.plane.height_m == pytest.approx(TOP_M, abs=0.003)
    found = detect_objects(picture, config=DetectConfig(classify=False))
    tops = [float(d.cloud.points[:, 2].max()) for d in found if abs(d.box.T_world_box[0, 3]) < 0.03]
    assert max(tops) == pytest.approx(TOP_M + 0.24, abs=0.01)


def test_a_tilted_slice_of_the_table_is_no_plane_on_which_its_objects_stand() -> None:
    """A flask and a wine glass of which noise hides the feet: they seem to float above the table, and to stand on a
    plane through the flask's shoulder that cuts the table."""
    picture = next(islice(clutter_pictures(11, seed=0), 10, None))
    tables = find_table(picture.view, picture.up, sensor=TABLETOP)
    assert tables.num_planes == 1
    assert tables.best is not None
    assert tables.best.plane.normal @ UP > np.cos(np.radians(0.5))
    assert tables.best.plane.height_m == pytest.approx(0.0, abs=0.002)
