"""The panel beside the scene: switches, the slider of grasps, legends, and what is known of each object.

Every word in it is escaped, since names of files can hold anything.
"""

from __future__ import annotations

import html
import threading
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gfp_grasp.drawing import ClassColours, Item, paled, spoken
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import Outcome
from gfp_grasp.view.layers import GUESSED, SEEN, Layers, Switches, scale_stops
from gfp_grasp.view.scene import ShownScene

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]


Rows = Sequence[tuple[str, str]]
_BOX = "font-size:0.8rem;line-height:1.45;padding:0.2rem 0.7rem 0.5rem"


def item_rows(item: Item) -> Rows:
    """Names and values of all figures of an object; lengths in mm."""
    completion, fit = item.completion, item.completion.fit
    name = fit.primitive.name if fit else completion.category
    rows = [("class", name), ("confidence", _scores(item)), ("size", _size(item))]
    if completion.note:
        rows.append(("note", completion.note))
    if fit is not None:
        rows.append(("residual", f"{1000 * fit.residual_m:.2f} mm, {spoken(fit.hypothesis)}"))
    middle, high = 1000 * np.quantile(completion.sigma_m, (0.5, 0.95))
    rows.append(("seen", f"{completion.observed.mean():.0%} of {len(completion.observed)} vertices"))
    rows.append(("sigma", f"{middle:.1f} mm, 95 % below {high:.1f} mm"))
    parts = completion.collision
    rows.append(("parts", f"{len(parts.parts)}, {parts.made_by}"))
    rows.append(("parts off by", "{:.2f} mm, 95 % below {:.2f}, all {:.2f}".format(*(1000 * e for e in parts.error_m))))
    if completion.detection.sensor.of_traffic:
        rows.append(("distance", _distance(item)))
    else:
        best = f"{len(item.grasps)}, best {item.grasps[0].quality:.2f}" if item.grasps else "none fits"
        rows.append(("grasps", best))
    if item.errors is not None:
        rows.append(("off the truth", f"{1000 * item.errors.cd_m:.1f} mm, F {item.errors.f_score:.2f} at 5 mm"))
    planning = "" if completion.detection.sensor.of_traffic else f", planning {1000 * item.grasp_s:.0f} ms"
    rows.append(("time", f"{1000 * item.seconds:.0f} ms{planning}"))
    if warning := parts.notes.get("warning"):
        rows.append(("warning", str(warning)))
    return rows


def table(rows: Rows, notes: Iterable[str] = ()) -> str:
    """Rows as a table, and warnings below it."""
    body = "".join(
        f'<tr><td style="opacity:0.65;padding-right:0.8em;vertical-align:top;white-space:nowrap">{_safe(name)}</td>'
        f"<td>{_safe(value)}</td></tr>"
        for name, value in rows
    )
    warned = "".join(f'<div style="color:#b05c00;margin-top:0.3em">{_safe(note)}</div>' for note in notes)
    return f'<div style="{_BOX}"><table style="border-spacing:0">{body}</table>{warned}</div>'


def line(text: str) -> str:
    """One line of text."""
    return f'<div style="{_BOX}">{_safe(text)}</div>'


def surface_legend(colours: ClassColours | None = None) -> str:
    """Legend of seen and guessed surface; of a street, of its classes."""
    if colours is None:
        named = [(SEEN, "seen"), (GUESSED, "guessed")]
    else:
        named = [(_rgb(rgb), name.replace("_", " ")) for name, rgb in colours.rgb.items()]
        named += [(_rgb(paled(rgb)), "guessed") for rgb in list(colours.rgb.values())[:1]]
    dots = "".join(
        f'<span style="margin-right:1em"><span style="display:inline-block;width:0.8em;height:0.8em;border-radius:50%;'
        f'margin-right:0.35em;background:rgb{colour}"></span>{_safe(word)}</span>'
        for colour, word in named
    )
    return f'<div style="{_BOX}">{dots}</div>'


def scale_legend(end_mm: float) -> str:
    """The colour scale of sigma, with its ends and its middle in mm."""
    ends = "".join(f"<span>{number}</span>" for number in ("0 mm", f"{end_mm / 2:g} mm", f"{end_mm:g} mm and more"))
    return (
        f'<div style="{_BOX}">sigma, one standard deviation<div style="height:0.8em;border-radius:2px;'
        f'background:linear-gradient(to right,{",".join(scale_stops())})"></div>'
        f'<div style="display:flex;justify-content:space-between">{ends}</div></div>'
    )


def outcome_text(outcome: Outcome) -> str:
    """Outcome of a grasp, in a line."""
    reason = spoken(outcome.reason)
    lift = f"lifted by {1000 * outcome.lift_m:.0f} mm, slipped by {1000 * outcome.slip_m:.1f} mm"
    if not outcome.success:
        return f"{reason}: {lift}"
    return f"{reason}: {lift}, {'fell' if outcome.falls_free else 'did not fall'} when the jaws opened"


def _scores(item: Item) -> str:
    scores = item.completion.scores
    if not scores:
        return "the class was given"
    own = scores.get(item.completion.category, 0.0)
    others = [f"{name} {score:.2f}" for name, score in scores.items() if name != item.completion.category]
    return f"{own:.2f}" + (f" ({', '.join(others)})" if others else "")


def _size(item: Item) -> str:
    """Extents along the primitive's own axes; its z axis is upright."""
    local = apply_T(invert_T(item.completion.T_world_object), item.completion.mesh.vertices)
    return " x ".join(f"{1000 * extent:.0f}" for extent in np.ptp(local, axis=0)) + " mm"


def _distance(item: Item) -> str:
    """From where the sensor stood to the middle of the object."""
    eye = item.completion.detection.cloud.viewpoint
    if eye is None:
        return "unknown"
    return f"{np.linalg.norm(item.completion.mesh.bounds.mean(axis=0) - eye):.1f} m"


def _rgb(colour: np.ndarray) -> tuple[int, int, int]:
    red, green, blue = (int(channel) for channel in colour)
    return red, green, blue


def _safe(text: str) -> str:
    return html.escape(text)


_LABELS = {
    "scene": ("scene's points", "Grey: the support. A colour for each cluster."),
    "observed": ("observed points", "Of each object."),
    "mesh": ("completed mesh", None),
    "sigma": ("sigma", "Colours the mesh by how sure the surface's place is, not by what was seen."),
    "parts": ("convex parts", "In place of the mesh."),
    "primitive": ("primitive", "The generic shape of the class as it was registered, before it is deformed."),
    "truth": ("true mesh", "Translucent."),
}


class Panels:
    """Switches for any scene, and one folder for each object of the present one.

    Switches keep their state from one scene to the next.

    Attributes:
        layers: Layers that the switches act on; None while there are none.
        playing: Whether a grasp is being tried, while none that is planned is shown.
        lock: Held while what is shown changes: viser answers every switch in a thread of its own.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.server = server
        self.layers: Layers | None = None
        self.playing = False
        self.lock = threading.RLock()
        self.folders: list[viser.GuiFolderHandle] = []
        self.boxes: list[viser.GuiCheckboxHandle] = []
        gui = server.gui
        with gui.add_folder("Show"):
            self.switches = {
                name: gui.add_checkbox(label, getattr(Switches, name), hint=hint)
                for name, (label, hint) in _LABELS.items()
            }
            self.slider = gui.add_slider("grasps", 0, 16, 1, Switches.num_grasps, hint="The best of each object.")
            self.legend = gui.add_html(surface_legend())
        for handle in (*self.switches.values(), self.slider):
            handle.on_update(lambda _: self.refresh())

    def put(self, shown: ShownScene, layers: Layers) -> None:
        """Take over a scene that is drawn, and let go of the one before."""
        self.clear()
        self.layers = layers
        self.switches["truth"].visible = bool(shown.truths)
        self.slider.visible = not shown.in_traffic  # no gripper takes hold of a car
        self.slider.max = max([1, *(len(item.grasps) for item in shown.items)])
        self.slider.value = min(self.slider.value, self.slider.max)
        gui = self.server.gui
        if shown.facts or shown.notes or not shown.items:
            self.folders.append(folder := gui.add_folder(shown.title))
            with folder:
                gui.add_html(table(shown.facts, shown.notes or (() if shown.items else ("nothing was completed",))))
        for item in shown.items:
            self.folders.append(folder := gui.add_folder(item.name))
            with folder:
                if len(shown.items) > 1:
                    self.boxes.append(box := gui.add_checkbox("show", True))
                    box.on_update(lambda _: self.refresh())
                gui.add_html(table(item_rows(item)))
        self.refresh()

    def clear(self) -> None:
        """Remove the folders of the present shown."""
        self.layers = None
        for folder in self.folders:
            folder.remove()
        self.folders, self.boxes = [], []

    def state(self) -> Switches:
        """State of the switches."""
        flags = {name: bool(box.value) for name, box in self.switches.items()}
        hidden = frozenset(number for number, box in enumerate(self.boxes) if not box.value)
        return Switches(**flags, num_grasps=0 if self.playing else int(self.slider.value), hidden=hidden)

    def refresh(self) -> None:
        """Bring scene and legend up to the switches."""
        with self.lock:
            state, layers = self.state(), self.layers
            if layers is None:
                return
            if not layers.shown.items:  # there is nothing else to see
                state = replace(state, truth=True)
            layers.show(state)
            self.legend.content = scale_legend(layers.end_mm) if state.sigma else surface_legend(layers.colours)
