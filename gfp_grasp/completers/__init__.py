"""Ways from a detection to a completed shape, by name: the package's own, brackets around them, and the user's."""

from gfp_grasp.completers.hulls import complete_as_observed, complete_by_mirror, mirror_cloud
from gfp_grasp.completers.oracle import Oracle
from gfp_grasp.completers.registry import COMPLETERS, CONFIGS, get_completer, needs_class
from gfp_grasp.completers.unfitted import Completer, CompletionInParts

__all__ = [
    "COMPLETERS",
    "CONFIGS",
    "Completer",
    "CompletionInParts",
    "Oracle",
    "complete_as_observed",
    "complete_by_mirror",
    "get_completer",
    "mirror_cloud",
    "needs_class",
]
