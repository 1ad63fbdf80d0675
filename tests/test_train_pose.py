"""What the proposal network's pose costs in training, and how its errors are measured: answers worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from gfp_grasp.detect import Look, ProposalNet
from gfp_grasp.train import Example
from gfp_grasp.train.calibration import measure_pose
from gfp_grasp.train.proposal import _pose_loss
from gfp_grasp.train.proposal_batches import _fronts
from gfp_grasp.train.proposal_data import Placed
from gfp_grasp.transforms import rotation_about

NAN = math.nan
UP = np.array([0.0, 0.0, 1.0])


def _rows(*rows: list[float]) -> Tensor:
    return torch.tensor(rows, dtype=torch.float64)


def _fronts_of(*orders: int) -> Tensor:
    return torch.from_numpy(np.stack([_fronts(np.eye(3), order) for order in orders]))


# A thing of one front, one of four, one that is round, and one without axes of its own.
FRONTS = _fronts_of(1, 4, 0, 0)
RESTS = torch.tensor([0, 2, 1, 1])
POSE = torch.stack(
    [
        _rows([0, 0, 1], [0.1, 0.2, 0.3], [0, 0, 0.5]),
        _rows([0.6, 0, 0.8], [0.0, 0.0, 0.0], [0, 0, 0.0]),
        _rows([0, 0, -1], [1.0, 1.0, 1.0], [1, 1, 1.0]),
        _rows([0, 0, 1], [NAN, NAN, NAN], [NAN, NAN, NAN]),
    ]
)


def _right() -> Look[Tensor]:
    """The right answer, as sure as can be; of what has none it says something all the same."""
    return Look(
        embedding=_rows(*[[1.0, 0.0]] * 4),
        rests=40.0 * torch.nn.functional.one_hot(RESTS, 3).double(),
        up=POSE[:, 0].clone(),
        front=_rows([1, 0, 0], [1, 0, 0], [0.3, -0.4, 0], [5, 6, 7]),
        log_extents=POSE[:, 1].nan_to_num(nan=9.0),
        centre=POSE[:, 2].nan_to_num(nan=-9.0),
    )


def _loss(seen: Look[Tensor]) -> float:
    return _pose_loss(seen, RESTS, FRONTS, POSE).item()


def test_the_right_pose_costs_nothing() -> None:
    assert _loss(_right()) == pytest.approx(0.0, abs=1e-12)


def test_the_loss_of_a_pose_is_the_sum_that_is_worked_out_by_hand() -> None:
    seen = _right()._replace(
        rests=_rows([math.log(2), 0, 0], [0, 0, 0], [0, math.log(6), 0], [9, 0, 0]),
        up=_rows([0, 0, 0.5], [0.6, 0, 0.8], [0, 0.1, -1], [1, 1, 1]),
        front=_rows([0.9, 0, 0.2], [0.1, -1, 0], [3, 3, 3], [4, 4, 4]),
        log_extents=_rows([0.1, 0.4, 0.3], [0, 0, 0], [1, 1, 1], [0, 0, 0]),
        centre=_rows([0, 0, 0.5], [0.05, 0, 0], [1, 1, 1], [0, 0, 0]),
    )
    rests = (math.log(2) + math.log(3) + math.log(8 / 6)) / 3
    up = (0.25 + 0 + 0.01) / 3
    front = (0.05 + 0.01) / 2  # of the four fronts -y is the nearest
    size = (0.2 - 0.05 + 0.5 * 0.05**2 / 0.1) / 18  # three things with six numbers each
    assert _loss(seen) == pytest.approx(rests + up + front + 5 * size, rel=1e-9)


@pytest.mark.parametrize("turn", range(4))
def test_fronts_that_symmetry_makes_equal_count_as_right(turn: int) -> None:
    seen = _right()
    x = torch.from_numpy(rotation_about(UP, turn * np.pi / 2)[:, 0])
    symmetric, other = seen.front.clone(), seen.front.clone()
    symmetric[1], other[0] = x, x
    assert _loss(seen._replace(front=symmetric)) == pytest.approx(0.0, abs=1e-12)
    # The thing of one front is wrong by the square of the chord, one of two that have a front.
    assert _loss(seen._replace(front=other)) == pytest.approx((0.0, 2.0, 4.0, 2.0)[turn] / 2, abs=1e-12)


def test_the_gradient_is_finite_and_none_reaches_what_has_no_axes() -> None:
    seen = Look(*(part.clone().requires_grad_() for part in _right()))
    seen = seen._replace(front=torch.zeros(4, 3, dtype=torch.float64, requires_grad=True))
    off = Look(*(part + 0.3 for part in seen))
    _pose_loss(off, RESTS, FRONTS, POSE).backward()
    for name in ("rests", "up", "front", "log_extents", "centre"):
        gradient = getattr(seen, name).grad
        assert gradient.isfinite().all(), name
        assert not gradient[3].any(), name
        assert gradient[:2].any(dim=1).all() if name != "rests" else gradient[:2].any(), name
    assert not seen.front.grad[2].any()  # pyright: ignore[reportOptionalSubscript]


def test_a_batch_without_fronts_costs_nothing_for_them() -> None:
    value = _pose_loss(_right(), RESTS, _fronts_of(0, 0, 0, 0), POSE)
    assert value.item() == pytest.approx(0.0, abs=1e-12)


def test_a_batch_of_things_without_axes_costs_nothing_and_teaches_nothing_of_a_pose() -> None:
    nothing = torch.full_like(POSE, NAN)
    nothing[:, 0] = POSE[:, 0]  # up is the z axis of a frame that nobody asked for
    said = Look(*(part.clone().requires_grad_() for part in _right()))
    value = _pose_loss(said, RESTS, _fronts_of(0, 0, 0, 0), nothing)
    assert value.item() == 0.0
    value.backward()
    assert not said.up.grad.any()  # pyright: ignore[reportOptionalMemberAccess]
    assert all(part.grad is None or not part.grad.any() for part in said)


def test_a_batch_of_things_without_axes_leaves_the_network_as_it_is() -> None:
    torch.manual_seed(0)
    network = ProposalNet(4, width=4)
    seen = network(torch.randn(4, 9, 12))
    _pose_loss(seen, RESTS, _fronts_of(0, 0, 0, 0).float(), torch.full((4, 3, 3), NAN)).backward()
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    assert len(gradients) > 10
    assert not any(gradient.any() for gradient in gradients)  # a NaN counts as true


RADIUS_M = 0.2
SAID_UP = np.array([0.0, np.sin(np.radians(20)), np.cos(np.radians(20))])
SAID_FRONT = 0.4 * np.array([np.cos(np.radians(10)), np.sin(np.radians(10)), 0.0])
SAID_LOG_EXTENTS, SAID_CENTRE = np.array([0.1, -0.2, 0.3]), np.array([0.05, -0.1, 0.5])


class _Says(ProposalNet):
    """Says the same of every cloud: lying, 20 degrees from upright, front at 10 degrees, and a box."""

    def forward(self, features: Tensor) -> Look[Tensor]:
        rows = ([1.0, 0.0], [0.0, 0.0, 3.0], SAID_UP, SAID_FRONT, SAID_LOG_EXTENTS, SAID_CENTRE)
        return Look(*(torch.tensor(np.array([row])).expand(len(features), -1) for row in rows))


def _dome(placed: Placed | None, resting: str = "lying") -> Example:
    """Half a ball about (1, 2, 0): all points are as far from the seen frame's zero, so that its unit is the radius."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(400, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points[:, 2] = np.abs(points[:, 2])
    points = points[points[:, 2] > 0.1]
    points = RADIUS_M * np.concatenate([points, points * [-1, -1, 1]])
    place = np.array([1.0, 2.0, 0.0])
    # The camera stands towards the world's y: that is the seen frame's x, whose y is the world's -x.
    viewpoint = place + np.array([0.0, 0.9, 0.4])
    return Example(points + place, viewpoint, "thing", "", ("thing",), ("thing",), resting, placed)


def _in_world(vector: np.ndarray) -> np.ndarray:
    return np.array([-vector[1], vector[0], vector[2]])


TRUE = Placed(
    R=rotation_about(UP, np.radians(90 + 10)),
    extents=RADIUS_M * np.exp(SAID_LOG_EXTENTS),
    centre=np.array([1.0, 2.0, 0.0]) + RADIUS_M * _in_world(SAID_CENTRE),
    order=1,
)


def _measured(*examples: Example) -> dict[str, object]:
    return measure_pose(_Says(2, width=2).eval(), examples)


def test_what_is_said_rightly_has_no_error() -> None:
    assert _measured(_dome(TRUE)) == {
        "wrong_rest": 0.0,
        "up_deg": 20.0,
        "front_deg": 0.0,
        "front_over_30_deg": 0.0,
        "size_error": 0.0,
        "centre_error": 0.0,
    }


def test_errors_of_a_pose_are_medians_and_shares() -> None:
    def turned(turn_deg: float, **changes) -> Placed:
        return replace(TRUE, R=rotation_about(UP, np.radians(90 + 10 + turn_deg)), **changes)

    aside = TRUE.centre + 0.3 * np.linalg.norm(TRUE.extents) * np.array([0.6, 0.8, 0.0])
    found = _measured(
        _dome(turned(25.0, extents=TRUE.extents * np.exp([0.1, -0.2, 0.3])), "upright"),
        _dome(turned(-50.0, centre=aside)),
        _dome(turned(95.0, order=4, extents=TRUE.extents * np.exp(0.04))),
        _dome(turned(123.0, order=math.inf), "upside_down"),
        _dome(None, "upright"),  # says nothing of a pose, so is not counted at all
    )
    assert found == {
        "wrong_rest": 0.5,
        "up_deg": 20.0,
        "front_deg": 25.0,  # of 25, 50 and 5: one thing is round
        "front_over_30_deg": 0.3333,
        "size_error": 0.02,  # of 0.2, 0, 0.04 and 0
        "centre_error": 0.0,  # of 0, 0.3, 0 and 0
    }
    assert _measured(_dome(turned(0.0, centre=aside)))["centre_error"] == 0.3


def test_an_axis_that_is_not_told_is_a_quarter_turn_off() -> None:
    class Silent(_Says):
        def forward(self, features: Tensor) -> Look[Tensor]:
            said = super().forward(features)
            return said._replace(up=torch.zeros_like(said.up), front=torch.zeros_like(said.front))

    found = measure_pose(Silent(2, width=2).eval(), [_dome(TRUE)])
    assert (found["up_deg"], found["front_deg"], found["front_over_30_deg"]) == (90.0, 90.0, 1.0)
