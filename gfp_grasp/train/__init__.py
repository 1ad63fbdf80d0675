"""Building primitives and training networks, from procedural families or from any folder of meshes."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.train.classfree_data import Thing, draw_things
from gfp_grasp.train.classfree_measure import HullRow, measure_against_hull, summarise_against_hull
from gfp_grasp.train.primitives import (
    build_from_folder,
    build_from_shapes,
    build_shipped,
    procedural_members,
    shipped_names,
    with_spec,
)
from gfp_grasp.train.proposal_data import CACHE, Example, above_table, assorted_examples, class_examples
from gfp_grasp.train.rests import rest_rotation
from gfp_grasp.train.scans import ScansConfig, scan_of
from gfp_grasp.train.street_data import StreetScan, read_street, render_street, street_of_kitti
from gfp_grasp.train.views import View, ViewsConfig, across_edge, render_views, shape_source

if TYPE_CHECKING:
    from gfp_grasp.train.classfree import ClassfreeConfig, train_classfree
    from gfp_grasp.train.curves import curves_of_cards
    from gfp_grasp.train.gfpnet import GFPNET_CONFIG, train_gfpnet
    from gfp_grasp.train.instances import InstancesConfig, train_instances
    from gfp_grasp.train.loop import Batch, LoopConfig, shuffled, train
    from gfp_grasp.train.openset import SIGHTS, OpenSetConfig, OpenSetRow, openset_rows, train_openset
    from gfp_grasp.train.paper import (
        PAPER_CONFIGS,
        Reading,
        chamfer_of_sets,
        looped_back,
        looped_loss,
        paper_loss,
        train_paper,
    )
    from gfp_grasp.train.paper_data import paper_patches
    from gfp_grasp.train.pcrnet import PCRNET_CONFIG, train_pcrnet
    from gfp_grasp.train.peers import PEER_CONFIGS, PeerConfig, peer_config, train_peer
    from gfp_grasp.train.pointrcnn import PointRCNNConfig, measure_pointrcnn, train_pointrcnn
    from gfp_grasp.train.proposal import train_proposal
    from gfp_grasp.train.proposal_batches import LIDAR_CONFIG, ProposalConfig
    from gfp_grasp.train.prototypes import make_prototypes, with_prototypes

__all__ = [
    "CACHE",
    "GFPNET_CONFIG",
    "LIDAR_CONFIG",
    "PAPER_CONFIGS",
    "PCRNET_CONFIG",
    "PEER_CONFIGS",
    "SIGHTS",
    "Batch",
    "ClassfreeConfig",
    "Example",
    "HullRow",
    "InstancesConfig",
    "LoopConfig",
    "OpenSetConfig",
    "OpenSetRow",
    "PeerConfig",
    "PointRCNNConfig",
    "ProposalConfig",
    "Reading",
    "ScansConfig",
    "StreetScan",
    "Thing",
    "View",
    "ViewsConfig",
    "above_table",
    "across_edge",
    "assorted_examples",
    "build_from_folder",
    "build_from_shapes",
    "build_shipped",
    "chamfer_of_sets",
    "class_examples",
    "curves_of_cards",
    "draw_things",
    "looped_back",
    "looped_loss",
    "make_prototypes",
    "measure_against_hull",
    "measure_pointrcnn",
    "openset_rows",
    "paper_loss",
    "paper_patches",
    "peer_config",
    "procedural_members",
    "read_street",
    "render_street",
    "render_views",
    "rest_rotation",
    "scan_of",
    "shape_source",
    "shipped_names",
    "shuffled",
    "street_of_kitti",
    "summarise_against_hull",
    "train",
    "train_classfree",
    "train_gfpnet",
    "train_instances",
    "train_openset",
    "train_paper",
    "train_pcrnet",
    "train_peer",
    "train_pointrcnn",
    "train_proposal",
    "with_prototypes",
    "with_spec",
]

# These bring torch, and so come with the first use of one of them.
_WITH_TORCH = {
    **dict.fromkeys(("ClassfreeConfig", "train_classfree"), "classfree"),
    **dict.fromkeys(("train_proposal",), "proposal"),
    **dict.fromkeys(("LIDAR_CONFIG", "ProposalConfig"), "proposal_batches"),
    **dict.fromkeys(("curves_of_cards",), "curves"),
    **dict.fromkeys(("GFPNET_CONFIG", "train_gfpnet"), "gfpnet"),
    **dict.fromkeys(("InstancesConfig", "train_instances"), "instances"),
    **dict.fromkeys(
        ("PAPER_CONFIGS", "Reading", "chamfer_of_sets", "looped_back", "looped_loss", "paper_loss", "train_paper"),
        "paper",
    ),
    **dict.fromkeys(("paper_patches",), "paper_data"),
    **dict.fromkeys(("Batch", "LoopConfig", "shuffled", "train"), "loop"),
    **dict.fromkeys(("SIGHTS", "OpenSetConfig", "OpenSetRow", "openset_rows", "train_openset"), "openset"),
    **dict.fromkeys(("PCRNET_CONFIG", "train_pcrnet"), "pcrnet"),
    **dict.fromkeys(("PointRCNNConfig", "measure_pointrcnn", "train_pointrcnn"), "pointrcnn"),
    **dict.fromkeys(("PEER_CONFIGS", "PeerConfig", "peer_config", "train_peer"), "peers"),
    **dict.fromkeys(("make_prototypes", "with_prototypes"), "prototypes"),
}


def __getattr__(name: str) -> object:
    if name in _WITH_TORCH:
        return getattr(import_module(f"gfp_grasp.train.{_WITH_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
