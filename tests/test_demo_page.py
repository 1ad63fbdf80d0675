"""The page of the demonstration: figures, captions and shapes of a scene are in it as they are."""

import base64
import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
from toy_completions import EXTENTS, toy_completion, toy_errors, toy_grasps, toy_item, toy_outcome

from gfp_grasp.demo.demo_scene import HEADINGS, DemoScene
from gfp_grasp.demo.page import write_page
from gfp_grasp.drawing import gripper_mesh
from gfp_grasp.types import SupportPlane


def page_of(folder: Path, *items: Any, **more: Any) -> str:
    scene = DemoScene("A <scene>", "Some & text", items, folder, **more)
    return write_page([scene], command="make <it>", notes=["a<b"])


def shapes_of(page: str) -> list[dict[str, Any]]:
    found = re.search(r'<script type="application/json" id="scenes">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


def array(words: str, kind: str, *shape: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(words), dtype=kind).reshape(*shape)


def section_of(page: str) -> ElementTree.Element:
    """The section of the first scene; what HTML leaves open is closed first."""
    text = page[page.index("<section") : page.index("</section>") + len("</section>")]
    return ElementTree.fromstring(re.sub(r"(<img [^>]*[^/])>", r"\1/>", text))


def test_table_says_which_columns_are_words_and_what_became_of_the_best_grasp(tmp_path: Path) -> None:
    held = toy_item(outcome=toy_outcome(), errors=toy_errors())
    failed = toy_item("<cup>", outcome=toy_outcome(False, "no_contact"))
    section = section_of(page_of(tmp_path, held, failed, toy_item("last", 0)))
    assert section.get("id") == "scene-0"
    assert [section.findtext("h2"), section.findtext("p")] == ["A <scene>", "Some & text"]
    heads = [(cell.text, cell.get("class"), cell.get("data-name")) for cell in section.iter("th")]
    words = {"object", "class", "best grasp"}
    assert heads == [(name, "word" if name in words else "", None) for name in HEADINGS]
    rows = [[(cell.text or "", cell.get("class"), cell.get("data-name")) for cell in row] for row in section.iter("tr")]
    assert not any(row.tail for row in section.iter("tr"))
    assert [cell[0] for cell in rows[1]] == ["mug-1", "mug", "", "4.2", "0.88", "2", "3", "held", "1.2", "0.1"]
    assert [cell[0] for cell in rows[2]] == ["<cup>", "mug", "", "?", "?", "2", "3", "no contact", "1.2", "0.1"]
    assert [cell[0] for cell in rows[3]][-4:] == ["0", "none found", "1.2", "0.1"]
    assert [row[7][1] for row in rows[1:]] == ["word held", "word failed", "word"]
    assert [cell[1] for cell in rows[1]] == ["word", "word", *[""] * 5, "word held", "", ""]
    assert [cell[2] for cell in rows[1]] == list(HEADINGS)


def test_pictures_are_in_the_page_under_their_captions(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"one")
    (tmp_path / "b.gif").write_bytes(b"other")
    section = section_of(page_of(tmp_path, toy_item(), pictures={"a.png": "near & far", "b.gif": "moves"}))
    images = [(image.get("src"), image.get("alt")) for image in section.iter("img")]
    assert images == [
        (f"data:image/png;base64,{base64.b64encode(b'one').decode()}", "near & far"),
        (f"data:image/gif;base64,{base64.b64encode(b'other').decode()}", "moves"),
    ]
    assert [caption.text for caption in section.iter("figcaption")] == ["near & far", "moves"]


def test_foot_names_command_and_notes_and_nothing_breaks_out_of_the_data(tmp_path: Path) -> None:
    page = page_of(tmp_path, toy_item("</script>"))
    assert "<code>make &lt;it&gt;</code>" in page
    assert "<p>a&lt;b</p>" in page
    assert "<title>gfp_grasp: one depth view, completed and grasped</title>" in page
    data = page[page.index('id="scenes">') :]
    assert "\\u003c/script>" in data[: data.index("</script>")]
    assert shapes_of(page)[0]["items"][0]["name"] == "</script>"
    assert data.count("<script>\n") == 1
    bare = write_page([DemoScene("t", "", (toy_item(),), tmp_path)], command="c")
    assert "<p>a&lt;b</p>" not in bare


def test_shapes_are_the_item_s_own(tmp_path: Path) -> None:
    truth = trimesh.creation.icosphere(subdivisions=1, radius=0.04)
    item = toy_item(truth=truth)
    (scene,) = shapes_of(page_of(tmp_path, item))
    (shapes,) = scene["items"]
    completion = item.completion
    assert (shapes["name"], shapes["at"], scene["floor"]) == ("mug-1", [0.0, 0.0, 0.05], 0.0)
    assert shapes["reach"] == pytest.approx(np.linalg.norm(EXTENTS) / 2, abs=1e-5)
    np.testing.assert_allclose(array(shapes["cloud"], "<f4", -1, 3), completion.detection.cloud.points, atol=1e-7)
    for name, mesh in (("completed", completion.mesh), ("truth", truth), ("gripper", gripper_mesh(toy_grasps(1)[0]))):
        np.testing.assert_allclose(array(shapes[name]["v"], "<f4", -1, 3), mesh.vertices, atol=1e-7)
        np.testing.assert_array_equal(array(shapes[name]["f"], "<u4", -1, 3), mesh.faces)
    seen = array(shapes["completed"]["seen"], "u1", -1)
    np.testing.assert_array_equal(seen, completion.observed)
    vertices, faces = array(shapes["parts"]["v"], "<f4", -1, 3), array(shapes["parts"]["f"], "<u4", -1, 3)
    np.testing.assert_array_equal(array(shapes["parts"]["part"], "<u2", -1), np.repeat([0, 1], 8))
    np.testing.assert_allclose(vertices, np.concatenate([part.vertices for part in completion.parts]), atol=1e-7)
    np.testing.assert_array_equal(faces[12:], completion.parts[1].faces + 8)


def test_what_is_unknown_is_left_out(tmp_path: Path) -> None:
    item = toy_item(num_grasps=0, completion=toy_completion(support=None))
    (scene,) = shapes_of(page_of(tmp_path, item))
    assert scene["floor"] is None
    assert set(scene["items"][0]) == {"name", "at", "reach", "cloud", "completed", "parts"}


@pytest.mark.parametrize(("num", "kept"), [(900, 900), (901, 451), (2700, 900)])
def test_a_cloud_of_more_than_900_points_is_thinned_evenly(num: int, kept: int, tmp_path: Path) -> None:
    item = toy_item(completion=toy_completion(num_points=num))
    points = array(shapes_of(page_of(tmp_path, item))[0]["items"][0]["cloud"], "<f4", -1, 3)
    assert len(points) == kept
    np.testing.assert_allclose(points, item.completion.detection.cloud.points[:: -(-num // 900)], atol=1e-7)


def test_the_page_is_turned_so_that_up_is_z_and_looks_from_aside_of_the_camera(tmp_path: Path) -> None:
    support = SupportPlane(np.array([1.0, 0.0, 0.0]), -0.2)
    completion = toy_completion(num_points=4, up=(1.0, 0.0, 0.0), viewpoint=(0.4, 0.5, 0.05), support=support)
    (scene,) = shapes_of(page_of(tmp_path, toy_item(completion=completion)))
    vertices = array(scene["items"][0]["completed"]["v"], "<f4", -1, 3)
    np.testing.assert_allclose(vertices[:, 2], completion.mesh.vertices[:, 0], atol=1e-7)
    assert scene["floor"] == -0.2
    # The turn that takes x to z takes z to -x and leaves y.
    _, y, z = np.array([0.4, 0.5, 0.05]) - completion.detection.cloud.points.mean(axis=0)
    assert scene["azimuth"] == round(np.arctan2(y, -z) + 0.7, 3)
    unknown = toy_item(completion=toy_completion(viewpoint=None))
    assert shapes_of(page_of(tmp_path, unknown))[0]["azimuth"] == 0.7
