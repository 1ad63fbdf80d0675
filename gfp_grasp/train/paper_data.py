"""What the paper's networks learn from: patches in the paper's own setting.

PCRNet moves one mean primitive of a class, rigidly. The label says where its vertices belong on the whole true surface:
the primitive is fitted to that, drawn onto it by the active contour (GFS), and moving least squares refine where it
ends. Drawn from the rigid pose itself, most contours fold. Labels that fold or stay off the surface are dropped and
counted, as the paper mended them by hand; patches that are far from their label, as of fits that PCRNet turned the
wrong way, are left out.
Every view gives three fits: of the primitive in its own size, as the paper has it; in the true size, for what the
network does where size is no question; and that of the default registration, onto which it can be put, too.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.assets import data_file
from gfp_grasp.deform import make_patches, patch_unit_m, template_points
from gfp_grasp.errors import FitDiverged, InvalidOption, TooFewPoints
from gfp_grasp.journal import write_arrays
from gfp_grasp.level import make_level_view
from gfp_grasp.meshes import crossing_faces, sample_surface, vertex_normals
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary, fit_full_surface, project
from gfp_grasp.register import FitConfig, fit_best, pcrnet_config, pcrnet_weights, size_of_extents
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import IN_PAPER
from gfp_grasp.train.by_sensor import class_sensor, class_views
from gfp_grasp.train.labels import MOST_RESIDUAL, draw_onto
from gfp_grasp.train.loop import Batch
from gfp_grasp.train.views import View, cache_name, seed_of
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import GenericPrimitive

_SAMPLES = 12_000  # of the true surface
_KERNEL = 2.0  # width of the moving least squares, in mean distances of these samples
_MOST_FOLDED = 0.01  # crossing pairs of faces for each vertex
_FITS = ("own size", "true size", "fitted")
_FAR = 1.0  # mean distance of a patch from its label, patch units


def paper_patches(
    split: str,
    *,
    classes: Sequence[str] = IN_PAPER,
    members: int,
    num_views: int = 4,
    data: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
) -> tuple[Batch, dict[str, dict[str, int]]]:
    """Patches that see something, of the views of the first members of classes.

    Args:
        split: "train", "val" or "test".
        classes: Classes whose views and mean primitives they are of.
        members: Members of each class.
        num_views: Views of each member.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        runs: Folder of the caches.
        workers: Processes that render and label.

    Returns:
        S, T and label (b, n, 3), float16 in patch frame and unit, and the unit (b,) m; and how many fits of each class
        were kept and dropped for which reason.

    Raises:
        InvalidOption: No label could be made.
    """
    library = PrimitiveLibrary.shipped()
    columns: list[list[np.ndarray]] = [[], [], [], []]
    counts = {}
    for name in classes:
        views = class_views(name, split, limit=members, num_views=num_views, runs=runs, workers=workers, data=data)
        make = partial(_cached_rows, primitive=library.primitive(name), folder=runs / "paper" / name)
        tally: Counter[str] = Counter()
        for of_view in pmap(make, views, workers=workers):
            for verdict, rows in of_view:
                tally[verdict] += 1
                for column, part in zip(columns, rows, strict=False):
                    column.append(part)
        counts[name] = dict(tally)
    if not columns[0]:
        raise InvalidOption(f"no label could be made: {counts}")
    return tuple(torch.from_numpy(np.concatenate(column)) for column in columns), counts


_Rows = tuple[str, tuple[np.ndarray, ...]]


def _cached_label(source: ObjectSource, *, primitive: GenericPrimitive, folder: Path) -> tuple[str, np.ndarray]:
    """Verdict on a shape, and where the primitive's vertices (v, 3) m belong on it, in its own frame."""
    path = folder / f"label_{cache_name(source)}_{_shape_id(primitive)}.npz"
    if not path.is_file():
        verdict, vertices = _label(source.load_mesh(), primitive, seed_of(source))
        write_arrays(path, verdict=np.array(verdict), vertices=vertices)
    with np.load(path) as stored:
        return str(stored["verdict"]), stored["vertices"]


def _label(mesh: trimesh.Trimesh, primitive: GenericPrimitive, seed: int) -> tuple[str, np.ndarray]:
    fitted, _ = fit_full_surface(primitive, mesh, seed=seed)
    points, normals, _ = sample_surface(mesh, _SAMPLES, np.random.default_rng(seed))
    drawn, residual_m = draw_onto(primitive, fitted, points, normals)
    if residual_m > MOST_RESIDUAL * patch_unit_m(primitive):
        return "residual", drawn
    facing = vertex_normals(drawn, primitive.faces)
    radius_m = _KERNEL * float(np.sqrt(mesh.area / _SAMPLES))
    refined = project(drawn, facing, points, normals, radius_m=radius_m)
    folded = len(crossing_faces(refined, primitive.faces)) > _MOST_FOLDED * len(refined)
    return "folded" if folded else "kept", refined


def _cached_rows(view: View, *, primitive: GenericPrimitive, folder: Path) -> list[_Rows]:
    """Verdict and rows of each fit of a view."""
    weights = pcrnet_weights(class_sensor(view.family))
    made_from = hashlib.sha256(view.points.tobytes() + _content(weights)).hexdigest()[:20]
    path = folder / f"{made_from}_{_shape_id(primitive)}.npz"
    if not path.is_file():
        verdict, label = _cached_label(view.source, primitive=primitive, folder=folder)
        true = size_of_extents(primitive, np.ptp(np.asarray(view.source.load_mesh().vertices), axis=0))
        stored: dict[str, np.ndarray] = {}
        for name, config in zip(_FITS, (pcrnet_config(), pcrnet_config(size=true), FitConfig()), strict=True):
            config = replace(config, hypotheses=(view.resting,))
            verdict_of_fit, rows = (verdict, ()) if verdict != "kept" else _rows(view, primitive, config, label)
            stored[f"{name}_verdict"] = np.array(verdict_of_fit)
            stored |= {f"{name}_{number}": row for number, row in enumerate(rows)}
        write_arrays(path, **stored)
    with np.load(path) as stored:
        return [
            (str(stored[f"{name}_verdict"]), tuple(stored[f"{name}_{n}"] for n in range(4) if f"{name}_{n}" in stored))
            for name in _FITS
        ]


def _rows(view: View, primitive: GenericPrimitive, config: FitConfig, label: np.ndarray) -> _Rows:
    try:
        level = make_level_view(view.detection(support=False, sensor=class_sensor(view.family)))
        fit = fit_best(level, [(primitive, 0.0)], config=config)
    except (FitDiverged, TooFewPoints):
        return "not fitted", ()
    T_fit_world = invert_T(level.T_world_level @ fit.T_world_object)
    T = T_fit_world @ view.T_world_object
    vertices = primitive.shape(fit.coefficients, fit.scale)
    target = apply_T(T, _turned(label, apply_T(invert_T(T), vertices), primitive))
    template = template_points(fit, level, symmetry=False)
    patches = make_patches(primitive, vertices, template, apply_T(T_fit_world, view.viewpoint))
    offset = np.einsum("bni,bij->bnj", (target - vertices)[patches.index], patches.frames) / patches.unit_m
    learnt = (patches.pose_features[:, -1] > 0) & (np.linalg.norm(offset, axis=2).mean(axis=1) < _FAR)
    if not learnt.any():
        return "far", ()
    own = (patches.source, patches.template, patches.source + offset)
    unit_m = np.full(int(learnt.sum()), patches.unit_m, dtype=np.float32)
    return "kept", (*(part[learnt].astype(np.float16) for part in own), unit_m)


def _turned(label: np.ndarray, vertices: np.ndarray, primitive: GenericPrimitive) -> np.ndarray:
    """A label (v, 3) m turned onto itself to be nearest to the vertices (v, 3) m of a fit: a round thing has no yaw."""
    (x, y, _), (u, v, _) = label.T, vertices.T
    yaw = float(np.arctan2((x * v - y * u).sum(), (x * u + y * v).sum()))
    turned = apply_T(make_T(rotation_about((0, 0, 1), yaw), None), label)
    tree, order = KDTree(label), primitive.symmetry.order
    off_m = float(tree.query(turned)[0].mean() - tree.query(label, k=2)[0][:, 1].mean() / 2)
    if np.isinf(order) or off_m < MOST_RESIDUAL * patch_unit_m(primitive):
        return turned
    step = 2 * np.pi / order
    return apply_T(make_T(rotation_about((0, 0, 1), step * np.round(yaw / step)), None), label)


@cache
def _content(weights: str) -> bytes:
    """What registers: another PCRNet makes other patches."""
    return data_file("weights", f"{weights}.safetensors").read_bytes()


def _shape_id(primitive: GenericPrimitive) -> str:
    return str(primitive.card.get("shape_sha256", ""))[:10]
