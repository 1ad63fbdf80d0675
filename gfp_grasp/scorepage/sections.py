"""The parts of the page, as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gfp_grasp.report import Report
from gfp_grasp.scorepage.charts import bracket_chart, reasons_chart, reasons_legend
from gfp_grasp.scorepage.failures import RULE, Exhibit, has_oracle
from gfp_grasp.scorepage.words import escaped, spoken

_WORDS = ("completer", "failures")  # columns of words, which start at the left and may break


def charts_section(report: Report) -> str:
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
<div class="card"><h3>The best grasp held: share of attempts</h3>{bracket_chart(summaries)}
<div class="legend">{key}</div></div>
<div class="card"><h3>How attempts on the true objects ended</h3>{reasons_chart(summaries)}
<div class="legend">{reasons_legend(summaries)}</div></div>
</div>
</section>"""


def failures_section(report: Report, exhibits: Sequence[Exhibit]) -> str:
    """The gallery, or a sentence where there is nothing to show."""
    bracketed = has_oracle(report)
    if not exhibits:
        nothing = "No row failed where the oracle held." if bracketed else "No attempt failed."
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


def figures_section(report: Report, *, link: str) -> str:
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
seen. All trials are in <a href="{escaped(link)}">{escaped(link)}</a>.</p>
<div class="card wide"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>
</section>"""


def settings_section(settings: Mapping[str, object], *, command: str) -> str:
    """Those of the score, with the numbers of a trial, which are many, folded away."""
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
    trial = exhibit.trial
    what = f"{trial.object}, view {trial.view}, {trial.completer}"
    images = "".join(
        f'<img src="{escaped(name)}" alt="{escaped(alt)}" width="{width}" height="{height}" loading="lazy">'
        for name, alt, width, height in (
            (exhibit.picture, f"Completion over the true object: {what}", 600, 300),
            (exhibit.clip, f"The attempt: {what}", 400, 300),
        )
        if name
    )
    facts = {
        "object": trial.object,
        "view": trial.view,
        "seed": trial.episode_seed,
        "completer": trial.completer,
        "CD": "-" if trial.cd_m is None else f"{1000 * trial.cd_m:.1f} mm",
        "reason": spoken(trial.reason),
        "on the completion": spoken(trial.completed_reason),
    }
    note = f"<p>{escaped(exhibit.note)}</p>" if exhibit.note else ""
    return (
        f"<figure>{images}<figcaption><strong>{escaped(trial.completer)} on {escaped(trial.object)}</strong>"
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
