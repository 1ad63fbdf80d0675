"""Trials in the report of `bench_peers`: one record a method and group, and what of an earlier report still holds."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from gfp_grasp.bench.kitti import OURS

# What a record has of each row, in the order of objects and views.
COLUMNS = ("cd_m", "f_score", "ms", "error")
IN_SIMULATOR = "score"  # in place of a group's name, in rows of the score
_PARTS = ("groups", "paired", "occlusion", "cost", "score", "kitti")


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


def is_report(content: object) -> bool:
    """Whether something is a report of `bench_peers`: it has all parts, and says what methods were made from."""
    if not isinstance(content, Mapping) or not {*_PARTS, "settings", "trials"} <= content.keys():
        return False
    return isinstance(content["settings"], Mapping) and {"made_from", "groups"} <= content["settings"].keys()


def without(report: Mapping[str, Any], methods: Collection[str]) -> dict[str, Any]:
    """An earlier report without all that some methods answered, and without what they were compared in."""

    def kept(figures: Mapping[str, Any]) -> dict[str, Any]:
        return {name: figure for name, figure in figures.items() if name not in methods}

    left = {part: kept(report[part]) for part in ("cost", "kitti")}
    left |= {part: {name: kept(of) for name, of in report[part].items()} for part in ("groups", "paired", "occlusion")}
    if OURS in methods:
        left["paired"] = {}
    settings = report["settings"]
    if score := report["score"]:
        completers = kept(score["completers"])
        paired = {name: kept(pairs) for name, pairs in kept(score["paired"]).items()}
        left["score"] = {"completers": completers, "paired": paired}
        settings = {**settings, "score": {**settings["score"], "completers": list(completers)}}
    trials = [trial for trial in report["trials"] if trial.get("method", trial.get("completer")) not in methods]
    return {**report, **left, "settings": settings, "trials": trials}


def keep(part: str, report: dict[str, Any], former: Mapping[str, Any]) -> None:
    """Take a part that was not asked for over from an earlier report, with its settings and trials."""
    if former.get(part):
        report[part] = former[part]
        report["settings"][part] = former["settings"][part]
        report["trials"] += [trial for trial in former["trials"] if trial["group"] == part]


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
