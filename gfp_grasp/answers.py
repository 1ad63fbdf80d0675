"""The answer to one object: the primitive of the likeliest class, deformed; or, where that does not hold, of no class.

What is likelier of no class than of any, or what no primitive explains, is completed by the network that knows no
class; where that contradicts what was seen too, the hull of the points is the answer.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.classfree import complete_hull
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.deform import DeformConfig, deform
from gfp_grasp.errors import FitDiverged, InvalidOption, NoSurface
from gfp_grasp.level import mark_observed
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.misfit import misfit_of
from gfp_grasp.openset import (
    evidence_of_fit,
    evidence_of_look,
    is_unknown_by_look,
    probability_by_look,
    probability_unknown,
)
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import class_is_given, fit_likeliest
from gfp_grasp.register import FitConfig, is_cut_off, part_is_seen
from gfp_grasp.types import KEEP_RULES, CompletedShape, Detection, FittedPrimitive, LevelView

# Probability of being of no class, by the look alone, from which on unlikely primitives are not worth their time.
_DOUBTFUL = 0.7


@dataclass(frozen=True)
class CompleteConfig:
    """Switches of a completion.

    Attributes:
        library: The classes that there are; those that ship by default.
        fit: Registration of a primitive.
        deform: Deformation of the fit.
        rival_share: A class whose score is at least this share of the best class's is fitted too, and the better fit
            decides. Where none of them fits well, less likely ones are tried.
        subcategories: Fit the subcategories of each such class as well.
        optional_parts: "card" keeps a part as the card of its class says; "seen" leaves out every part that no point
            supports, "always" none.
        unknown_above: Probability of being of no class from which on the class-free completion answers; 1 for never.
            Where the look alone tells it, and nothing hides an end of the object, 0.8 is enough, whatever is asked
            for below 1. Nobody asks it of what a LiDAR saw.
        fall_back: Check what is returned against the points, the free space and their reach: what fails gives way to
            the class-free completion, and that to the hull of the points.
        collision: Budget of the convex parts, which are made at first access.
    """

    library: PrimitiveLibrary = field(default_factory=PrimitiveLibrary.shipped)
    fit: FitConfig = field(default_factory=FitConfig)
    deform: DeformConfig = field(default_factory=DeformConfig)
    rival_share: float = 0.1
    subcategories: bool = True
    optional_parts: str = "card"
    unknown_above: float = 0.9
    fall_back: bool = True
    collision: CollisionConfig = field(default_factory=CollisionConfig)

    def __post_init__(self) -> None:
        if not isinstance(self.library, PrimitiveLibrary):
            raise InvalidOption(f"library is a {type(self.library).__name__}; a PrimitiveLibrary is expected")
        if not 0 < self.rival_share <= 1:
            raise InvalidOption(f"rival_share is {self.rival_share}; a number in (0, 1] is expected")
        if not 0 <= self.unknown_above <= 1:
            raise InvalidOption(f"unknown_above is {self.unknown_above}; a probability, 0 to 1, is expected")
        if self.optional_parts not in ("card", *KEEP_RULES):
            legal = ", ".join(("card", *KEEP_RULES))
            raise InvalidOption(f"optional_parts is {self.optional_parts!r}; one of {legal} is expected")


class Clock:
    """Seconds by stage.

    Args:
        laps: Seconds of the stages before.
    """

    def __init__(self, laps: dict[str, float]) -> None:
        self.laps = dict(laps)
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Count the time since the last lap for a stage."""
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now


def answer(view: LevelView, detection: Detection, config: CompleteConfig, clock: Clock) -> CompletedShape:
    """Complete an object in its level frame.

    Args:
        view: What was seen of it.
        detection: The same, with its class or its scores, and what one look at it proposes.
        config: Switches.
        clock: Told the time of every stage.

    Raises:
        FitDiverged: No primitive could be fitted, where config says not to fall back.
    """
    doubts = []
    # The models of openset learnt from things on tables.
    of_traffic = detection.sensor.of_traffic
    asked = not class_is_given(detection) and config.unknown_above < 1 and not of_traffic
    look = evidence_of_look(detection, config.library) if asked else np.empty(0)
    unknown = probability_by_look(look) if asked else 0.0
    is_unknown = asked and is_unknown_by_look(unknown, config.unknown_above, lambda: is_cut_off(view))
    if not is_unknown:
        try:
            shape = by_class(view, detection, config, clock, unlikely=unknown < _DOUBTFUL)
        except FitDiverged as error:
            if not config.fall_back:
                raise
            doubts.append(str(error))
        else:
            if not asked and not config.fall_back:
                return shape
            misfit = misfit_of(shape.mesh, view)
            if asked:
                assert shape.fit is not None
                unknown = probability_unknown(look, evidence_of_fit(shape.fit, misfit))
                is_unknown = unknown >= config.unknown_above
            doubts += misfit.faults(of_traffic=of_traffic, unknown=unknown) if config.fall_back else []
            clock.lap("check")
            if not doubts and not is_unknown:
                return shape
    if is_unknown:
        doubts.insert(0, f"it is of no class with a probability of {unknown:.2f}")
    shape = _without_class(view, clock)
    return replace(shape, note="; ".join(filter(None, (*doubts, shape.note))))


def by_class(
    view: LevelView, detection: Detection, config: CompleteConfig, clock: Clock, *, unlikely: bool = True
) -> CompletedShape:
    """The primitive that fits best, deformed, in the level frame; whatever its fit says.

    Args:
        view: As in `answer`.
        detection: Likewise.
        config: Likewise.
        clock: Likewise.
        unlikely: Fit primitives of unlikely classes as well where none of the likely ones fits.

    Raises:
        FitDiverged: No primitive could be fitted.
    """
    fit = fit_likeliest(
        view,
        detection,
        config.library,
        config=config.fit,
        rival_share=config.rival_share,
        subcategories=config.subcategories,
        unlikely=unlikely,
    )
    fit = _with_parts_seen(fit, view, config.optional_parts)
    clock.lap("register")
    deformed = deform(fit, view, config=config.deform)
    if deformed.kept < 1 or config.deform.method == "none":
        solid = _solid(fit)  # a fit that crosses itself is a rare thing, and to know it takes time
        if solid is not fit:
            fit, deformed = solid, deform(solid, view, config=config.deform)
    clock.lap("deform")
    faces = fit.primitive.faces
    observed, sigma_m = mark_observed(
        deformed.vertices, faces, view.cloud, sensor_sigma_m=view.sigma_m, sigma_m=deformed.sigma_m
    )
    if fit.spread_m is not None:
        sigma_m = np.hypot(sigma_m, fit.spread_m)
    clock.lap("mark")
    mesh = trimesh.Trimesh(deformed.vertices, faces.copy(), process=False)
    return CompletedShape(mesh, observed, sigma_m, fit, made_by="primitive")


def _without_class(view: LevelView, clock: Clock) -> CompletedShape:
    """The class-free completion, or where it does not hold the hull of the points, whose note says why."""
    from gfp_grasp.classfree import complete_level  # torch is loaded where it is needed only

    try:
        shape = complete_level(view)
    except NoSurface as error:
        faults = [str(error)]
    else:
        faults = misfit_of(shape.mesh, view).faults()
    if faults:
        shape = replace(complete_hull(view), note=f"nor does the class-free completion hold: {'; '.join(faults)}")
    clock.lap("classfree")
    return shape


def _with_parts_seen(fit: FittedPrimitive, view: LevelView, rule: str) -> FittedPrimitive:
    """The fit without the optional parts that are to be seen and are not; the modes hold for the body that is left."""
    missing = [
        part.name
        for part in fit.primitive.spec.optional_parts
        if (part.keep if rule == "card" else rule) == "seen" and not part_is_seen(fit, part.name, view)
    ]
    body = fit.primitive.without(missing)
    if body is None or body is fit.primitive:
        return fit
    spread_m = fit.spread_m
    if spread_m is not None:  # of the nearest vertex of the whole
        spread_m = spread_m[KDTree(fit.primitive.vertices).query(body.vertices)[1]]
    return replace(fit, primitive=body, spread_m=spread_m)


def _solid(fit: FittedPrimitive) -> FittedPrimitive:
    """The fit with its modes drawn back towards the mean until its surface does not cross itself."""
    primitive, coefficients = fit.primitive, fit.coefficients
    for attempt in range(12):
        if len(crossing_faces(primitive.shape(coefficients, fit.scale), primitive.faces)) == 0:
            return fit if attempt == 0 else replace(fit, coefficients=coefficients)
        coefficients = 0.75 * coefficients
    return replace(fit, coefficients=np.zeros_like(coefficients))
