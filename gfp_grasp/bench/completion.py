"""Bench of completions: `gfp-grasp bench completion`.

Each object is seen from random views (see views.py), turned by any yaw on a table of any height. A method is given the
object's points, the viewpoint and up; nothing else. Its answer is compared with 8192 samples of the true surface that
can be seen from outside or through an opening.
"""

from __future__ import annotations

import hashlib
import time
import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import KDTree
from scipy.stats import rankdata

from gfp_grasp.bench.methods import (
    FORMER_NAMES,
    METHODS,
    PROTOCOLS,
    UNDEFORMED,
    Answer,
    ObjectView,
    in_sight,
    is_told_class,
    run_method,
    view_object,
)
from gfp_grasp.bench.rows import CompletionRow, paired_gain, summarise, table_one
from gfp_grasp.completers import PEER_COMPLETERS, check_network
from gfp_grasp.completion import Completion
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.meshes import sample_surface, vertex_normals
from gfp_grasp.metrics import chamfer_m, f_score, iou, scale_error, visible_surface
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource, load_objects
from gfp_grasp.types import LIDAR, UNKNOWN, CategorySpec

_SAMPLES = 8192
_NEAR_M = 0.005  # of the F-score; lengths of this and the next lines are for things on tables
_WALL_M = 0.02  # a difference of normals of one unit counts like this distance
_TRAFFIC = 10.0  # times as large are lengths in traffic
_BACK_M = 0.01  # a point of the cloud this near says that the sensor saw the place: dropouts and boards do not


@dataclass(frozen=True)
class CompletionConfig:
    """Which views are measured, and what methods are told.

    Attributes:
        views: Number of views of each object.
        seed: Seed of views, noise and samples.
        split: Split of the procedural families: train, val or test.
        limit: Most objects; families take turns. None takes all.
        give_category: Tell the methods the true class.
        noise_m: Standard deviation of the depth noise, m.
        protocol: How objects stand and are seen, one of views.PROTOCOLS.
        gps: Folders of primitives of your own, as the environment's option takes them.
        hidden_share: Share of each object's pixels that the protocol "hidden" hides.
    """

    views: int = 16
    seed: int = 0
    split: str = "test"
    limit: int | None = None
    give_category: bool = False
    noise_m: float = 0.001
    protocol: str = "standard"
    gps: str = ""
    hidden_share: float = 0.5

    def __post_init__(self) -> None:
        if self.views < 1:
            raise InvalidOption(f"views is {self.views}; at least 1 is expected")
        if self.protocol not in PROTOCOLS:
            raise InvalidOption(f"protocol is {self.protocol!r}; one of {', '.join(PROTOCOLS)} is expected")
        if not 0 <= self.hidden_share < 1:
            raise InvalidOption(f"hidden_share is {self.hidden_share}; a share from 0 to below 1 is expected")
        if self.protocol != "hidden" and self.hidden_share != CompletionConfig.hidden_share:
            raise InvalidOption(
                f"hidden_share is {self.hidden_share} and protocol {self.protocol!r}; only 'hidden' hides anything"
            )


def bench_completion(
    objects: str | Sequence[ObjectSource],
    *,
    methods: Sequence[str] = METHODS,
    config: CompletionConfig = CompletionConfig(),
    known: Mapping[str, Any] | None = None,
    workers: int = 1,
    ray: str | None = None,
    progress=None,
) -> dict[str, Any]:
    """Measure completions of procedural families, or of a folder's meshes of classes that have a primitive.

    Args:
        objects: Families with commas between, or a folder; or sources, which the config's split and limit say nothing
            to. Those of a class that has no primitive are left out. Things of no class make rows of `UNKNOWN` under
            every method that is not told the class.
        methods: Some of METHODS and of `gfp_grasp.completers.PEER_COMPLETERS`.
        config: Views and noise.
        known: Report of an earlier run, whose rows are kept if its settings are the same; else all are made again.
        workers: Number of processes.
        ray: Address of a Ray cluster to run on instead, or "auto".
        progress: Wraps the stream of finished views.

    Returns:
        {"settings", "rows": {class: {method: figures}}, "paper_table_one": see `table_one`, "paired": {class: {method:
        gain}}, "trials": every `CompletionRow`}.

        Figures are those of `summarise`: Chamfer distance `cd_m`, `f_score` at 5 mm (50 mm in traffic), `iou` of
        solids, the median of the size's relative error, milliseconds; of the library's own answers also how much of
        what is marked as observed was (`seen_precision`) and the other way round (`seen_recall`), the rank correlation
        of sigma with the true error (`sigma_rank`) and the share of vertices within two sigma (`two_sigma`). Pairs set
        each of the package's methods against "registration", the same fit undeformed, on the same view (see
        `paired_gain`).

    Raises:
        InvalidOption: An unknown method.
        NotTrained: The weights of another network do not ship; the message has the command that trains it.
        UnreadableFile: The weights of another network are none.
    """
    legal = (*METHODS, *PEER_COMPLETERS)
    unknown = set(methods) - set(legal)
    if unknown:
        raise InvalidOption(f"unknown methods {sorted(unknown)}; legal are {', '.join(legal)}")
    for name in set(methods) & set(PEER_COMPLETERS):
        check_network(name)
    library = PrimitiveLibrary.from_option(config.gps)
    if isinstance(objects, str):
        objects = load_objects(objects, split=config.split, limit=config.limit)
    sources = [s for s in objects if s.category in ("", *library.categories)]
    settings = {"objects": [s.name for s in sources], "samples": _SAMPLES, **asdict(config)}
    if settings.pop("gps"):
        settings["gps"] = [folder.name for folder in library.folders[1:]]
    if config.hidden_share == CompletionConfig.hidden_share:
        del settings["hidden_share"]  # as in reports of when there was no other
    kept: dict[tuple[str, int], list[CompletionRow]] = {}
    if known is not None and known.get("settings") == settings:
        for record in known["trials"]:
            row = CompletionRow(**{**record, "method": FORMER_NAMES.get(record["method"], record["method"])})
            kept.setdefault((row.object, row.view), []).append(row)
        done = {row.method for rows in kept.values() for row in rows}
        methods = tuple(m for m in legal if m in methods or m in done)
    jobs = [(source, view, kept.get((source.name, view), [])) for source in sources for view in range(config.views)]
    run = partial(_rows_of_view, methods=tuple(methods), config=config)
    found = pmap(run, jobs, workers=workers, ray=ray, progress=progress)
    flat = [row for rows in found for row in rows]
    by_class = {
        c: [row for row in flat if c in ("all", row.category)]
        for c in (*sorted({s.category or UNKNOWN for s in sources}), "all")
    }
    rivals = [m for m in methods if m.startswith(("gfs", "gfpnet")) and UNDEFORMED in methods]
    table = {
        c: {m: summarise([row for row in rows if row.method == m]) for m in methods} for c, rows in by_class.items()
    }
    return {
        "settings": settings,
        "rows": table,
        "paper_table_one": table_one(table),
        "paired": {c: {m: paired_gain(rows, m, UNDEFORMED) for m in rivals} for c, rows in by_class.items()},
        "trials": [row.to_json() for row in flat],
    }


def _rows_of_view(job, *, methods: tuple[str, ...], config: CompletionConfig) -> list[CompletionRow]:
    source, number, kept = job
    library = PrimitiveLibrary.from_option(config.gps)
    done = {row.method: row for row in kept}
    seed = _seed_of(source, number, config)
    rng = np.random.default_rng(seed)
    view = _seen(source, config, rng)
    truth = visible_surface(view.mesh, _SAMPLES, rng)
    rows = []
    for method in methods:
        if method in done:
            rows.append(done[method])
            continue
        if is_told_class(method) and not source.category:
            continue
        own = np.random.default_rng([*seed, zlib.crc32(method.encode())])
        start = time.perf_counter()
        figures: dict[str, Any] = {"cd_m": None, "f_score": 0.0}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                told = (source.category or None) if config.give_category else None
                answer = run_method(method, view, told, source.category, library=library)
        except GfpGraspError as error:
            figures["error"] = type(error).__name__
            answer = None
        ms = round(1000 * (time.perf_counter() - start), 1)
        if answer is not None:
            figures = _errors(answer, view, truth, own)
            if "class_found" in figures:
                right = _right_classes(library.spec(source.category)) if source.category else {UNKNOWN}
                figures["class_right"] = figures["class_found"] in right
        category = source.category or UNKNOWN
        rows.append(CompletionRow(object=source.name, category=category, view=number, method=method, ms=ms, **figures))
    return rows


def view_of(source: ObjectSource, number: int, config: CompletionConfig) -> ObjectView:
    """The view of an object that rows of this number are made from."""
    return _seen(source, config, np.random.default_rng(_seed_of(source, number, config)))


def _seed_of(source: ObjectSource, number: int, config: CompletionConfig) -> list[int]:
    return [config.seed, number, int.from_bytes(hashlib.sha256(source.name.encode()).digest()[:4], "little")]


def _seen(source: ObjectSource, config: CompletionConfig, rng: np.random.Generator) -> ObjectView:
    mesh = source.load_mesh(largest_m=LIDAR.largest_m) if config.protocol == "lidar" else source.load_mesh()
    return view_object(mesh, rng, protocol=config.protocol, noise_m=config.noise_m, hidden_share=config.hidden_share)


def _right_classes(spec: CategorySpec) -> set[str]:
    """A class and, where it has no part that tells it, those that it is easily taken for."""
    return {spec.category} if spec.optional_parts else {spec.category, *spec.alike}


def _errors(answer: Answer, view: ObjectView, truth: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Fields of a `CompletionRow` that compare an answer with the truth."""
    surface = answer.surface
    points = visible_surface(surface, _SAMPLES, rng) if isinstance(surface, trimesh.Trimesh) else surface
    figures: dict[str, Any] = {
        "cd_m": _rounded(chamfer_m(points, truth), 7),
        "f_score": _rounded(f_score(points, truth, threshold_m=_NEAR_M * _grown(view))),
        "scale_error": _rounded(scale_error(surface, view.mesh)),
    }
    if isinstance(surface, trimesh.Trimesh) and view.mesh.is_volume and surface.is_volume:
        figures["iou"] = _rounded(iou(surface, view.mesh))
    if answer.completion is None:
        return figures
    return {**figures, "class_found": answer.completion.category, **_calibration(answer.completion, view, rng)}


def _calibration(completion: Completion, view: ObjectView, rng: np.random.Generator) -> dict[str, float]:
    """Whether `observed` and `sigma_m` say what is so."""
    vertices, sigma_m, observed = (
        np.asarray(a) for a in (completion.mesh.vertices, completion.sigma_m, completion.observed)
    )
    normals = vertex_normals(vertices, np.asarray(completion.mesh.faces))
    points, true_normals, _ = sample_surface(view.mesh, 4 * _SAMPLES, rng)
    # A vertex belongs to the true surface that is near it and faces its way: walls are thin.
    wall_m, back_m = _WALL_M * _grown(view), _BACK_M * _grown(view)
    near = KDTree(np.hstack([points, wall_m * true_normals])).query(np.hstack([vertices, wall_m * normals]))[1]
    viewpoint = view.cloud.viewpoint
    assert viewpoint is not None
    seen = in_sight(view.mesh, points[near], true_normals[near], viewpoint)
    # The camera looked there, and something came back.
    seen &= KDTree(view.cloud.points).query(points[near])[0] < back_m
    error_m = np.abs(np.einsum("ni,ni->n", points[near] - vertices, true_normals[near]))
    both = float((seen & observed).sum())
    return {
        "seen_precision": _rounded(both / max(observed.sum(), 1)),
        "seen_recall": _rounded(both / max(seen.sum(), 1)),
        "sigma_rank": _rounded(_rank_correlation(sigma_m, error_m)),
        "two_sigma": _rounded(float((error_m < 2 * sigma_m).mean())),
    }


def _grown(view: ObjectView) -> float:
    """How much larger than on tables lengths are."""
    return _TRAFFIC if view.sensor.of_traffic else 1.0


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's; zero where either is constant."""
    ranks = rankdata(a), rankdata(b)
    return float(np.corrcoef(*ranks)[0, 1]) if min(np.ptp(r) for r in ranks) > 0 else 0.0


def _rounded(value: float, decimals: int = 5) -> float:
    return round(float(value), decimals)
