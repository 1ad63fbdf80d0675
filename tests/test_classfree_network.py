"""The network of the class-free completion: what it computes where, whatever it has learnt."""

import pytest
import torch
from torch import nn

from gfp_grasp.classfree import NUM_CHANNELS, REACH, DistanceNet
from gfp_grasp.classfree.network import _blocks, _cells, _Conv


def _network(**options: int) -> DistanceNet:
    torch.manual_seed(0)
    return DistanceNet(**options).eval()


@pytest.mark.parametrize("shape", [(2, 8, 4, 6, 5), (1, 40, 32, 24, 8)])
def test_planes_with_their_neighbours_are_convolved_as_cubes_are(shape: tuple[int, ...]) -> None:
    torch.manual_seed(0)
    own = _Conv(shape[1], 12)
    torchs = nn.Conv3d(shape[1], 12, 3, padding=1)
    torchs.load_state_dict(own.state_dict())
    x = torch.randn(shape)
    torch.testing.assert_close(own(x), torchs(x), rtol=1e-4, atol=1e-5)


def test_cells_of_a_block_come_back_to_their_places() -> None:
    cells = torch.arange(2.0 * 3 * 4 * 6 * 8).view(2, 3, 4, 6, 8)
    blocks = _blocks(cells)
    assert blocks.shape == (2, 24, 2, 3, 4)
    assert torch.equal(_cells(blocks), cells)
    # The first cell of a block is its lowest corner, the last its highest.
    assert torch.equal(blocks[:, 0], cells[:, 0, ::2, ::2, ::2])
    assert torch.equal(blocks[:, 23], cells[:, 2, 1::2, 1::2, 1::2])


def test_answers_are_as_large_as_the_grid_and_distances_end_at_their_reach() -> None:
    network = _network(width=8, depth=1)
    known = 30 * torch.randn(2, NUM_CHANNELS, 16, 8, 24)
    with torch.inference_mode():
        distance, log_scale = network(known)
    assert distance.shape == log_scale.shape == (2, 16, 8, 24)
    assert float(distance.abs().max()) <= REACH
    assert torch.isfinite(log_scale).all()


def test_a_grid_is_completed_the_same_beside_others() -> None:
    network = _network(width=8, depth=1)
    known = torch.randn(3, NUM_CHANNELS, 16, 8, 16)
    with torch.inference_mode():
        together, alone = network(known), network(known[1:2])
    for a, b in zip(together, alone, strict=True):
        torch.testing.assert_close(a[1:2], b, rtol=1e-4, atol=1e-4)


def test_scales_grow_by_a_factor_and_distances_stay() -> None:
    network = _network(width=8, depth=1)
    known = torch.randn(1, NUM_CHANNELS, 8, 8, 8)
    with torch.inference_mode():
        distance, log_scale = network(known)
        network.add_to_log_scale(0.7)
        again, larger = network(known)
    torch.testing.assert_close(again, distance)
    free = log_scale > -3.5
    assert free.any()
    torch.testing.assert_close(larger[free], log_scale[free] + 0.7, rtol=1e-4, atol=1e-4)


def test_the_network_of_the_defaults_fits_into_ten_megabytes_of_half_precision() -> None:
    assert 2 * sum(p.numel() for p in DistanceNet().parameters()) < 10e6
