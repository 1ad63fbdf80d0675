"""The comparison with other completion networks: `gfp-grasp bench peers`.

The paper compares by class and does not say what was hidden. Here each class of its table is measured, all household
classes and things of no class, and how the distance grows with what is hidden; beside these what an answer costs, what
it is worth to a gripper, and KITTI. Every peer stands in both of its ways: around what was seen, and told the true box.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gfp_grasp.bench.completion import bench_completion
from gfp_grasp.bench.costs import NETWORKS, measure_costs
from gfp_grasp.bench.digests import digest_of, digest_of_meshes, digest_of_scans, digests_of_methods
from gfp_grasp.bench.kitti import OURS, PAPER, PARTIAL, WHOLE, KittiConfig, bench_kitti
from gfp_grasp.bench.methods import UNDEFORMED
from gfp_grasp.bench.peer_groups import Group, PeersConfig, groups_of, sources_of, trained_of
from gfp_grasp.bench.peer_trials import IN_SIMULATOR, followed_by, is_report, keep, packed, unpacked, without
from gfp_grasp.bench.rows import CompletionRow, paired_gain
from gfp_grasp.completers import PEER_COMPLETERS
from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import Progress
from gfp_grasp.scenes import label_of
from gfp_grasp.score import Report, ScoreConfig, ScoreRow, score
from gfp_grasp.shapes import HOUSEHOLD
from gfp_grasp.types import UNKNOWN

BEFORE, AFTER = (PARTIAL, "observed", "mirror", *PAPER), ("classfree", UNDEFORMED, OURS)
BELOW, ABOVE = "observed", ("classfree", OURS, "oracle")  # in the score
_FIGURES = ("cd_m", "cd_median_m", "f_score", "failed", "views", "ms", "ms_p95")
_COSTED = 20  # objects


@dataclass(frozen=True)
class _Run:
    """How a comparison is made.

    Attributes:
        config: What is compared.
        peers: Completers of PEER_COMPLETERS that are measured.
        made_from: Digests of what methods read of the package, by method.
        former: What still holds of an earlier report, or nothing.
        workers: Number of processes.
        progress: Makes what wraps a part's results.
        journals: Folder of the trials of grasps.
    """

    config: PeersConfig
    peers: tuple[str, ...]
    made_from: Mapping[str, str]
    former: Mapping[str, Any]
    workers: int
    progress: Callable[[str], Progress | None]
    journals: Path | None

    def settings_of(self, part: str) -> Mapping[str, Any]:
        return self.former.get("settings", {}).get(part, {})


def bench_peers(
    *,
    config: PeersConfig = PeersConfig(),
    known: Mapping[str, Any] | None = None,
    workers: int = 1,
    progress: Callable[[str], Progress | None] = lambda part: None,
    save: Callable[[dict[str, Any]], None] = lambda report: None,
    journals: Path | None = None,
) -> dict[str, Any]:
    """Set the package beside other networks, and beside the paper's own method.

    Args:
        config: What is compared.
        known: An earlier report. What it has of the same settings and objects is kept, but for methods whose networks
            or primitives have changed since; parts that are not asked for are kept whatever their settings.
        workers: Number of processes; costs are measured with nothing beside them.
        progress: Makes what wraps the stream of a part's results, from the part's name.
        save: Given the report so far, after each part.
        journals: Folder of the trials of grasps as they come, a file for each completer, see `gfp_grasp.score.score`.
            Those of the same objects, settings and weights are not made again; the folder is the caller's to remove.

    Returns:
        {"settings", "left_out": [{"method", "why"}] of peers without weights, "groups": {group: {method: figures}} with
        the Chamfer distance `cd_m` (mean) and `cd_median_m`, `f_score`, `failed` of `views`, and ms, "paired": {group:
        {method: `paired_gain` of "gfpnet" over it}}, "occlusion": {share that is hidden: {method: figures}}, "cost":
        see `measure_costs`, "score": {"completers", "paired"}, see `gfp_grasp.score.Report`, "kitti": {row: figures of
        `bench_kitti`}, "trials"}. What neither was asked for nor is known, or has no object, is empty.

        A trial of a group is one method: its distances, F-scores, ms and errors, for the objects of the group's
        settings in their order and the views of each. A trial of the group "score" is one `ScoreRow`.

    Raises:
        InvalidOption: A folder without any object of these classes, or an earlier report of something else.
        UnreadableFile: A mesh or scan that cannot be read, or weights that are none of their peer.
    """
    if known is not None and not is_report(known):
        raise InvalidOption("what is known was not written by this bench: name a file of its own, or start afresh")
    groups = tuple(groups_of(config))
    before: Mapping[str, str] = {} if known is None else known["settings"]["made_from"]
    peers, left_out = trained_of(config.peers, before)
    made_from = digests_of_methods(name for name in NETWORKS if name in peers or name not in PEER_COMPLETERS)
    changed = {name for name in {*before, *made_from} if before.get(name) != made_from.get(name)}
    former = {} if known is None else without(known, changed)
    run = _Run(config, peers, made_from, former, workers, progress, journals)
    report: dict[str, Any] = {
        "settings": {
            "views": config.views,
            "limit": config.limit,
            "seed": config.seed,
            "data": None if config.data is None else label_of(config.data),
            "made_from": made_from,
            "groups": {},
        },
        "left_out": left_out,
        **{part: {} for part in ("groups", "paired", "occlusion", "cost", "score", "kitti")},
        "trials": [],
    }
    for group in groups:
        _compare(group, run, report)
        save(followed_by(report, former))
    for part, asked, add in (("kitti", config.kitti, _drive), ("score", config.with_score, _grasp)):
        if asked:
            add(run, report)
            save(followed_by(report, former))
        else:
            keep(part, report, former)
    _weigh(run, report)
    save(followed_by(report, former))
    return report


def _compare(group: Group, run: _Run, report: dict[str, Any]) -> None:
    """Add the completions of a group."""
    known, meshes = None, digest_of_meshes(group.sources)
    settings = dict(run.settings_of("groups").get(group.name, {}))
    if settings and settings.pop("meshes", None) == meshes:
        categories = {source.name: source.category or UNKNOWN for source in group.sources}
        records = [record for record in run.former["trials"] if record["group"] == group.name]
        known = {"settings": settings, "trials": list(unpacked(records, settings, categories))}
    found = bench_completion(
        group.sources,
        methods=(*BEFORE, *run.peers, *AFTER),
        config=group.views,
        known=known,
        workers=run.workers,
        progress=run.progress(group.name),
    )
    rows = [CompletionRow(**trial) for trial in found["trials"]]
    of_methods = found["rows"]["all"]
    answered = [method for method in (*BEFORE, *run.peers, *AFTER) if of_methods[method]["views"]]
    figures = {method: {name: of_methods[method][name] for name in _FIGURES} for method in answered}
    if group.hidden is None:
        report["groups"][group.name] = figures
    else:
        report["occlusion"][str(group.hidden)] = figures
    report["paired"][group.name] = {name: paired_gain(rows, OURS, name) for name in answered if name != OURS}
    report["settings"]["groups"][group.name] = {**found["settings"], "meshes": meshes}
    report["trials"] += packed(group.name, found["trials"], answered)


def _drive(run: _Run, report: dict[str, Any]) -> None:
    """Add what is completed of KITTI's scans."""
    tree, how = run.config.kitti, KittiConfig()
    assert tree is not None
    settings = {"tree": label_of(tree), "scans": digest_of_scans(tree)}
    settings |= {"frames": how.frames, "least_points": how.least_points}
    rows = (PARTIAL, WHOLE, *PAPER, *run.peers, UNDEFORMED, OURS)
    found = dict(run.former["kitti"]) if run.settings_of("kitti") == settings else {}
    if missing := tuple(row for row in rows if row not in found):
        told = bench_kitti(tree, config=KittiConfig(missing), workers=run.workers, progress=run.progress("kitti"))
        for row, figures in told["rows"].items():
            found[row] = {name: value for name, value in figures.items() if name != "each"}
    report["settings"]["kitti"] = settings
    report["kitti"] = {row: found[row] for row in rows}


def _grasp(run: _Run, report: dict[str, Any]) -> None:
    """Add what grasps do that are planned on the completions of household objects, if there are any."""
    config = run.config
    sources = sources_of(config, HOUSEHOLD)
    if not sources:
        return
    how = ScoreConfig(views=config.views, seed=config.seed, limit=config.limit, classes=HOUSEHOLD)
    objects = ",".join(HOUSEHOLD) if config.data is None else str(config.data)
    asked = {"objects": label_of(objects), **asdict(how), "classes": sorted(HOUSEHOLD)}
    asked["meshes"] = digest_of_meshes(sources)
    completers = (BELOW, *run.peers, *ABOVE)
    settings, rows = {}, []
    if asked.items() <= run.settings_of("score").items():
        settings = dict(run.settings_of("score"))
        rows = [ScoreRow(**_own(trial)) for trial in run.former["trials"] if trial["group"] == IN_SIMULATOR]
    done = {row.completer for row in rows}
    for name in (name for name in completers if name not in done):
        # A journal knows the settings only: its name says what else its rows were made from.
        file = f"{name}.{digest_of([asked, run.made_from.get(name)])}.jsonl"
        made = score(
            objects,
            (name,),
            config=how,
            workers=run.workers,
            journal=None if run.journals is None else run.journals / file,
            progress=run.progress(f"{IN_SIMULATOR} of {name}"),
        )
        settings, rows = {**asked, **made.settings}, [*rows, *made.rows]
    settings["completers"] = list(completers)
    ordered = sorted(rows, key=lambda row: completers.index(row.completer))
    whole = Report(settings, tuple(ordered))
    report["settings"]["score"] = settings
    report["score"] = {
        "completers": whole.completers(),
        "paired": {
            name: {other: pair for other, pair in pairs.items() if other in (BELOW, *ABOVE)}
            for name, pairs in whole.paired().items()
        },
    }
    report["trials"] += [{"group": IN_SIMULATOR, **asdict(row)} for row in ordered]


def _own(trial: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in trial.items() if name != "group"}


def _weigh(run: _Run, report: dict[str, Any]) -> None:
    """Add what a completion costs."""
    settings = {"objects": "household", "limit": _COSTED, "seed": run.config.seed}
    methods = tuple(name for name in (*BEFORE, *run.peers, *AFTER) if name != PARTIAL)
    found = dict(run.former["cost"]) if run.settings_of("cost") == settings else {}
    if missing := tuple(name for name in methods if name not in found):
        found |= measure_costs(missing, **settings, progress=run.progress("cost"))
    report["settings"]["cost"] = settings
    report["cost"] = {name: found[name] for name in methods}
