"""Trials in the report of `bench_peers`: one record a method and group, and what of an earlier report still holds."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

# What a record has of each row, in the order of objects and views.
COLUMNS = ("cd_m", "f_score", "ms", "error")
IN_SIMULATOR = "score"  # in place of a group's name, in rows of the score


def packed(group: str, trials: Sequence[Mapping[str, Any]], methods: Sequence[str]) -> list[dict[str, Any]]:
    """Records of one group.

    Args:
        group: Its name.
        trials: Rows of `bench_completion`, of all objects and views under each method.
        methods: Those that have rows, in the order of the records.
    """
    records = []
    for method in methods:
        own = [trial for trial in trials if trial["method"] == method]
        columns = {name: [trial.get(name) for trial in own] for name in COLUMNS}
        if not any(columns["error"]):
            del columns["error"]
        records.append({"group": group, "method": method, **columns})
    return records


def unpacked(
    records: Sequence[Mapping[str, Any]], settings: Mapping[str, Any], categories: Mapping[str, str]
) -> Iterator[dict[str, Any]]:
    """Rows that `bench_completion` takes as known.

    Args:
        records: Trials of one group.
        settings: Settings of that group, with the names of its objects and the number of views.
        categories: Class of each object.
    """
    things = [(name, view) for name in settings["objects"] for view in range(settings["views"])]
    for record in records:
        columns = [record.get(name, [None] * len(things)) for name in COLUMNS]
        for (name, view), *values in zip(things, *columns, strict=True):
            about = {"object": name, "category": categories.get(name, ""), "view": view, "method": record["method"]}
            yield about | dict(zip(COLUMNS, values, strict=True))


def without(report: Mapping[str, Any], methods: Collection[str]) -> dict[str, Any]:
    """An earlier report without all that some methods answered."""

    def kept(figures: Mapping[str, Any]) -> dict[str, Any]:
        return {name: figure for name, figure in figures.items() if name not in methods}

    left = {part: kept(report[part]) for part in ("cost", "kitti")}
    nested = ("groups", "paired", "occlusion", "score")
    left |= {part: {name: kept(of) for name, of in report[part].items()} for part in nested}
    trials = [trial for trial in report["trials"] if trial.get("method", trial.get("completer")) not in methods]
    return {**report, **left, "trials": trials}


def followed_by(report: Mapping[str, Any], former: Mapping[str, Any]) -> dict[str, Any]:
    """A report that is not whole yet, and what an earlier one has of the parts that are still to come."""
    if not former:
        return dict(report)
    settings = {**former["settings"], **report["settings"]}
    settings["groups"] = {**former["settings"]["groups"], **report["settings"]["groups"]}
    done = {trial["group"] for trial in report["trials"]}
    return {
        **report,
        **{part: {**former[part], **report[part]} for part in ("groups", "paired", "occlusion")},
        **{part: report[part] or former[part] for part in ("cost", "score", "kitti")},
        "settings": settings,
        "trials": [*report["trials"], *(trial for trial in former["trials"] if trial["group"] not in done)],
    }
