"""What the proposal network learns from: partial views of classes and other things, turned and thinned anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import detect_symmetry
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import FAMILIES, foreign_kinds, get_family, make_assorted, make_shape, split_seeds
from gfp_grasp.train.scans import ScansConfig
from gfp_grasp.train.views import View, ViewsConfig, cached_views, config_id, read_views, views_of_mesh, write_views
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LIDAR, TABLETOP, SensorProfile, SupportPlane

VIEWS = ViewsConfig(
    elevation_deg=(5.0, 70.0), distance_m=(0.4, 1.0), fallen_share=0.2, hidden_share=0.25, num_points=1500
)
_DRAWN: dict[str, ViewsConfig | ScansConfig] = {TABLETOP.name: VIEWS, LIDAR.name: ScansConfig()}
_STREET_M = (0.5, 8.0)  # longest side of things of no class in a street
CACHE = Path("runs/proposal")
UP = np.array([0.0, 0.0, 1.0])
TABLE = SupportPlane(UP, 0.0)
_MIN_HANDLE_POINTS = 15
_SYMMETRY_FROM = 6  # members of a kind,
_AMONG = 120  # the first of the train split


@dataclass(frozen=True, eq=False)
class Placed:
    """How the object of a view lies.

    Attributes:
        R: (3, 3), object's axes in the world.
        extents: (3,) m along them.
        centre: (3,) m, middle of its box in the world.
        order: Fold of its symmetry about its own z; inf for a body of revolution.
    """

    R: np.ndarray
    extents: np.ndarray
    centre: np.ndarray
    order: float


@dataclass(frozen=True, eq=False)
class Example:
    """A view with its class.

    Attributes:
        points: (n, 3) m, on the table z = 0.
        viewpoint: (3,) m.
        category: Its class, or the name of its kind where it is of no class.
        subcategory: Its own within the class; "" where none is known.
        answers: The classes that it may be taught as; several where the part that tells them apart is out of sight.
        accepted: The classes that count as right; of a class without such a part, also those it is easily taken for.
        resting: "upright", "upside_down" or "lying".
        placed: None where the object has no axes of its own.
        sensor: What saw it.
    """

    points: np.ndarray
    viewpoint: np.ndarray
    category: str
    subcategory: str
    answers: tuple[str, ...]
    accepted: tuple[str, ...]
    resting: str
    placed: Placed | None
    sensor: SensorProfile = TABLETOP


def class_examples(
    category: str,
    split: str,
    *,
    num_views: int,
    classes: Sequence[str],
    limit: int | None = None,
    data: Path | None = None,
    sensor: SensorProfile = TABLETOP,
    workers: int = 1,
    folder: Path = CACHE,
    progress=None,
) -> list[Example]:
    """Views of the members of one class, from the cache where they are in it.

    Args:
        category: Class.
        split: "train", "val" or "test".
        num_views: Number of views of each member.
        classes: All classes that there are; those among them that the class is alike may be named in its place.
        limit: At most so many members.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
        sensor: What sees them.
        workers: Processes that render.
        folder: Cache.
        progress: Wraps the stream of members.
    """
    views = cached_views(
        category,
        split,
        num_views=num_views,
        limit=limit,
        folder=folder,
        workers=workers,
        config=_DRAWN[sensor.name],
        data=data,
        progress=progress,
    )
    return [_example(view, classes, sensor) for view in views]


def _example(view: View, classes: Sequence[str], sensor: SensorProfile) -> Example:
    anatomy = _anatomy(view.source)
    category = view.source.category
    spec = get_family(category).spec if category in FAMILIES else {}
    alike = tuple(name for name in spec.get("alike", ()) if name in classes)  # pyright: ignore[reportGeneralTypeIssues]
    also = tuple(name for name in anatomy.also if name in classes)
    hidden = anatomy.body_m is not None and not part_in_view(view.points, view.T_world_object, anatomy.body_m)
    answers = (category, *alike) if hidden else (category, *also)
    accepted = tuple(dict.fromkeys((*answers, *alike))) if anatomy.body_m is None else answers
    R = view.T_world_object[:3, :3]
    centre = apply_T(view.T_world_object, anatomy.bounds.mean(axis=0))
    placed = Placed(R, np.ptp(anatomy.bounds, axis=0), centre, anatomy.order)
    return Example(view.points, view.viewpoint, category, anatomy.kind, answers, accepted, view.resting, placed, sensor)


def assorted_examples(
    first: int,
    count: int,
    *,
    num_members: int,
    num_views: int,
    sensor: SensorProfile = TABLETOP,
    workers: int = 1,
    folder: Path = CACHE,
    progress=None,
) -> list[Example]:
    """Views of kinds of things that are like no family, from a number of kind on; each counts as a class of its own."""
    jobs = [(kind, member) for kind in foreign_kinds(first, count) for member in range(num_members)]
    render = partial(_assorted_views, num_views=num_views, sensor=sensor, folder=folder)
    return [example for views in pmap(render, jobs, workers=workers, progress=progress) for example in views]


def part_in_view(points: np.ndarray, T_world_object: np.ndarray, body_m: float) -> bool:
    """Whether points lie beyond the body's radius towards +x, where a handle is; noise stays within 3 mm."""
    local = apply_T(invert_T(T_world_object), points)
    return int((local[:, 0] > body_m + 0.003).sum()) >= _MIN_HANDLE_POINTS


@dataclass(frozen=True, eq=False)
class _Anatomy:
    """A shape's variant, the radius m of its body from which a handle stands out, its bounds, symmetry and classes."""

    kind: str
    body_m: float | None
    bounds: np.ndarray
    order: float
    also: tuple[str, ...]


@cache
def _anatomy(source: ObjectSource) -> _Anatomy:
    if source.path is not None:
        return _Anatomy("", None, np.array(source.load_mesh().bounds), 1, ())
    shape = make_shape(source.family, source.seed)
    body_m = float(np.abs(shape.mesh.vertices[:, 1]).max()) if shape.has_handle else None
    also = get_family(source.family).also.get(shape.kind, ())
    return _Anatomy(shape.kind, body_m, np.array(shape.mesh.bounds), _order(source.family, shape.kind), tuple(also))


@cache
def _order(family: str, kind: str) -> float:
    """Fold of the symmetry that members of a kind have about their z axis."""
    members = _some_of_each_kind(family).get(kind, [])
    return detect_symmetry(members, np.random.default_rng(0), share=0.6).order if members else 1


@cache
def _some_of_each_kind(family: str) -> dict[str, list[trimesh.Trimesh]]:
    """The first few members of each kind of a family, from the train split."""
    found: dict[str, list[trimesh.Trimesh]] = {}
    for seed in split_seeds(family, "train", _AMONG):
        shape = make_shape(family, seed)
        own = found.setdefault(shape.kind, [])
        if len(own) < _SYMMETRY_FROM:
            own.append(shape.mesh)
    return found


def _assorted_views(job: tuple[int, int], *, num_views: int, sensor: SensorProfile, folder: Path) -> list[Example]:
    kind, member = job
    name, config = f"assorted-{kind}", _DRAWN[sensor.name]
    path = folder / "assorted" / f"{kind:05d}_{member:03d}_{num_views}_{config_id(config)}.npz"
    source = ObjectSource(name, name)
    if not path.is_file():
        rng = np.random.default_rng([kind, member])
        mesh = make_assorted(kind, member)
        if sensor is LIDAR:
            mesh.apply_scale(np.exp(rng.uniform(*np.log(_STREET_M))) / float(mesh.extents.max()))
        views = views_of_mesh(source, mesh, rng, num_views=num_views, config=config)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_views(path, views)
    return [
        Example(v.points, v.viewpoint, name, "", (name,), (name,), v.resting, None, sensor)
        for v in read_views(path, source)
    ]


def above_table(example: Example) -> np.ndarray:
    """The points (n, 3) m of an example that are clear of the table; all of them where none is."""
    above = example.points[example.points[:, 2] > example.sensor.floor_m]
    return above if len(above) else example.points
