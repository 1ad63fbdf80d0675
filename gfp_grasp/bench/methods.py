"""What the bench of completions compares: methods by name, and one standard and three hard protocols of views."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.camera import (
    SensorModel,
    apply_sensor,
    cast_rays,
    cloud_of,
    intrinsics,
    render_mesh_view,
    sample_viewpoint,
)
from gfp_grasp.complete import CompleteConfig, complete_to_mesh
from gfp_grasp.completers import (
    CONFIGS,
    PEER_COMPLETERS,
    InTrueBox,
    complete_as_observed,
    complete_without_class,
    get_completer,
    mirror_cloud,
)
from gfp_grasp.completion import Completion
from gfp_grasp.deform import DeformConfig, Method, diffuse, patch_layout, patch_unit_m
from gfp_grasp.detect import DetectConfig, detect_single
from gfp_grasp.errors import TooFewPoints
from gfp_grasp.meshes import sample_surface, vertex_normals
from gfp_grasp.peers import true_box
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, icp_config, pcrnet_config, size_of_extents
from gfp_grasp.train import ScansConfig, across_edge, rest_rotation, scan_of
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import (
    LIDAR,
    TABLETOP,
    DepthImage,
    Detection,
    OrientedBox,
    PointCloud,
    SensorProfile,
)

PROTOCOLS = ("standard", "noisy", "fallen", "hidden", "lidar")
# What the protocol of traffic looks at: everything that an HDL-64 sees of a thing at 7 to 16 m.
_SCANS = ScansConfig(distance_m=(7.0, 16.0), height_m=(1.73, 1.73), hidden_share=0.0, lost_share=0.1, num_points=20_000)
# What the noisy protocol's sensor does: blobs without return, and a quarter of the silhouette lost.
_NOISY = SensorModel(sigma_m=0.003, hole_share=0.08, hole_radius_px=3.0, edge_lost_share=0.25)
_LOOKS = 20  # scans that are tried until one has returns enough
_LIFT_M = 1e-4  # rays start this far off their own surface
_BOARD_M = 0.05  # how far in front of the object the board of the hidden protocol stands


@dataclass(frozen=True, eq=False)
class ObjectView:
    """One object as one camera saw it.

    Attributes:
        mesh: The true mesh, in the world's frame.
        T_world_object: (4, 4) pose of the object on the table.
        cloud: Points that the camera saw, with its viewpoint.
        image: The depth picture; None where a view is made of points alone.
        mask: (h, w) bool, the object's pixels in it that came back.
        sensor: What saw it.
    """

    mesh: trimesh.Trimesh
    T_world_object: np.ndarray
    cloud: PointCloud
    image: DepthImage | None = None
    mask: np.ndarray | None = None
    sensor: SensorProfile = TABLETOP


def view_object(
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    protocol: str = "standard",
    noise_m: float = 0.001,
    hidden_share: float = 0.5,
) -> ObjectView:
    """Put an object on a table of any height, by any yaw, and look at it from 0.6 m, 240x320, 35 degrees field.

    Args:
        mesh: True mesh, z up, m.
        rng: Draws place, view and noise.
        protocol: "standard" (20 to 60 degrees up), "noisy" (5 to 80 degrees, 3 mm of noise and dropouts), "fallen"
            (lying by any roll, or upside down), "hidden" (half of its pixels behind a nearer board, whose straight
            edge has any direction) or "lidar" (as it stands on a road, 7 to 16 m from an HDL-64 with its own noise).
        noise_m: Standard deviation of the depth noise; "noisy" has its own.
        hidden_share: Share of the pixels that "hidden" hides.
    """
    if protocol == "lidar":
        return _scanned(mesh, rng)
    height = float(rng.uniform(-0.3, 0.9))
    R = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi))
    if protocol == "fallen":
        R = R @ _fallen(rng)
    low = float((mesh.vertices @ R.T)[:, 2].min())
    T = make_T(R, (0.0, 0.0, height - low))
    placed = mesh.copy()
    placed.apply_transform(T)
    camera = sample_viewpoint(
        rng, elevation_deg=(5.0, 80.0) if protocol == "noisy" else (20.0, 60.0), target=placed.bounds.mean(axis=0)
    )
    K = intrinsics(320, 240, 35.0)
    image, index = render_mesh_view([placed], T_world_camera=camera, K=K, width=320, height=240, table_height=height)
    if protocol == "hidden":
        image, index = _behind_a_board(image, index, rng, share=hidden_share)
    image = apply_sensor(image, _NOISY if protocol == "noisy" else SensorModel.gaussian(noise_m), rng)
    mask = (index == 0) & (image.depth_m > 0)
    return ObjectView(placed, T, cloud_of(image, mask), image, mask)


def _scanned(mesh: trimesh.Trimesh, rng: np.random.Generator) -> ObjectView:
    for _ in range(_LOOKS):
        scanned = scan_of(mesh, rng, _SCANS)
        if scanned is not None:
            points, viewpoint, T = scanned
            placed = mesh.copy()
            placed.apply_transform(T)
            return ObjectView(placed, T, PointCloud(points, viewpoint), sensor=LIDAR)
    raise TooFewPoints(
        f"a mesh {np.round(mesh.extents, 2)} m in extent gave fewer than {_SCANS.least_points} returns in each of "
        f"{_LOOKS} scans at {_SCANS.distance_m} m: is it in metres?"
    )


def _fallen(rng: np.random.Generator) -> np.ndarray:
    """Rotation (3, 3) that turns a standing object upside down or onto any side."""
    if rng.random() < 0.5:
        return rest_rotation("upside_down")
    return rest_rotation("lying", rng.uniform(0, 2 * np.pi))


def _behind_a_board(
    image: DepthImage, index: np.ndarray, rng: np.random.Generator, *, share: float = 0.5
) -> tuple[DepthImage, np.ndarray]:
    along = across_edge(index.shape, rng.uniform(0, 2 * np.pi))
    board = along < np.quantile(along[index == 0], share)
    depth = np.where(board, image.depth_m[index == 0].min() - _BOARD_M, image.depth_m)
    return DepthImage(depth.astype(np.float32), image.K, image.T_world_camera), np.where(board, 1, index)


def in_sight(mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray, viewpoint: np.ndarray) -> np.ndarray:
    """(n,) bool, which points (n, 3) on a mesh's surface, with their normals, nothing hides from a viewpoint."""
    sight = viewpoint - points
    facing = np.einsum("ni,ni->n", sight, normals) > 0
    distance, _, _ = cast_rays([(np.asarray(mesh.vertices), np.asarray(mesh.faces))], points + _LIFT_M * normals, sight)
    return facing & ~np.isfinite(distance)


def extents_of(view: ObjectView) -> np.ndarray:
    """(3,) m, extents along the axes of the object as it stands."""
    upright = apply_T(invert_T(view.T_world_object), np.asarray(view.mesh.vertices))
    return np.ptp(upright, axis=0)


UNDEFORMED = "registration"
_BOUND = "-bound"  # of a row that registers: as good as any deformation of what was observed can make it
_OBSERVED = 6  # points that a patch has at least that observed something
_SURFACE = 40_000  # samples of the true surface
_ITERATIONS = range(1, 8)


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of a method to a view.

    Attributes:
        surface: A mesh, or points (n, 3) m where the method has none.
        completion: Completion that the library returned, for methods of the library.
    """

    surface: trimesh.Trimesh | np.ndarray
    completion: Completion | None = None


def run_method(
    name: str, view: ObjectView, category: str | None, given: str, *, library: PrimitiveLibrary | None = None
) -> Answer:
    """One method on one view.

    Args:
        name: One of METHODS or of `gfp_grasp.completers.PEER_COMPLETERS`. "truth" is the true mesh, as far from itself
            as two samplings of one surface are; "partial" the cloud as it is, "observed" its hull. Those that begin
            with "told-" (the paper's) are told the true class; those that end in "-sized" also get the true height and
            width, and those that end in "-true-box" the true box. "told-pcrnet-bound" deforms its fit perfectly
            wherever something was observed.
        view: The view; a method gets its cloud.
        category: Class that the other methods are told, or None.
        given: True class of the object.
        library: The classes that there are; None for those that ship.

    Raises:
        GfpGraspError: The method has no answer.
    """
    if name in _SIMPLE:
        return Answer(_SIMPLE[name](view))
    if name in PEER_COMPLETERS:
        return _answer_of_peer(name, view)
    config, tell = config_of(name, view, given, library=library)
    done = complete_to_mesh(
        view.cloud.points,
        viewpoint=view.cloud.viewpoint,
        category=given if tell else category,
        sensor=view.sensor,
        config=config,
    )
    return Answer(_bound(view, done), None) if _BOUND in name else Answer(done.mesh, done)


def _bound(view: ObjectView, done: Completion) -> trimesh.Trimesh:
    """The fit of an answer with every patch that observed something drawn onto the true surface, the rest following.

    No network that deforms where something was observed, and only there, does better on the same registration.
    """
    assert done.fit is not None
    primitive, vertices = done.fit.primitive, done.fit.vertices_world()
    index, unit_m = patch_layout(primitive)[0], patch_unit_m(primitive)
    reach_m = np.linalg.norm(vertices[index] - vertices[index[:, :1]], axis=2).max(axis=1)
    points = KDTree(view.cloud.points).query_ball_point(vertices[index[:, 0]], reach_m, return_length=True)
    observed = np.zeros(len(vertices))
    observed[index[points >= _OBSERVED]] = 1.0
    points, normals, _ = sample_surface(view.mesh, _SURFACE, np.random.default_rng(0))
    # Opposite walls are kept apart: a difference of normals of one unit counts like the patch unit.
    own = unit_m * vertex_normals(vertices, primitive.faces)
    belongs = KDTree(np.hstack([points, unit_m * normals])).query(np.hstack([vertices, own]))[1]
    moved = vertices + diffuse(primitive, points[belongs] - vertices, observed)
    return trimesh.Trimesh(moved, primitive.faces, process=False)


def _answer_of_peer(name: str, view: ObjectView) -> Answer:
    """Another network's answer; one that is told the true box gets that of the object as it stands."""
    upright = view.mesh.copy()
    upright.apply_transform(invert_T(view.T_world_object))
    done = ask_peer(name, _detection(view), true_box(upright, view.T_world_object))
    return Answer(done.mesh, done)


def ask_peer(name: str, detection: Detection, box: OrientedBox) -> Completion:
    """The completion of one of PEER_COMPLETERS, which is told the true box if that is its way."""
    complete = get_completer(name)
    return complete(detection, box) if isinstance(complete, InTrueBox) else complete(detection)


def is_told_class(name: str) -> bool:
    """Whether a method is told the true class, and so says nothing of a thing that has none."""
    return name.removesuffix("-sized") in _PAPER


def config_of(
    name: str, view: ObjectView | None = None, given: str = "", *, library: PrimitiveLibrary | None = None
) -> tuple[CompleteConfig, bool]:
    """Config of a row that registers a primitive, and whether the row is told the class."""
    library = library or PrimitiveLibrary.shipped()
    if name in _OWN:
        return replace(_OWN[name], library=library), False
    base = name.removesuffix("-sized").removesuffix(_BOUND)
    rigid, method = _PAPER[base]
    fit = rigid()
    if name.endswith("-sized"):
        assert view is not None
        fit = rigid(size=size_of_extents(library.primitive(given), extents_of(view)))
    deform = DeformConfig(method=method)
    config = CompleteConfig(library=library, rival_share=1.0, subcategories=False, fall_back=False)
    return replace(config, fit=fit, deform=deform), True


def _detection(view: ObjectView) -> Detection:
    config = DetectConfig(sensor=view.sensor, classify=False)  # the class is nothing to any method that asks for this
    return detect_single(view.cloud.points, viewpoint=view.cloud.viewpoint, up=np.array([0, 0, 1.0]), config=config)


def _standing(*, size: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> FitConfig:
    """PCRNet's registration where it is known that objects stand upright, as the paper's do."""
    return replace(pcrnet_config(size=size), hypotheses=("upright",))


def _without(**switches: object) -> CompleteConfig:
    """The default with switches of all refinements of its fit."""
    fit = FitConfig()
    laps = {name: replace(getattr(fit, name), **switches) for name in ("quick", "middle", "thorough")}
    return CompleteConfig(fit=replace(fit, **laps))


_SIMPLE: Mapping[str, Callable[[ObjectView], trimesh.Trimesh | np.ndarray]] = {
    "truth": lambda view: view.mesh,
    "partial": lambda view: view.cloud.points,
    "observed": lambda view: complete_as_observed(_detection(view)).mesh,
    "mirror": lambda view: mirror_cloud(_detection(view)),
    "classfree": lambda view: complete_without_class(_detection(view)).mesh,
}
_PAPER: Mapping[str, tuple[Callable[..., FitConfig], Method]] = {
    "told-icp": (icp_config, "none"),
    "told-pcrnet": (_standing, "none"),
    "told-pcrnet-gfs": (_standing, "gfs"),
    "told-pcrnet-gfpnet-oneshot": (_standing, "gfpnet-oneshot"),
    "told-pcrnet-gfpnet-paper": (_standing, "gfpnet-paper"),
}
SWITCHES: Mapping[str, CompleteConfig] = {
    "gfpnet-no-scale": _without(estimate_scale=False),
    "gfpnet-no-modes": _without(estimate_modes=False),
    "gfpnet-no-kinds": CompleteConfig(subcategories=False),
    "gfpnet-no-roundness": CompleteConfig(fit=FitConfig(roundness=False)),
    "gfpnet-no-free-space": _without(free_space=False),
    "gfpnet-no-support": _without(support=False),
    "gfpnet-no-symmetry": CompleteConfig(deform=DeformConfig(symmetry=False)),
    "gfpnet-pcrnet-start": CompleteConfig(fit=FitConfig(start="pcrnet")),
}
_OWN: Mapping[str, CompleteConfig] = {
    **{name: CONFIGS[name] for name in (UNDEFORMED, "gfs", "gfpnet-oneshot", "gfpnet")},
    "registration-no-modes": replace(SWITCHES["gfpnet-no-modes"], deform=DeformConfig(method="none")),
    **{
        f"gfpnet-paper-{m}": replace(CONFIGS["gfpnet-paper"], deform=DeformConfig(method="gfpnet-paper", iterations=m))
        for m in _ITERATIONS
    },
    **SWITCHES,
}
METHODS = (
    *_SIMPLE,
    *(f"{name}{sized}" for name in (*_PAPER, f"told-pcrnet{_BOUND}") for sized in ("", "-sized")),
    *_OWN,
)
BRIEF = (*_SIMPLE, "told-icp", UNDEFORMED, "gfs", "gfpnet-paper-5", "gfpnet")
# Names of rows in reports that were written before: the same method had another name as a completer.
FORMER_NAMES: Mapping[str, str] = {
    "hull": "observed",
    **{f"{name.removeprefix('told-')}{sized}": f"{name}{sized}" for name in _PAPER for sized in ("", "-sized")},
}

__all__ = ["BRIEF", "FORMER_NAMES", "METHODS", "SWITCHES", "UNDEFORMED", "Answer", "config_of", "run_method"]
