"""What each type takes, refuses and takes where nothing is said."""

import math

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidCloud, InvalidGrasp, InvalidMesh, InvalidOption
from gfp_grasp.types import (
    REASONS,
    CategorySpec,
    CompletedShape,
    DepthImage,
    Detection,
    Grasp,
    OptionalPart,
    OrientedBox,
    PointCloud,
    Silhouette,
    SupportPlane,
    default_density,
)

BOX = OrientedBox(np.eye(4), np.ones(3))
POINTS = np.random.default_rng(0).normal(size=(50, 3))


def test_a_class_of_which_nothing_is_said_stands_upright_and_is_solid() -> None:
    spec = CategorySpec("pot")
    assert spec.as_dict() == {
        "category": "pot",
        "parent": None,
        "size_range_m": ((0.01, 0.01, 0.01), (1.0, 1.0, 1.0)),
        "rests": {"upright": 0.9796292072, "upside_down": 0.0179425348, "lying": 0.00242825803},
        "hollow": False,
        "density_kg_m3": (150.0, 1050.0),
        "optional_parts": [],
        "alike": (),
        "share": 1.0,
        "names": {},
    }
    assert spec.rest_costs() == pytest.approx({"upright": 0.0, "upside_down": 4.0, "lying": 6.0}, abs=1e-6)
    assert spec.cost == 0.0
    assert default_density(hollow=True) == (900.0, 2400.0)
    assert default_density(hollow=False) == (150.0, 1050.0)


def test_a_spec_comes_back_with_all_that_was_said() -> None:
    spec = CategorySpec(
        "pot.lidded",
        parent="pot",
        size_range_m=((0.1, 0.1, 0.2), (0.2, 0.3, 0.4)),
        rests={"lying": 0.25, "upright": 0.5},
        hollow=True,
        density_kg_m3=(500.0, 600.0),
        optional_parts=(OptionalPart("lid"), OptionalPart("grip", keep="always")),
        alike=("pan",),
        share=0.25,
        names={"shapenet": ("1", "2"), "kitti": ("Pot",)},
    )
    assert CategorySpec.from_dict(spec.as_dict()) == spec
    assert spec.as_dict()["optional_parts"] == [{"name": "lid", "keep": "seen"}, {"name": "grip", "keep": "always"}]
    assert spec.cost == pytest.approx(math.log(4), abs=1e-6)
    assert spec.rest_costs() == pytest.approx({"lying": math.log(2), "upright": 0.0}, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"category": ""}, "category"),
        ({"category": "a.b.c"}, "category"),
        ({"category": "a."}, "category"),
        ({"category": "a.b"}, "parent"),
        ({"parent": "pan"}, "parent"),
        ({"size_range_m": ((0, 1, 1), (1, 1, 1))}, "smallest"),
        ({"size_range_m": ((1, 1, 2), (1, 1, 1))}, "smallest"),
        ({"size_range_m": ((1, 1, 1),)}, "entries"),
        ({"size_range_m": ((1, 1), (1, 1))}, "3 finite"),
        ({"size_range_m": ((1, 1, 1), (1, 1, math.inf))}, "3 finite"),
        ({"density_kg_m3": (0, 1)}, "density"),
        ({"density_kg_m3": (2, 1)}, "density"),
        ({"rests": {}}, "rests"),
        ({"rests": {"flying": 1.0}}, "rests"),
        ({"rests": {"upright": 0.0}}, "rests"),
        ({"rests": {"upright": 1.1}}, "rests"),
        ({"share": 0.0}, "share"),
        ({"share": 1.1}, "share"),
        ({"names": {"web": ("a",)}}, "names"),
        ({"names": {"kitti": "Pot"}}, "list of words"),
        ({"alike": "pan"}, "list of words"),
        ({"optional_parts": [{"name": "not a name"}]}, "region"),
        ({"optional_parts": [{"name": "lid", "keep": "never"}]}, "keep"),
        ({"optional_parts": [{"lid": 1}]}, "malformed"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_a_field_that_is_wrong_is_refused_by_its_name(changes: dict, words: str) -> None:
    with pytest.raises(InvalidOption, match=words):
        CategorySpec.from_dict({"category": "pot"} | changes)


def test_bounds_that_are_just_legal_are_taken() -> None:
    CategorySpec("pot", size_range_m=((1, 1, 1), (1, 1, 1)), density_kg_m3=(1, 1), rests={"lying": 1.0}, share=1.0)
    with pytest.raises(InvalidOption, match="named fields"):
        CategorySpec.from_dict([1])  # type: ignore[arg-type]
    with pytest.raises(InvalidOption, match="no category"):
        CategorySpec.from_dict({})


def test_a_plane_measures_along_its_normal() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    plane = SupportPlane(normal, 0.5)
    np.testing.assert_allclose(plane.distances(np.array([[0.0, 0, 0], [0.6, 9.0, 0.8]])), [-0.5, 0.5])


def test_a_detection_of_which_nothing_more_is_known_has_the_noise_of_a_depth_camera() -> None:
    detection = Detection(PointCloud(POINTS), np.array([0.0, 0.0, 1.0]), None, "", {}, BOX)
    assert detection.sensor_sigma_m == 0.0015
    assert detection.sensor.name == "tabletop"
    assert detection.view is detection.mask is None
    assert not detection.up.flags.writeable
    with pytest.raises(InvalidCloud, match="up"):
        Detection(PointCloud(POINTS), np.array([0.0, 1.0]), None, "", {}, BOX)


def test_a_grasp_has_a_finite_pose_and_an_opening_from_zero_on() -> None:
    grasp = Grasp(np.eye(4), np.float32(0.0))  # type: ignore[arg-type]
    assert (grasp.width_m, grasp.quality) == (0.0, 0.0)
    assert type(grasp.width_m) is float
    assert not grasp.T_world_gripper.flags.writeable
    for pose, width in ((np.eye(3), 0.1), (np.full((4, 4), np.nan), 0.1), (np.eye(4), -0.01), (np.eye(4), math.inf)):
        with pytest.raises(InvalidGrasp):
            Grasp(pose, width)


def test_reasons_are_a_fixed_list() -> None:
    assert REASONS == (
        "held", "collided_on_approach", "no_contact", "slipped_on_lift", "slipped_on_shake", "unstable",
        "unreachable_width", "no_grasp_found",
    )  # fmt: skip


def test_a_completed_shape_says_something_of_each_vertex() -> None:
    box = trimesh.creation.box()
    shape = CompletedShape(box, [1, 0] * 4, [0.001] * 8)  # type: ignore[arg-type]
    assert shape.observed.tolist() == [True, False] * 4
    assert shape.fit is None
    for observed, sigma in ((np.ones(7), np.ones(8)), (np.ones(8), np.ones(9))):
        with pytest.raises(InvalidMesh, match="must be"):
            CompletedShape(box, observed, sigma)


def test_what_lies_in_front_of_a_return_is_brought_to_the_object_at_its_range() -> None:
    view = DepthImage(np.full((5, 7), 2.0), np.array([[10.0, 0, 3], [0, 10.0, 2], [0, 0, 1]]), np.eye(4))
    free = np.full((5, 7), 2.0)
    free[2, 3] = 0.0  # the object's own pixel
    offset = np.stack([2 - np.indices((5, 7))[0], 3 - np.indices((5, 7))[1]]).astype(float)
    silhouette = Silhouette(view, free, True, offset, margin_m=0.1)

    def seen_at(column: float, row: float, range_m: float) -> np.ndarray:
        return view.unproject([column, row], range_m)

    points = np.stack([
        seen_at(5.0, 2.0, 1.0),  # free
        seen_at(3.0, 2.0, 1.0),  # the object's own pixel
        seen_at(5.0, 1.0, 1.95),  # within the margin
        seen_at(5.0, 1.0, 1.85),  # beyond the margin
        seen_at(7.2, 2.0, 1.0),  # beside the picture
        [0.0, 0.0, -1.0],  # behind the camera
        seen_at(1.3, 3.8, 1.5),
    ])  # fmt: skip
    index, back = silhouette.free_space_violation(points)
    assert index.tolist() == [0, 3, 6]
    np.testing.assert_allclose(points[0] + back[0], seen_at(3.0, 2.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(points[3] + back[1], seen_at(3.0, 2.0, 1.85), atol=1e-12)
    # Moved by whole pixels, from where the point itself is seen.
    np.testing.assert_allclose(points[6] + back[2], seen_at(3.3, 1.8, 1.5), atol=1e-12)
    np.testing.assert_allclose(silhouette.pixel_of(points[6]), [1.3, 3.8])
