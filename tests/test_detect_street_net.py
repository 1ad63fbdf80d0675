"""The networks of the detector of scans: what they see, and boxes in bins, by hand."""

import numpy as np
import torch

from gfp_grasp.detect import (
    CELL_M,
    StreetNet,
    box_loss,
    boxes_of,
    picture_from_above,
    places_in,
    point_features,
    pool,
    refined_boxes,
    refined_loss,
)
from gfp_grasp.detect.street_net import BOX_POINTS, SHIFT, TURN, TWIST, WAY

BOX = torch.tensor([[12.3, -4.1, 0.9, 4.2, 1.7, 1.5, 0.35]])
POINT = torch.tensor([[11.0, -3.7, 0.6]])


def told(bins, value: float) -> torch.Tensor:
    """The answer of a network that is sure of a value."""
    number, place = bins.encode(torch.tensor([value]))
    answer = torch.zeros(1, 2 * bins.count)
    answer[0, number] = 30.0
    answer[0, bins.count + number] = place
    return answer


def test_every_kind_of_bins_gives_back_what_it_was_told():
    for bins in (WAY, TURN, SHIFT, TWIST):
        for value in np.linspace(bins.edges[0], bins.edges[-1], 37)[1:-1]:
            np.testing.assert_allclose(bins.decode(told(bins, float(value))), [value], atol=1e-5)


def test_what_lies_beyond_the_bins_is_taken_for_their_end():
    assert WAY.decode(told(WAY, 14.0)).item() == WAY.edges[-1] == 10.0
    assert WAY.decode(told(WAY, -14.0)).item() == -10.0


def test_a_right_answer_is_the_box_and_loses_nothing():
    way = BOX[:, :3] - POINT
    rest = torch.cat([way[:, 2:], BOX[:, 3:6].log()], dim=1)
    answer = torch.cat([told(WAY, float(way[0, 0])), told(WAY, float(way[0, 1])), told(TURN, 0.35), rest], dim=1)
    np.testing.assert_allclose(boxes_of(POINT, answer), BOX, atol=1e-5)
    assert box_loss(answer, POINT, BOX, torch.ones(1)).item() < 1e-4
    turned_round = BOX + torch.tensor([0, 0, 0, 0, 0, 0, np.pi], dtype=torch.float32)
    assert box_loss(answer, POINT, turned_round, torch.ones(1)).item() < 1e-4
    longer = BOX * torch.tensor([1, 1, 1, 1.5, 1, 1, 1])
    # Twice the smooth L1 loss of log 1.5, whose slope changes at 0.1.
    np.testing.assert_allclose(
        box_loss(answer, POINT, longer, torch.ones(1)).item(), 2 * (np.log(1.5) - 0.05), atol=1e-4
    )


def test_a_proposal_is_moved_along_its_own_axes():
    start = torch.tensor([[12.0, -4.0, 1.0, 4.0, 2.0, 1.5, np.pi / 2]])
    rest = torch.tensor([[-0.1, np.log(1.1), 0.0, 0.0]])
    answer = torch.cat([told(SHIFT, 0.6), told(SHIFT, -0.2), told(TWIST, 0.3), rest], dim=1)
    expected = [[12.2, -3.4, 0.9, 4.4, 2.0, 1.5, np.pi / 2 + 0.3]]
    np.testing.assert_allclose(refined_boxes(start, answer), expected, atol=1e-5)
    assert refined_loss(answer, start, torch.tensor(expected)).item() < 1e-4
    assert refined_loss(answer, start, start).item() > 1.0


def test_the_picture_shows_points_by_height_and_cell():
    points = np.array([[3.05, -1.95, 0.3], [3.15, -1.85, 1.2], [3.0, -1.9, 9.0], [90.0, 0.0, 1.0]])
    picture = picture_from_above(points, np.array([0.0, -6.4]), (32, 64))
    assert picture.shape == (14, 32, 64)
    cell = picture[:, 15, 22]
    expected = np.zeros(10)
    expected[[0, 3]] = np.log(2) / 2  # one point between 0.2 and 0.5 m, one between 1.1 and 1.4 m
    np.testing.assert_allclose(cell[:10], expected, atol=1e-6)
    np.testing.assert_allclose(cell[10:13], [1.2, 0.3, 0.75], atol=1e-6)
    np.testing.assert_allclose(cell[13], np.hypot(3.1, -1.9) / 50, atol=1e-6)
    assert np.count_nonzero(picture[:13]) == 5


def test_features_are_those_of_the_cell_that_a_point_is_in():
    seen = torch.arange(2 * 16 * 32, dtype=torch.float32).reshape(1, 2, 16, 32)
    corner, shape = torch.tensor([[[4.0, -6.4]]]), (32, 64)
    middle = torch.tensor([[[4.0 + 5.5 * 2 * CELL_M, -6.4 + 9.5 * 2 * CELL_M, 0.0]]])
    found = StreetNet(2, width=4).features_at(seen, places_in(middle, corner, shape))
    np.testing.assert_allclose(found[0, 0], seen[0, :, 5, 9], atol=1e-3)
    np.testing.assert_allclose(
        point_features(torch.tensor([[4.5, -3.0, 1.2]]))[0], [1.2, -0.25, 0.0, np.hypot(4.5, 3) / 50], atol=1e-5
    )


def test_the_second_stage_looks_at_the_points_of_a_box_in_its_frame():
    box = np.array([[10.0, 5.0, 0.8, 4.0, 2.0, 1.6, np.pi / 2]])
    points = np.array([[10.5, 6.0, 1.0], [40.0, 0.0, 1.0], [9.8, 3.2, 0.5]])
    index, mask, what = pool(points, box, np.random.default_rng(0))
    assert index.shape == mask.shape == (1, BOX_POINTS)
    assert index[0, mask[0]].tolist() == [0, 2]
    np.testing.assert_allclose(what[0, 0, :3], [1.0, -0.5, 0.2], atol=1e-6)
    np.testing.assert_allclose(what[0, 0, 3:6], [1.0 - 2.0, 0.5 - 1.0, 0.2 - 0.8], atol=1e-6)
    np.testing.assert_allclose(what[0, 0, 6:], [1.0, np.hypot(10.5, 6) / 50], atol=1e-6)
    assert not what[0, 2:].any()


def test_points_that_do_not_count_change_nothing():
    torch.manual_seed(0)
    network = StreetNet(3, width=4).eval()
    pooled, mask = torch.randn(2, 5, 16), torch.tensor([[1, 1, 1, 0, 0], [1, 1, 0, 0, 0]]).bool()
    sizes = torch.tensor([[4.0, 2.0, 1.5], [1.0, 0.6, 1.7]])
    other = torch.where(mask[..., None], pooled, 100.0)
    with torch.inference_mode():
        for one, same in zip(network.second(pooled, mask, sizes), network.second(other, mask, sizes), strict=True):
            np.testing.assert_array_equal(one, same)
        whole = network.second(pooled, torch.ones(2, 5).bool(), sizes)
    assert not np.allclose(whole[0], network.second(pooled, mask, sizes)[0].detach())
