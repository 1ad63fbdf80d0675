"""Deform one fitted primitive by the method of choice.

Displacements are spread over the mesh, and damped where the surface would fold, so that a solid stays one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import factorized
from scipy.spatial import KDTree

from gfp_grasp.deform.gfs import SnakeConfig, evolve
from gfp_grasp.deform.patches import Patches, blend, make_patches
from gfp_grasp.deform.standing import stood
from gfp_grasp.deform.template import TemplatePoints, patch_unit_m, template_points
from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import crossing_faces, graph_laplacian, neighbour_average, pairs_on_the_way, triangle_normals
from gfp_grasp.parallel import one_thread
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import FittedPrimitive, GenericPrimitive, LevelView

_STIFFNESS = 0.3
_HALVINGS = 5
# A face whose normal turns by more than this has folded over.
_FOLD_COSINE = 0.0
_LITTLE = 0.03  # share of an object's longest side


def diffuse(primitive: GenericPrimitive, displacement: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Spread displacements (v, 3) m over the mesh, by their confidence (v,), to vertices that have none.

    Minimises the confident misfit and the bending of the displacement: the sum of c (d - d0)^2 + s (L d)^2.

    Args:
        primitive: Whose connectivity is meant.
        displacement: (v, 3) m.
        confidence: (v,) from 0 to 1.

    Returns:
        (v, 3) m.
    """
    confidence = np.maximum(confidence, 1e-3)
    solve = _diffuser(primitive, confidence.tobytes())
    return np.column_stack([solve(confidence * column) for column in displacement.T])


@lru_cache(maxsize=32)
def _diffuser(primitive: GenericPrimitive, confidence_bytes: bytes) -> Callable[[np.ndarray], np.ndarray]:
    """The factorised system of one primitive and confidence: the default network's is the same for every fit."""
    confidence = np.frombuffer(confidence_bytes)
    L = graph_laplacian(primitive.faces, len(confidence))
    return factorized(sparse.csc_matrix(sparse.diags(confidence) + _STIFFNESS * (L.T @ L)))


def damp_until_solid(vertices: np.ndarray, faces: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, float]:
    """Move vertices as far as the surface neither folds nor crosses itself.

    The displacement is halved around the faces that fold or cross, and everywhere when that does not help.

    Args:
        vertices: (v, 3) m, of a mesh that does not cross itself.
        faces: (f, 3).
        displacement: (v, 3) m.

    Returns:
        (v, 3) m moved vertices, and the smallest share of its displacement that a vertex kept.
    """
    share = np.ones(len(vertices))
    average = _cached_average(faces.tobytes(), len(faces), len(vertices))
    changed = pairs = None
    for _ in range(_HALVINGS):
        moved = vertices + share[:, None] * displacement
        bad = _bad_faces(vertices, moved, faces, changed, pairs)
        if len(bad) == 0:
            return moved, float(share.min())
        if pairs is None:  # mostly the first look is the last
            pairs = pairs_on_the_way(vertices, vertices + displacement, faces)
        near = np.zeros(len(vertices))
        near[faces[bad].ravel()] = 1.0
        for _ in range(3):  # the damping fades out over three rings: an edge of its own would fold the surface
            near = np.maximum(near, 0.7 * (average @ near))
        share *= 1.0 - 0.5 * np.minimum(near, 1.0)
        changed = (near > 0)[faces].any(axis=1)  # the others were good, and stay so among themselves
    for factor in (0.5, 0.25, 0.1, 0.0):
        moved = vertices + factor * share[:, None] * displacement
        if len(_bad_faces(vertices, moved, faces, None, pairs)) == 0:
            return moved, float(factor * share.min())
    return vertices.copy(), 0.0


def _bad_faces(
    before: np.ndarray, after: np.ndarray, faces: np.ndarray, changed: np.ndarray | None, pairs: np.ndarray | None
) -> np.ndarray:
    """Faces that fold, and those that cross others; only the `changed` (f,) bool and the `pairs` (p, 2) can cross."""
    old, new = triangle_normals(before[faces]), triangle_normals(after[faces])
    scale = np.linalg.norm(old, axis=1) * np.linalg.norm(new, axis=1) + 1e-30
    folded = np.flatnonzero(np.einsum("fi,fi->f", old, new) / scale < _FOLD_COSINE)
    return np.union1d(folded, crossing_faces(after, faces, among=changed, pairs=pairs).ravel()).astype(np.int64)


@lru_cache(maxsize=32)
def _cached_average(face_bytes: bytes, num_faces: int, num_vertices: int) -> sparse.csr_matrix:
    faces = np.frombuffer(face_bytes, dtype=np.int64).reshape(num_faces, 3)
    return neighbour_average(faces, num_vertices)


# The longest offset of a single point that is believed, in units of `patch_unit_m`: 2 mm on a cup. On the validation
# split most offsets are shorter; longer ones, on shapes unlike those learnt, lose more than they win.
_FARTHEST = 1 / 15

Method = Literal["gfpnet", "gfpnet-paper", "gfpnet-oneshot", "gfs", "none"]
METHODS: tuple[Method, ...] = get_args(Method)


@dataclass(frozen=True)
class DeformConfig:
    """How a fit is deformed.

    Attributes:
        method: "gfpnet" (per-point decoder), "gfpnet-paper" (iterative), "gfpnet-oneshot", "gfs" (active contour) or
            "none".
        symmetry: Observed points are mirrored to the hidden side.
        iterations: How often gfpnet-paper loops its answer back; None is the paper's five.
        snake: Energies of gfs.
    """

    method: Method = "gfpnet"
    symmetry: bool = True
    iterations: int | None = None
    snake: SnakeConfig = field(default_factory=SnakeConfig)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InvalidOption(f"deformation method is {self.method!r}; one of {METHODS} is expected")
        if self.iterations is not None and self.iterations < 1:
            raise InvalidOption(f"iterations is {self.iterations}; at least 1 is expected")


@dataclass(frozen=True, eq=False)
class Deformed:
    """A deformed primitive.

    Attributes:
        vertices: (v, 3) m, in the frame of the view; the primitive's connectivity, not folded, not crossing itself.
        sigma_m: (v,) standard deviation of the surface's position, m; NaN where the method does not tell.
        kept: Smallest share of its displacement that a vertex kept when the surface was held free of folds.
    """

    vertices: np.ndarray
    sigma_m: np.ndarray
    kept: float


def deform(fit: FittedPrimitive, view: LevelView, *, config: DeformConfig = DeformConfig()) -> Deformed:
    """Deform a fitted primitive onto the observation.

    Args:
        fit: Registered primitive whose own surface does not cross itself.
        view: The observation, in the frame of the fit.
        config: Method and its switches.

    Returns:
        The deformed vertices in that frame.
    """
    vertices, faces = fit.primitive.shape(fit.coefficients, fit.scale), fit.primitive.faces
    if config.method == "none":
        placed, unknown = fit.vertices_world(), np.full(len(vertices), np.nan)
        moved, kept = damp_until_solid(placed, faces, stood(placed, faces, view) - placed)
        return Deformed(moved, unknown, kept)
    # The paper knows of no symmetry.
    symmetry = config.symmetry and config.method not in ("gfpnet-paper", "gfpnet-oneshot")
    template = template_points(fit, view, symmetry=symmetry)
    if config.method == "gfs":
        displacement, sigma_m = _by_contour(fit, vertices, template, config.snake), np.full(len(vertices), np.nan)
    else:
        viewpoint = None if view.viewpoint is None else apply_T(invert_T(fit.T_world_object), view.viewpoint)
        patches = make_patches(fit.primitive, vertices, template, viewpoint)
        told = _by_points(fit, patches) if config.method == "gfpnet" else _by_sets(fit, patches, config)
        displacement, sigma_m = told
    T = fit.T_world_object
    placed = apply_T(T, vertices + displacement)
    displacement = displacement + (stood(placed, faces, view) - placed) @ T[:3, :3]
    moved, kept = damp_until_solid(vertices, faces, displacement)
    moved = apply_T(T, moved)
    if kept < 1 and view.sensor.step_rad:
        moved = _stood_again(moved, faces, view)
    return Deformed(moved, sigma_m, kept)


def _stood_again(vertices: np.ndarray, faces: np.ndarray, view: LevelView) -> np.ndarray:
    """Vertices (v, 3) m brought down to the road by what the damping took of it, where that is little for their size.

    A vehicle whose wheels are a few centimetres above the road drops and rolls in a simulator.
    """
    missing = stood(vertices, faces, view) - vertices
    if np.abs(missing).max() > _LITTLE * np.ptp(vertices, axis=0).max():
        return vertices
    return damp_until_solid(vertices, faces, missing)[0]


def _by_contour(fit: FittedPrimitive, vertices: np.ndarray, template: TemplatePoints, snake: SnakeConfig) -> np.ndarray:
    """Displacement (v, 3) m by the active contour."""
    unit_m = patch_unit_m(fit.primitive)
    drawn = evolve(vertices, fit.primitive.faces, template.points, template.normals, unit_m=unit_m, config=snake)
    return drawn - vertices


def _by_points(fit: FittedPrimitive, patches: Patches) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (v, 3) m and sigma (v,) m by the network that answers for each point.

    A primitive on which the network gains nothing stays as it was fitted; it is told its sigma all the same.
    """
    from gfp_grasp.deform.weights import pays_on  # torch is loaded where it is needed only

    offsets, log_sigma, field = _per_point(patches, fit)
    sigma_m = _blend_sigma(patches, log_sigma, len(field))
    if not pays_on(fit.primitive.name):
        return np.zeros_like(field), sigma_m
    displacement, weight = blend(patches, offsets, len(field))
    return diffuse(fit.primitive, displacement + field, np.minimum(weight, 1.0)), sigma_m


def _by_sets(fit: FittedPrimitive, patches: Patches, config: DeformConfig) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (v, 3) m by one of the paper's networks, which does not tell sigma (v,): NaN."""
    num_vertices = len(fit.primitive.vertices)
    sigma_m, patches = np.full(num_vertices, np.nan), patches.seeing()
    if len(patches.index) == 0:
        return np.zeros((num_vertices, 3)), sigma_m
    offsets = _offsets_to(_predicted_sets(patches, config), patches.source)
    displacement, weight = blend(patches, offsets, num_vertices)
    return diffuse(fit.primitive, displacement, np.minimum(weight, 1.0)), sigma_m


def _per_point(patches: Patches, fit: FittedPrimitive) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets (b, n, 3) in patch units, log sigma (b, n), and the displacement (v, 3) m by the change of the fit."""
    import torch

    from gfp_grasp.deform.gfpnet import BELIEF, change_field, fit_features
    from gfp_grasp.deform.weights import load_network

    features = torch.tensor(fit_features(fit)[None], dtype=torch.float32)
    with one_thread(), torch.inference_mode():
        answer = load_network("patch")(*(part[None] for part in patch_tensors(patches)), features)
        field = BELIEF * change_field(fit, patches, answer)
    offset = BELIEF * answer.offset[0].double().numpy()
    length = np.linalg.norm(offset, axis=2, keepdims=True)
    offset = offset * np.minimum(1.0, _FARTHEST / np.maximum(length, 1e-12))
    return offset, answer.log_sigma[0].double().numpy(), field


def _predicted_sets(patches: Patches, config: DeformConfig) -> np.ndarray:
    """The point sets MS (b, n, 3) that one of the paper's networks predicts, patch units."""
    import torch

    from gfp_grasp.deform.weights import load_network

    network = load_network("paper-iterative" if config.method == "gfpnet-paper" else "paper-oneshot")
    source, _, template, *_ = patch_tensors(patches)
    iterations = config.iterations if config.method == "gfpnet-paper" else None
    with one_thread(), torch.inference_mode():
        return network(source, template, iterations=iterations).double().numpy()


def patch_tensors(patches: Patches):
    """Float32 tensors (source, source_normals, template, template_normals, mirrored, residuals, pose_features)."""
    import torch

    p = patches
    arrays = (
        p.source,
        p.source_normals,
        p.template,
        p.template_normals,
        p.mirrored,
        p.residuals,
        p.pose_features,
    )
    return tuple(torch.tensor(a, dtype=torch.float32) for a in arrays)


def _offsets_to(predicted: np.ndarray, sources: np.ndarray, *, neighbours: int = 8) -> np.ndarray:
    """Offsets (b, n, 3) that lead each S (b, n, 3) to its predicted set (b, n, 3), smoothed over neighbours of S.

    The rows of the set have no tie to the rows of S (see gfpnet.py), so each point takes its nearest, and the mean
    over its neighbourhood keeps the surface from tearing.
    """
    offsets = np.empty_like(sources)
    for i, (source, points) in enumerate(zip(sources, predicted, strict=True)):
        nearest = points[KDTree(points).query(source)[1]] - source
        around = KDTree(source).query(source, k=min(neighbours, len(source)))[1]
        offsets[i] = nearest[around].mean(axis=1)
    return offsets


def _blend_sigma(patches: Patches, log_sigma: np.ndarray, num_vertices: int) -> np.ndarray:
    """Weighted mean (v,) m of what overlapping patches say in logarithms; NaN where no patch reaches."""
    flat = patches.index.ravel()
    total = np.bincount(flat, patches.weights.ravel(), minlength=num_vertices)
    mean = np.bincount(flat, (patches.weights * log_sigma).ravel(), minlength=num_vertices)
    return np.where(total > 1e-6, np.exp(mean / np.maximum(total, 1e-9)) * patches.unit_m, np.nan)
