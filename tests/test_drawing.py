"""What pages draw with: pictures, films, charts, HTML, and objects with their grasps."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from gfp_grasp.camera import intrinsics
from gfp_grasp.drawing import (
    apart,
    bracket_chart,
    escaped,
    every_nth,
    gripper_mesh,
    html_page,
    joined_boxes,
    overlay,
    paint_objects,
    reasons_chart,
    reasons_legend,
    spoken,
    without_paths,
    write_bars,
    write_clip,
    write_confusion,
    write_curves,
    write_depth,
    write_front,
)
from gfp_grasp.drawing.charts import _HATCHES
from gfp_grasp.drawing.pictures import FRAME_PX, film_camera
from gfp_grasp.transforms import apply_T, make_T, random_rotation
from gfp_grasp.types import REASONS, DepthImage, Grasp


def test_depth_picture_is_lighter_where_it_is_nearer_and_grey_where_nothing_came_back(tmp_path: Path) -> None:
    depth = np.linspace(0.4, 0.8, 64 * 48).reshape(48, 64).astype(np.float32)
    depth[0] = 0
    write_depth(tmp_path / "depth.png", depth)
    picture = np.asarray(Image.open(tmp_path / "depth.png")).astype(float)
    assert np.ptp(picture[0], axis=-1).max() <= 10
    assert (np.diff(picture[1:].sum(axis=2).mean(axis=1)) < 0).all()


def test_picture_without_any_return_is_still_written(tmp_path: Path) -> None:
    write_depth(tmp_path / "depth.png", np.zeros((4, 4), np.float32))
    assert Image.open(tmp_path / "depth.png").size == (4, 4)


def test_clip_has_all_frames_and_repeats(tmp_path: Path) -> None:
    frames = [np.full((20, 30, 3), 20 * k, np.uint8) for k in range(5)]
    write_clip(tmp_path / "clip.gif", frames)
    with Image.open(tmp_path / "clip.gif") as clip:
        assert clip.n_frames == 5  # pyright: ignore[reportAttributeAccessIssue]
        assert clip.info["loop"] == 0
        clip.seek(3)
        assert abs(int(np.asarray(clip.convert("RGB")).mean()) - 60) <= 2


def test_gripper_mesh_opens_along_y_by_its_width_and_approaches_along_z() -> None:
    grasp = Grasp(np.eye(4), 0.05)
    mesh = gripper_mesh(grasp)
    between = np.abs(mesh.vertices[:, 1])[mesh.vertices[:, 2] > -0.01]
    assert between.min() == pytest.approx(0.025)
    assert mesh.vertices[:, 2].max() < 0.02
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = random_rotation(np.random.default_rng(0)), (0.1, 0.2, 0.3)
    np.testing.assert_allclose(gripper_mesh(Grasp(T, 0.05)).vertices, apply_T(T, mesh.vertices), atol=1e-12)


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize("yaw_deg", range(0, 180, 30))
def test_the_film_shows_both_jaws_and_the_whole_lift(alone: bool, yaw_deg: int) -> None:
    closing = np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg)), 0.0])
    R = np.column_stack([np.cross(closing, (0, 0, -1)), closing, (0, 0, -1)])
    camera = film_camera(Grasp(make_T(R, (0, 0, 0.1)), 0.06), alone=alone)
    width, height = FRAME_PX
    jaws = 0.03 * np.array([closing, -closing]) + (0, 0, 0.1)
    lifted = np.concatenate([jaws, [[0, 0, 0.0], [0, 0, 0.1 + 0.2 + 0.16]]])
    pixels, _ = DepthImage(np.zeros((height, width)), intrinsics(width, height, 35.0), camera).project(lifted)
    assert ((pixels > 0) & (pixels < (width, height))).all()
    assert abs(pixels[0, 0] - pixels[1, 0]) > 0.06 * height  # seen from along the jaws there would be no gap


@pytest.mark.parametrize("yaw_deg", range(0, 360, 45))
def test_a_gripper_that_comes_from_the_side_hides_nothing(yaw_deg):
    yaw = np.radians(yaw_deg)
    approach = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    closing = np.array([-approach[1], approach[0], 0.0])
    T = make_T(np.column_stack([np.cross(closing, approach), closing, approach]), (0, 0, 0.1))
    camera = film_camera(Grasp(T, 0.06), alone=True)
    sight = camera[:3, 2] * (1, 1, 0) / np.linalg.norm(camera[:2, 2])
    assert sight @ approach == pytest.approx(np.cos(np.deg2rad(55)), abs=1e-6)


def test_the_overlay_shows_what_is_missing_dark_and_what_is_too_much_light():
    truth = trimesh.creation.box(bounds=((-0.03, -0.03, 0.0), (0.03, 0.03, 0.10)))
    tall = trimesh.creation.box(bounds=((-0.03, -0.03, 0.0), (0.03, 0.03, 0.14)))
    for shapes, dark_on_top in (((tall, truth), True), ((truth, tall), False)):
        picture = overlay(*shapes, seen_from=np.array([0.5, 0.0, 0.4])).astype(int)
        assert picture.shape == (300, 600, 3)
        for panel in (picture[:, :300], picture[:, 300:]):
            blue = panel[..., 2] - panel[..., 0]
            top = blue[np.abs(blue).max(axis=1) > 30][:40]  # the first rows of what is coloured
            assert (top.max() > 60) if dark_on_top else (top.min() < -60)


def test_shapes_that_agree_are_mixed_and_the_truth_alone_is_drawn_where_nothing_was_completed():
    ball = trimesh.creation.icosphere(radius=0.05)
    ball.apply_translation((0, 0, 0.05))
    alone = overlay(ball, None, seen_from=np.array([0.5, 0.0, 0.4])).astype(int)
    both = overlay(ball, ball, seen_from=np.array([0.5, 0.0, 0.4])).astype(int)
    assert alone[150, 150, 2] > alone[150, 150, 0] + 40
    np.testing.assert_allclose(both[150, 150, 0] - alone[150, 150, 0], 0.39 * 255 * _brightness(alone), atol=12)


def _brightness(picture: np.ndarray) -> float:
    """Of the middle pixel, whose colour is known but for it."""
    return float(picture[150, 150, 2] / (0.62 * 255))


@pytest.mark.parametrize(
    ("words", "left"),
    [
        ("/a/b/c.ply is none", "c.ply is none"),
        ("in '/a/b': 3/4 m/s, gfpnet/top-down", "in 'b': 3/4 m/s, gfpnet/top-down"),
        (r"C:\users\me\mug.obj", "mug.obj"),
        ("cup / mug", "cup / mug"),
    ],
)
def test_folders_are_taken_out_of_absolute_paths_alone(words, left):
    assert without_paths(words) == left


def test_every_reason_has_a_hatch_of_its_own():
    assert tuple(_HATCHES) == REASONS
    assert len({(strokes, colour) for colour, strokes, _ in _HATCHES.values()}) == len(REASONS)


def figures(successes: int, attempts: int, low: float, high: float, **more: object) -> dict:
    reasons = {"held": successes, "no_contact": attempts - successes}
    rates = {"attempts": attempts, "successes": successes, "success_rate": successes / attempts, "ci95": [low, high]}
    return {**rates, "reasons": {reason: n for reason, n in reasons.items() if n}, **more}


def test_whiskers_run_from_one_end_of_the_interval_to_the_other_in_both_worlds():
    summaries = {"own": figures(1, 4, 0.05, 0.7, completed_world=figures(2, 4, 0.15, 0.85))}
    chart = ElementTree.fromstring(bracket_chart(summaries, ("oracle", "observed")))
    ends = {}
    for world in ("true", "completed"):
        (path,) = chart.iterfind(f"g[@class='{world}']/path")
        words = (path.get("d") or "").replace("M", " ").replace("H", " ").replace(",", " ").split()
        ends[world] = (float(words[0]), float(words[5]))
    assert ends == {"true": (10 + 400 * 0.05, 10 + 400 * 0.7), "completed": (10 + 400 * 0.15, 10 + 400 * 0.85)}
    assert chart.find("rect[@class='between']") is None  # no brackets were scored
    assert not chart.findall("path[@class='bracket']")


def test_the_space_between_brackets_is_filled_from_the_lower_to_the_higher():
    summaries = {
        name: figures(held, 4, 0.0, 1.0, completed_world=figures(held, 4, 0.0, 1.0))
        for name, held in (("oracle", 3), ("own", 2), ("observed", 1))
    }
    chart = ElementTree.fromstring(bracket_chart(summaries, ("oracle", "observed")))
    (between,) = chart.iterfind("rect[@class='between']")
    assert (float(between.get("x", "")), float(between.get("width", ""))) == (110.0, 200.0)
    grid = [
        float((path.get("d") or "").split(",")[0].removeprefix("M")) for path in chart.iterfind("path[@class='grid']")
    ]
    assert grid == [10.0, 110.0, 210.0, 310.0, 410.0]
    counts = [text.text for text in chart.iterfind("text") if "/" in (text.text or "")]
    assert counts == ["3/4", "3/4", "2/4", "2/4", "1/4", "1/4"]


def test_parts_of_a_bar_stand_side_by_side_and_the_legend_has_the_reasons_that_were_met():
    summaries = {"own": figures(1, 4, 0.0, 1.0)}
    bars = ElementTree.fromstring(reasons_chart(summaries)).findall("rect")
    lefts, widths = ([float(bar.get(name, "")) for bar in bars] for name in ("x", "width"))
    assert (lefts, widths) == ([10.0, 125.0], [115.0, 345.0])
    legend = reasons_legend(summaries)
    assert [reason for reason in REASONS if spoken(reason) in legend] == ["held", "no_contact"]


def test_bars_are_as_long_as_their_distance_and_the_longest_fills_its_panel(tmp_path: Path):
    rows = {
        "cup": {"gfpnet": {"cd_m": 0.004}, "other": {"cd_m": 0.012}},
        "all": {"gfpnet": {"cd_m": 0.006}, "other": {}},
    }
    drawing = ElementTree.parse(write_bars(rows, tmp_path / "rows.svg", title="T")).getroot()
    bars = [bar for bar in drawing.iter("{http://www.w3.org/2000/svg}rect") if bar.get("x")]
    lengths = [float(bar.get("width", "")) for bar in bars]
    assert lengths == pytest.approx([80.0, 240.0, 120.0], abs=0.06)
    assert len({bar.get("fill") for bar in bars}) == 2  # the package's default stands out
    assert bars[0].get("fill") == bars[2].get("fill")


def test_curves_of_all_panels_stand_at_their_values_over_one_two_three(tmp_path: Path):
    panels = {"left": {"a": [4.0, 2.0, 1.0], "b": [3.0]}, "right": {"c": [2.0, 5.0, 3.0]}}
    chart = write_curves(panels, tmp_path / "lines.svg", title="T", axis="iterations")
    lines = _polylines(ElementTree.parse(chart).getroot())
    heights = np.concatenate([line[:, 1] for line in lines])
    values = np.array([4.0, 2.0, 1.0, 3.0, 2.0, 5.0, 3.0])
    slope, height = np.polyfit(values, heights, 1)
    np.testing.assert_allclose(heights, slope * values + height, atol=0.06)
    assert slope < 0  # more is higher up
    np.testing.assert_allclose(np.diff(lines[0][:, 0]), np.diff(lines[2][:, 0]), atol=0.11)
    assert lines[2][0, 0] > lines[0][2, 0]  # beside each other
    levels = ElementTree.parse(chart).getroot().findall("{http://www.w3.org/2000/svg}line")
    told = [(float(line.get("y1", "")) - height) / slope for line in levels]
    np.testing.assert_allclose(told, [1, 2, 3, 4, 5] * 2, atol=0.01)


def test_a_front_stands_as_a_stair_at_ratios_of_time_and_the_papers_network_is_marked(tmp_path: Path):
    rows = [{"name": n, "ms": m, "cd_units": c} for n, m, c in (("a", 1.0, 9.0), ("b", 10.0, 8.0), ("c", 100.0, 5.0))]
    far = {"name": "d", "ms": 100.0, "cd_units": 9.0}
    chart = write_front([*rows, far], rows, far, tmp_path / "front.svg", title="T")
    drawing = ElementTree.parse(chart).getroot()
    dots = drawing.findall("{http://www.w3.org/2000/svg}circle")
    assert len(dots) == 4 + 3  # those of the front once more, upon the others
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = ((float(d.get("cx", "")), float(d.get("cy", ""))) for d in dots[:4])
    assert cx - bx == pytest.approx(bx - ax, abs=0.11)
    assert cy - by == pytest.approx(3 * (by - ay), abs=0.2)
    assert ax < bx < cx
    assert ay < by < cy
    stair, diamond, _ = drawing.findall("{http://www.w3.org/2000/svg}path")
    assert stair.get("d") == f"M{ax},{ay} H{bx} V{by} H{cx} V{cy}"
    assert str(diamond.get("d")).startswith(f"M{dx},{dy - 8:.1f} ")


def _polylines(drawing: ElementTree.Element) -> list[np.ndarray]:
    lines = drawing.findall("{http://www.w3.org/2000/svg}polyline")
    return [
        np.array([[float(n) for n in pair.split(",")] for pair in (line.get("points") or "").split()]) for line in lines
    ]


def test_a_confusion_is_as_dark_as_a_class_is_often_named_and_tells_what_is_wrong(tmp_path: Path):
    rows = {"cup": [3, 1, 0], "jar": [0, 0, 8]}
    drawing = ElementTree.parse(write_confusion(rows, ["cup", "mug", "jar"], tmp_path / "a.svg", title="T")).getroot()
    squares = [square for square in drawing.iter("{http://www.w3.org/2000/svg}rect") if square.get("fill-opacity")]
    assert [float(square.get("fill-opacity", "")) for square in squares] == [0.75, 0.25, 0.0, 0.0, 0.0, 1.0]
    assert squares[0].get("fill") == squares[5].get("fill") != squares[1].get("fill") == squares[3].get("fill")
    words = [text.text for text in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert words[2:] == ["cup", "mug", "jar", "cup", "75", "25", "jar", "100"]


def test_every_nth_acts_at_the_first_call_and_then_at_each_nth():
    acted: list[int] = []
    on_step = every_nth(3, lambda: acted.append(1))
    counts = []
    for _ in range(8):
        on_step(None)
        counts.append(len(acted))
    assert counts == [1, 1, 1, 2, 2, 2, 3, 3]


def test_boxes_are_joined_with_eight_corners_each():
    boxes = np.array([[[0, 0, 0], [1, 1, 1]], [[2, 0, 0], [3, 2, 1]]], dtype=float)
    mesh = joined_boxes(boxes)
    assert mesh.vertices.shape == (16, 3)
    assert mesh.volume == pytest.approx(1.0 + 2.0)
    np.testing.assert_allclose(mesh.vertices[8:].min(axis=0), [2, 0, 0])


def test_a_page_escapes_its_title_and_names_no_place_of_the_machine():
    page = html_page("<b>", "<p>body</p>", css=".own {}", script="<i>last</i>")
    assert "<title>&lt;b&gt;</title>" in page
    assert page.index("<p>body</p>") < page.index("</main>") < page.index("<i>last</i>") < page.index("</body>")
    assert page.index(":root") < page.index(".own {}") < page.index("</style>")
    assert escaped('/some/place/"mug"') == "&quot;mug&quot;"
    assert spoken("slipped_on_lift") == "slipped on lift"


def test_objects_are_painted_in_their_own_colours_over_grey_depth() -> None:
    depth = np.linspace(0.5, 1.5, 24).reshape(4, 6)
    depth[0, 0] = 0.0
    first, second = np.zeros((4, 6), bool), np.zeros((4, 6), bool)
    first[1, 1:3], second[2, 4] = True, True
    picture = paint_objects(depth, [first, second])
    assert (picture.shape, picture.dtype) == ((4, 6, 3), np.uint8)
    assert picture[0, 0].tolist() == [26, 26, 26]  # nothing came back
    grey = picture[~(first | second)]
    assert (np.ptp(grey.astype(int), axis=1) == 0).all()
    assert picture[0, 1, 0] > picture[2, 1, 0] > picture[3, 4, 0]
    for mask, colour in ((first, apart(2)[0]), (second, apart(2)[1])):
        own = picture[mask].astype(float) - 0.65 * colour
        assert (np.ptp(own, axis=1) <= 1.5).all()  # what is left is grey


def test_nothing_that_came_back_is_a_dark_picture() -> None:
    assert (paint_objects(np.zeros((2, 3)), []) == 26).all()
