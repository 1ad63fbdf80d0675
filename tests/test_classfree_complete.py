"""The class-free completion from a detection on, with a network that says what is true, or what it has not learnt."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from seen_wedge import points_alone, seen, without_view
from torch import Tensor, nn

from gfp_grasp.classfree import REACH, DistanceNet, complete_classfree, complete_level, grid_around
from gfp_grasp.errors import GfpGraspError, NoSurface, TooFewPoints
from gfp_grasp.level import make_level_view
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.train.distances import signed_distances
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import Detection, PointCloud

T_WORLD = make_T(rotation_about((0.3, -0.5, 1.0), 0.8), (0.4, -0.7, 0.9))


class Says(nn.Module):
    """Stands for a network that knows the true distances, and a scale of half a cell."""

    def __init__(self, distance: np.ndarray, scale: float = 0.5) -> None:
        super().__init__()
        self.distance = nn.Parameter(torch.from_numpy(distance)[None], requires_grad=False)
        self.scale = scale

    def forward(self, known: Tensor) -> tuple[Tensor, Tensor]:
        assert known.shape[2:] == self.distance.shape[1:]
        return self.distance, torch.full_like(self.distance, float(np.log(self.scale)))


def _truthful(detection: Detection, mesh) -> Says:
    view = make_level_view(detection)
    level = mesh.copy()
    level.apply_transform(invert_T(view.T_world_level))
    return Says(signed_distances(level, grid_around(view), reach=REACH))


@pytest.mark.parametrize("told", [lambda detection: detection, without_view, points_alone])
def test_a_network_that_knows_the_truth_gives_it_in_the_detections_frame(told) -> None:
    detection, mesh = seen(moved=T_WORLD)
    detection = told(detection)
    shape = complete_classfree(detection, network=_truthful(detection, mesh))  # pyright: ignore[reportArgumentType]
    assert shape.mesh.is_volume
    assert shape.fit is None
    rng = np.random.default_rng(0)
    samples, again = (visible_surface(mesh, 8192, rng) for _ in range(2))
    assert chamfer_m(visible_surface(shape.mesh, 8192, rng), samples) < chamfer_m(again, samples) + 0.0006


def test_it_stands_on_the_support_and_knows_what_of_it_was_seen() -> None:
    detection, mesh = seen(moved=T_WORLD)
    shape = complete_classfree(detection, network=_truthful(detection, mesh))  # pyright: ignore[reportArgumentType]
    assert detection.support is not None
    height = detection.support.distances(np.asarray(shape.mesh.vertices))
    assert height.min() == pytest.approx(0.0, abs=1e-9)
    assert (height < 1e-9).sum() > 50
    assert detection.cloud.viewpoint is not None
    sight = detection.cloud.viewpoint - np.asarray(shape.mesh.vertices)
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    facing = np.einsum("vi,vi->v", shape.mesh.vertex_normals, sight)
    assert not shape.observed[facing < -0.2].any()
    assert shape.observed[facing > 0.2].mean() > 0.6
    assert np.median(shape.sigma_m[shape.observed]) < 0.3 * np.median(shape.sigma_m[~shape.observed])


def test_a_view_is_completed_in_its_level_frame() -> None:
    detection, mesh = seen(moved=T_WORLD)
    view, network = make_level_view(detection), _truthful(detection, mesh)
    level = complete_level(view, network=network)  # pyright: ignore[reportArgumentType]
    shape = complete_classfree(detection, network=network)  # pyright: ignore[reportArgumentType]
    np.testing.assert_allclose(apply_T(view.T_world_level, level.mesh.vertices), shape.mesh.vertices, atol=1e-12)
    np.testing.assert_array_equal(level.observed, shape.observed)


def _untaught() -> DistanceNet:
    """A network that has learnt nothing, and holds what has points for solid."""
    torch.manual_seed(3)
    network = DistanceNet(8, 1).eval()
    with torch.no_grad():
        network.head.bias[:8] -= 0.5  # pyright: ignore[reportOptionalSubscript]
    return network


def test_the_same_view_gives_the_same_answer_whatever_the_order_of_its_points() -> None:
    detection, _ = seen()
    points = np.asarray(detection.cloud.points)
    order = np.random.default_rng(0).permutation(len(points))
    shuffled = replace(detection, cloud=PointCloud(points[order], detection.cloud.viewpoint))
    twice = replace(detection, cloud=PointCloud(np.repeat(points, 2, axis=0), detection.cloud.viewpoint))
    first, *others = (complete_classfree(d, network=_untaught()) for d in (detection, detection, shuffled, twice))
    for other in others:
        np.testing.assert_array_equal(other.mesh.vertices, first.mesh.vertices)
        np.testing.assert_array_equal(other.sigma_m, first.sigma_m)


def _odd_clouds() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(0, 0.1, (400, 2)), np.full(400, 0.05)])
    return {
        "flat": flat,
        "line": flat * [1, 0, 0] + [0, 0, 0.02],
        "few": rng.uniform(0, 0.1, (20, 3)),
        "huge": 40.0 * rng.uniform(0, 1, (900, 3)),
        "tiny": 1e-4 * rng.uniform(0, 1, (300, 3)),
        "one place": np.tile([0.1, 0.2, 0.3], (50, 1)) + 1e-7 * rng.normal(size=(50, 3)),
        "two clusters": rng.normal(0, 0.005, (400, 3)) + np.repeat([[0.0, 0, 0], [2, 0, 0]], 200, axis=0),
        "far from the support": rng.uniform(0, 0.1, (300, 3)) + np.array([0, 0, 1.5]),
        "below the support": rng.uniform(0, 0.1, (300, 3)) - [0, 0, 0.5],
        "many": rng.uniform(0, 0.1, (30_000, 3)),
    }


@pytest.mark.parametrize("name", _odd_clouds())
@pytest.mark.parametrize("told", [without_view, points_alone])
def test_an_odd_cloud_is_completed_or_refused_by_name(name: str, told) -> None:
    detection = told(seen()[0])
    points = _odd_clouds()[name]
    detection = replace(detection, cloud=PointCloud(points, detection.cloud.viewpoint))
    try:
        shape = complete_classfree(detection, network=_untaught())
    except GfpGraspError as error:
        assert len(str(error)) > 20  # noqa: PT017
        return
    assert shape.mesh.is_watertight
    assert np.isfinite(shape.mesh.vertices).all()
    assert (shape.sigma_m > 0).all()


def test_two_points_are_refused() -> None:
    detection = without_view(seen()[0])
    with pytest.raises(TooFewPoints):
        complete_classfree(replace(detection, cloud=PointCloud(np.array([[0.0, 0, 0], [0.1, 0, 0.1]]))))


def test_a_network_that_sees_nothing_solid_says_so() -> None:
    detection, mesh = seen()
    empty = np.full(_truthful(detection, mesh).distance.shape[1:], 2.0, dtype=np.float32)
    with pytest.raises(NoSurface):
        complete_classfree(detection, network=Says(empty))  # pyright: ignore[reportArgumentType]
