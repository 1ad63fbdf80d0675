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
from gfp_grasp.demo.demo_scene import DemoScene, StreetLook
from gfp_grasp.drawing import Item, gripper_mesh, html_page, paled
from gfp_grasp.transforms import apply_T, make_T, rotation_between

# More points than this hide the surface under them.
_MAX_POINTS = 900
_ASIDE_RAD = 0.7
_MEDIA_TYPES = {".png": "image/png", ".gif": "image/gif", ".jpg": "image/jpeg"}
# More points of a scan make turning slow; whole centimetres are finer than its noise.
_MAX_SCAN, _CM = 60_000, 100
# The first look at a street: from behind and right of the sensor, as far away as this radius needs.
_LOOK_AT, _LOOK_RADIUS_M, _LOOK_AZIMUTH_RAD = (-0.4, 1.0, 0.0), 17.5, -2.77
_LEAD = """Each object below was seen from one side only. A primitive of its class was fitted and deformed to the
points. The mesh is watertight, in metres, and comes with convex parts for a simulator. The best grasp planned on it was
tried in MuJoCo: on the true object where there is one, on the completed parts elsewhere."""
_FOOT = """CD is the mean distance from the completion to the truth plus the mean distance back, over the surface that
can be seen from outside or through an opening; F is the F-score at 5 mm; a question mark stands where the truth is
unknown. Fit is the trimmed mean distance of the points to the fitted primitive, before it is deformed. The number
beside a class is its probability."""
_STREET_LEAD = """A LiDAR sees the near side of what stands about it. Vehicles and people were found in the scan, and
the whole shape of each was completed from a primitive of its class. The meshes are watertight, in metres, in the scan's
frame, and come with convex parts for a simulator."""
_STREET_FOOT = """Distance is that of an object's middle from the sensor; size is length, width and height; guessed is
the share of its vertices that nobody saw. The number beside a class is its probability."""


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
    streets = bool(scenes) and all(scene.street is not None for scene in scenes)
    heading = "One scan in, whole vehicles and people out" if streets else "One depth view in, whole objects out"
    lead, words = (_STREET_LEAD, _STREET_FOOT) if streets else (_LEAD, _FOOT)
    body = f"""<h1>{heading}</h1>
<p class="lead">{lead}</p>
{sections}
<footer>
<p>Made by <code>{html.escape(command)}</code>.</p>
{foot}
<p>{words}</p>
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
<div class="legend">{_legend(scene.street)}
<span>drag to turn, wheel or pinch to zoom, double-click to reset</span></div>
</div>
<div class="card wide">{_table(scene)}</div>
<div class="pictures">{figures}</div>
</section>"""


def _legend(street: StreetLook | None) -> str:
    """What the colours of the canvas mean."""
    if street is None:
        dots = [("#3a76c9", "surface that was seen"), ("#ec9d38", "surface that was completed")]
    else:
        dots = [(_hex(rgb), name.replace("_", " ")) for name, rgb in street.colours.rgb.items()]
        first = next(iter(street.colours.rgb.values()))
        dots += [(_hex(paled(first)), "paler: nobody saw it"), ("#8a8a8a", "points of the scan by height")]
    return "\n".join(f'<span><i style="--dot:{colour}"></i>{html.escape(words)}</span>' for colour, words in dots)


def _hex(rgb: np.ndarray) -> str:
    return "#" + bytes(rgb.astype(np.uint8)).hex()


def _table(scene: DemoScene) -> str:
    columns = scene.columns

    def cell(tag: str, heading: str, text: str, item: Item | None = None) -> str:
        kinds = ["word"] if heading in columns.words else []
        if item and item.outcome and heading == "best grasp":
            kinds.append("held" if item.outcome.success else "failed")
        name = f' data-name="{html.escape(heading)}"' if item else ""  # narrow pages show it beside the figure
        return f'<{tag} class="{" ".join(kinds)}"{name}>{html.escape(text)}</{tag}>'

    head = "".join(cell("th", heading, heading) for heading in columns.headings)
    body = "".join(
        "<tr>"
        + "".join(
            cell("td", heading, text, item) for heading, text in zip(columns.headings, columns.row(item), strict=True)
        )
        + "</tr>"
        for item in scene.items
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _shapes(scene: DemoScene) -> dict[str, object]:
    """All shapes of a scene, turned so that up is z, which the viewer takes for granted."""
    if scene.street is not None:
        return _street_shapes(scene, scene.street)
    detection = scene.items[0].completion.detection
    T = make_T(rotation_between(detection.up, [0.0, 0.0, 1.0]))
    support = lowest_support([item.completion for item in scene.items])
    floor = support.height_m if support else None
    items = [_item(item, T) for item in scene.items]
    return {"floor": floor, "azimuth": _azimuth(scene, T), "items": items}


def _street_shapes(scene: DemoScene, street: StreetLook) -> dict[str, object]:
    """Shapes of a street: each object with its colours of seen and guessed surface, and the scan in centimetres."""
    items = []
    for item in scene.items:
        rgb = street.colours.rgb[item.completion.category]
        items.append({**_item(item, street.T_level_world), "colours": [rgb.tolist(), paled(rgb).tolist()]})
    points = street.points[:: max(1, -(-len(street.points) // _MAX_SCAN))]
    level_cm = np.clip(np.round(_CM * apply_T(street.T_level_world, points)), -32767, 32767)
    look = {"at": _LOOK_AT, "radius": _LOOK_RADIUS_M}
    scan = _base64(level_cm, "<i2")
    return {"floor": None, "azimuth": _LOOK_AZIMUTH_RAD, "items": items, "scan": scan, "look": look}


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
