"""The peers by name: what each of them is, where it was published, and the file that its weights are in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import InvalidOption, NotTrained

TRUE_BOX = "-true-box"  # what a completer's name ends in that is told the true box


@dataclass(frozen=True)
class Peer:
    """Another completion network.

    Attributes:
        title: What it is called in print.
        source: Where it was published.
        network: Module of this room and class in it.
    """

    title: str
    source: str
    network: tuple[str, str]


PEERS: Mapping[str, Peer] = {
    "pcn": Peer("PCN", "arXiv:1808.00671", ("pcn", "PCN")),
    "foldingnet": Peer("FoldingNet's decoder", "arXiv:1712.07262", ("foldingnet", "FoldingNet")),
    "topnet": Peer("TopNet", "CVPR 2019, 10.1109/CVPR.2019.00047", ("topnet", "TopNet")),
    "3d-epn": Peer("3D-EPN", "arXiv:1612.00101", ("epn", "EncoderPredictor")),
    "3d-sc": Peer(
        "3D shape completion by amortised maximum likelihood", "CVPR 2018, arXiv:1805.07290", ("sc", "AmortisedFit")
    ),
    "scrg": Peer("Shape completion enabled robotic grasping", "arXiv:1609.08546", ("scrg", "VoxelCompletion")),
}


def get_peer(name: str) -> Peer:
    """The peer of a name.

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
