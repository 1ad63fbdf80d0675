"""Rendered partial views of procedural shapes: what every network of the package learns from.

`cached_views` fills a cache that later calls read; a run that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import warnings
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.clouds import thin
from gfp_grasp.datasets import read_dataset
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.journal import write_arrays
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import split_seeds
from gfp_grasp.train.rests import draw_rest, ways_of_shape
from gfp_grasp.train.scans import ScansConfig, scan_of
from gfp_grasp.transforms import make_T
from gfp_grasp.types import (
    RESTS,
    TABLETOP,
    Detection,
    OrientedBox,
    PointCloud,
    SensorProfile,
    SupportPlane,
)

CACHE = Path("runs/views")
_MIN_PIXELS = 60
_TRIES = 12
_T = TypeVar("_T")
_LARGEST_M = 0.4  # up to this size the distances of the config hold


@dataclass(frozen=True)
class ViewsConfig:
    """How training views are drawn.

    Attributes:
        elevation_deg: Range of the camera's elevation.
        distance_m: Range of its distance.
        fallen_share: Share of objects that lie or stand upside down.
        hidden_share: Share of views of which an occluder hides a part.
        width: Columns, px.
        height: Rows, px.
        fov_y_deg: Vertical field of view.
        num_points: Points kept of a view.
    """

    elevation_deg: tuple[float, float] = (8.0, 75.0)
    distance_m: tuple[float, float] = (0.45, 0.9)
    fallen_share: float = 0.15
    hidden_share: float = 0.15
    width: int = 320
    height: int = 240
    fov_y_deg: float = 35.0
    num_points: int = 3000

    def __post_init__(self) -> None:
        if not (0 <= self.fallen_share <= 1 and 0 <= self.hidden_share <= 1):
            raise InvalidOption("fallen_share and hidden_share must be shares between 0 and 1")


@dataclass(frozen=True, eq=False)
class View:
    """One partial view with its truth.

    Attributes:
        source: The shape.
        points: (n, 3) m; the table is z = 0.
        viewpoint: (3,) m.
        T_world_object: (4, 4), of the shape's mesh as its source loads it.
        resting: "upright", "upside_down" or "lying".
    """

    source: ObjectSource
    points: np.ndarray
    viewpoint: np.ndarray
    T_world_object: np.ndarray
    resting: str

    @property
    def family(self) -> str:
        """Class of the shape."""
        return self.source.category

    @property
    def seed(self) -> int:
        """Number of the shape within its class."""
        return seed_of(self.source)

    def detection(
        self, *, category: str | None = None, support: bool = True, sensor: SensorProfile = TABLETOP
    ) -> Detection:
        """The view as a detection of known class, its support known or not, by a kind of sensor."""
        category = category or self.family
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        return Detection(
            cloud=PointCloud(self.points, self.viewpoint),
            up=np.array([0.0, 0.0, 1.0]),
            support=SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0) if support else None,
            category=category,
            scores={category: 1.0},
            box=OrientedBox(make_T(None, (low + high) / 2), high - low),
            sensor=sensor,
        )


def shape_source(family: str, seed: int) -> ObjectSource:
    """One procedural shape."""
    return ObjectSource(f"{family}-{seed}", family, family=family, seed=seed)


def training_sources(family: str, split: str, limit: int | None = None, data: Path | None = None) -> list[ObjectSource]:
    """Shapes of one class to learn from.

    Args:
        family: Class.
        split: "train", "val" or "test".
        limit: At most so many; of the procedural train split there are as many as are asked for.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
    """
    if data is not None:
        return list(read_dataset(data, split, classes=[family])[:limit])
    return [shape_source(family, seed) for seed in split_seeds(family, split, limit)]


def seed_of(source: ObjectSource) -> int:
    """A procedural shape's own seed; of a file a number by its name."""
    return source.seed if source.path is None else zlib.crc32(source.name.encode())


def render_views(
    source: ObjectSource, *, num_views: int, config: ViewsConfig | ScansConfig = ViewsConfig(), first_seed: int = 0
) -> list[View]:
    """Views of one shape, the same for the same arguments; a shape that is never in sight gives fewer."""
    rng = np.random.default_rng([first_seed, seed_of(source), sum(map(ord, source.category))])
    ways = ways_of_shape(source.family, source.seed)
    return views_of_mesh(source, source.load_mesh(), rng, num_views=num_views, config=config, ways=ways)


def views_of_mesh(
    source: ObjectSource,
    mesh: trimesh.Trimesh,
    rng: np.random.Generator,
    *,
    num_views: int,
    config: ViewsConfig | ScansConfig = ViewsConfig(),
    ways: tuple[str, ...] = RESTS,
) -> list[View]:
    """Views of a mesh; one that is never in sight gives fewer.

    It rests in the first of the ways, unless it has fallen: then in any other. What is larger than things on a table is
    looked at from farther away in proportion. To a LiDAR everything stands.
    """
    if isinstance(config, ScansConfig):
        taken = (_first(partial(scan_of, mesh, rng, config)) for _ in range(num_views))
        return [View(source, *scan, "upright") for scan in taken if scan is not None]
    zoom = max(1.0, float(mesh.extents.max()) / _LARGEST_M)
    if zoom > 1:
        mesh = mesh.copy()
        mesh.apply_scale(1 / zoom)
    K = intrinsics(config.width, config.height, config.fov_y_deg)
    views = []
    for _ in range(num_views):
        view = _first(partial(_one_view, source, mesh, rng, K, config, ways))
        if view is not None:
            views.append(view if zoom == 1 else _enlarged(view, zoom))
    return views


def _first(take: Callable[[], _T | None]) -> _T | None:
    """What the first of several tries gives that gives anything."""
    return next((taken for taken in (take() for _ in range(_TRIES)) if taken is not None), None)


def cached_views(
    family: str,
    split: str,
    *,
    num_views: int = 4,
    limit: int | None = None,
    folder: Path = CACHE,
    workers: int = 1,
    config: ViewsConfig | ScansConfig = ViewsConfig(),
    data: Path | None = None,
    progress=None,
) -> list[View]:
    """Views of every shape of a split (see `training_sources`), rendered where the cache lacks them.

    A mesh that cannot be made solid is left out, with a warning.
    """
    jobs = training_sources(family, split, limit, data)
    make = partial(_load_or_render, num_views=num_views, folder=folder, config=config)
    return [view for views in pmap(make, jobs, workers=workers, progress=progress) for view in views]


def _load_or_render(
    source: ObjectSource, *, num_views: int, folder: Path, config: ViewsConfig | ScansConfig
) -> list[View]:
    path = folder / source.category / f"{cache_name(source)}_{num_views}_{config_id(config)}.npz"
    if path.is_file():
        return read_views(path, source)
    try:
        views = render_views(source, num_views=num_views, config=config)
    except InvalidMesh as error:
        warnings.warn(f"{source.name} is left out: {error}", stacklevel=2)
        return []
    if not views:
        return []
    write_views(path, views)
    return read_views(path, source)  # in the precision of the cache, as every later run reads them


def write_views(path: Path, views: list[View]) -> None:
    """Write views of one shape; another process never sees half of the file."""
    write_arrays(
        path,
        count=np.array([len(v.points) for v in views]),
        points=np.concatenate([np.zeros((0, 3)), *(v.points for v in views)]).astype(np.float32),
        viewpoint=np.array([v.viewpoint for v in views]),
        T_world_object=np.array([v.T_world_object for v in views]),
        resting=np.array([v.resting for v in views]),
    )


def read_views(path: Path, source: ObjectSource) -> list[View]:
    """The views of one shape that `write_views` wrote."""
    with np.load(path) as stored:
        counts = stored["count"]
        clouds = np.split(stored["points"], np.cumsum(counts)[:-1]) if len(counts) else []
        return [
            View(source, p.astype(np.float64), v, T, str(r))
            for p, v, T, r in zip(
                clouds,
                stored["viewpoint"],
                stored["T_world_object"],
                stored["resting"],
                strict=True,
            )
        ]


def cache_name(source: ObjectSource) -> str:
    """What files that are made of a shape are called: a procedural one's seed; for a file a digest of its content."""
    if source.path is None:
        return f"{source.seed:06d}"
    content = source.path.read_bytes() + f"{source.up} {source.height_m}".encode()
    return f"file_{hashlib.sha256(content).hexdigest()[:16]}"


def config_id(config: object) -> str:
    """Eight hexadecimal digits that change with any field of a config dataclass."""
    return hashlib.sha256(json.dumps(asdict(config), sort_keys=True).encode()).hexdigest()[:8]  # type: ignore[call-overload]


def _one_view(
    source: ObjectSource,
    shape: trimesh.Trimesh,
    rng: np.random.Generator,
    K: np.ndarray,
    config: ViewsConfig,
    ways: tuple[str, ...],
) -> View | None:
    resting, T = draw_rest(np.asarray(shape.vertices), rng, config.fallen_share, ways)
    mesh = shape.copy()
    mesh.apply_transform(T)
    target = mesh.bounds.mean(axis=0) + rng.uniform(-0.03, 0.03, 3)
    camera = sample_viewpoint(
        rng, elevation_deg=config.elevation_deg, distance_m=rng.uniform(*config.distance_m), target=target
    )
    image, index = render_mesh_view(
        [mesh], T_world_camera=camera, K=K, width=config.width, height=config.height, table_height=0.0
    )
    sensors = (SensorModel.gaussian(0.001), SensorModel.realsense(), SensorModel.kinect(), SensorModel.gaussian(0.002))
    image = apply_sensor(image, sensors[rng.integers(len(sensors))], rng)
    mask = (index == 0) & (image.depth_m > 0)
    if rng.random() < config.hidden_share:
        mask = _occlude(mask, rng)
    if mask.sum() < _MIN_PIXELS:
        return None
    cloud = cloud_of(image, mask)
    assert cloud.viewpoint is not None
    return View(source, thin(cloud.points, config.num_points), cloud.viewpoint, T, resting)


def _enlarged(view: View, zoom: float) -> View:
    T = make_T(view.T_world_object[:3, :3], zoom * view.T_world_object[:3, 3])
    return replace(view, points=zoom * view.points, viewpoint=zoom * view.viewpoint, T_world_object=T)


def across_edge(shape: tuple[int, ...], angle_rad: float) -> np.ndarray:
    """(h, w) px, how far each pixel lies beyond a straight edge through the first pixel, which an occluder may have."""
    rows, columns = np.indices(shape)
    return rows * np.sin(angle_rad) + columns * np.cos(angle_rad)


def _occlude(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cut off up to half of the pixels by a straight edge in a random direction."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return mask
    along = across_edge(mask.shape, rng.uniform(0, 2 * np.pi))[rows, columns]
    keep = along > np.quantile(along, rng.uniform(0.1, 0.5))
    cut = np.zeros_like(mask)
    cut[rows[keep], columns[keep]] = True
    return cut


__all__ = [
    "View",
    "ViewsConfig",
    "across_edge",
    "cache_name",
    "cached_views",
    "config_id",
    "read_views",
    "render_views",
    "seed_of",
    "shape_source",
    "training_sources",
    "views_of_mesh",
    "write_views",
]
