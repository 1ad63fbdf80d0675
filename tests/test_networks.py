"""Weights of a file become a network in single precision, or a named error."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from gfp_grasp.errors import UnreadableFile
from gfp_grasp.networks import with_weights


def test_half_floats_become_single_ones_and_whole_numbers_stay(tmp_path: Path) -> None:
    network = nn.Sequential(nn.Linear(2, 3), nn.BatchNorm1d(3))
    wanted = {name: torch.full_like(tensor, 3 if tensor.dtype == torch.int64 else 0.25) for name, tensor in
              network.state_dict().items()}  # fmt: skip
    save_file(
        {name: t.half() if t.is_floating_point() else t for name, t in wanted.items()}, tmp_path / "a.safetensors"
    )
    read = with_weights(network.train(), tmp_path / "a.safetensors", name="toy")
    assert read is network
    assert not read.training
    for name, tensor in read.state_dict().items():
        assert tensor.dtype == wanted[name].dtype
        assert torch.equal(tensor, wanted[name])


@pytest.mark.parametrize("content", ["other", "broken", "missing", "folder"])
def test_a_file_of_something_else_is_a_named_error(tmp_path: Path, content: str) -> None:
    path = tmp_path / "a.safetensors"
    if content == "other":
        save_file({"other": torch.zeros(2)}, path)
    elif content == "broken":
        path.write_bytes(b"no tensors")
    elif content == "folder":
        path.mkdir()
    with pytest.raises(UnreadableFile, match=r"a\.safetensors holds no weights of a network 'toy'"):
        with_weights(nn.Linear(2, 3), path, name="toy")
