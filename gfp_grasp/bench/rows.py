"""Rows of benches, and what the bench of completions makes of its own: means, paired gains, the paper's table I.

The paper's metres are no target: its figure for PCRNet alone exceeds a cup. What can be compared are the ratios within
a table.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from gfp_grasp.metrics import mean_of_groups

_MEANS = ("cd_m", "f_score", "iou", "seen_precision", "seen_recall", "sigma_rank", "two_sigma")
_DECIMALS = {"cd_m": 5}
_PAPER_METHODS = {"PCRNet": "told-pcrnet", "GFS": "told-pcrnet-gfs", "GFPNet": "told-pcrnet-gfpnet-paper"}


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement of a bench; figures that do not apply are None."""

    def to_json(self) -> dict[str, Any]:
        """Figures that apply."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class CompletionRow(Row):
    """One method on one view of one object; None where a figure does not apply.

    Attributes:
        object: Name of the object.
        category: True class of the object.
        view: Number of the view.
        method: Name of the method.
        ms: Time that the method took, ms.
        cd_m: Chamfer distance to the truth, m; None where the method has no answer.
        f_score: F-score at 5 mm, in traffic at 50 mm; 0 where the method has no answer.
        scale_error: Relative error of the size.
        iou: Intersection over union of the solids.
        class_found: Class that the method found.
        class_right: Whether that is the true class or, where the class has no part that tells it, one that it is easily
            taken for.
        seen_precision: Share of the vertices marked as observed that were seen.
        seen_recall: Share of the vertices that were seen which are marked as observed.
        sigma_rank: Rank correlation of sigma with the true error.
        two_sigma: Share of the vertices whose true error is below two sigma.
        error: Name of the error where the method has no answer.
    """

    object: str
    category: str
    view: int
    method: str
    ms: float
    cd_m: float | None
    f_score: float
    scale_error: float | None = None
    iou: float | None = None
    class_found: str | None = None
    class_right: bool | None = None
    seen_precision: float | None = None
    seen_recall: float | None = None
    sigma_rank: float | None = None
    two_sigma: float | None = None
    error: str | None = None

    def to_json(self) -> dict[str, Any]:
        """Figures that apply, and the Chamfer distance even where there is none."""
        return {"cd_m": self.cd_m, **super().to_json()}


def summarise(rows: Sequence[CompletionRow]) -> dict[str, Any]:
    """Figures of one method over its rows; a method without an answer has no distance, and an F-score of 0."""
    errors = _known(rows, "cd_m")
    found = [row.class_found == row.category for row in rows if row.class_found]
    right = [row.class_right for row in rows if row.class_right is not None]
    answer: dict[str, Any] = {}
    for name in _MEANS:
        values = _known(rows, name)
        answer[name] = round(float(np.mean(values)), _DECIMALS.get(name, 4)) if values else None
    scale = [abs(value) for value in _known(rows, "scale_error")]
    times = [row.ms for row in rows]
    return answer | {
        "cd_median_m": round(float(np.median(errors)), 5) if errors else None,
        "scale_error_median": round(float(np.median(scale)), 4) if scale else None,
        "class_found": round(float(np.mean(found)), 4) if found else None,
        "class_right": round(float(np.mean(right)), 4) if right else None,
        "ms": round(float(np.median(times)), 1) if times else None,
        "ms_p95": round(float(np.quantile(times, 0.95)), 1) if times else None,
        "views": len(rows),
        "failed": len(rows) - len(errors),
    }


def paired_gain(rows: Sequence[CompletionRow], method: str, reference: str) -> dict[str, Any]:
    """Gain of a method over a reference in Chamfer distance, view by view; the interval resamples objects.

    Args:
        rows: Rows of both methods; others are passed over.
        method: The method whose gain is asked for.
        reference: The method that it is compared with.

    Returns:
        {"gain_m", "ci95_m", "gain_share" of the reference's distance, "wins" as a share, "pairs"}.
    """
    errors = {(row.object, row.view, row.method): row.cd_m for row in rows if row.cd_m is not None}
    pairs = [
        (name, errors[name, view, reference], error)
        for (name, view, own), error in errors.items()
        if own == method and (name, view, reference) in errors
    ]
    gains: dict[str, list[float]] = {}
    for name, before, after in pairs:
        gains.setdefault(name, []).append(before - after)
    if not gains:
        return {"pairs": 0}
    gain, low, high = mean_of_groups(list(gains.values()))
    return {
        "gain_m": round(gain, 6),
        "ci95_m": [round(float(low), 6), round(float(high), 6)],
        "gain_share": round(gain / float(np.mean([before for _, before, _ in pairs])), 4),
        "wins": round(float(np.mean([after < before for _, before, after in pairs])), 4),
        "pairs": len(pairs),
    }


def table_one(rows: Mapping[str, Mapping[str, Mapping]]) -> dict[str, dict[str, dict[str, float | None]]]:
    """Figures of the paper's methods by class, as it gives them and as they come out here.

    Args:
        rows: {class: {method: figures with "cd_m"}} of `bench_completion`.

    Returns:
        {method: {class: {"paper_m", "rigid_m", "sized_m"}}}: `rigid_m` with the mean primitive at its own size as in
        the paper, `sized_m` with the true height and width given; None where it was not measured.
    """

    paper = json.loads(files("gfp_grasp.bench").joinpath("paper.json").read_text(encoding="utf-8"))

    def cd_m(category: str, method: str) -> float | None:
        return rows.get(category, {}).get(method, {}).get("cd_m")

    return {
        name: {
            category: {
                "paper_m": paper_m,
                "rigid_m": cd_m(category, _PAPER_METHODS[name]),
                "sized_m": cd_m(category, f"{_PAPER_METHODS[name]}-sized"),
            }
            for category, paper_m in by_class.items()
        }
        for name, by_class in paper["cd_m"].items()
    }


def _known(rows: Sequence[CompletionRow], name: str) -> list[float]:
    return [value for row in rows if (value := getattr(row, name)) is not None]
