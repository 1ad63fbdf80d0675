"""The panel beside the scene: its texts, its switches, and what they do."""

import re
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from toy_completions import toy_completion, toy_errors, toy_fit, toy_item, toy_outcome
from toy_server import ToyServer

from gfp_grasp.drawing import Item
from gfp_grasp.view.layers import Layers, Switches
from gfp_grasp.view.panels import Panels, item_rows, line, outcome_text, scale_legend, surface_legend, table
from gfp_grasp.view.scene import ShownScene


def scene(*items: Item, **more: Any) -> ShownScene:
    return ShownScene("own", items, None, np.array([0.0, 0.0, 1.0]), **more)


class Page:
    """Panels of a toy server with a scene in it."""

    def __init__(self, *shown: ShownScene) -> None:
        self.server: Any = ToyServer()
        self.panels = Panels(self.server)
        for one in shown:
            self.layers = Layers(self.server, one)
            self.panels.put(one, self.layers)

    def visible(self, start: str = "/") -> set[str]:
        return {name for name, node in self.layers.nodes.items() if node.visible and name.startswith(start)}


def test_all_figures_of_a_fitted_object_are_told_in_millimetres() -> None:
    completion = toy_completion(fit=toy_fit(), scores={"mug": 0.876, "cup": 0.12}, warning="thin")
    assert dict(item_rows(toy_item(completion=completion, errors=toy_errors()))) == {
        "class": "mug.tall",
        "confidence": "0.88 (cup 0.12)",
        "size": "80 x 60 x 100 mm",  # the primitive's own axes are turned by 90 degrees
        "residual": "2.34 mm, upside down",
        "seen": "50% of 8 vertices",
        "sigma": "1.7 mm, 95 % below 2.3 mm",
        "parts": "2, cuts",
        "parts off by": "0.12 mm, 95 % below 3.45, all 6.78",
        "grasps": "3, best 0.87",
        "off the truth": "4.2 mm, F 0.88 at 5 mm",
        "time": "1250 ms, planning 125 ms",
        "warning": "thin",
    }


def test_what_is_not_known_of_an_object_is_not_told() -> None:
    rows = dict(item_rows(toy_item(num_grasps=0)))
    assert list(rows) == [*("class", "confidence", "size", "seen", "sigma", "parts", "parts off by", "grasps", "time")]
    assert (rows["class"], rows["confidence"], rows["grasps"]) == ("mug", "the class was given", "none fits")
    made = toy_completion(scores={"mug": 0.6, "cup": 0.4}, category="unknown")
    doubted = replace(made, shape=replace(made.shape, note="it is of no class"))
    doubted.__dict__["collision"] = made.collision
    rows = dict(item_rows(toy_item(completion=doubted)))
    assert (rows["class"], rows["note"]) == ("unknown", "it is of no class")
    assert rows["confidence"] == "0.00 (mug 0.60, cup 0.40)"
    lone = item_rows(toy_item(completion=toy_completion(scores={"mug": 1.0})))
    assert dict(lone)["confidence"] == "1.00"


def test_outcome_says_whether_the_object_fell_where_it_was_held() -> None:
    assert outcome_text(toy_outcome()) == "held: lifted by 200 mm, slipped by 1.2 mm, fell when the jaws opened"
    assert outcome_text(toy_outcome(False, "no_contact")) == "no contact: lifted by 200 mm, slipped by 1.2 mm"


def test_tables_have_a_row_for_each_figure_and_notes_below() -> None:
    rows = ElementTree.fromstring(table((("<a>", "1 & 2"), ("b", "3")), ("careful", "<again>")))
    assert [[cell.text for cell in row] for row in rows.iter("tr")] == [["<a>", "1 & 2"], ["b", "3"]]
    assert [note.text for note in rows.findall("div")] == ["careful", "<again>"]
    assert not ElementTree.fromstring(table((("a", "b"),))).findall("div")
    assert "".join(ElementTree.fromstring(line("<&>")).itertext()) == "<&>"


def test_legends_have_the_colours_of_the_surfaces_and_the_ends_of_the_scale() -> None:
    legend = surface_legend()
    assert re.findall(r"background:rgb(\([^)]*\))\"></span>(\w+)", legend) == [
        ("(58, 118, 201)", "seen"),
        ("(236, 157, 56)", "guessed"),
    ]
    scale = scale_legend(3.0)
    assert "linear-gradient(to right,#440154,#3b528b,#21918c,#5ec962,#fde725)" in scale
    assert re.findall(r"<span>([^<]*)</span>", scale) == ["0 mm", "1.5 mm", "3 mm and more"]


def test_panel_has_a_switch_for_each_layer_as_the_scene_begins() -> None:
    page = Page()
    switches = {handle.arguments[0]: handle for handle in page.server.gui.added if handle.kind == "checkbox"}
    assert {label: handle.value for label, handle in switches.items()} == {
        "scene's points": True,
        "observed points": True,
        "completed mesh": True,
        "sigma": False,
        "convex parts": False,
        "primitive": False,
        "true mesh": False,
    }
    assert [handle.named["hint"] is None for handle in switches.values()] == [False, False, True, *[False] * 4]
    assert list(page.panels.switches) == ["scene", "observed", "mesh", "sigma", "parts", "primitive", "truth"]
    assert page.panels.slider.arguments == ("grasps", 0, 16, 1, 4)  # type: ignore[attr-defined]
    assert [handle.arguments for handle in page.server.gui.added if handle.kind == "folder"] == [("Show",)]
    assert page.panels.legend.content == surface_legend()
    assert page.panels.state() == Switches()
    page.panels.refresh()  # nothing is shown


def test_every_switch_and_the_slider_act_at_once() -> None:
    page = Page(scene(toy_item(completion=toy_completion(fit=toy_fit())), truths=(toy_completion().mesh,)))
    panels: Any = page.panels
    for name, value, shown, hidden in (
        ("observed", False, set(), {"/objects/0/observed"}),
        ("sigma", True, {"/objects/0/sigma"}, {"/objects/0/mesh"}),
        ("parts", True, {"/objects/0/parts"}, {"/objects/0/sigma"}),
        ("primitive", True, {"/objects/0/primitive"}, set()),
        ("truth", True, {"/truth/0"}, set()),
    ):
        panels.switches[name].value = value
        panels.switches[name].on["update"](None)
        assert shown <= page.visible()
        assert not hidden & page.visible()
    assert panels.legend.content == scale_legend(3.0)
    panels.slider.value = 1
    panels.slider.on["update"](None)
    assert page.visible("/grasps/0/") == {"/grasps/0/0"}
    panels.playing = True
    panels.refresh()
    assert page.visible("/grasps/0/") == set()
    panels.switches["sigma"].value = False
    panels.refresh()
    assert panels.legend.content == surface_legend()


def test_several_objects_have_a_folder_each_with_a_switch_for_all_of_the_object() -> None:
    page = Page(scene(toy_item("red"), toy_item("blue", 7, completion=toy_completion((0.3, 0.0, 0.05)))))
    folders = [handle.arguments[0] for handle in page.server.gui.added if handle.kind == "folder"]
    assert folders == ["Show", "red", "blue"]
    _, box = page.panels.boxes
    assert (box.arguments, page.panels.slider.max) == (("show", True), 7)  # type: ignore[attr-defined]
    box.value = False
    box.on["update"](None)  # type: ignore[attr-defined]
    assert page.panels.state().hidden == {1}
    assert not page.visible("/objects/1")
    assert page.visible("/objects/0")
    tables = [handle.content for handle in page.server.gui.added if handle.kind == "html"]
    assert tables[1] == table(item_rows(toy_item("red")))


def test_a_scene_s_own_folder_has_its_facts_and_notes_and_a_lone_object_has_no_switch() -> None:
    page = Page(scene(toy_item("red"), facts=(("mass", "3 g"),), notes=("careful",)))
    folders = [handle.arguments[0] for handle in page.server.gui.added if handle.kind == "folder"]
    assert folders == ["Show", "own", "red"]
    assert not page.panels.boxes
    assert page.server.gui.added[-3].content == table((("mass", "3 g"),), ("careful",))
    for more in ({"facts": (("a", "b"),)}, {"notes": ("a",)}):
        assert "own" in Page(scene(toy_item("red"), **more)).server.gui.named("folder")
    assert "own" not in Page(scene(toy_item("red"))).server.gui.named("folder")


def test_where_nothing_was_completed_that_is_told_and_the_truth_is_shown() -> None:
    page = Page(scene(truths=(toy_completion().mesh,)))
    assert "nothing was completed" in page.server.gui.added[-1].content
    assert page.visible() == {"/truth/0"}
    assert page.panels.slider.max == 1
    noted = Page(scene(notes=("failed",)))
    assert noted.server.gui.added[-1].content == table((), ("failed",))


def test_the_next_scene_takes_the_place_of_the_one_before_and_switches_keep_their_state() -> None:
    first = scene(toy_item("red", 6), toy_item("blue", completion=toy_completion((0.3, 0.0, 0.05))))
    page = Page(first)
    page.panels.switches["parts"].value = True
    page.panels.slider.value = 6
    before = list(page.panels.folders)
    second = scene(toy_item("green", 2), truths=(toy_completion().mesh,))
    page.layers = Layers(page.server, second)
    assert not page.panels.switches["truth"].visible
    page.panels.put(second, page.layers)
    assert all(folder.removed for folder in before)  # type: ignore[attr-defined]
    assert len(before) == 2
    assert [folder.arguments for folder in page.panels.folders] == [("green",)]  # type: ignore[attr-defined]
    assert page.panels.boxes == []
    assert (page.panels.slider.max, page.panels.slider.value) == (2, 2)
    assert page.panels.switches["truth"].visible
    assert "/objects/0/parts" in page.visible()
    page.panels.clear()
    assert page.panels.layers is None
    assert page.panels.folders == []


@pytest.mark.parametrize("value", [0, 3])
def test_as_many_grasps_are_shown_as_the_slider_says(value: int) -> None:
    page = Page(scene(toy_item("red", 5)))
    page.panels.slider.value = value
    page.panels.refresh()
    assert len(page.visible("/grasps/0/")) == value
