"""How well objects are found and named: `gfp-grasp bench detection`.

Every detector is measured on rendered clutter and rooms, and on labelled table tops where a folder of them is given;
category on views of the procedural test split, and on captures of that folder.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gfp_grasp.bench.finding import (
    MATCH_IOU,
    LabelledPicture,
    clutter_pictures,
    match_detectors,
    room_pictures,
    table_pictures,
)
from gfp_grasp.detect import classify, detect_objects
from gfp_grasp.errors import NothingDetected
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train import CACHE, Example, above_table, assorted_examples, class_examples
from gfp_grasp.types import DepthImage, SupportPlane

_SCENES = 40  # rendered, of each kind
_MARKS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 1.01)  # of the best class's score
UP = np.array([0.0, 0.0, 1.0])
_FIRST_KIND, _NUM_KINDS = 2000, 18  # of things of no class, which no network has learnt


def bench_detection(data: Path | None, *, cache: Path = CACHE, num_views: int = 4, workers: int = 1) -> dict[str, Any]:
    """Measure detection and classification.

    Args:
        data: Folder with captures/, or None.
        cache: Folder of rendered views.
        num_views: Number of views of each shape of the test split.
        workers: Number of processes that render.
    """
    figures: dict[str, object] = {"match_iou": MATCH_IOU, "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
    sets: dict[str, Callable[[], Iterable[LabelledPicture]]] = {
        "clutter": partial(clutter_pictures, _SCENES, seed=0),
        "rooms": partial(room_pictures, _SCENES, seed=0),
    }
    if data is not None:
        sets["tables"] = partial(table_pictures, data)
        figures["captures"] = {path.stem: name_capture(path) for path in _single_captures(data)}
    figures["found"] = match_detectors(sets)
    classes = PrimitiveLibrary.shipped().categories
    examples = [
        example
        for name in classes
        for example in class_examples(name, "test", num_views=num_views, classes=classes, workers=workers, folder=cache)
    ]
    figures["procedural_test"] = name_views(examples)
    figures["procedural_test_upright"] = name_views([e for e in examples if e.resting == "upright"])
    outside = assorted_examples(_FIRST_KIND, _NUM_KINDS, num_members=2, num_views=2, workers=workers, folder=cache)
    figures["foreign_mean_top_score"] = round(float(np.mean([max(_scores(e).values()) for e in outside])), 3)
    return figures


def name_capture(path: Path) -> dict[str, Any]:
    """Category of the biggest object of a picture whose up is unknown."""
    with np.load(path) as capture:
        view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
    try:
        found = detect_objects(view, up=None)
    except NothingDetected as error:
        return {"detections": 0, "refused": str(error)}
    return {
        "detections": len(found),
        "category": found[0].category,
        "scores": {name: round(score, 3) for name, score in found[0].scores.items()},
    }


def name_views(examples: list[Example]) -> dict[str, Any]:
    """Accuracy and confusion; classes that are alike but for a part are told apart only where that part is seen.

    `accuracy_named_as_taught` is stricter: what never has the part is wrong there under the name of what has it.
    """
    classes = PrimitiveLibrary.shipped().categories
    confusion = np.zeros((len(classes), len(classes)), dtype=int)
    several = np.zeros((len(classes), len(classes)), dtype=int)
    right, strict, sure = [], [], []
    for example in examples:
        scores = _scores(example)
        named = max(scores, key=lambda name: scores[name])
        right.append(named in example.accepted)
        strict.append(named in example.answers)
        sure.append(scores[named])
        counts = confusion if len(example.answers) == 1 else several
        counts[classes.index(example.category), classes.index(named)] += 1
    return {
        "views": len(right),
        "accuracy": round(float(np.mean(right)), 4),
        "accuracy_named_as_taught": round(float(np.mean(strict)), 4),
        "calibration": _calibration(np.array(sure), np.array(right)),
        "confusion_rows_true": {name: row.tolist() for name, row in zip(classes, confusion, strict=True)},
        "several_right": {name: row.tolist() for name, row in zip(classes, several, strict=True) if row.any()},
        "columns_named": list(classes),
    }


def _calibration(sure: np.ndarray, right: np.ndarray) -> list[dict[str, float]]:
    """How many answers have a score between two marks, their mean score, and how many of them are right."""
    rows = []
    for low, high in pairwise(_MARKS):
        between = (sure >= low) & (sure < high)
        if between.any():
            shares = {"mean_score": sure[between].mean(), "right": right[between].mean()}
            rows.append(
                {"from": low, "views": int(between.sum()), **{k: round(float(v), 4) for k, v in shares.items()}}
            )
    return rows


def _scores(example: Example) -> dict[str, float]:
    return classify(above_table(example), UP, SupportPlane(UP, 0.0), viewpoint=example.viewpoint)


def _single_captures(data: Path) -> list[Path]:
    return [path for path in sorted(data.glob("captures/*.npz")) if not path.stem.startswith("table_")]
