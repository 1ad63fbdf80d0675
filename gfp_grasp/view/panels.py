"""The panel beside the scene: switches, the slider of grasps, legends, and what is known of each object."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import TYPE_CHECKING

from gfp_grasp.view.layers import Layers, Switches
from gfp_grasp.view.scene import ShownScene
from gfp_grasp.view.text import item_rows, scale_legend, surface_legend, table

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]

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
            self.legend.content = scale_legend(layers.end_mm) if state.sigma else surface_legend()
