"""One self-contained HTML page: pictures, figures, and shapes that one can turn. It asks nothing of any network."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib.resources import files

import numpy as np
import trimesh

from gfp_grasp.completion import lowest_support
from gfp_grasp.demo.demo_scene import HEADINGS, WORD_HEADINGS, DemoScene, figures_row
from gfp_grasp.drawing import Item, gripper_mesh, html_page
from gfp_grasp.transforms import apply_T, make_T, rotation_between

# More points than this hide the surface under them.
_MAX_POINTS = 900
_ASIDE_RAD = 0.7
_MEDIA_TYPES = {".png": "image/png", ".gif": "image/gif"}


def write_page(scenes: Sequence[DemoScene], *, command: str, notes: Sequence[str] = ()) -> str:
    """The page as text.

    Args:
        scenes: Scenes to show, in order.
        command: Command that made the page, for its foot.
        notes: Further lines for the foot.
    """
    shapes = json.dumps([_shapes(scene) for scene in scenes], separators=(",", ":")).replace("<", "\\u003c")
    viewer = files("gfp_grasp.demo").joinpath("viewer.js").read_text(encoding="utf-8")
    sections = "\n".join(_section(scene, i) for i, scene in enumerate(scenes))
    foot = "".join(f"<p>{html.escape(note)}</p>" for note in notes)
    body = f"""<h1>One depth view in, whole objects out</h1>
<p class="lead">Each object below was seen from one side only. A primitive of its class was fitted and deformed to the
points. The mesh is watertight, in metres, and comes with convex parts for a simulator. The best grasp planned on it was
tried in MuJoCo: on the true object where there is one, on the completed parts elsewhere.</p>
{sections}
<footer>
<p>Made by <code>{html.escape(command)}</code>.</p>
{foot}
<p>CD is the mean distance from the completion to the truth plus the mean distance back, over the surface that can be
seen from outside or through an opening; F is the F-score at 5 mm; a question mark stands where the truth is unknown.
Fit is the trimmed mean distance of the points to the fitted primitive, before it is deformed. The number beside a class
is its probability.</p>
</footer>"""
    data = f'<script type="application/json" id="scenes">{shapes}</script>'
    script = f"{data}\n<script>\n{viewer}</script>\n"
    return html_page("gfp_grasp: one depth view, completed and grasped", body, script=script)


def _section(scene: DemoScene, index: int) -> str:
    figures = "\n".join(
        f'<figure><img src="{_data_uri(scene, name)}" alt="{html.escape(caption)}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
        for name, caption in scene.pictures.items()
    )
    return f"""<section class="scene" id="scene-{index}">
<h2>{html.escape(scene.title)}</h2>
<p>{html.escape(scene.text)}</p>
<div class="card">
<div class="bar"><div class="choose" role="group" aria-label="Object"></div>
<div class="layers" role="group" aria-label="What is shown"></div></div>
<canvas tabindex="0" role="img" aria-label="{html.escape(scene.title)}: drag or use the arrow keys to turn"></canvas>
<div class="legend"><span><i style="--dot:#3a76c9"></i>surface that was seen</span>
<span><i style="--dot:#ec9d38"></i>surface that was completed</span>
<span>drag to turn, wheel or pinch to zoom, double-click to reset</span></div>
</div>
<div class="card wide">{_table(scene)}</div>
<div class="pictures">{figures}</div>
</section>"""


def _table(scene: DemoScene) -> str:
    def cell(tag: str, heading: str, text: str, item: Item | None = None) -> str:
        kinds = ["word"] if heading in WORD_HEADINGS else []
        if item and item.outcome and heading == "best grasp":
            kinds.append("held" if item.outcome.success else "failed")
        name = f' data-name="{html.escape(heading)}"' if item else ""  # narrow pages show it beside the figure
        return f'<{tag} class="{" ".join(kinds)}"{name}>{html.escape(text)}</{tag}>'

    head = "".join(cell("th", heading, heading) for heading in HEADINGS)
    body = "".join(
        "<tr>"
        + "".join(cell("td", heading, text, item) for heading, text in zip(HEADINGS, figures_row(item), strict=True))
        + "</tr>"
        for item in scene.items
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _shapes(scene: DemoScene) -> dict[str, object]:
    """All shapes of a scene, turned so that up is z, which the viewer takes for granted."""
    detection = scene.items[0].completion.detection
    T = make_T(rotation_between(detection.up, [0.0, 0.0, 1.0]))
    support = lowest_support([item.completion for item in scene.items])
    floor = support.height_m if support else None
    items = [_item(item, T) for item in scene.items]
    return {"floor": floor, "azimuth": _azimuth(scene, T), "items": items}


def _azimuth(scene: DemoScene, T: np.ndarray) -> float:
    """Azimuth of the first look: aside of where the camera stood, so that seen and unseen surface both show."""
    cloud = scene.items[0].completion.detection.cloud
    if cloud.viewpoint is None:
        return _ASIDE_RAD
    x, y, _ = apply_T(T, cloud.viewpoint) - apply_T(T, cloud.points).mean(axis=0)
    return round(float(np.arctan2(y, x)) + _ASIDE_RAD, 3)


def _item(item: Item, T: np.ndarray) -> dict[str, object]:
    completion = item.completion
    points = np.asarray(completion.detection.cloud.points)
    points = points[:: -(-len(points) // _MAX_POINTS)]
    vertices = apply_T(T, completion.mesh.vertices)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shapes: dict[str, object] = {
        "name": item.name,
        "at": ((low + high) / 2).round(5).tolist(),
        "reach": round(float(np.linalg.norm(high - low)) / 2, 5),
        "cloud": _base64(apply_T(T, points), "<f4"),
        "completed": {**_mesh(completion.mesh, T), "seen": _base64(completion.observed, "u1")},
        "parts": _parts(completion.parts, T),
    }
    if item.truth is not None:
        shapes["truth"] = _mesh(item.truth, T)
    if item.grasps:
        shapes["gripper"] = _mesh(gripper_mesh(item.grasps[0]), T)
    return shapes


def _mesh(mesh: trimesh.Trimesh, T: np.ndarray) -> dict[str, str]:
    return {"v": _base64(apply_T(T, mesh.vertices), "<f4"), "f": _base64(mesh.faces, "<u4")}


def _parts(parts: Sequence[trimesh.Trimesh], T: np.ndarray) -> dict[str, str]:
    """All parts as one mesh, with the number of the part that each vertex belongs to."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])[:-1]
    vertices = np.concatenate([part.vertices for part in parts])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    number = np.repeat(np.arange(len(parts)), [len(part.vertices) for part in parts])
    return {**_mesh(trimesh.Trimesh(vertices, faces, process=False), T), "part": _base64(number, "<u2")}


def _base64(array: np.ndarray, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=kind).tobytes()).decode("ascii")


def _data_uri(scene: DemoScene, name: str) -> str:
    path = scene.folder / name
    return f"data:{_MEDIA_TYPES[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
