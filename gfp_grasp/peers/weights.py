"""Networks of the peers with their weights: those that ship, and those of a file."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path

from gfp_grasp.assets import data_file
from gfp_grasp.networks import with_weights
from gfp_grasp.peers.catalogue import check_trained, get_peer, weights_stem
from gfp_grasp.peers.network import PeerNetwork


def make_network(name: str) -> PeerNetwork:
    """A network of a peer with random weights.

    Raises:
        InvalidOption: No such peer.
    """
    return network_class(name)()


def network_class(name: str) -> type[PeerNetwork]:
    """The class of a peer's network.

    Raises:
        InvalidOption: No such peer.
    """
    module, network = get_peer(name)
    return getattr(import_module(f"gfp_grasp.peers.{module}"), network)


@cache
def load_network(name: str, *, true_box: bool) -> PeerNetwork:
    """The shipped network of a peer, in evaluation mode, loaded once.

    Raises:
        InvalidOption: No such peer.
        NotTrained: Its weights are not there; the message has the command that trains it.
    """
    check_trained(name, true_box=true_box)
    return read_network(name, data_file("weights", f"{weights_stem(name, true_box=true_box)}.safetensors"))


def read_network(name: str, path: Path) -> PeerNetwork:
    """A network of a peer with the weights of a file, in evaluation mode.

    Raises:
        UnreadableFile: The file holds no weights of this peer.
    """
    return with_weights(make_network(name), path, name=name)
