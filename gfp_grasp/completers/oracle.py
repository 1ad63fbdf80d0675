"""The upper bracket: a completer that is given the truth."""

from __future__ import annotations

import trimesh

from gfp_grasp.completers.unfitted import CompletionInParts, mark_shape
from gfp_grasp.completion import Completion
from gfp_grasp.errors import InvalidOption
from gfp_grasp.types import CollisionMesh, Detection


class Oracle:
    """The true mesh as its own completion; no other completer is given the truth."""

    needs_truth = True

    def __call__(
        self, detection: Detection, truth: trimesh.Trimesh | None = None, collision: CollisionMesh | None = None
    ) -> Completion:
        """Complete an object by its true mesh.

        Args:
            detection: The object as it was seen; it tells what was observed.
            truth: True mesh in the world frame.
            collision: Convex parts of the true mesh, world frame.

        Raises:
            InvalidOption: The truth is missing, as for any other completer.
        """
        if truth is None or collision is None:
            raise InvalidOption("the oracle needs the true mesh and its convex parts: use it in a simulator only")
        return CompletionInParts(mark_shape(truth, detection), detection, collision)
