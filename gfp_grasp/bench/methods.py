"""Methods that the bench of completions compares, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gfp_grasp.bench.views import ObjectView, extents_of
from gfp_grasp.complete import CompleteConfig, complete_to_mesh
from gfp_grasp.completers import CONFIGS, complete_as_observed, mirror_cloud
from gfp_grasp.completion import Completion
from gfp_grasp.deform import DeformConfig, Method
from gfp_grasp.detect import detect_single
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, icp_config, pcrnet_config
from gfp_grasp.types import Detection, GenericPrimitive

UNDEFORMED = "registration"
_ITERATIONS = range(1, 8)


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of a method to a view.

    Attributes:
        surface: A mesh, or points (n, 3) m where the method has none.
        completion: Completion that the library returned, for methods of the library.
    """

    surface: trimesh.Trimesh | np.ndarray
    completion: Completion | None = None


def run_method(
    name: str, view: ObjectView, category: str | None, given: str, *, library: PrimitiveLibrary | None = None
) -> Answer:
    """One method on one view.

    Args:
        name: One of METHODS. Those that begin with "told-" (the paper's) are told the true class; those that end in
            "-sized" also get the true height and width.
        view: The view; a method gets its cloud.
        category: Class that the other methods are told, or None.
        given: True class of the object.
        library: The classes that there are; None for those that ship.

    Raises:
        GfpGraspError: The method has no answer.
    """
    if name in _SIMPLE:
        return Answer(_SIMPLE[name](view))
    config, tell = config_of(name, view, given, library=library)
    done = complete_to_mesh(
        view.cloud.points,
        viewpoint=view.cloud.viewpoint,
        category=given if tell else category,
        config=config,
    )
    return Answer(done.mesh, done)


def config_of(
    name: str, view: ObjectView | None = None, given: str = "", *, library: PrimitiveLibrary | None = None
) -> tuple[CompleteConfig, bool]:
    """Config of a row that registers a primitive, and whether the row is told the class."""
    library = library or PrimitiveLibrary.shipped()
    if name in _OWN:
        return replace(_OWN[name], library=library), False
    base = name.removesuffix("-sized")
    rigid, method = _PAPER[base]
    fit = rigid()
    if name.endswith("-sized"):
        assert view is not None
        fit = rigid(size=_true_size(view, library.primitive(given)))
    deform = DeformConfig(method=method)
    return CompleteConfig(library=library, fit=fit, deform=deform, rival_share=1.0, subcategories=False), True


def _true_size(view: ObjectView, primitive: GenericPrimitive) -> tuple[float, float, float]:
    """Scale that gives a primitive the true height and mean width."""
    true, own = extents_of(view), np.ptp(primitive.vertices, axis=0)
    wide = float(true[:2].mean() / own[:2].mean())
    return wide, wide, float(true[2] / own[2])


def _detection(view: ObjectView) -> Detection:
    return detect_single(view.cloud.points, viewpoint=view.cloud.viewpoint, up=np.array([0, 0, 1.0]))


def _without(**switches: object) -> CompleteConfig:
    """The default with switches of all refinements of its fit."""
    fit = FitConfig()
    laps = {name: replace(getattr(fit, name), **switches) for name in ("quick", "middle", "thorough")}
    return CompleteConfig(fit=replace(fit, **laps))


_SIMPLE: Mapping[str, Callable[[ObjectView], trimesh.Trimesh | np.ndarray]] = {
    "partial": lambda view: view.cloud.points,
    "observed": lambda view: complete_as_observed(_detection(view)).mesh,
    "mirror": lambda view: mirror_cloud(_detection(view)),
}
_PAPER: Mapping[str, tuple[Callable[..., FitConfig], Method]] = {
    "told-icp": (icp_config, "none"),
    "told-pcrnet": (pcrnet_config, "none"),
    "told-pcrnet-gfs": (pcrnet_config, "gfs"),
    "told-pcrnet-gfpnet-oneshot": (pcrnet_config, "gfpnet-oneshot"),
    "told-pcrnet-gfpnet-paper": (pcrnet_config, "gfpnet-paper"),
}
SWITCHES: Mapping[str, CompleteConfig] = {
    "gfpnet-no-scale": _without(estimate_scale=False),
    "gfpnet-no-modes": _without(estimate_modes=False),
    "gfpnet-no-kinds": CompleteConfig(subcategories=False),
    "gfpnet-no-roundness": CompleteConfig(fit=FitConfig(roundness=False)),
    "gfpnet-no-free-space": _without(free_space=False),
    "gfpnet-no-support": _without(support=False),
    "gfpnet-no-symmetry": CompleteConfig(deform=DeformConfig(symmetry=False)),
    "gfpnet-pcrnet-start": CompleteConfig(fit=FitConfig(start="pcrnet")),
}
_OWN: Mapping[str, CompleteConfig] = {
    **{name: CONFIGS[name] for name in (UNDEFORMED, "gfs", "gfpnet-oneshot", "gfpnet")},
    "registration-no-modes": replace(SWITCHES["gfpnet-no-modes"], deform=DeformConfig(method="none")),
    **{
        f"gfpnet-paper-{m}": CompleteConfig(deform=DeformConfig(method="gfpnet-paper", iterations=m))
        for m in _ITERATIONS
    },
    **SWITCHES,
}
METHODS = (
    *_SIMPLE,
    *(f"{name}{sized}" for name in _PAPER for sized in ("", "-sized")),
    *_OWN,
)
BRIEF = (*_SIMPLE, "told-icp", UNDEFORMED, "gfs", "gfpnet-paper-5", "gfpnet")
# Names of rows in reports that were written before: the same method had another name as a completer.
FORMER_NAMES: Mapping[str, str] = {
    "hull": "observed",
    **{f"{name.removeprefix('told-')}{sized}": f"{name}{sized}" for name in _PAPER for sized in ("", "-sized")},
}

__all__ = ["BRIEF", "FORMER_NAMES", "METHODS", "SWITCHES", "UNDEFORMED", "Answer", "config_of", "run_method"]
