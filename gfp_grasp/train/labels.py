"""Labels for GFPNet: where each vertex of a fitted primitive belongs on the true surface.

The label of a fit is the fit drawn onto the whole true surface by the active contour (GFS), stiff first, then soft.
Labels that fold or stay off the surface are dropped and counted. Half of the fits have few modes to use: such a fit is
as far off as a fit to an object that its class does not foresee, which is where a deformation is needed most. Half do
not know where the support is.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.deform import SnakeConfig, TemplatePoints, evolve, patch_unit_m, template_points
from gfp_grasp.errors import FitDiverged, TooFewPoints
from gfp_grasp.journal import write_arrays
from gfp_grasp.level import make_level_view
from gfp_grasp.meshes import crossing_faces, sample_surface, vertex_normals
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, fit_best, part_is_seen
from gfp_grasp.train.views import View, cached_views
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import GenericPrimitive

MOST_RESIDUAL = 1 / 15  # of a label that is kept, patch units: 2 mm on a cup
_ALL = 1000
_MODES = (_ALL, _ALL, 8, 3)  # that a label's fit may use, drawn by view
_STAGES = (
    SnakeConfig(steps=10, elastic=1.0, bending=4.0, reach=1.0, smooth=3),
    SnakeConfig(steps=10, elastic=0.3, bending=1.0, reach=0.5, smooth=3),
    SnakeConfig(steps=8, elastic=0.05, bending=0.1, reach=4 / 15, smooth=3),
)


@dataclass(frozen=True, eq=False)
class Label:
    """One fitted view with its label, in the primitive's own frame (rigid, metric).

    Attributes:
        primitive: Name of the primitive.
        without: Optional parts that the fit lacks.
        vertices: (v, 3) m, the fit.
        target: (v, 3) m, where the vertices belong.
        template: Observed and mirrored points.
        viewpoint: (3,) m, where the camera stood.
        coefficients: (k,) of the fit's modes.
        scale: (3,) of the fit.
    """

    primitive: str
    without: tuple[str, ...]
    vertices: np.ndarray
    target: np.ndarray
    template: TemplatePoints
    viewpoint: np.ndarray
    coefficients: np.ndarray
    scale: np.ndarray


def make_labels(
    family: str,
    split: str,
    *,
    library: PrimitiveLibrary | None = None,
    num_views: int = 4,
    limit: int | None = None,
    runs: Path = Path("runs"),
    fit: FitConfig = FitConfig(),
    data: Path | None = None,
    workers: int = 1,
    progress=None,
) -> tuple[list[Label], dict[str, int]]:
    """Labels of the cached views of one split, and how many were kept and dropped for which reason."""
    views = cached_views(
        family, split, num_views=num_views, limit=limit, folder=runs / "views", workers=workers, data=data
    )
    make = partial(_cached_label, folder=runs / "labels", fit=fit, library=library or PrimitiveLibrary.shipped())
    answers = pmap(make, views, workers=workers, progress=progress)
    counts: dict[str, int] = {}
    for _, verdict in answers:
        counts[verdict] = counts.get(verdict, 0) + 1
    return [label for label, _ in answers if label is not None], counts


def draw_onto(
    primitive: GenericPrimitive, vertices: np.ndarray, truth_points: np.ndarray, truth_normals: np.ndarray
) -> tuple[np.ndarray, float]:
    """Draw a fitted primitive onto a whole true surface by the active contour.

    Args:
        primitive: What was fitted.
        vertices: (v, 3) m, the fit.
        truth_points: (n, 3) m, dense samples in the same frame.
        truth_normals: (n, 3) unit, outward.

    Returns:
        (v, 3) m label and its mean distance m to the surface.
    """
    unit_m, moved = patch_unit_m(primitive), vertices
    for stage in _STAGES:
        moved = evolve(moved, primitive.faces, truth_points, truth_normals, unit_m=unit_m, config=stage)
    normals = vertex_normals(moved, primitive.faces)
    distance, nearest = KDTree(truth_points).query(moved, k=8)
    agrees = np.einsum("vi,vki->vk", normals, truth_normals[nearest]) > 0.5
    far_m = 2 * MOST_RESIDUAL * unit_m
    return moved, float(np.where(agrees, distance, far_m).min(axis=1).mean())


def _cached_label(view: View, *, folder: Path, fit: FitConfig, library: PrimitiveLibrary) -> tuple[Label | None, str]:
    draw = int(hashlib.sha256(view.points.tobytes()).hexdigest(), 16)
    num_modes, support = _MODES[draw % len(_MODES)], draw // len(_MODES) % 2 == 0
    content = view.points.tobytes() + repr((fit, num_modes, support)).encode() + _card_id(library, view.family)
    key = hashlib.sha256(content).hexdigest()[:20]
    path = folder / view.family / f"{key}.npz"
    if path.is_file():
        with np.load(path) as s:
            if str(s["verdict"]) != "kept":
                return None, str(s["verdict"])
            template = TemplatePoints(s["points"].astype(float), s["normals"].astype(float), s["mirrored"])
            vertices, target, *rest = (
                s[name].astype(float) for name in ("vertices", "target", "viewpoint", "coefficients", "scale")
            )
            without = tuple(str(part) for part in s["without"])
            return Label(str(s["primitive"]), without, vertices, target, template, *rest), "kept"
    label, verdict = _label(view, fit, num_modes, support=support, library=library)
    if label is None:
        write_arrays(path, verdict=verdict)
    else:
        write_arrays(
            path,
            verdict=verdict,
            primitive=label.primitive,
            without=np.array(label.without, dtype=str),
            vertices=label.vertices.astype(np.float32),
            target=label.target.astype(np.float32),
            points=label.template.points.astype(np.float32),
            normals=label.template.normals.astype(np.float32),
            mirrored=label.template.mirrored,
            viewpoint=label.viewpoint,
            coefficients=label.coefficients,
            scale=label.scale,
        )
    return label, verdict


def _label(
    view: View, config: FitConfig, num_modes: int, *, support: bool, library: PrimitiveLibrary
) -> tuple[Label | None, str]:
    try:
        level = make_level_view(view.detection(support=support))
        # How it rests is given: a fit that stands on its head has no label.
        candidates = [(primitive, 0.0) for primitive in _primitives_of(library, view.family, num_modes)]
        fit = fit_best(level, candidates, config=replace(config, hypotheses=(view.resting,)))
    except (FitDiverged, TooFewPoints):
        return None, "not fitted"
    parts = fit.primitive.spec.optional_parts
    without = tuple(part.name for part in parts if not part_is_seen(fit, part.name, level))
    body = fit.primitive.without(without)
    fit, without = (fit, ()) if body is None else (replace(fit, primitive=body), without)
    mesh = view.source.load_mesh()
    points, normals, _ = sample_surface(mesh, 12000, np.random.default_rng(view.seed))
    T_object_world = invert_T(level.T_world_level @ fit.T_world_object)
    T = T_object_world @ view.T_world_object
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    target, residual = draw_onto(fit.primitive, vertices, apply_T(T, points), normals @ T[:3, :3].T)
    if residual > MOST_RESIDUAL * patch_unit_m(fit.primitive):
        return None, "residual"
    if len(crossing_faces(target, fit.primitive.faces)) > 0.01 * len(target):
        return None, "folded"
    viewpoint = apply_T(T_object_world, view.viewpoint)
    template = template_points(fit, level)
    name, coefficients = fit.primitive.name, fit.coefficients
    return Label(name, without, vertices, target, template, viewpoint, coefficients, fit.scale), "kept"


@lru_cache(maxsize=32)
def _primitives_of(library: PrimitiveLibrary, category: str, num_modes: int) -> tuple[GenericPrimitive, ...]:
    """The primitives of a class and its subcategories with their first modes only, and so their variants."""

    def shortened(primitive: GenericPrimitive) -> GenericPrimitive:
        samples, count = primitive.coefficient_samples, min(num_modes, len(primitive.modes))
        return replace(
            primitive,
            modes=primitive.modes[:count],
            explained=primitive.explained[:count],
            coefficient_samples=np.hstack([samples[:, :count], samples[:, -3:]]),
            variants=tuple(replace(v, primitive=shortened(v.primitive)) for v in primitive.variants),
        )

    return tuple(shortened(primitive) for primitive in library.members_of(category))


def _card_id(library: PrimitiveLibrary, category: str) -> bytes:
    members = library.members_of(category)
    return "".join(str(primitive.card.get("shape_sha256", "")) for primitive in members).encode()
