"""Building the Generic Primitive of a class from any set of its meshes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.errors import BuildFailed, GfpGraspError, InvalidOption
from gfp_grasp.meshes import check_mesh, crossing_faces, make_solid, triangle_normals, vertex_normals
from gfp_grasp.parallel import Progress
from gfp_grasp.primitives.correspondence import Correspondence, CorrespondenceConfig, TemplateFitter
from gfp_grasp.primitives.mls import project
from gfp_grasp.primitives.pose import bring_into_one_pose, stand_up
from gfp_grasp.primitives.procrustes import ShapeModel, choose_template, generalized, shape_model
from gfp_grasp.primitives.regions import detect_symmetry, label_regions, without_part
from gfp_grasp.primitives.remesh import RemeshConfig, remesh
from gfp_grasp.primitives.resample import ResampleConfig, resample
from gfp_grasp.primitives.surface import untangle
from gfp_grasp.types import BODY_REGIONS, GenericPrimitive, Variant

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class BuildConfig:
    """How a primitive is built.

    Attributes:
        orientation: What is known of the meshes: "placed" (upright, axis through x = y = 0, handle towards +x),
            "upright" (z is up, any yaw and place), or "any".
        rounds: Fits of all members; after each one the template is the mean of what fitted.
        variance: Share of the variance that the modes keep.
        max_modes: At most so many modes.
        smoothing: Width of the MLS kernel, in mean edge lengths of the template.
        max_residual: Members farther than this from the bent template are dropped; share of their diagonal.
        min_covered: Members that fewer of the template's vertices find are dropped.
        max_flipped: Members on which more faces turn inside out are dropped.
        min_members: Fewer than this in the end is a failure.
        symmetry_share: Share of the members that must have a symmetry for the class to have it.
        optional_parts: Whether some members lack a part that stands out, a handle: bodies without it are made too.
        parts: Whether the mean is decomposed into convex parts.
        licence: Licence of the meshes, for the card.
    """

    orientation: Literal["placed", "upright", "any"] = "placed"
    rounds: int = 2
    variance: float = 0.99
    max_modes: int = 24
    smoothing: float = 0.75
    max_residual: float = 0.015
    min_covered: float = 0.93
    max_flipped: float = 0.03
    min_members: int = 5
    symmetry_share: float = 0.9
    optional_parts: bool = True
    parts: bool = True
    licence: str = ""
    correspondence: CorrespondenceConfig = field(default_factory=CorrespondenceConfig)
    remesh: RemeshConfig = field(default_factory=lambda: RemeshConfig(min_edge=0.015, max_edge=0.05))
    resample: ResampleConfig = field(default_factory=ResampleConfig)

    def __post_init__(self) -> None:
        if self.orientation not in ("placed", "upright", "any"):
            raise InvalidOption(f"orientation is {self.orientation!r}: choose 'placed', 'upright' or 'any'")
        if self.rounds < 1 or not 0 < self.variance <= 1 or self.max_modes < 1 or self.min_members < 2:
            raise InvalidOption(
                f"{self}: rounds >= 1, 0 < variance <= 1, max_modes >= 1, min_members >= 2 are expected"
            )


def build_primitive(
    meshes: Sequence[trimesh.Trimesh],
    category: str,
    *,
    config: BuildConfig = BuildConfig(),
    seed: int = 0,
    progress: Progress | None = None,
) -> GenericPrimitive:
    """Mean, modes, scales, regions, symmetry and parts of a class, from meshes that need not share their vertex order.

    Members are repaired and brought into one pose; a template is bent onto each of them, replaced by the mean, and
    bent again; members with equal faces are one mesh in several shapes and correspond already. Generalized
    Procrustes Analysis aligns the results; the mean is projected onto its moving-least-squares surface and thinned
    out. Members that cannot be repaired or fitted are dropped and counted by reason in the card.

    Args:
        meshes: In metres, any orientation that the config admits.
        category: Name of the class, or "class.subcategory".
        config: How it is built.
        seed: Same seed, same primitive.
        progress: Wraps the stream of members, told how many there will be.

    Raises:
        BuildFailed: Fewer than config.min_members are left.
    """
    rng = np.random.default_rng(seed)
    dropped: Counter[str] = Counter()
    solids = _repair(meshes, dropped)
    _enough(len(solids), dropped, config)
    members = bring_into_one_pose(solids, config.orientation, rng)
    if all(_same_faces(member, members[0]) for member in members):
        config = replace(config, smoothing=0.0)  # one mesh in many shapes has no noise of a fit
        vertices, faces = np.stack([np.asarray(member.vertices) for member in members]), np.asarray(members[0].faces)
    else:
        vertices, faces = _bent_template(members, dropped, config, rng, seed, progress)
    placed = _into_frame(vertices, faces, config)
    areas = _vertex_areas(placed.mean(axis=0), faces)
    model = shape_model(placed, areas, variance=config.variance, max_modes=config.max_modes)
    primitive = _assemble(model, faces, category, config, rng, num_given=len(meshes), dropped=dropped)
    return with_parts(primitive) if config.parts else primitive


def _repair(meshes: Sequence[trimesh.Trimesh], dropped: Counter[str]) -> list[trimesh.Trimesh]:
    solids = []
    for mesh in meshes:
        try:
            mesh = check_mesh(mesh)
            solid = mesh if mesh.is_volume and mesh.body_count == 1 else make_solid(mesh)[0]
        except GfpGraspError as error:
            dropped[f"not repaired: {type(error).__name__}"] += 1
            continue
        solids.append(solid)
    return solids


def _same_faces(a: trimesh.Trimesh, b: trimesh.Trimesh) -> bool:
    return len(a.vertices) == len(b.vertices) and np.array_equal(a.faces, b.faces)


def _bent_template(
    members: Sequence[trimesh.Trimesh],
    dropped: Counter[str],
    config: BuildConfig,
    rng: np.random.Generator,
    seed: int,
    progress: Progress | None,
) -> tuple[np.ndarray, np.ndarray]:
    """The members (s, v, 3) m in the vertex order of one template, and its faces; the mean is the next template."""
    template = remesh(members[choose_template(members, rng)], rng, config=config.remesh)
    vertices, faces = np.zeros((0, 0, 3)), np.asarray(template.faces)
    for round_index in range(config.rounds):
        if round_index > 0:
            template = remesh(_mean_mesh(vertices, faces, config), rng, config=config.remesh)
        lost: Counter[str] = Counter()
        vertices, faces = _correspond(template, members, lost, config, seed, progress)
        _enough(len(vertices), dropped + lost, config)
        if round_index == config.rounds - 1:
            dropped += lost
    return vertices, faces


def _correspond(
    template: trimesh.Trimesh,
    members: Sequence[trimesh.Trimesh],
    dropped: Counter[str],
    config: BuildConfig,
    seed: int,
    progress: Progress | None,
) -> tuple[np.ndarray, np.ndarray]:
    fitter = TemplateFitter(template, config=config.correspondence, seed=seed)
    diagonal = float(np.linalg.norm(template.extents))
    fitted = []
    watch = progress or (lambda stream, total: stream)

    def fit(member: trimesh.Trimesh) -> tuple[Correspondence, float]:
        size = float(np.linalg.norm(member.extents)) / diagonal
        same_size = trimesh.Trimesh(np.asarray(member.vertices) / size, member.faces, process=False)
        return fitter.fit(same_size), size

    for found, size in watch(map(fit, members), len(members)):
        if found.residual_m > config.max_residual * diagonal:
            dropped["template does not reach it"] += 1
        elif found.covered < config.min_covered:
            dropped["lacks surface that the template has"] += 1
        elif found.flipped > config.max_flipped:
            dropped["folds the template"] += 1
        else:
            fitted.append(found.vertices * size)
    return np.array(fitted).reshape(len(fitted), len(template.vertices), 3), np.asarray(template.faces)


def _enough(kept: int, dropped: Counter[str], config: BuildConfig) -> None:
    if kept < config.min_members:
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items()) or "none was dropped"
        raise BuildFailed(
            f"{kept} members are left ({reasons}), {config.min_members} are needed: give more meshes of the class"
        )


def _mean_mesh(vertices: np.ndarray, faces: np.ndarray, config: BuildConfig) -> trimesh.Trimesh:
    """The mean after scale, as the next template."""
    placed = _into_frame(vertices, faces, config)
    mean = shape_model(placed, _vertex_areas(placed.mean(axis=0), faces), max_modes=1).mean
    return trimesh.Trimesh(_smooth(mean, faces, config.smoothing), faces, process=False)


def _into_frame(vertices: np.ndarray, faces: np.ndarray, config: BuildConfig) -> np.ndarray:
    """Corresponded members (s, v, 3) turned onto each other, upright, base at z = 0, axis at x = y = 0."""
    areas = _vertex_areas(vertices.mean(axis=0), faces)
    if config.orientation == "placed":
        return vertices - [0, 0, 1] * vertices[..., 2].min(axis=1)[:, None, None]
    aligned = generalized(vertices, weights=areas, axis=_UP if config.orientation == "upright" else None)
    turned = np.stack([v @ move.R.T for v, move in zip(vertices, aligned.transforms, strict=True)])
    return stand_up(turned, aligned.mean, faces, upright=config.orientation == "upright")


def _smooth(mean: np.ndarray, faces: np.ndarray, width: float) -> np.ndarray:
    """The mean on its moving-least-squares surface, small folds undone before and after."""
    if width <= 0:
        return untangle(mean, faces) if len(crossing_faces(mean, faces)) else mean
    mean = untangle(mean, faces)
    normals = vertex_normals(mean, faces)
    edge = float(np.linalg.norm(mean[faces[:, 0]] - mean[faces[:, 1]], axis=1).mean())
    return untangle(project(mean, normals, mean, normals, radius_m=width * edge), faces)


def _vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    area = np.linalg.norm(triangle_normals(corners), axis=1)
    return np.bincount(faces.ravel(), np.repeat(area / 6, 3), minlength=len(vertices))


def _assemble(
    model: ShapeModel,
    faces: np.ndarray,
    category: str,
    config: BuildConfig,
    rng: np.random.Generator,
    *,
    num_given: int,
    dropped: Counter[str],
) -> GenericPrimitive:
    mean = _smooth(model.mean, faces, config.smoothing)
    mean = mean - [0, 0, mean[:, 2].min()]
    moved = float(np.linalg.norm(mean - model.mean, axis=1).mean())
    swings = [mean + sign * 2 * mode for mode in model.modes[:6] for sign in (1, -1)]
    carry, thin, error = resample(np.stack([mean, *swings]), faces, rng, config=config.resample)
    vertices, modes = carry @ mean, np.einsum("wv,kvc->kwc", carry, model.modes, optimize=True)
    vertices = vertices - [0, 0, vertices[:, 2].min()]
    mesh = trimesh.Trimesh(vertices, thin, process=False)
    if not mesh.is_volume or len(crossing_faces(vertices, thin)):
        raise BuildFailed(f"the mean {category} is no clean volume: its members are too different, or too few")
    regions, region_names = label_regions(mesh)
    samples = np.hstack([model.coefficients, model.log_scale])
    shared = {
        "category": category.partition(".")[0],
        "subcategory": category.partition(".")[2],
        "explained": model.explained,
        "log_scale_cov": np.cov(model.log_scale[~model.outlier].T),
        "coefficient_samples": samples,
        "region_names": region_names,
        "up": _UP,
        "licence": config.licence,
    }
    some = rng.permutation(len(samples))[:40]
    shapes = [(vertices + np.tensordot(samples[i, :-3], modes, 1)) * np.exp(samples[i, -3:]) for i in some]
    share = config.symmetry_share

    def symmetry(index: np.ndarray, own_faces: np.ndarray):
        return detect_symmetry(
            [trimesh.Trimesh(shape[index], own_faces, process=False) for shape in shapes], rng, share=share
        )

    variants = []
    for parts in _subsets(region_names[len(BODY_REGIONS) :] if config.optional_parts else ()):
        part = np.isin(regions, [region_names.index(name) for name in parts])
        try:
            kept, own_faces = without_part(vertices, thin, part)
        except BuildFailed:
            continue  # the part is kept always
        body = GenericPrimitive(
            vertices=vertices[kept],
            faces=own_faces,
            modes=modes[:, kept],
            symmetry=symmetry(kept, own_faces),
            regions=regions[kept],
            **shared,
        )
        variants.append(Variant(parts, body, kept))
    card = {
        "meshes_given": num_given,
        "members_used": len(samples),
        "members_dropped": dict(dropped),
        "outliers": int(model.outlier.sum()),
        "vertices": len(vertices),
        "faces": len(thin),
        "modes": len(modes),
        "variance_kept": float(model.explained.sum()),
        "rms_after_scale_mm": round(1e3 * model.variance_m2**0.5, 3),
        "smoothing_moved_mm": round(1e3 * moved, 4),
        "resampling_error_mm": round(1e3 * error, 4),
        "dense_vertices": len(mean),
    }
    full = GenericPrimitive(
        vertices=vertices,
        faces=thin,
        modes=modes,
        symmetry=symmetry(np.arange(len(vertices)), thin),
        regions=regions,
        card=card,
        **shared,
    )
    return replace(full, variants=tuple(replace(v, primitive=replace(v.primitive, spec=full.spec)) for v in variants))


def _subsets(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Every set of at least one of the names."""
    return [chosen for count in range(1, len(names) + 1) for chosen in combinations(names, count)]


def with_parts(primitive: GenericPrimitive) -> GenericPrimitive:
    """The same primitive, and its variants, with convex parts at every level; takes minutes.

    Raises:
        DecompositionFailed: CoACD was lost in every attempt.
    """
    from gfp_grasp.collision import part_levels, with_binding  # starts a child process

    levels = part_levels(trimesh.Trimesh(primitive.vertices, primitive.faces, process=False))
    errors_mm = [round(1e3 * float(error), 3) for error in levels.errors_m[-1]]
    decomposed = replace(
        primitive,
        card={**primitive.card, "parts": len(levels.parts), "parts_error_mm": errors_mm},
        parts=levels.parts,
        part_merges=levels.merges,
        part_errors_m=levels.errors_m,
        binding=None,
        variants=tuple(replace(v, primitive=with_parts(v.primitive)) for v in primitive.variants),
    )
    return with_binding(decomposed)
