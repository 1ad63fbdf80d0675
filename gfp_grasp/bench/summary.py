"""Means, medians and paired gains of the trials of a bench."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

_RESAMPLINGS = 2000
_MEANS = ("cd_m", "f_score", "iou", "seen_precision", "seen_recall", "sigma_rank", "two_sigma")
_DECIMALS = {"cd_m": 5}


def summary(rows: Sequence[Mapping]) -> dict[str, object]:
    """Figures of one method over its trials; an error has no distance, and an F-score of nothing."""
    errors = _known(rows, "cd_m")
    found = [row["class_found"] == row["category"] for row in rows if row.get("class_found")]
    answer: dict[str, object] = {}
    for name in _MEANS:
        values = _known(rows, name)
        answer[name] = round(float(np.mean(values)), _DECIMALS.get(name, 4)) if values else None
    scale = [abs(value) for value in _known(rows, "scale_error")]
    times = [row["ms"] for row in rows]
    return answer | {
        "cd_median_m": round(float(np.median(errors)), 5) if errors else None,
        "scale_error_median": round(float(np.median(scale)), 4) if scale else None,
        "class_found": round(float(np.mean(found)), 4) if found else None,
        "ms": round(float(np.median(times)), 1) if times else None,
        "ms_p95": round(float(np.quantile(times, 0.95)), 1) if times else None,
        "views": len(rows),
        "failed": len(rows) - len(errors),
    }


def paired_gain(rows: Sequence[Mapping], method: str, reference: str) -> dict[str, object]:
    """What a method takes off the Chamfer distance of a reference, view by view; the interval resamples objects.

    Args:
        rows: Trials with "object", "view", "method" and "cd_m".
        method: The one.
        reference: The other.

    Returns:
        {"gain_m", "ci95_m", "gain_share" of the reference's distance, "wins" as a share, "pairs"}.
    """
    errors = {(r["object"], r["view"], r["method"]): r["cd_m"] for r in rows if r["cd_m"] is not None}
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
    sums, counts = (np.array([f(g) for g in gains.values()], dtype=float) for f in (np.sum, len))
    drawn = np.random.default_rng(0).integers(len(gains), size=(_RESAMPLINGS, len(gains)))
    low, high = np.quantile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), [0.025, 0.975])
    gain = float(sums.sum() / counts.sum())
    return {
        "gain_m": round(gain, 6),
        "ci95_m": [round(float(low), 6), round(float(high), 6)],
        "gain_share": round(gain / float(np.mean([before for _, before, _ in pairs])), 4),
        "wins": round(float(np.mean([after < before for _, before, after in pairs])), 4),
        "pairs": len(pairs),
    }


def _known(rows: Sequence[Mapping], name: str) -> list[float]:
    return [row[name] for row in rows if row.get(name) is not None]
