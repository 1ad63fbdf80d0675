"""Nodes of the viewer's scene: their names, shapes, places, colours and what moves and hides them."""

from typing import Any

import numpy as np
import pytest
import trimesh
from toy_completions import EXTENTS, toy_completion, toy_fit, toy_image, toy_item
from toy_server import ToyServer
from toy_street import toy_street

from gfp_grasp.drawing import ClassColours, Item, apart, gripper_mesh, scan_points
from gfp_grasp.transforms import quat_wxyz, rotation_about, rotation_between
from gfp_grasp.types import SupportPlane
from gfp_grasp.view.layers import (
    Layers,
    Switches,
    grasp_colour,
    scale_colours,
    scale_end_mm,
    scale_stops,
)
from gfp_grasp.view.panels import surface_legend
from gfp_grasp.view.scene import ShownScene

UP = np.array([0.0, 0.0, 1.0])
SEEN, GUESSED = (58, 118, 201), (236, 157, 56)


def scene(*items: Item, **more: Any) -> ShownScene:
    return ShownScene("own", items, more.pop("image", None), more.pop("up", UP), **more)


def drawn(shown: ShownScene) -> tuple[Layers, dict[str, Any]]:
    """The layers, and the handles of all nodes by name."""
    server = ToyServer()
    layers = Layers(server, shown)  # type: ignore[arg-type]
    handles = {handle.arguments[0]: handle for handle in server.scene.added}
    assert layers.nodes == handles
    return layers, handles


def test_an_object_has_a_node_for_each_layer_and_grasp() -> None:
    mask = np.zeros((24, 32), dtype=bool)
    mask[3, 4:9] = True
    fitted = toy_completion(fit=toy_fit(), view=toy_image(0.45), mask=mask)
    layers, nodes = drawn(scene(toy_item(completion=fitted), image=toy_image(0.45), truths=(fitted.mesh,)))
    kinds = {name: handle.kind for name, handle in nodes.items()}
    assert kinds == {
        "/objects/0": "frame",
        "/objects/0/observed": "point_cloud",
        "/objects/0/mesh": "mesh_trimesh",
        "/objects/0/sigma": "mesh_trimesh",
        "/objects/0/parts": "mesh_trimesh",
        "/objects/0/primitive": "mesh_simple",
        "/objects/0/cluster": "point_cloud",
        "/grasps/0": "frame",
        "/grasps/0/0": "mesh_simple",
        "/grasps/0/1": "mesh_simple",
        "/grasps/0/2": "mesh_simple",
        "/scene/points": "point_cloud",
        "/scene/grid": "grid",
        "/truth/0": "mesh_simple",
    }
    assert nodes["/objects/0"].named == nodes["/grasps/0"].named == {"show_axes": False}
    assert not nodes["/truth/0"].visible
    assert layers.end_mm == 3.0  # 95 % of the vertices are below 2.4 mm


def test_meshes_are_in_place_and_have_the_colours_of_their_layers() -> None:
    item = toy_item(completion=toy_completion(fit=toy_fit()))
    completion = item.completion
    _, nodes = drawn(scene(item, truths=(completion.mesh,)))
    colours = {}
    for name in ("mesh", "sigma"):
        mesh = nodes[f"/objects/0/{name}"].arguments[1]
        np.testing.assert_array_equal(mesh.vertices, completion.mesh.vertices)
        np.testing.assert_array_equal(mesh.faces, completion.mesh.faces)
        colours[name] = mesh.visual.vertex_colors[:, :3]
    np.testing.assert_array_equal(colours["mesh"], [SEEN if low else GUESSED for low in completion.observed])
    np.testing.assert_array_equal(colours["sigma"], scale_colours(completion.sigma_m, 3.0))
    parts = nodes["/objects/0/parts"].arguments[1]
    np.testing.assert_allclose(parts.vertices, np.concatenate([part.vertices for part in completion.parts]))
    np.testing.assert_array_equal(parts.visual.vertex_colors[:, :3], np.repeat(apart(2), 8, axis=0))
    _, vertices, faces = nodes["/objects/0/primitive"].arguments
    np.testing.assert_array_equal(vertices, toy_fit().vertices_world())
    np.testing.assert_array_equal(faces, toy_fit().primitive.faces)
    assert nodes["/objects/0/primitive"].named == {"color": (120, 60, 150), "wireframe": True}
    assert nodes["/truth/0"].named == {"color": (70, 160, 110), "opacity": 0.45}
    np.testing.assert_array_equal(nodes["/truth/0"].arguments[1], completion.mesh.vertices)


def test_grasps_are_open_grippers_the_best_one_green() -> None:
    item = toy_item(num_grasps=8)
    _, nodes = drawn(scene(item))
    for rank, grasp in enumerate(item.grasps):
        np.testing.assert_array_equal(nodes[f"/grasps/0/{rank}"].arguments[1], gripper_mesh(grasp).vertices)
    looks = [nodes[f"/grasps/0/{rank}"].named for rank in range(8)]
    assert all((look["flat_shading"], look["cast_shadow"]) == (True, False) for look in looks)
    assert [look["color"] for look in looks] == [(40, 160, 70), *[(110, 116, 124)] * 7]
    opacities = [look["opacity"] for look in looks]
    assert opacities[:3] == pytest.approx([0.85, 0.45, 0.36])
    assert opacities[-2:] == pytest.approx([0.45 * 0.8**5, 0.12])
    assert grasp_colour(15) == ((110, 116, 124), 0.12)


def test_a_street_has_the_colours_of_its_classes_grey_points_and_no_grid() -> None:
    street = toy_street()
    items = [Item(name, completion) for name, completion in zip(street.names, street, strict=True)]
    layers, nodes = drawn(scene(*items, street=street))
    colours = ClassColours.of(["car", "car", "pedestrian"])
    for number, completion in enumerate(street):
        shown = nodes[f"/objects/{number}/mesh"].arguments[1].visual.vertex_colors[:, :3]
        np.testing.assert_array_equal(shown, colours.of_vertices(completion.category, completion.observed))
    _, points, greys = nodes["/scene/points"].arguments
    np.testing.assert_array_equal(points, scan_points(street))
    assert (greys == greys[:, :1]).all()
    assert nodes["/scene/points"].named["point_size"] == pytest.approx(25 * 0.0014)
    assert "/scene/grid" not in nodes
    assert layers.colours is not None
    assert "pedestrian" in surface_legend(layers.colours)
    assert "guessed" in surface_legend(layers.colours)


def test_points_are_small_and_those_of_an_object_are_thinned() -> None:
    _, nodes = drawn(scene(toy_item(completion=toy_completion(num_points=1501))))
    name, points, colour = nodes["/objects/0/observed"].arguments
    assert (len(points), colour) == (751, (24, 40, 70))
    assert nodes[name].named == {"point_size": 0.001, "precision": "float32"}
    _, nodes = drawn(scene(toy_item(completion=toy_completion(num_points=1500))))
    assert len(nodes["/objects/0/observed"].arguments[1]) == 1500


def test_points_of_the_scene_are_grey_and_each_cluster_has_a_colour_and_moves_with_its_object() -> None:
    image, masks = toy_image(0.45), np.zeros((2, 24, 32), dtype=bool)
    masks[0, 3, 4:9], masks[1, 10, 4:7] = True, True
    items = [
        toy_item(f"mug-{n}", completion=toy_completion((0.01 * n, 0.0, 0.05), view=image, mask=mask))
        for n, mask in enumerate(masks)
    ]
    _, nodes = drawn(scene(*items, image=image))
    for number, num in enumerate((5, 3)):
        _, points, colour = nodes[f"/objects/{number}/cluster"].arguments
        np.testing.assert_allclose(points, image.points()[masks[number]], atol=1e-9)
        assert len(points) == num
        np.testing.assert_array_equal(colour, apart(2)[number])
        assert nodes[f"/objects/{number}/cluster"].named["point_size"] == 0.0008
    _, points, colours = nodes["/scene/points"].arguments
    assert len(points) == 24 * 32 - 8
    assert nodes["/scene/points"].named["point_size"] == 0.0014
    np.testing.assert_array_equal(np.unique(colours, axis=0), [(120, 120, 126)])  # 5 cm above the support
    _, nodes = drawn(scene(*items, image=toy_image(0.5)))
    np.testing.assert_array_equal(np.unique(nodes["/scene/points"].arguments[2], axis=0), [(176, 176, 170)])


def test_grid_lies_on_the_support_under_the_first_object() -> None:
    normal = np.array([0.0, 0.6, 0.8])
    completion = toy_completion((0.1, 0.2, 0.3), support=SupportPlane(normal, 0.1))
    layers, nodes = drawn(scene(toy_item(completion=completion), up=normal))
    grid = nodes["/scene/grid"]
    assert grid.arguments == ("/scene/grid", 1.0, 1.0)
    np.testing.assert_allclose(grid.named.pop("position"), np.array([0.1, 0.2, 0.3]) - 0.26 * normal)
    np.testing.assert_allclose(grid.named.pop("wxyz"), quat_wxyz(rotation_between(UP, normal)))
    lines = {"cell_color": (222, 222, 218), "section_color": (222, 222, 218)}
    assert grid.named == {"cell_size": 0.05, "section_size": 0.1, **lines}
    (up,) = layers.server.scene.set["set_up_direction"]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(up, normal)
    _, nodes = drawn(scene(toy_item(completion=toy_completion(support=None))))
    assert "/scene/grid" not in nodes


def test_several_objects_have_their_names_above_them_and_a_lone_one_has_none() -> None:
    up = np.array([0.0, 1.0, 0.0])
    items = (toy_item("red"), toy_item("blue", completion=toy_completion((0.3, 0.0, 0.05))))
    _, nodes = drawn(scene(*items, up=up))
    for number, name in enumerate(("red", "blue")):
        label = nodes[f"/objects/{number}/name"]
        assert (label.kind, label.arguments[1]) == ("label", name)
        assert label.named["position"][1] == pytest.approx(EXTENTS[1] / 2 + 0.02)
    assert "/objects/0/name" not in drawn(scene(items[0]))[1]


def test_an_object_moves_with_its_truth_and_all_is_removed_from_the_leaves_on() -> None:
    completion = toy_completion()
    layers, nodes = drawn(scene(toy_item(), truths=(completion.mesh,)))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_about(UP, 0.3), (0.1, 0.2, 0.3)
    layers.move(0, T)
    layers.move(7, T)  # there is none
    for name in ("/objects/0", "/truth/0"):
        np.testing.assert_allclose(nodes[name].wxyz, quat_wxyz(T[:3, :3]))
        np.testing.assert_array_equal(nodes[name].position, (0.1, 0.2, 0.3))
    order: list[str] = []
    for name, handle in nodes.items():
        handle.remove = lambda name=name: order.append(name)
    layers.remove()
    assert not layers.nodes
    assert sorted(order) == sorted(nodes)
    assert all(order.index(f"/objects/0/{leaf}") < order.index("/objects/0") for leaf in ("mesh", "parts"))


def test_switches_hide_and_show_nodes() -> None:
    items = (toy_item("a"), toy_item("b", 6, completion=toy_completion((0.3, 0.0, 0.05))))
    layers, nodes = drawn(scene(*items, truths=(trimesh.creation.box(),)))
    ranks = [rank for rank in range(6) if nodes[f"/grasps/1/{rank}"].visible]
    assert ranks == [0, 1, 2, 3]
    layers.show(Switches(truth=True, mesh=False, num_grasps=1, hidden=frozenset({0})))
    visible = {name for name, node in nodes.items() if node.visible}
    assert visible == {
        *("/scene/grid", "/objects/1", "/objects/1/observed", "/objects/1/name", "/grasps/1", "/grasps/1/0"),
        "/truth/0",
    }


def test_colours_of_parts_are_far_apart_and_known() -> None:
    np.testing.assert_array_equal(apart(4), [(204, 103, 230), (48, 191, 121), (153, 87, 69), (57, 70, 230)])


def test_scale_s_stops_are_those_of_viridis() -> None:
    assert scale_stops() == ("#440154", "#3b528b", "#21918c", "#5ec962", "#fde725")
    sigma = np.array([0.0, 0.0005, 0.001, 0.0015, 0.002])
    rows = [bytes(row).hex() for row in scale_colours(sigma, 2.0)]
    assert tuple(f"#{row}" for row in rows) == scale_stops()


@pytest.mark.parametrize("end", [1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0])
def test_ends_of_the_scale_are_round(end: float) -> None:
    assert scale_end_mm([np.full(5, 0.00099 * end), np.array([])]) == end
    few = np.concatenate([np.full(96, 0.0009 * end), np.full(4, 1.0)])
    many = np.concatenate([np.full(94, 0.0009 * end), np.full(6, 1.0)])
    assert (scale_end_mm([few]), scale_end_mm([many])) == (end, 500.0)
