"""The library call: a partial cloud in, a watertight mesh and its convex parts out, in the same frame, in metres."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.arguments import checked_direction, checked_height, checked_place
from gfp_grasp.clouds import order_points
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.completion import Completion
from gfp_grasp.deform import DeformConfig, deform
from gfp_grasp.detect import Detector, clean_cloud, detect_single, get_detector
from gfp_grasp.errors import FitDiverged, InvalidOption, InvalidView, UnknownCategory
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.observation import (
    canonical_frame,
    level_frame,
    mark_observed,
    move_detection,
    move_view,
)
from gfp_grasp.parallel import one_thread
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import Evidence, FitConfig, fit_best, gather_evidence, part_is_seen
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import (
    KEEP_RULES,
    CompletedShape,
    DepthImage,
    Detection,
    FittedPrimitive,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

# Below this the best class is an opinion, not a finding: of held-out objects of the classes 2 % are below it, and real
# boxes, cans, bowls and plates are.
_SURE_SCORE = 0.8


@dataclass(frozen=True)
class CompleteConfig:
    """Switches of a completion.

    Attributes:
        library: The classes that there are; those that ship by default.
        fit: Registration of a primitive.
        deform: Deformation of the fit.
        rival_share: A class whose score is at least this share of the best class's is fitted too, and the better fit
            decides.
        subcategories: Fit the subcategories of each such class as well.
        optional_parts: "card" keeps a part as the card of its class says; "seen" leaves out every part that no point
            supports, "always" none.
        collision: Budget of the convex parts, which are made at first access.
    """

    library: PrimitiveLibrary = field(default_factory=PrimitiveLibrary.shipped)
    fit: FitConfig = field(default_factory=FitConfig)
    deform: DeformConfig = field(default_factory=DeformConfig)
    rival_share: float = 0.05
    subcategories: bool = True
    optional_parts: str = "card"
    collision: CollisionConfig = field(default_factory=CollisionConfig)

    def __post_init__(self) -> None:
        if not isinstance(self.library, PrimitiveLibrary):
            raise InvalidOption(f"library is a {type(self.library).__name__}; a PrimitiveLibrary is expected")
        if not 0 < self.rival_share <= 1:
            raise InvalidOption(f"rival_share is {self.rival_share}; a number in (0, 1] is expected")
        if self.optional_parts not in ("card", *KEEP_RULES):
            legal = ", ".join(("card", *KEEP_RULES))
            raise InvalidOption(f"optional_parts is {self.optional_parts!r}; one of {legal} is expected")


@one_thread()
def complete_to_mesh(
    cloud: object,
    *,
    viewpoint: ArrayLike | None = None,
    up: ArrayLike | None = (0.0, 0.0, 1.0),
    support_height: float | None = None,
    view: DepthImage | None = None,
    mask: np.ndarray | None = None,
    category: str | None = None,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> Completion:
    """Complete one object that was seen from one side.

    Args:
        cloud: (n, 3) array-like, m; also a trimesh or Open3D point cloud, or a torch tensor. Non-finite rows are
            dropped and counted in a warning, copies of a point count once.
        viewpoint: (3,) m, where the camera stood, same frame. Without it normals have no sign and nothing is known of
            free space, and the answer is less sure.
        up: (3,) normal of the support; None estimates it, from the plane under the object or else from the axes of
            the camera, and `completion.detection.up` reports the choice.
        support_height: Height of the support along up, m; None estimates it.
        view: The whole depth picture, for the space that it saw to be free.
        mask: (h, w) bool, the object's pixels in the view.
        category: A class with a primitive; None lets the classifier and the fits choose.
        config: Switches.
        seed: Of every random choice; the same seed gives the same answer, whatever the order of the points.

    Returns:
        The completion, in the frame of the cloud, m.

    Raises:
        InvalidCloud: Not an (n, 3) cloud in metres, or degenerate; viewpoint or up is no place or direction.
        TooFewPoints: Too few finite points.
        NothingDetected: Nothing stands above the support.
        InvalidView: View, mask and cloud do not fit each other.
        InvalidOption: Height, seed or config of the wrong type.
        UnknownCategory: No primitive of that class; the message lists those on offer.
        FitDiverged: No primitive could be fitted.
    """
    _check_options(config, seed)
    _check_category(category, config)
    if view is not None and not isinstance(view, DepthImage):
        raise InvalidView(f"view is a {type(view).__name__}; a gfp_grasp.types.DepthImage is expected")
    place, direction = checked_place(viewpoint), checked_direction(up)
    height = checked_height(support_height)
    start = time.perf_counter()
    points = order_points(clean_cloud(cloud), seed=seed)
    detection = _detect(points, place, direction, height, view, mask, category)
    completion = complete_detection(detection, config=config, seed=seed)
    timings = {"detect": time.perf_counter() - start - sum(completion.timings_s.values()), **completion.timings_s}
    return replace(completion, shape=replace(completion.shape, timings_s=timings))


@one_thread()
def complete_scene(
    image: DepthImage,
    *,
    up: ArrayLike | None = (0.0, 0.0, 1.0),
    detector: str | Detector = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> tuple[Completion, ...]:
    """Complete every object of a depth picture, largest first.

    Args:
        image: Depth, m, with intrinsics and pose.
        up: (3,) normal of the support in the world frame; None estimates it.
        detector: Name of a detector, see `gfp_grasp.detect.get_detector`, or a function like `detect_objects`.
        config: Switches.
        seed: Of every random choice.

    Returns:
        One completion an object; an object that no primitive fits is left out with a warning.

    Raises:
        NothingDetected: No object stands out from the support.
        FitDiverged: No primitive fits any object.
        InvalidView: Not a DepthImage.
        UnknownDetector: No detector of that name.
    """
    _check_options(config, seed)
    if not isinstance(image, DepthImage):
        raise InvalidView(f"image is a {type(image).__name__}; a gfp_grasp.types.DepthImage is expected")
    done, failure = [], None
    detect = get_detector(detector) if isinstance(detector, str) else detector
    for detection in detect(image, up=checked_direction(up)):
        try:
            done.append(complete_detection(detection, config=config, seed=seed))
        except FitDiverged as error:
            warnings.warn(f"an object was left out: {error}", stacklevel=2)
            failure = error
    if failure is not None and not done:
        raise FitDiverged(f"no object of the picture could be completed; the last: {failure}")
    return tuple(done)


@one_thread()
def complete_detection(detection: Detection, *, config: CompleteConfig | None = None, seed: int = 0) -> Completion:
    """Complete a detected object: registration of the likely classes, choice, deformation.

    Args:
        detection: One object, world frame.
        config: Switches.
        seed: Of every random choice.

    Raises:
        TooFewPoints: Too few points.
        FitDiverged: No primitive could be fitted.
    """
    config = config or CompleteConfig()
    if not detection.scores and not detection.category:
        detection = _classified(detection)
    if _sureness(detection.scores, config.library) < _SURE_SCORE:
        scores = ", ".join(f"{name} {score:.2f}" for name, score in detection.scores.items())
        warnings.warn(f"no known class is likely ({scores}); the best is completed all the same", stacklevel=2)
    return _complete(detection, config, seed)


def _detect(
    points: np.ndarray,
    viewpoint: np.ndarray | None,
    up: np.ndarray | None,
    support_height: float | None,
    view: DepthImage | None,
    mask: np.ndarray | None,
    category: str | None,
) -> Detection:
    """The object of the points, looked for in their level frame, where grids do not depend on the caller's axes."""
    if viewpoint is None and view is not None:
        viewpoint = view.T_world_camera[:3, 3]
    if up is None:
        return detect_single(
            points, viewpoint=viewpoint, up=None, support_height=support_height, view=view, mask=mask, category=category
        )
    T_world_level = level_frame(points, up, viewpoint)
    T_level_world = invert_T(T_world_level)
    found = detect_single(
        order_points(apply_T(T_level_world, points)),
        viewpoint=None if viewpoint is None else apply_T(T_level_world, viewpoint),
        support_height=None if support_height is None else support_height - float(up @ T_world_level[:3, 3]),
        view=None if view is None else move_view(view, T_level_world),
        mask=mask,
        category=category,
    )
    return replace(move_detection(found, T_world_level), view=view)


def _classified(detection: Detection) -> Detection:
    """The detection with the scores of the classes, which its detector did not give."""
    from gfp_grasp.detect import classify  # torch is loaded where it is needed only

    scores = classify(detection.cloud.points, detection.up, detection.support)
    return replace(detection, category=max(scores, key=lambda name: scores[name]), scores=scores)


def _sureness(scores: Mapping[str, float], library: PrimitiveLibrary) -> float:
    """Score of the best class, together with those it is easily taken for; 1 where no class was asked for."""
    together = [
        sum(scores.get(n, 0.0) for n in (name, *library.spec(name).alike)) for name in scores if name in library
    ]
    return max([*scores.values(), *together]) if scores else 1.0


def _complete(detection: Detection, config: CompleteConfig, seed: int) -> Completion:
    clock = _Clock()
    # Everything below runs in a frame tied to the object and the viewer, so that the answer moves with its input.
    detection_here, T_world_here = canonical_frame(detection, seed=seed)
    fit = _best_fit(detection_here, config)
    clock.lap("register")
    deformed = deform(fit, detection_here, config=config.deform)
    if deformed.kept < 1 or config.deform.method == "none":
        solid = _solid(fit)  # a fit that crosses itself is a rare thing, and to know it takes time
        if solid is not fit:
            fit, deformed = solid, deform(solid, detection_here, config=config.deform)
    clock.lap("deform")
    observed, sigma = mark_observed(deformed.vertices, fit.primitive.faces, detection_here, deformed.sigma_m)
    vertices = deformed.vertices @ T_world_here[:3, :3].T + T_world_here[:3, 3]
    mesh = trimesh.Trimesh(vertices, fit.primitive.faces.copy(), process=False)
    clock.lap("mark")
    shape = CompletedShape(
        mesh=mesh,
        observed=observed,
        sigma_m=sigma,
        fit=replace(fit, T_world_object=T_world_here @ fit.T_world_object),
        timings_s=clock.laps,
    )
    return Completion(shape, detection, collision_config=config.collision)


def _best_fit(detection: Detection, config: CompleteConfig) -> FittedPrimitive:
    evidence, library = gather_evidence(detection), config.library
    candidates = []
    for name in _candidates(detection.scores, detection.category, config):
        odds = -np.log(max(detection.scores.get(name, 1.0), 1e-6))
        primitives = library.members_of(name) if config.subcategories else (library.primitive(name),)
        candidates += [(primitive, odds + primitive.spec.cost) for primitive in primitives]
    fit = fit_best(evidence, candidates, config=config.fit)
    return _with_parts_seen(fit, evidence, config.optional_parts)


def _candidates(scores: Mapping[str, float], category: str, config: CompleteConfig) -> Sequence[str]:
    offered = {name: score for name, score in scores.items() if name in config.library.categories}
    if not offered:
        return [category]
    best = max(offered.values())
    return sorted((n for n, score in offered.items() if score >= config.rival_share * best), key=lambda n: -offered[n])


def _with_parts_seen(fit: FittedPrimitive, evidence: Evidence, rule: str) -> FittedPrimitive:
    """The fit without the optional parts that are to be seen and are not; the modes hold for the body that is left."""
    missing = [
        part.name
        for part in fit.primitive.spec.optional_parts
        if (part.keep if rule == "card" else rule) == "seen" and not part_is_seen(fit, part.name, evidence)
    ]
    body = fit.primitive.without(missing)
    return fit if body is None or body is fit.primitive else replace(fit, primitive=body)


def _solid(fit: FittedPrimitive) -> FittedPrimitive:
    """The fit with its modes drawn back towards the mean until its surface does not cross itself."""
    primitive, coefficients = fit.primitive, fit.coefficients
    for attempt in range(12):
        if len(crossing_faces(primitive.shape(coefficients, fit.scale), primitive.faces)) == 0:
            return fit if attempt == 0 else replace(fit, coefficients=coefficients)
        coefficients = 0.75 * coefficients
    return replace(fit, coefficients=np.zeros_like(coefficients))


def _check_category(category: str | None, config: CompleteConfig | None) -> None:
    known = (config or CompleteConfig()).library.categories
    if category is not None and category not in known:
        raise UnknownCategory(f"there is no primitive of {category!r}; there are {', '.join(known)}")


def _check_options(config: object, seed: object) -> None:
    if config is not None and not isinstance(config, CompleteConfig):
        raise InvalidOption(f"config is a {type(config).__name__}; a CompleteConfig is expected")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InvalidOption(f"seed is {seed!r}; a whole number from 0 on is expected")


class _Clock:
    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = now - self._last
        self._last = now


__all__ = ["CompleteConfig", "Completion", "complete_detection", "complete_scene", "complete_to_mesh"]
