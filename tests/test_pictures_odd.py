"""Pictures that hold no table with things on it, or more than usual: an answer, or what was seen and what to do."""

import time
import warnings

import numpy as np
import pytest
import trimesh

from gfp_grasp.camera import intrinsics, render_mesh_view
from gfp_grasp.complete import complete_scene
from gfp_grasp.detect import DetectConfig, detect_objects
from gfp_grasp.errors import InvalidView, NothingDetected
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage

WIDTH, HEIGHT = 320, 240
K = intrinsics(WIDTH, HEIGHT, 45.0)
UP = (0.0, 0.0, 1.0)
IN_TIME_S = 3.0


def thing(family: str, seed: int, x: float, y: float) -> trimesh.Trimesh:
    mesh = make_shape(family, seed).mesh.copy()
    mesh.apply_translation([x, y, -mesh.bounds[0, 2]])
    return mesh


MUG, CUP = thing("mug", 1, 0.0, 0.0), thing("cup", 2, 0.12, -0.1)
WALL = trimesh.creation.box(bounds=[[-1.5, -3.0, -1.0], [-1.0, 3.0, 2.0]])


def picture(
    *meshes: trimesh.Trimesh,
    eye: tuple[float, float, float] = (0.5, 0.2, 0.45),
    target: tuple[float, float, float] = (0.0, 0.0, 0.05),
    table: bool = True,
) -> DepthImage:
    """What a camera with 1 mm of noise sees."""
    camera = {"T_world_camera": look_at(eye, target), "K": K, "width": WIDTH, "height": HEIGHT}
    image, _ = render_mesh_view(meshes, **camera, table_height=0.0 if table else None)
    noise = np.random.default_rng(0).normal(scale=0.001, size=image.depth_m.shape)
    return DepthImage(np.where(image.depth_m > 0, image.depth_m + noise, 0.0), K, image.T_world_camera)


def with_holes(image: DepthImage, patch_px: int) -> DepthImage:
    """A tenth of the picture, in patches."""
    kept = np.random.default_rng(1).random((HEIGHT // patch_px, WIDTH // patch_px)) < 0.1
    kept = np.kron(kept, np.ones((patch_px, patch_px), bool))
    return DepthImage(np.where(kept, image.depth_m, 0.0), image.K, image.T_world_camera)


REFUSED = {
    "objects without a table": (lambda: picture(MUG, CUP, table=False), r"0\.\d\d m across in all.*complete_to_mesh"),
    "an empty table": (picture, r"100% of the picture is one plane, 1\.\d\d m across.*empty table.*point the camera"),
    "a wall": (
        lambda: picture(WALL, eye=(0.5, 0.0, 0.5), target=(-1.0, 0.0, 0.4), table=False),
        r"100% of the picture is one plane.*a wall.*point the camera",
    ),
    "an object that fills it": (
        lambda: picture(thing("bottle", 2, 0, 0), eye=(0.14, 0.0, 0.1), target=(0.0, 0.0, 0.09), table=False),
        r"9\d% of the picture is one plane, 0\.\d\d m across.*the side of an object.*complete_to_mesh",
    ),
    "single pixels": (lambda: with_holes(picture(MUG, CUP), 1), r"only 10% of the pixels.*holes.*median"),
    "patches": (lambda: with_holes(picture(MUG, CUP), 8), r"only \d+% of the pixels.*holes.*median"),
    "nothing": (lambda: DepthImage(np.zeros((HEIGHT, WIDTH)), K, np.eye(4)), "no pixel of the picture came back"),
}


@pytest.mark.parametrize("up", [UP, None])
@pytest.mark.parametrize("name", REFUSED)
def test_a_picture_without_things_on_a_table_says_what_it_shows_and_what_to_do(name: str, up) -> None:
    make, words = REFUSED[name]
    image = make()
    started = time.monotonic()
    with pytest.raises(NothingDetected, match=words):
        complete_scene(image, up=up)
    assert time.monotonic() - started < IN_TIME_S


def test_a_wall_and_a_table_are_told_apart_where_up_is_known() -> None:
    with pytest.raises(NothingDetected, match="0 degrees from level, as an empty table is"):
        complete_scene(picture())
    make, _ = REFUSED["a wall"]
    with pytest.raises(NothingDetected, match="90 degrees from level, as a wall, or"):
        complete_scene(make())


@pytest.mark.parametrize(("factor", "unit"), [(100, "centimetres"), (1000, "millimetres")])
def test_a_picture_in_another_unit_is_refused_with_the_unit_that_fits(factor: float, unit: str) -> None:
    image = picture(MUG)
    with pytest.raises(InvalidView, match=f"in {unit} it would be 0.7\\d* m: divide by {factor:g}"):
        DepthImage(factor * image.depth_m, K, image.T_world_camera)


def test_a_camera_that_stands_hundreds_of_metres_away_is_refused() -> None:
    image = picture(MUG)
    T = image.T_world_camera.copy()
    T[:3, 3] *= 1000
    with pytest.raises(
        InvalidView, match=r"puts the camera 70\d\.\d m from the world's origin.*in millimetres it would be"
    ):
        complete_scene(DepthImage(image.depth_m, K, T))


def test_sixty_objects_are_answered() -> None:
    families = ("mug", "cup", "bottle")
    things = [thing(families[i % 3], 1 + i % 5, -0.75 + 0.17 * (i % 10), -0.45 + 0.18 * (i // 10)) for i in range(60)]
    image = picture(*things, eye=(1.1, 0.1, 1.3), target=(0.0, 0.0, 0.0))
    started = time.monotonic()
    found = detect_objects(image, config=DetectConfig(classify=False))
    assert time.monotonic() - started < 2 * IN_TIME_S
    assert 40 <= len(found) <= 60
    support = found[0].support
    assert support is not None
    assert support.height_m == pytest.approx(0.0, abs=0.002)


def test_the_ghosts_that_a_mirror_shows_below_the_table_are_no_objects() -> None:
    ghosts = [mesh.copy().apply_transform(np.diag([1.0, 1.0, -1.0, 1.0])) for mesh in (MUG, CUP)]
    image, below = picture(MUG, CUP), picture(*ghosts, table=False)
    points = image.points()
    on_table = np.abs(points[..., 2]) < 0.004
    depth = np.where(on_table & (below.depth_m > 0), below.depth_m, image.depth_m)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = detect_objects(DepthImage(depth, K, image.T_world_camera), config=DetectConfig(classify=False))
    assert len(found) == 2
    for detection, mesh in zip(found, (MUG, CUP), strict=True):
        middle = detection.cloud.points.mean(axis=0)
        assert (mesh.bounds[0] - 0.005 < middle).all()
        assert (middle < mesh.bounds[1] + 0.005).all()
        assert detection.cloud.points[:, 2].min() > -0.003
