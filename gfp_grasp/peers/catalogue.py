"""The peers by name: where each of them is, and the file that its weights are in."""

from __future__ import annotations

from collections.abc import Mapping

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import InvalidOption, NotTrained

TRUE_BOX = "-true-box"  # what a completer's name ends in that is told the true box


# Module of this room, whose head says where the network was published and what is smaller here, and class in it.
PEERS: Mapping[str, tuple[str, str]] = {
    "pcn": ("pcn", "PCN"),
    "foldingnet": ("foldingnet", "FoldingNet"),
    "topnet": ("topnet", "TopNet"),
    "3d-epn": ("epn", "EncoderPredictor"),
    "3d-sc": ("sc", "AmortisedFit"),
    "scrg": ("scrg", "VoxelCompletion"),
}


def get_peer(name: str) -> tuple[str, str]:
    """Module and class of a peer's network.

    Raises:
        InvalidOption: No such peer; the message lists those that there are.
    """
    if name not in PEERS:
        raise InvalidOption(f"no peer {name!r}: choose one of {', '.join(PEERS)}")
    return PEERS[name]


def weights_stem(name: str, *, true_box: bool) -> str:
    """Name of the weights file of a peer, without its suffix."""
    get_peer(name)
    return f"peer_{name}{TRUE_BOX if true_box else ''}".replace("-", "_")


def check_trained(name: str, *, true_box: bool) -> None:
    """Check, without loading anything, that the weights of a peer are there.

    Raises:
        InvalidOption: No such peer.
        NotTrained: They are not; the message has the command that trains it.
    """
    file = f"{weights_stem(name, true_box=true_box)}.safetensors"
    if not (data_dir("weights") / file).is_file():
        command = f"gfp-grasp train peer {name}{' --true-box' if true_box else ''}"
        raise NotTrained(
            f"the weights of the peer {name!r} ({file}) do not ship with this installation: `{command}` trains it, "
            f"{'ten' if true_box else 'forty'} minutes of one core, and puts them there"
        )
