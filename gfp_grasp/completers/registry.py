"""Completers by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import trimesh

from gfp_grasp.complete import CompleteConfig, complete_detection
from gfp_grasp.completers.hulls import complete_as_observed, complete_by_mirror
from gfp_grasp.completers.oracle import Oracle
from gfp_grasp.completers.unfitted import Completer, mark_shape
from gfp_grasp.completion import Completion
from gfp_grasp.deform import DeformConfig
from gfp_grasp.errors import InvalidMesh, UnknownCompleter
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.plugins import imported_function
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import icp_config, pcrnet_config
from gfp_grasp.types import Detection

# Completers that fit a primitive, and how each of them does it.
CONFIGS: Mapping[str, CompleteConfig] = {
    "icp": CompleteConfig(fit=icp_config(), deform=DeformConfig(method="none"), subcategories=False),
    "pcrnet": CompleteConfig(fit=pcrnet_config(), deform=DeformConfig(method="none"), subcategories=False),
    "registration": CompleteConfig(deform=DeformConfig(method="none")),
    "gfs": CompleteConfig(deform=DeformConfig(method="gfs")),
    "gfpnet-oneshot": CompleteConfig(deform=DeformConfig(method="gfpnet-oneshot")),
    "gfpnet-paper": CompleteConfig(deform=DeformConfig(method="gfpnet-paper")),
    "gfpnet": CompleteConfig(),
}
# Completers that look at the points alone: nobody has to load a network for them.
_WITHOUT_CLASS: Mapping[str, Completer] = {
    "oracle": Oracle(),
    "observed": complete_as_observed,
    "mirror": complete_by_mirror,
}
COMPLETERS = (*_WITHOUT_CLASS, *CONFIGS)


def get_completer(name: str, *, library: PrimitiveLibrary | None = None) -> Completer:
    """A completer by name.

    Args:
        name: `observed` (hull of what was seen), `mirror` (hull of the cloud and its reflection in the vertical plane
            through its middle that faces the camera), `icp` and `pcrnet` (the mean primitive, placed rigidly),
            `registration` (the fitted primitive, undeformed), that deformed by `gfs` (active contour),
            `gfpnet-oneshot` or `gfpnet-paper` (the paper's networks) or `gfpnet` (the package's method), `oracle` (the
            true mesh; see `Oracle`), or `package.module:function`, a function of a Detection that returns a
            trimesh.Trimesh in the world frame or a Completion.
        library: The classes that there are for the package's own completers; None for those that ship.

    Returns:
        A function of a detection; for `oracle` an `Oracle`, which takes the truth as well.

    Raises:
        UnknownCompleter: The name is none of these, or cannot be imported.
    """
    if name in _WITHOUT_CLASS:
        return _WITHOUT_CLASS[name]
    if name in CONFIGS:
        config = CONFIGS[name] if library is None else replace(CONFIGS[name], library=library)
        return partial(complete_detection, config=config)
    on_offer = ", ".join(COMPLETERS)
    function = imported_function(name, what="completer", of="a Detection", on_offer=on_offer, error=UnknownCompleter)
    return _checked(function)


def needs_class(name: str) -> bool:
    """Whether a completer, by name, looks at the class of its detection; one that does not runs without torch."""
    return name not in _WITHOUT_CLASS  # a user's own may ask for the class


def _checked(function: Callable[[Detection], object]) -> Completer:
    """A user's function as a completer: its mesh is checked, made solid and marked."""

    def complete(detection: Detection) -> Completion:
        answer = function(detection)
        if isinstance(answer, Completion):
            return answer
        if not isinstance(answer, trimesh.Trimesh):
            raise InvalidMesh(
                f"the completer returned a {type(answer).__name__}; a trimesh.Trimesh or Completion is expected"
            )
        mesh = check_mesh(answer)
        solid = mesh if mesh.is_volume else make_solid(mesh)[0]
        return Completion(mark_shape(solid, detection), detection)

    return complete
