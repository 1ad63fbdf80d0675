"""What PCRNet is taught: pairs whose truth moves along with every change of the pair."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from moments import assert_known
from scipy.spatial.transform import Rotation
from toy_primitive import toy_cup_primitive

from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import PCRNet, PoseShape, rotation_of
from gfp_grasp.train import ViewsConfig, render_views, shape_source
from gfp_grasp.train.pcrnet import _is_near, _jittered, _loss, _measure, _samples, _truth, augmented
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import Symmetry


def _pairs(count: int = 300, seed: int = 0) -> tuple[torch.Tensor, ...]:
    rng = np.random.default_rng(seed)
    template = rng.normal(size=(count, 7, 3))
    R = Rotation.from_quat(rng.normal(size=(count, 4))).as_matrix()
    t = rng.normal(size=(count, 3))
    cloud = np.einsum("bij,bnj->bni", R, template) + t[:, None]  # the truth brings each point onto its own
    return tuple(torch.tensor(part, dtype=torch.float64).float() for part in (template, cloud, R, t, np.ones(count)))


def _changed(pairs: tuple[torch.Tensor, ...], seed: int = 0) -> tuple[torch.Tensor, ...]:
    def stream(_: torch.Generator):
        while True:
            yield pairs

    return next(augmented(stream)(torch.Generator().manual_seed(seed)))


def test_the_truth_of_a_changed_pair_still_brings_the_template_onto_the_cloud() -> None:
    template, cloud, R, t, radius = _changed(_pairs())
    torch.testing.assert_close(template @ R.transpose(1, 2) + t[:, None], cloud, atol=1e-4, rtol=0)
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(300), atol=1e-4, rtol=0)
    assert (radius == 1).all()


def test_half_of_the_pairs_are_mirrored_left_to_right() -> None:
    pairs = _pairs()
    _, cloud, *_ = _changed(pairs)
    mirrored = (cloud[:, :, 1] == -pairs[1][:, :, 1]).all(dim=1)
    assert 0.4 < mirrored.float().mean() < 0.6
    assert (cloud[:, :, [0, 2]] == pairs[1][:, :, [0, 2]]).all()
    assert (cloud[~mirrored] == pairs[1][~mirrored]).all()


def test_templates_are_moved_by_a_few_degrees_and_a_tenth_of_the_radius() -> None:
    template, cloud, _, _, _ = pairs = _pairs(2000)
    changed, other_cloud, *_ = _changed(pairs)
    same = (other_cloud == cloud).all(dim=2).all(dim=1)
    R, t = [], []
    for a, b in zip(template[same].double().numpy(), changed[same].double().numpy(), strict=True):
        found = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))[0]
        R.append(found.magnitude())
        t.append(b.mean(axis=0) - found.apply(a.mean(axis=0)))
    # A quaternion (1, 0.05 n) turns by twice 0.05 |n|, whose root mean square is 0.1 sqrt(3).
    assert np.sqrt(np.mean(np.square(R))) == pytest.approx(0.1 * np.sqrt(3), rel=0.06)
    assert np.std(t, axis=0) == pytest.approx([0.1, 0.1, 0.1], rel=0.08)


class _Still(PCRNet):
    """Says how far each template moves, whatever it is shown."""

    def __init__(self, steps: list[float]) -> None:
        super().__init__()
        self.steps = steps

    def iterate(self, template, cloud, *, iterations=5):
        for step in self.steps:
            yield torch.eye(3).expand(len(template), 3, 3), torch.full((len(template), 3), step)


def test_the_loss_is_the_mean_distance_to_the_true_place_over_all_iterations() -> None:
    template = torch.randn(4, 6, 3)
    truth = (torch.eye(3).expand(4, 3, 3), torch.full((4, 3), 1.0))
    value = _loss(_Still([0.0, 3.0]), (template, template, *truth, torch.ones(4)))
    assert value.item() == pytest.approx((1 + 2) * np.sqrt(3) / 2, rel=1e-5)


def test_errors_are_measured_in_millimetres_before_and_after() -> None:
    template = torch.randn(300, 6, 3)  # more than one batch
    radius = torch.linspace(0.01, 0.09, 300)
    truth = (torch.eye(3).expand(300, 3, 3), torch.full((300, 3), 1.0))
    found = _measure(_Still([5.0, 1.2]), (template, template, *truth, radius))
    assert found == {
        "val_samples": 300,
        "mean_error_before_mm": pytest.approx(50 * np.sqrt(3), rel=1e-3),
        "mean_error_after_mm": pytest.approx(10 * np.sqrt(3), rel=1e-3),
    }


def _state(R: np.ndarray, t: tuple[float, float, float]) -> PoseShape:
    primitive = toy_cup_primitive()
    return PoseShape(R, np.array(t), np.zeros(3), np.zeros(len(primitive.modes)), R[:, 2], 0.1, "upright")


def test_the_truth_of_a_body_of_revolution_leaves_its_yaw_alone() -> None:
    primitive = toy_cup_primitive()
    tilt, yaw = rotation_about((1.0, 0.0, 0.0), 0.3), rotation_about((0.0, 0.0, 1.0), 1.1)
    state, T = _state(yaw, (0.1, 0.2, 0.3)), make_T(tilt, (0.4, 0.1, 0.2))
    R, t = _truth(state, T, primitive)
    np.testing.assert_allclose(R, tilt, atol=1e-9)
    np.testing.assert_allclose(R @ state.t + t, T[:3, 3], atol=1e-12)
    lopsided = replace(primitive, symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), order=1.0))
    R, _ = _truth(state, T, lopsided)
    np.testing.assert_allclose(R @ state.R, tilt, atol=1e-9)


def test_quaternions_of_any_length_are_rotations() -> None:
    q = np.random.default_rng(0).normal(size=(50, 4))
    expected = Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotation_of(torch.tensor(3 * q)).numpy(), expected, atol=1e-12)


@pytest.mark.parametrize(("degrees", "near"), [(48.0, True), (52.0, False)])
def test_starts_within_the_turn_that_is_asked_of_the_network_are_near(degrees: float, near: bool) -> None:
    T = make_T(rotation_about((1.0, 0.0, 0.0), np.radians(degrees)), (0.0, 0.0, 0.0))
    assert _is_near(_state(np.eye(3), (0.0, 0.0, 0.0)), T, toy_cup_primitive()) == near


def test_jitter_turns_shifts_and_scales_by_known_spreads() -> None:
    state = replace(_state(rotation_about((1.0, 0.0, 0.0), 0.4), (0.1, 0.2, 0.3)), log_scale=np.full(3, np.log(2.0)))
    rng = np.random.default_rng(0)
    moved = [_jittered(state, rng, 0.006) for _ in range(1500)]
    turn = np.array([Rotation.from_matrix(m.R @ state.R.T).as_rotvec() for m in moved])
    np.testing.assert_allclose(np.cross(turn, state.R[:, 2]), 0.0, atol=1e-9)  # about its own axis
    assert np.degrees((turn @ state.R[:, 2]).std()) == pytest.approx(8.0, rel=0.06)
    assert np.std([m.t for m in moved], axis=0) == pytest.approx(0.012 * np.ones(3), rel=0.08)  # times the scale
    assert np.std([m.log_scale for m in moved], axis=0) == pytest.approx(0.05 * np.ones(3), rel=0.08)
    assert np.mean([m.t for m in moved], axis=0) == pytest.approx(state.t, abs=1e-3)


class _Turns(PCRNet):
    """Says that each template is turned by a quarter about z, whatever it is shown."""

    def iterate(self, template, cloud, *, iterations=5):
        yield QUARTER.expand(len(template), 3, 3), torch.zeros(len(template), 3)


QUARTER = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_a_turn_is_counted_in_its_own_sense() -> None:
    template = torch.tensor([[[1.0, 0.0, 0.0], [3.0, 0.0, 1.0]]]).repeat(2, 1, 1)
    pairs = (template, template, QUARTER.expand(2, 3, 3), torch.zeros(2, 3), torch.tensor([0.01, 0.03]))
    assert _loss(_Turns(), pairs).item() == pytest.approx(0.0, abs=1e-6)
    found = _measure(_Turns(), pairs)
    assert found["mean_error_after_mm"] == pytest.approx(0.0, abs=1e-6)
    assert found["mean_error_before_mm"] == pytest.approx(20 * 2 * np.sqrt(2), rel=1e-3)
    backwards = (*pairs[:2], QUARTER.T.expand(2, 3, 3), *pairs[3:])
    assert _loss(_Turns(), backwards).item() == pytest.approx(4.0)


def test_pairs_are_near_starts_of_a_view_with_the_way_to_its_truth() -> None:
    cup = PrimitiveLibrary.shipped().primitive("cup")
    (view,) = render_views(shape_source("cup", 3), num_views=1, config=ViewsConfig(width=160, height=120))
    rows = _samples([view], cup, np.random.default_rng(0), copies=3)
    assert len(rows) == 3
    for template, cloud, R, t, radius in rows:
        assert template.shape == cloud.shape == (128, 3)
        # The truth brings the template near the cloud: a tenth of the radius off, where its width or height is.
        moved = template @ R.T + t
        away = np.linalg.norm(cloud[:, None] - moved, axis=2).min(axis=1).mean()
        assert away < 0.35
        assert 0.02 < radius < 0.1
    assert_known("pairs of pcrnet", np.concatenate([np.append(t, radius) for *_, t, radius in rows]), rel=1e-3)
    assert_known("templates of pcrnet", np.stack([template for template, *_ in rows]), rel=1e-3)
    over = replace(view, T_world_object=np.diag([1.0, -1.0, -1.0, 1.0]))
    assert _samples([over], cup, np.random.default_rng(0), copies=3) == []
