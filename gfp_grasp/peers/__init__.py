"""Other completion networks, by name and written from their papers: what GFPNet is compared with."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.peers.catalogue import PEERS, TRUE_BOX, check_trained, get_peer, weights_stem
from gfp_grasp.peers.cube import Cube, cube_of_box, cube_of_seen, tidied, true_box
from gfp_grasp.peers.seen import Seen, cell_middles, seen_in

if TYPE_CHECKING:
    from gfp_grasp.peers.complete import complete_by_peer
    from gfp_grasp.peers.encoder import NUM_INPUT
    from gfp_grasp.peers.epn import log_distance_loss
    from gfp_grasp.peers.network import PeerNetwork, PointNetwork
    from gfp_grasp.peers.sc import AmortisedFit, ShapePrior, likelihood_loss, prior_loss
    from gfp_grasp.peers.weights import load_network, make_network, network_class, read_network

__all__ = [
    "NUM_INPUT",
    "PEERS",
    "TRUE_BOX",
    "AmortisedFit",
    "Cube",
    "PeerNetwork",
    "PointNetwork",
    "Seen",
    "ShapePrior",
    "cell_middles",
    "check_trained",
    "complete_by_peer",
    "cube_of_box",
    "cube_of_seen",
    "get_peer",
    "likelihood_loss",
    "load_network",
    "log_distance_loss",
    "make_network",
    "network_class",
    "prior_loss",
    "read_network",
    "seen_in",
    "tidied",
    "true_box",
    "weights_stem",
]

# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    "complete_by_peer": "complete",
    "NUM_INPUT": "encoder",
    "log_distance_loss": "epn",
    **dict.fromkeys(("PeerNetwork", "PointNetwork"), "network"),
    **dict.fromkeys(("AmortisedFit", "ShapePrior", "likelihood_loss", "prior_loss"), "sc"),
    **dict.fromkeys(("load_network", "make_network", "network_class", "read_network"), "weights"),
}


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.peers.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
