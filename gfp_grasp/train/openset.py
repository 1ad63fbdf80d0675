"""Learns to tell things of no class from things of a class: from both, as they are seen, fitted and completed.

`gfp-grasp train openset` looks, completes and learns. Members of a class are seen by a library without it, too.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.optimize import minimize

from gfp_grasp.answers import Clock, CompleteConfig, by_class
from gfp_grasp.assets import data_dir
from gfp_grasp.classfree import complete_level, hull_of
from gfp_grasp.errors import FitDiverged, InvalidCloud, InvalidOption, NoSurface
from gfp_grasp.journal import check_place, write_whole
from gfp_grasp.level import make_level_view
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.misfit import misfit_of
from gfp_grasp.openset import LogisticModel, evidence_of_fit, evidence_of_look
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import recognise
from gfp_grasp.register import is_cut_off
from gfp_grasp.shapes import FAMILIES, TRAFFIC
from gfp_grasp.train.classfree_data import PLAIN, SeenThing, SightConfig, Thing, draw_things, seen_things
from gfp_grasp.train.loop import command_line
from gfp_grasp.transforms import apply_T, invert_T

_SAMPLES = 8192
_LOST = 0.6  # of the hull's Chamfer distance: a completion that is worse is no good answer to a thing of no class
_SHRINKAGE = 1e-3  # weight of the squares of the weights
# How things are looked at: as the benches look, as sensors and tables have it, and behind a board.
SIGHTS: Mapping[str, SightConfig] = {
    "plain": PLAIN,
    "varied": SightConfig(),
    "hidden": replace(PLAIN, hidden_share=1.0, whole_share=0.5),
}


@dataclass(frozen=True)
class OpenSetConfig:
    """What is looked at, each once in every way of SIGHTS.

    Attributes:
        members: Members of each household family; as many again are seen without their class.
        mixtures: Things of each kind that is of no class.
    """

    members: int = 8
    mixtures: int = 24

    def __post_init__(self) -> None:
        if min(self.members, self.mixtures) < 1:
            raise InvalidOption("members and mixtures must be at least 1")


@dataclass(frozen=True, kw_only=True)
class OpenSetRow:
    """One view of a thing, with what speaks for it being of no class, and how near the answers to it come.

    Attributes:
        kind: Family or kind of mixture.
        number: Number of the thing within it.
        sort: "known"; "left_out", whose class the library lacks; or "mixture".
        sight: How it was seen, one of SIGHTS.
        cut_off: Whether an end of it is hidden, as `is_cut_off` says.
        look: Of `evidence_of_look`.
        fit: Of `evidence_of_fit`; None where no primitive could be fitted.
        misfit: Numbers of the `Misfit` of the completed primitive, likewise.
        named: The class that was fitted, likewise.
        cd_m: Chamfer distance of the completed primitive to the truth, m, likewise.
        hull_cd_m: That of the convex hull of what was seen.
        classfree_cd_m: That of the class-free completion; None where it found nothing.
    """

    kind: str
    number: int
    sort: str
    sight: str
    cut_off: bool
    look: tuple[float, ...]
    fit: tuple[float, ...] | None = None
    misfit: tuple[float, ...] | None = None
    named: str | None = None
    cd_m: float | None = None
    hull_cd_m: float
    classfree_cd_m: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Figures that apply."""
        return {name: value for name, value in asdict(self).items() if value is not None}

    @property
    def lost(self) -> bool:
        """Whether the completed primitive is no good answer."""
        return self.cd_m is None or self.cd_m > _LOST * self.hull_cd_m


def openset_rows(
    split: str, config: OpenSetConfig = OpenSetConfig(), *, workers: int = 1, progress: Progress | None = None
) -> list[OpenSetRow]:
    """Views of things of a split, with what the shipped networks and primitives make of them.

    Args:
        split: "train", "val" or "test".
        config: What is looked at.
        workers: Processes.
        progress: Wraps the stream of things.
    """
    things = draw_things(split, config.members, config.mixtures, without=TRAFFIC)
    return [row for rows in pmap(rows_of_thing, things, workers=workers, progress=progress) for row in rows]


def rows_of_thing(thing: Thing) -> list[OpenSetRow]:
    """The rows of one thing; a view whose points have no hull is left out."""
    shipped = PrimitiveLibrary.shipped()
    if thing.kind in FAMILIES:
        libraries = {"known": shipped, "left_out": shipped.without(thing.kind)}
    else:
        libraries = {"mixture": shipped}
    rows = []
    for name, sight in SIGHTS.items():
        for seen in seen_things(thing, 1, sight):
            rows += _rows(seen, libraries, name)
    return rows


def _rows(seen: SeenThing, libraries: Mapping[str, PrimitiveLibrary], sight: str) -> list[OpenSetRow]:
    thing, detection = seen.thing, recognise(seen.detection, PrimitiveLibrary.shipped())
    view = make_level_view(detection)
    truth = apply_T(invert_T(view.T_world_level), visible_surface(seen.mesh, _SAMPLES, thing.rng(1)))

    def cd_m(mesh: trimesh.Trimesh) -> float:
        return round(chamfer_m(visible_surface(mesh, _SAMPLES, thing.rng(2)), truth), 6)

    try:
        hull_cd_m = cd_m(hull_of(view.cloud.points))
    except InvalidCloud:
        return []
    try:
        classfree_cd_m = cd_m(complete_level(view).mesh)
    except NoSurface:
        classfree_cd_m = None
    rows = []
    for sort, library in libraries.items():
        detection = recognise(replace(detection, category="", scores={}), library)
        look = _rounded(evidence_of_look(detection, library))
        row = OpenSetRow(
            kind=thing.kind,
            number=thing.number,
            sort=sort,
            sight=sight,
            cut_off=is_cut_off(view),
            look=look,
            hull_cd_m=hull_cd_m,
            classfree_cd_m=classfree_cd_m,
        )
        try:
            shape = by_class(view, detection, CompleteConfig(library=library), Clock({}))
        except FitDiverged:
            rows.append(row)
            continue
        assert shape.fit is not None
        misfit = misfit_of(shape.mesh, view)
        rows.append(
            replace(
                row,
                fit=_rounded(evidence_of_fit(shape.fit, misfit)),
                misfit=_rounded(astuple(misfit)),
                named=shape.fit.primitive.name,
                cd_m=cd_m(shape.mesh),
            )
        )
    return rows


def _rounded(numbers: Iterable[float]) -> tuple[float, ...]:
    return tuple(round(float(number), 4) for number in numbers)


def fit_logistic(evidence: np.ndarray, unknown: np.ndarray) -> LogisticModel:
    """The logistic model of the largest likelihood; both sides weigh the same, however many there are of each.

    Args:
        evidence: (n, e).
        unknown: (n,) bool.
    """
    middle, spread = evidence.mean(axis=0), evidence.std(axis=0) + 1e-9
    columns = np.column_stack([(evidence - middle) / spread, np.ones(len(evidence))])
    weight = np.where(unknown, 0.5 / max(unknown.sum(), 1), 0.5 / max((~unknown).sum(), 1))
    side = np.where(unknown, 1.0, -1.0)

    def loss(weights: np.ndarray) -> float:
        return float(
            (weight * np.logaddexp(0, -side * (columns @ weights))).sum() + _SHRINKAGE * (weights[:-1] ** 2).sum()
        )

    found = minimize(loss, np.zeros(columns.shape[1])).x
    weights = found[:-1] / spread
    return LogisticModel(tuple(weights.tolist()), float(found[-1] - weights @ middle))


def fit_models(rows: Sequence[OpenSetRow]) -> dict[str, LogisticModel]:
    """The models "look" and "both": lost things of no class against known things that are not."""
    told = [row for row in rows if row.fit is not None and row.lost == (row.sort != "known")]
    unknown = np.array([row.lost for row in told])
    look = np.array([row.look for row in told])
    both = np.array([row.look + row.fit for row in told if row.fit is not None])
    return {"look": fit_logistic(look, unknown), "both": fit_logistic(both, unknown)}


def train_openset(
    *,
    config: OpenSetConfig = OpenSetConfig(),
    out: Path | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Path:
    """Learn on the validation split, which the networks have not learnt from, and write the models as a card.

    Args:
        config: What is looked at.
        out: The card; None is the shipped one.
        workers: Processes.
        progress: Wraps the stream of things.

    Returns:
        Path of the card.

    Raises:
        CannotWrite: `out`.
    """
    path = out or data_dir("weights") / "openset.json"
    check_place(path)
    started = time.perf_counter()
    rows = openset_rows("val", config, workers=workers, progress=progress)
    models = fit_models(rows)
    counts = Counter(row.sort for row in rows)
    card = {
        "command": command_line(),
        "config": asdict(config),
        "data": {"split": "val", "views": dict(counts), "lost": dict(Counter(row.sort for row in rows if row.lost))},
        "hours": round((time.perf_counter() - started) / 3600, 3),
        "models": {name: asdict(model) for name, model in models.items()},
    }
    write_whole(path, json.dumps(card, indent=1) + "\n")
    return path
