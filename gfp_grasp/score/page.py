"""The page of a score, with its pictures beside it, and its chart by itself. Neither asks anything of any network."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from gfp_grasp import __version__
from gfp_grasp.drawing import bracket_chart, escaped, html_page, reasons_chart, reasons_legend, spoken
from gfp_grasp.errors import CannotWrite
from gfp_grasp.journal import write_whole
from gfp_grasp.parallel import Progress
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.score.failures import RULE, Exhibit, choose_failures, has_oracle, make_exhibits
from gfp_grasp.score.report import BRACKETS, Report
from gfp_grasp.score.rows import NO_GRIP, TOO_HEAVY, ScoreConfig

FILE, FIGURES = "index.html", "score.json"
_WORDS = ("completer", "failures")  # columns of words, which start at the left and may break
_INKS = "--card: #ffffff; --ink: #1d2127; --soft: #5d6570; --rule: #e2e3e0; --accent: #2f66b3;"


def prepare_folder(directory: str | Path) -> Path:
    """Make the folder of a page and see that it can be written, before anything is scored for it.

    Raises:
        CannotWrite: It cannot.
    """
    directory = Path(directory)
    probe = directory / f".{FILE}.probe"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise CannotWrite(
            f"no page can be written to {directory.name or directory} ({error.strerror or error}): name a folder that "
            "can be made or written"
        ) from error
    return directory


def write_score_page(
    report: Report,
    directory: str | Path,
    *,
    objects: str | Path,
    config: ScoreConfig | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write index.html with its pictures, and score.json beside it.

    Failures that are worth a look (`gfp_grasp.score.failures.RULE`) are made again from their seeds, which takes
    some seconds each.

    Args:
        report: Report of the score.
        directory: Folder to write; it is made if it is not there.
        objects: Objects that were scored, as `score` took them.
        config: Config of the score; None takes the report's settings, which name no folder of primitives.
        progress: Wraps the stream of failures, told how many there will be.

    Returns:
        The page.

    Raises:
        CannotWrite: The folder, or a file in it.
        InvalidOption: The objects are not those of the report.
    """
    folder = prepare_folder(directory)
    report.write(folder / FIGURES)
    exhibits: tuple[Exhibit, ...] = ()
    chosen = choose_failures(report)
    if chosen:
        config = config or _config_of(report.settings)
        exhibits = make_exhibits(chosen, folder, objects=objects, config=config, progress=progress)
    write_whole(folder / FILE, _page(report, exhibits, command=_command(report.settings, folder.resolve().name)))
    return folder / FILE


def write_picture(report: Report, path: Path) -> Path:
    """Draw success between the brackets to an .svg file that any browser shows.

    Args:
        report: Report of the score.
        path: File to write; its folder is made if it is not there.

    Raises:
        CannotWrite: The file.
    """
    sheet = _css()
    rules = "\n".join(line for line in sheet.splitlines() if line.startswith(".chart "))
    chart = bracket_chart(report.completers(), BRACKETS)
    opening, drawn = chart.split("\n", 1)
    opening = opening.replace(
        "<svg ", '<svg xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif" '
    )
    style = f"<style>\n.chart {{ {_INKS} background: #ffffff; font-size: 14px; }}\n{rules}\n</style>"
    write_whole(path, f"{opening}\n{style}\n{drawn}\n")
    return path


def _page(report: Report, exhibits: Sequence[Exhibit], *, command: str) -> str:
    settings = report.settings
    objects = escaped(settings["objects"]).replace(",", ", ")
    body = f"""<h1>What completions are worth to a gripper</h1>
<p class="lead">Objects: {escaped(settings["num_objects"])} of {objects}. Views of each: {escaped(settings["views"])}.
Each row completes the same single views; the best grasp planned on its completion was tried in MuJoCo, on the true
object and on the completion itself.</p>
{_charts_section(report)}
{_failures_section(report, exhibits)}
{_figures_section(report, link=FIGURES)}
{_settings_section(settings, command=command)}
<footer>
<p>Made by gfp_grasp {escaped(__version__)}. Files and folders of objects go by their names alone: run the command where
they lie. One trial is made again by <code>GfpGraspEnv(objects=..., completer=...)</code> and
<code>reset(seed=..., options={{"object": number}})</code>, with the seed shown beside it and the object's number in
<code>env.sources</code>.</p>
</footer>"""
    return html_page("gfp_grasp: what completions are worth", body, css=_css())


def _config_of(settings: Mapping[str, Any]) -> ScoreConfig:
    names = ("views", "grasps", "seed", "split", "clutter", "detector")
    return ScoreConfig(**{name: settings[name] for name in names if name in settings})


def _css() -> str:
    return files("gfp_grasp.score").joinpath("page.css").read_text(encoding="utf-8")


def _command(settings: Mapping[str, Any], directory: str) -> str:
    """Command that makes the page again, in the folder where the objects lie."""
    words = [
        "gfp-grasp",
        "score",
        "--objects",
        str(settings["objects"]),
        "--completers",
        ",".join(settings["completers"]),
    ]
    for name in ("views", "grasps", "seed", "split", "clutter", "detector"):
        words += [f"--{name}", str(settings[name])] if name in settings else []
    left_out = [name for kind in (NO_GRIP, TOO_HEAVY) for name in settings.get(kind, ())]
    met = settings["num_objects"] + len(left_out)  # the limit counts what is left out, too
    words += ["--limit", str(met)]
    for folder in settings.get("gps", ()):
        words += ["--gps", folder]
    if set(settings["classes"]) != {*PrimitiveLibrary.shipped().categories, ""}:
        words += ["--classes", ",".join(settings["classes"])]
    return shlex.join([*words, "--report", directory])


def _charts_section(report: Report) -> str:
    """Both drawings side by side, with their legends."""
    summaries = report.completers()
    key = "".join(
        f'<span><svg class="key" viewBox="0 0 26 16" aria-hidden="true">{drawn}</svg>{meaning}</span>'
        for drawn, meaning in (
            (_key_whisker("true"), "on the true object"),
            (_key_whisker("completed"), "on the completion itself"),
            ('<path class="bracket" d="M13,0 V16"/>', "bracket"),
        )
    )
    return f"""<section id="brackets">
<h2>Success and reasons</h2>
<p>Lines from end to end are 95 % intervals (Wilson). A completion is worth what it adds to the hull of the seen points
(observed); the true mesh (oracle) shows what the planner makes of a perfect one.</p>
<div class="charts">
<div class="card"><h3>The best grasp held: share of trials</h3>{bracket_chart(summaries, BRACKETS)}
<div class="legend">{key}</div></div>
<div class="card"><h3>How trials on the true objects ended</h3>{reasons_chart(summaries)}
<div class="legend">{reasons_legend(summaries)}</div></div>
</div>
</section>"""


def _failures_section(report: Report, exhibits: Sequence[Exhibit]) -> str:
    """The gallery, or a sentence where there is nothing to show."""
    bracketed = has_oracle(report)
    if not exhibits:
        nothing = "No row failed where the oracle held." if bracketed else "No trial failed."
        return f'<section id="failures">\n<h2>Failures</h2>\n<p>{nothing}</p>\n</section>'
    figures = "\n".join(_figure(exhibit) for exhibit in exhibits)
    return f"""<section id="failures">
<h2>Failures{" where the oracle held" if bracketed else ""}</h2>
<p>{escaped(RULE)} Left half of a picture: from where the camera stood; right half: from aside.</p>
<div class="legend over"><span><i style="--dot:#335f9e"></i>true object</span>
<span><i style="--dot:#faad42"></i>completion</span></div>
<div class="failures">
{figures}
</div>
</section>"""


def _figures_section(report: Report, *, link: str) -> str:
    """The table, and where all trials are."""
    rows = report.table()
    kind = {name: ' class="word"' if name in _WORDS else "" for name in rows[0]} if rows else {}
    head = "".join(f"<th{kind[name]}>{escaped(name)}</th>" for name in kind)
    body = "".join(
        "<tr>"
        + "".join(f'<td{kind[name]} data-name="{escaped(name)}">{_cell(name, row[name])}</td>' for name in kind)
        + "</tr>"
        for row in rows
    )
    return f"""<section id="figures">
<h2>Figures</h2>
<p>Of best few: views on which one of the best {escaped(report.settings["grasps"])} grasps held. Precision and recall:
of the completed world as a forecast of the true one. CD: mean Chamfer distance of the completions, surfaces that can be
seen. All of them are in <a href="{escaped(link)}">{escaped(link)}</a>.</p>
<div class="card wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>
</section>"""


def _settings_section(settings: Mapping[str, object], *, command: str) -> str:
    """Settings of the score; the numbers of a trial, which are many, are folded away."""
    trial = settings.get("trial")
    plain = {name: value for name, value in settings.items() if name != "trial"}
    folded = ""
    if isinstance(trial, Mapping):
        folded = f"<details><summary>numbers of a trial</summary>{_list(trial)}</details>"
    return f"""<section id="settings">
<h2>Settings</h2>
<div class="card settings">{_list(plain)}{folded}</div>
<pre><code>{escaped(command)}</code></pre>
</section>"""


def _key_whisker(kind: str) -> str:
    return f'<g class="{kind}"><path d="M1,4 v8 M1,8 H25 M25,4 v8"/><circle cx="13" cy="8" r="5"/></g>'


def _figure(exhibit: Exhibit) -> str:
    row = exhibit.row
    what = f"{row.object}, view {row.view}, {row.completer}"
    images = "".join(
        f'<img src="{escaped(name)}" alt="{escaped(alt)}" width="{width}" height="{height}" loading="lazy">'
        for name, alt, width, height in (
            (exhibit.picture, f"Completion over the true object: {what}", 600, 300),
            (exhibit.clip, f"The trial: {what}", 400, 300),
        )
        if name
    )
    facts = {
        "object": row.object,
        "view": row.view,
        "seed": row.episode_seed,
        "completer": row.completer,
        "CD": "-" if row.cd_m is None else f"{1000 * row.cd_m:.1f} mm",
        "reason": spoken(row.reason),
        "on the completion": spoken(row.completed_reason),
    }
    note = f"<p>{escaped(exhibit.note)}</p>" if exhibit.note else ""
    return (
        f"<figure>{images}<figcaption><strong>{escaped(row.completer)} on {escaped(row.object)}</strong>"
        f"{_list(facts)}{note}</figcaption></figure>"
    )


def _cell(name: str, text: str) -> str:
    return escaped(spoken(text) if name == "failures" else text)


def _list(facts: Mapping[str, object]) -> str:
    def said(value: object) -> str:
        if not isinstance(value, list | tuple):
            return escaped(value)
        return escaped(", ".join(str(part) or "(unknown)" for part in value) or "none")

    return "<dl>" + "".join(f"<dt>{escaped(n)}</dt><dd>{said(value)}</dd>" for n, value in facts.items()) + "</dl>"
