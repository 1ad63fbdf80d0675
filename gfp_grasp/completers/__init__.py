"""Ways from a detection to a completed shape, by name: the package's own, brackets around them, peers, a user's."""

from gfp_grasp.completers.registry import (
    COMPLETERS,
    CONFIGS,
    PEER_COMPLETERS,
    Completer,
    CompletionInParts,
    InTrueBox,
    Oracle,
    ToldTruth,
    check_network,
    complete_as_observed,
    complete_as_peer,
    complete_by_mirror,
    complete_without_class,
    get_completer,
    mirror_cloud,
    needs_class,
)

__all__ = [
    "COMPLETERS",
    "CONFIGS",
    "PEER_COMPLETERS",
    "Completer",
    "CompletionInParts",
    "InTrueBox",
    "Oracle",
    "ToldTruth",
    "check_network",
    "complete_as_observed",
    "complete_as_peer",
    "complete_by_mirror",
    "complete_without_class",
    "get_completer",
    "mirror_cloud",
    "needs_class",
]
