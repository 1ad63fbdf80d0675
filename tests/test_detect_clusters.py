"""What stands on a known table, told apart in pictures and in bare points."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.camera import camera_points, intrinsics, render_mesh_view
from gfp_grasp.detect import label_picture, label_points
from gfp_grasp.transforms import apply_T, look_at, make_T
from gfp_grasp.types import SupportPlane

WIDTH, HEIGHT = 200, 150
K = intrinsics(WIDTH, HEIGHT, 40.0)
TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)
ABOVE = np.array([0.0, 0.0, 0.6])


def _box(extents: tuple[float, float, float], x: float = 0.0, y: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    return trimesh.creation.box(extents, transform=make_T(None, (x, y, z + extents[2] / 2)))


def _cup(radius: float = 0.04, height: float = 0.09, wall: float = 0.003, floor: float = 0.01) -> trimesh.Trimesh:
    profile = [[0, 0], [radius, 0], [radius, height], [radius - wall, height], [radius - wall, floor], [0, floor]]
    return trimesh.creation.revolve(profile, sections=48)


def _labels(
    meshes: list[trimesh.Trimesh], eye: ArrayLike = ABOVE, target: ArrayLike = (0.0, 0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Labels (h, w), and the mesh that each pixel sees 6.5 mm or more over the table; -1 for the others."""
    image, index = render_mesh_view(
        meshes, T_world_camera=look_at(eye, target), K=K, width=WIDTH, height=HEIGHT, table_height=0.0
    )
    points = apply_T(image.T_world_camera, camera_points(image))
    index = np.where((index < len(meshes)) & (points[..., 2] > 0.0065), index, -1)
    return label_picture(points, TABLE, np.asarray(eye), float(K[0, 0])), index


def _one_label(labels: np.ndarray, of: np.ndarray) -> int:
    """The label of nearly all of the chosen pixels."""
    values, counts = np.unique(labels[of], return_counts=True)
    assert counts.max() > 0.94 * of.sum()
    return int(values[counts.argmax()])


def test_the_smallest_object_has_eight_square_centimetres() -> None:
    large, small = _box((0.04, 0.03, 0.03), x=-0.06), _box((0.02, 0.03, 0.03), x=0.06)  # from above: 12 and 6 cm^2
    labels, index = _labels([large, small])
    assert _one_label(labels, index == 0) == 1
    assert _one_label(labels, index == 1) == 0


def test_points_lower_than_six_millimetres_belong_to_the_table() -> None:
    for height, is_object in ((0.0055, False), (0.007, True)):
        labels, _ = _labels([_box((0.1, 0.08, height))])
        assert labels.any() == is_object


def test_what_is_wider_than_sixty_centimetres_is_furniture() -> None:
    for width, number in ((0.55, 1), (0.65, 0)):
        labels, index = _labels([_box((width, 0.1, 0.05))], eye=(0.0, 0.0, 1.2))
        assert _one_label(labels, index == 0) == number


def test_a_cup_seen_from_above_is_one_object_with_its_floor() -> None:
    labels, index = _labels([_cup()], eye=(0.15, 0.1, 0.5), target=(0.0, 0.0, 0.04))
    assert _one_label(labels, index == 0) == 1
    # From straight above each pixel of the wall is a depth step: rim and floor remain, and the floor is the larger.
    labels, _ = _labels([_cup()], eye=(0.02, 0.03, 0.6))
    assert labels[HEIGHT // 2 - 7 : HEIGHT // 2 + 7, WIDTH // 2 - 7 : WIDTH // 2 + 7].all()


def test_a_box_on_a_wide_slab_is_another_object_and_both_are_numbered_by_size() -> None:
    slab, box = _box((0.16, 0.14, 0.04)), _box((0.05, 0.06, 0.1), z=0.04)
    labels, index = _labels([box, slab], eye=(0.35, -0.25, 0.35), target=(0.0, 0.0, 0.05))
    assert {_one_label(labels, index == 0), _one_label(labels, index == 1)} == {1, 2}
    assert (labels == 1).sum() > (labels == 2).sum()


def test_two_boxes_side_by_side_in_the_picture_part_at_a_depth_step() -> None:
    """From above one ends where the other begins; their tops are 2 cm apart, and 1 cm parts them."""
    low, high = _box((0.08, 0.1, 0.02), x=-0.041), _box((0.08, 0.1, 0.04), x=0.041)
    labels, index = _labels([low, high])
    assert {_one_label(labels, index == 0), _one_label(labels, index == 1)} == {1, 2}


def test_a_wall_ten_centimetres_behind_takes_no_pixel_of_what_stands_in_front() -> None:
    front, wall = _box((0.06, 0.07, 0.1)), _box((0.02, 0.4, 0.25), x=-0.14)
    labels, index = _labels([front, wall], eye=(0.6, 0.05, 0.15), target=(0.0, 0.0, 0.08))
    assert _one_label(labels, index == 0) != _one_label(labels, index == 1)
    assert not (set(labels[index == 0]) - {0}) & (set(labels[index == 1]) - {0})


def test_two_boxes_a_gap_apart_are_two_objects_in_points_and_one_when_they_touch() -> None:
    def points(gap_m: float) -> np.ndarray:
        left, right = _box((0.06, 0.05, 0.08), x=-0.03 - gap_m / 2), _box((0.06, 0.12, 0.08), x=0.03 + gap_m / 2)
        samples = [trimesh.sample.sample_surface(mesh, 20_000, seed=1)[0] for mesh in (left, right)]
        return np.vstack(samples)

    apart = label_points(points(0.08), TABLE)
    high = points(0.08)[:, 2] > 0.0065
    assert set(apart[:20_000][high[:20_000]]) == {2}
    assert set(apart[20_000:][high[20_000:]]) == {1}  # the larger surface comes first
    assert not apart[~high & (points(0.08)[:, 2] < 0.0055)].any()
    assert set(label_points(points(0.002), TABLE)[high]) == {1}


def test_lone_points_in_the_air_get_no_label() -> None:
    box = trimesh.sample.sample_surface(_box((0.06, 0.05, 0.08)), 20_000, seed=1)[0]
    lone = np.array([[0.2, 0.0, 0.1], [0.0, 0.2, 0.15], [-0.2, 0.1, 0.1]])
    labels = label_points(np.vstack([box, lone]), TABLE)
    assert labels[-3:].tolist() == [0, 0, 0]
    assert labels.max() == 1


def test_too_few_points_are_no_object() -> None:
    few = np.column_stack([np.zeros(20), np.zeros(20), np.linspace(0.02, 0.1, 20)])
    assert not label_points(few, TABLE).any()
    picture = np.full((HEIGHT, WIDTH, 3), np.nan)
    assert not label_picture(picture, TABLE, ABOVE, float(K[0, 0])).any()
