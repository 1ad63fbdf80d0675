"""Ways from a detection to a completed shape, by name: the package's own, brackets around them, and the user's."""

from gfp_grasp.completers.registry import (
    COMPLETERS,
    CONFIGS,
    Completer,
    CompletionInParts,
    Oracle,
    complete_as_observed,
    complete_by_mirror,
    complete_without_class,
    get_completer,
    mirror_cloud,
    needs_class,
)

__all__ = [
    "COMPLETERS",
    "CONFIGS",
    "Completer",
    "CompletionInParts",
    "Oracle",
    "complete_as_observed",
    "complete_by_mirror",
    "complete_without_class",
    "get_completer",
    "mirror_cloud",
    "needs_class",
]
