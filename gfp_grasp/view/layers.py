"""A scene as nodes of viser's scene, in layers that can be shown or not; the names of nodes say what they are.

| name | node |
|---|---|
| /scene/points, /scene/grid | points that belong to no object; the support |
| /objects/NUMBER/LAYER | layers of an object: cluster, observed, mesh, sigma, parts, primitive, name |
| /grasps/NUMBER/RANK | grasps on an object, 0 is the best |
| /truth/NUMBER | true mesh |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from gfp_grasp.completion import lowest_support
from gfp_grasp.drawing import ClassColours, Item, apart, gripper_mesh, height_greys, level_frame_of, scan_points
from gfp_grasp.transforms import apply_T, quat_wxyz, rotation_between
from gfp_grasp.types import Grasp
from gfp_grasp.view.scene import SUPPORT, ShownScene, scene_cloud

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]


SEEN, GUESSED = (58, 118, 201), (236, 157, 56)
TABLE, SURROUNDINGS, LINES, OBSERVED = (176, 176, 170), (120, 120, 126), (222, 222, 218), (24, 40, 70)
TRUTH, PRIMITIVE = (70, 160, 110), (120, 60, 150)
BEST_GRASP, OTHER_GRASP, GRIPPER = (40, 160, 70), (110, 116, 124), (92, 98, 108)
# The least of these that covers so much of what is shown ends the scale.
_ENDS_MM = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0)
_COVERED = 0.95
# Five colours of viridis, which also those see apart who do not see red and green apart.
_SCALE = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=np.float64)
_BEST, _SECOND, _FADE, _FAINTEST = 0.85, 0.45, 0.8, 0.12  # opacities


def seen_colours(observed: np.ndarray) -> np.ndarray:
    """(v, 3) uint8 of vertices (v,) bool: SEEN or GUESSED."""
    return np.where(observed[:, None], np.array(SEEN, np.uint8), np.array(GUESSED, np.uint8))


def scale_end_mm(sigmas_m: Sequence[np.ndarray]) -> float:
    """End of the scale, mm: a round number that covers 95 % of the vertices of all that is shown."""
    if not any(len(sigma) for sigma in sigmas_m):
        return _ENDS_MM[0]
    high_mm = 1000 * float(np.quantile(np.concatenate(sigmas_m), _COVERED))
    return next((end for end in _ENDS_MM if end >= high_mm), _ENDS_MM[-1])


def scale_colours(sigma_m: np.ndarray, end_mm: float) -> np.ndarray:
    """(v, 3) uint8 of standard deviations (v,) m: dark violet at 0, yellow from the end of the scale on."""
    at = np.clip(1000 * np.asarray(sigma_m) / end_mm, 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(_SCALE))
    return np.column_stack([np.interp(at, stops, channel) for channel in _SCALE.T]).round().astype(np.uint8)


def scale_stops() -> tuple[str, ...]:
    """Colours of the scale from its beginning to its end, as CSS has them."""
    return tuple("#" + bytes(stop).hex() for stop in _SCALE.astype(int).tolist())


def grasp_colour(rank: int) -> tuple[tuple[int, int, int], float]:
    """Colour and opacity of the grasp of a rank: the best, 0, is green; the further down, the fainter."""
    if rank == 0:
        return BEST_GRASP, _BEST
    return OTHER_GRASP, max(_FAINTEST, _SECOND * _FADE ** (rank - 1))


# More points of an object than this hide the surface under them.
_MAX_OBSERVED = 1500
_OBSERVED_M, _CLUSTER_M, _SCENE_M = 0.001, 0.0008, 0.0014  # sizes of points
_IN_TRAFFIC = 25.0  # times these sizes are those of vehicles and people
_MAX_SCAN = 150_000
_TRUTH_OPACITY = 0.45
_GRID_M, _CELL_M, _LABEL_M = 1.0, 0.05, 0.02


@dataclass(frozen=True)
class Switches:
    """Which layers of a scene are visible.

    Attributes:
        scene: Points of the whole scene.
        observed: Points of each object.
        mesh: Completed mesh.
        sigma: The mesh in the colours of its uncertainty, in place of those of seen and guessed surface.
        parts: Convex parts, in place of the mesh.
        primitive: Wire mesh of the primitive as it was registered.
        truth: True mesh, translucent.
        num_grasps: Number of grasps on each object, the best first.
        hidden: Numbers of objects that are not shown at all.
    """

    scene: bool = True
    observed: bool = True
    mesh: bool = True
    sigma: bool = False
    parts: bool = False
    primitive: bool = False
    truth: bool = False
    num_grasps: int = 4
    hidden: frozenset[int] = frozenset()

    def shows(self, name: str) -> bool:
        """Whether a node is visible; a node without a switch of its own is, so that its children can be."""
        room, number, layer = (*name.strip("/").split("/"), "")[:3]
        if room == "scene":
            return self.scene if number == "points" else True
        if room == "truth":
            return self.truth
        if int(number) in self.hidden:
            return False
        if room == "grasps":
            return not layer or int(layer) < self.num_grasps
        surface = self.mesh and not self.parts
        layers = {
            "cluster": self.scene,
            "observed": self.observed,
            "mesh": surface and not self.sigma,
            "sigma": surface and self.sigma,
            "parts": self.parts,
            "primitive": self.primitive,
        }
        return layers.get(layer, True)


@dataclass(eq=False)
class Layers:
    """The nodes of one scene, by name.

    Attributes:
        server: Viser's server, whose scene the nodes are in.
        shown: The scene that they show.
        end_mm: End of the colour scale of sigma, mm.
        size: Sizes of points and labels, in multiples of those for things on tables.
        colours: Colours of the classes of a street; None where surface is blue or orange, seen or guessed.
        nodes: Handle of each node.
    """

    server: viser.ViserServer
    shown: ShownScene
    end_mm: float = field(init=False)
    size: float = field(init=False)
    colours: ClassColours | None = field(init=False)
    nodes: dict[str, viser.SceneNodeHandle] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.size = _IN_TRAFFIC if self.shown.in_traffic else 1.0
        street = self.shown.street
        self.colours = None if street is None else ClassColours.of([completion.category for completion in street])
        self.end_mm = scale_end_mm([item.completion.sigma_m for item in self.shown.items])
        with self.server.atomic():
            for number, item in enumerate(self.shown.items):
                self._draw_item(number, item)
            self._draw_scene()
            self.show(Switches())

    def show(self, switches: Switches) -> None:
        """Make visible what the switches say, and nothing else."""
        with self.server.atomic():
            for name, node in self.nodes.items():
                node.visible = switches.shows(name)

    def move(self, number: int, T_now_start: np.ndarray) -> None:
        """Move an object, its points and its truth by a rigid motion (4, 4) from where they were drawn."""
        for name in (f"/objects/{number}", f"/truth/{number}"):
            if name in self.nodes:
                self.nodes[name].wxyz = quat_wxyz(T_now_start[:3, :3])
                self.nodes[name].position = T_now_start[:3, 3]

    def remove(self) -> None:
        """Take all nodes out of the scene."""
        for name in sorted(self.nodes, reverse=True):  # children before their parents
            self.nodes[name].remove()
        self.nodes.clear()

    def _draw_scene(self) -> None:
        scene, shown = self.server.scene, self.shown
        scene.set_up_direction(shown.up)
        completions = [item.completion for item in shown.items]
        if shown.image is not None:
            points, labels = scene_cloud(shown.image, completions)
            colours = np.where(
                (labels == SUPPORT)[:, None], np.array(TABLE, np.uint8), np.array(SURROUNDINGS, np.uint8)
            )
            self._points("/scene/points", points[labels < 0], colours[labels < 0], _SCENE_M)
            for number, colour in enumerate(apart(len(completions))):  # each moves with its object
                self._points(f"/objects/{number}/cluster", points[labels == number], colour, _CLUSTER_M)
        if shown.street is not None:
            points = scan_points(shown.street)
            points = points[:: max(1, -(-len(points) // _MAX_SCAN))]
            greys = height_greys(apply_T(level_frame_of(shown.street), points)[:, 2])
            self._points("/scene/points", points, greys, _SCENE_M)
        for number, truth in enumerate(shown.truths):
            self._simple(f"/truth/{number}", truth, TRUTH, opacity=_TRUTH_OPACITY)
        if shown.street is None and (support := lowest_support(completions)) is not None:  # a scan shows its road
            middle = completions[0].mesh.bounds.mean(axis=0)
            self.nodes["/scene/grid"] = scene.add_grid(
                "/scene/grid",
                self.size * _GRID_M,
                self.size * _GRID_M,
                cell_size=self.size * _CELL_M,
                cell_color=LINES,
                section_size=2 * self.size * _CELL_M,
                section_color=LINES,
                wxyz=quat_wxyz(rotation_between((0.0, 0.0, 1.0), support.normal)),
                position=middle - support.distances(middle[None])[0] * support.normal,
            )

    def _draw_item(self, number: int, item: Item) -> None:
        at, completion, scene = f"/objects/{number}", item.completion, self.server.scene
        self.nodes[at] = scene.add_frame(at, show_axes=False)
        points = np.asarray(completion.detection.cloud.points)
        self._points(f"{at}/observed", points[:: max(1, -(-len(points) // _MAX_OBSERVED))], OBSERVED, _OBSERVED_M)
        own = self.colours
        seen = (
            seen_colours(completion.observed)
            if own is None
            else own.of_vertices(completion.category, completion.observed)
        )
        self._coloured(f"{at}/mesh", completion.mesh, seen)
        self._coloured(f"{at}/sigma", completion.mesh, scale_colours(completion.sigma_m, self.end_mm))
        colours = apart(len(completion.parts))
        shards = [
            _painted(part, np.tile(c, (len(part.vertices), 1)))
            for part, c in zip(completion.parts, colours, strict=True)
        ]
        self.nodes[f"{at}/parts"] = scene.add_mesh_trimesh(f"{at}/parts", _joined(shards))
        if (fit := completion.fit) is not None:
            wire = trimesh.Trimesh(fit.vertices_world(), fit.primitive.faces, process=False)
            self._simple(f"{at}/primitive", wire, PRIMITIVE, wireframe=True)
        if len(self.shown.items) > 1:
            top = completion.mesh.vertices[np.argmax(completion.mesh.vertices @ self.shown.up)]
            self.nodes[f"{at}/name"] = scene.add_label(
                f"{at}/name", item.name, position=top + self.size * _LABEL_M * self.shown.up
            )
        self.nodes[f"/grasps/{number}"] = scene.add_frame(f"/grasps/{number}", show_axes=False)
        for rank, grasp in enumerate(item.grasps):
            self._draw_grasp(f"/grasps/{number}/{rank}", grasp, rank)

    def _draw_grasp(self, name: str, grasp: Grasp, rank: int) -> None:
        colour, opacity = grasp_colour(rank)
        self._simple(name, gripper_mesh(grasp), colour, opacity=opacity, flat_shading=True, cast_shadow=False)

    def _simple(self, name: str, mesh: trimesh.Trimesh, colour: tuple[int, int, int], **look: Any) -> None:
        self.nodes[name] = self.server.scene.add_mesh_simple(
            name, np.asarray(mesh.vertices), np.asarray(mesh.faces), color=colour, **look
        )

    def _points(self, name: str, points: np.ndarray, colours: np.ndarray | tuple[int, int, int], size_m: float) -> None:
        self.nodes[name] = self.server.scene.add_point_cloud(
            name, points, colours, point_size=self.size * size_m, precision="float32"
        )

    def _coloured(self, name: str, mesh: trimesh.Trimesh, colours: np.ndarray) -> None:
        self.nodes[name] = self.server.scene.add_mesh_trimesh(name, _painted(mesh, colours))


def _painted(mesh: trimesh.Trimesh, colours: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colours, process=False)


def _joined(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))  # pyright: ignore[reportReturnType]
