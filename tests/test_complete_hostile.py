"""What users, sensors and other programs pass to complete_to_mesh by mistake, and every form a cloud may have."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from gfp_grasp import complete_scene, complete_to_mesh
from gfp_grasp.clouds import distinct_points, order_points
from gfp_grasp.complete import Completion, _detect
from gfp_grasp.deform import DeformConfig
from gfp_grasp.detect import clean_cloud, detect_single
from gfp_grasp.errors import InvalidCloud, InvalidOption, InvalidView, TooFewPoints
from gfp_grasp.level import move_detection
from gfp_grasp.transforms import apply_T, look_at, make_T, random_rotation
from gfp_grasp.types import TABLETOP, CompletedShape, DepthImage

EYE = np.array([0.4, 0.0, 0.4])
K = np.array([[300.0, 0, 80], [0, 300.0, 60], [0, 0, 1]])


@pytest.fixture(scope="module")
def cup() -> np.ndarray:
    """(n, 3) m, the near side of a cylinder without its table."""
    mesh = trimesh.creation.cylinder(radius=0.04, height=0.1, sections=64)
    points, faces = mesh.sample(6000, return_index=True, seed=0)[:2]
    return np.asarray(points[mesh.face_normals[faces] @ EYE > 0.05]) + np.array([0, 0, 0.05])


@pytest.fixture(scope="module")
def view(cup) -> DepthImage:
    """A picture of that cylinder before a wall."""
    T = look_at(EYE, (0, 0, 0.05))
    camera = (cup - EYE) @ T[:3, :3]
    depth = np.full((120, 160), 2.0)
    u, v = np.round(camera[:, :2] / camera[:, 2:] * 300 + (80, 60)).astype(int).T
    depth[v, u] = camera[:, 2]
    return DepthImage(depth, K, T)


def _structured(points: np.ndarray) -> np.ndarray:
    rows = np.zeros(len(points), dtype=[("rgb", "u4"), ("x", "f8"), ("y", "f8"), ("z", "f8")])
    rows["x"], rows["y"], rows["z"] = points.T
    return rows


@pytest.mark.parametrize(
    "wrap",
    [
        _structured,
        lambda p: torch.tensor(p).to_sparse(),
        lambda p: torch.tensor(p, requires_grad=True) * 1.0,
        lambda p: p.astype(">f8"),
        lambda p: p.astype(object),
        lambda p: np.asfortranarray(p),
        lambda p: np.ma.masked_array(p, mask=False),
        lambda p: SimpleNamespace(point=SimpleNamespace(positions=torch.tensor(p))),  # as Open3D's tensor cloud
    ],
)
def test_every_form_of_a_cloud_has_the_same_points(cup, wrap):
    np.testing.assert_array_equal(clean_cloud(wrap(cup)), cup)


def test_masked_rows_are_dropped_and_counted(cup):
    mask = np.zeros(cup.shape, dtype=bool)
    mask[:7] = True
    with pytest.warns(UserWarning, match="7 of"):
        out = clean_cloud(np.ma.masked_array(np.where(mask, 9.9, cup), mask=mask))
    np.testing.assert_array_equal(out, cup[7:])


@pytest.mark.parametrize("cloud", [[[10**400] * 3] * 99, torch.zeros((99, 3), device="meta"), torch.ones(99, 3) * 1j])
def test_what_no_conversion_takes_is_refused_by_name(cloud):
    with pytest.raises(InvalidCloud, match="cloud"):
        clean_cloud(cloud)


def test_copies_of_a_point_count_once(cup):
    expected = order_points(cup)
    for copies in (np.vstack([cup, cup]), np.vstack([np.repeat(cup[:1000], 30, axis=0), cup])):
        np.testing.assert_array_equal(order_points(clean_cloud(copies)), expected)


def test_many_copies_of_few_points_are_no_line_and_are_not_thinned_away(cup):
    few = cup[::10]
    many = np.tile(few, (1000, 1))
    assert len(many) > 200_000
    np.testing.assert_array_equal(order_points(clean_cloud(many)), order_points(few))
    assert len(distinct_points(many)) == len(few)


def test_four_points_in_many_copies_are_too_few(cup):
    with pytest.raises(TooFewPoints, match="4 different"):
        clean_cloud(np.repeat(cup[:4], 500, axis=0))


def test_mostly_empty_pixels_do_not_hide_the_object(cup):
    in_camera = cup + np.array([0.0, 0.0, 0.6])
    cleaned = clean_cloud(np.vstack([np.zeros((300 * len(cup), 3)), in_camera]))
    np.testing.assert_array_equal(cleaned[1:], in_camera)


@pytest.mark.parametrize("far_m", [30.0, 1e6, 1e300])
def test_strays_are_dropped_and_counted(cup, far_m):
    with pytest.warns(UserWarning, match="2 points are more than"):
        out = clean_cloud(np.vstack([[[far_m, 0, 0]], cup, [[0, -far_m, far_m]]]))
    np.testing.assert_array_equal(out, cup)


@pytest.mark.parametrize(
    ("factor", "words"), [(1000, "millimetres"), (100, "centimetres"), (1e-3, "another unit"), (1e-300, "another unit")]
)
def test_other_units_are_named(cup, factor, words):
    with pytest.raises(InvalidCloud, match=words):
        complete_to_mesh(cup * factor)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"viewpoint": (0.0, 0.0, 0.05)}, InvalidCloud, "inside"),
        ({"viewpoint": (0.04, 0.0, 0.05)}, InvalidCloud, "inside"),
        ({"viewpoint": EYE * 1000}, InvalidCloud, "away from the object"),
        ({"viewpoint": (1e200, 0, 0)}, InvalidCloud, "in the frame of the cloud"),
        ({"viewpoint": np.eye(4)}, InvalidCloud, r"\(4, 4\)"),
        ({"viewpoint": [1j, 0, 0]}, InvalidCloud, "complex"),
        ({"viewpoint": (np.nan, 0, 0)}, InvalidCloud, "finite"),
        ({"up": "z"}, InvalidCloud, "up"),
        ({"up": (0, 0, 0)}, InvalidCloud, "no length"),
        ({"support_height": "x"}, InvalidOption, "support_height"),
        ({"support_height": [0.0]}, InvalidOption, "support_height"),
        ({"support_height": np.nan}, InvalidOption, "support_height"),
        ({"seed": -1}, InvalidOption, "seed"),
        ({"seed": "x"}, InvalidOption, "seed"),
        ({"seed": 1.5}, InvalidOption, "seed"),
        ({"config": {}}, InvalidOption, "CompleteConfig"),
        ({"config": DeformConfig()}, InvalidOption, "CompleteConfig"),
        ({"view": np.ones((120, 160))}, InvalidView, "DepthImage"),
    ],
)
def test_nonsense_is_refused_by_name_within_a_second(cup, options, error, words):
    start = time.process_time()
    with pytest.raises(error, match=words):
        complete_to_mesh(cup, **options)
    assert time.process_time() - start < 1.0


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (np.ones((160, 120), bool), r"\(160, 120\)"),
        ([[1], [1, 2]], "list"),
        (np.zeros((120, 160), bool), "0%"),
        (np.full((120, 160), np.nan), "0%"),
    ],
)
def test_masks_that_say_nothing_of_the_points_are_refused(cup, view, mask, words):
    with pytest.raises(InvalidView, match=words):
        detect_single(cup, view=view, mask=mask, category="cup")


def test_a_view_from_another_frame_is_refused(cup, view):
    astray = DepthImage(view.depth_m, view.K, make_T(view.T_world_camera[:3, :3], (5.0, 5.0, 5.0)))
    with pytest.raises(InvalidView, match="T_world_camera"):
        detect_single(cup, view=astray, category="cup")


@pytest.mark.parametrize(
    ("depth", "T", "words"),
    [
        (np.full((4, 4), 600, np.uint16), np.eye(4), "millimetres"),
        (np.ones((4, 4)), 2 * np.eye(4), "rigid"),
        (np.ones((4, 4)), np.diag([1.0, 1, -1, 1]), "rigid"),
        ("picture", np.eye(4), "depth_m"),
        (np.ones((4, 4)), "pose", "T_world_camera"),
    ],
)
def test_pictures_in_another_unit_or_with_no_pose_are_refused(depth, T, words):
    with pytest.raises(InvalidView, match=words):
        DepthImage(depth, K, T)


def test_a_scene_is_a_depth_image(cup):
    with pytest.raises(InvalidView, match="DepthImage"):
        complete_scene(cup)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("up", [(0, 0, 1e300), (0, 0, 1e-5), torch.tensor([0.0, 0.0, 2.0], requires_grad=True)])
def test_up_of_any_length_is_the_same_direction(cup, up, monkeypatch):
    monkeypatch.setattr("gfp_grasp.complete._complete", _found_only)
    detection = complete_to_mesh(cup, up=up, viewpoint=EYE, category="cup").detection
    np.testing.assert_allclose(detection.up, (0, 0, 1), atol=1e-12)


def test_detection_does_not_depend_on_the_frame(cup):
    """Offsets of a kilometre and any turn: the same points are the object's, and the same noise is read off them."""
    rng = np.random.default_rng(0)
    points = order_points(cup + rng.normal(scale=0.0008, size=cup.shape))
    rest = (None, None, None, "cup", TABLETOP)  # support, view and mask are unknown
    here = move_detection(*_detect(points, EYE, np.array([0.0, 0.0, 1.0]), *rest))
    for _ in range(3):
        T = make_T(random_rotation(rng), rng.normal(scale=1000.0, size=3))
        there = move_detection(*_detect(order_points(apply_T(T, points)), apply_T(T, EYE), T[:3, 2], *rest))
        assert there.sensor_sigma_m == pytest.approx(here.sensor_sigma_m, rel=1e-6)
        expected = order_points(apply_T(T, here.cloud.points))
        np.testing.assert_allclose(order_points(there.cloud.points), expected, atol=1e-9)


def test_up_is_found_among_the_axes_where_the_viewpoint_is_not_the_origin(cup):
    """The camera looks down at an upright cylinder from z, not from the y of a camera's frame."""
    assert detect_single(cup, viewpoint=EYE, up=None).up == pytest.approx([0.0, 0.0, 1.0])


def _found_only(detection, T_world_found, config, seed, *, timings_s) -> Completion:
    shape = CompletedShape(trimesh.creation.box(), np.zeros(8, bool), np.ones(8))
    return Completion(shape, move_detection(detection, T_world_found))
