"""Networks with the weights of a file, wherever in the package they are."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from gfp_grasp.errors import UnreadableFile

_N = TypeVar("_N", bound=nn.Module)


def with_weights(network: _N, path: Path, *, name: str) -> _N:
    """A network with the weights of a file, in evaluation mode.

    Args:
        network: Freshly made.
        path: A .safetensors file; half floats become single ones.
        name: What the network is called in the error.

    Raises:
        UnreadableFile: The file cannot be read, or holds no weights of such a network.
    """
    try:
        network.load_state_dict(in_single(load_file(path)))
    except (OSError, RuntimeError, SafetensorError) as error:
        raise UnreadableFile(f"{path} holds no weights of a network {name!r}: {error}") from error
    return network.eval()


def in_single(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The same tensors, floats in single precision."""
    return {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in state.items()}
