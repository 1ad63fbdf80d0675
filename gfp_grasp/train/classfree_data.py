"""What the class-free completion learns from: things as they are seen from one side, with their exact distances.

Things are members of the families, those of traffic as toys, and mixtures of no class. `cached_samples` fills a cache
that later calls read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from zlib import crc32

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.classfree import REACH, channels, grid_around
from gfp_grasp.errors import TooFewPoints
from gfp_grasp.journal import write_arrays
from gfp_grasp.level import make_level_view
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.shapes import FAMILIES, MIXTURES, TRAFFIC, make_mixture, make_shape, split_seeds
from gfp_grasp.train.distances import signed_distances
from gfp_grasp.train.rests import draw_rest, draw_stable_rest, ways_of_shape
from gfp_grasp.train.views import across_edge
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import DepthImage, Detection, OrientedBox, PointCloud, SupportPlane

_WIDTH, _HEIGHT, _FOV_DEG = 320, 240, 35.0
_DISTANCE_M = (0.4, 1.0)
_CLEAR = 1.7  # times its longest side: as near a camera sees all of a thing
_FALLEN = 0.15  # share of the members of families that rest in another way than they use to
_ANYHOW = 0.3  # share of them that rest on any side
_LOST_BELOW_M = 0.006  # what is as near to the table may be taken for it
_TOY_M = (0.08, 0.35)  # longest side of a member of a traffic family
_LEAST_PX = 60
_TRIES = 12
_LEVELS = 127.0  # steps in which numbers from -1 to 1 are cached
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, order=True)
class Thing:
    """One thing to learn from or to measure on; light, and pickles into workers.

    Attributes:
        kind: A family or one of MIXTURES.
        number: Seed of a member of a family, or number of a mixture.
        split: "train", "val" or "test".
    """

    kind: str
    number: int
    split: str

    def load_mesh(self) -> trimesh.Trimesh:
        """Its mesh, m, z up."""
        if self.kind not in FAMILIES:
            return make_mixture(self.kind, self.number, split=self.split)
        mesh = make_shape(self.kind, self.number).mesh
        if self.kind in TRAFFIC:
            mesh = mesh.copy()
            mesh.apply_scale(self.rng().uniform(*_TOY_M) / float(mesh.extents.max()))
        return mesh

    def rng(self, *more: int) -> np.random.Generator:
        """A generator of its own."""
        return np.random.default_rng([crc32(f"{self.kind} {self.split}".encode()), self.number, *more])


def draw_things(split: str, members: int, mixtures: int, *, without: Sequence[str] = ()) -> list[Thing]:
    """Things of a split: so many members of each family but those left out, and so many of each kind of mixture."""
    families = [name for name in FAMILIES if name not in without]
    own = [Thing(name, seed, split) for name in families for seed in split_seeds(name, split, members)]
    return own + [Thing(kind, number, split) for kind in MIXTURES for number in range(mixtures)]


@dataclass(frozen=True)
class SightConfig:
    """How things are looked at.

    Attributes:
        elevation_deg: Range of the camera's elevation.
        sensors: One is drawn for each view.
        hidden_share: Share of the views in which a board hides some of the thing.
        whole_share: Share of the views that tell all that the sensor saw;
        viewpoint_share: of the others, so many tell the viewpoint beside the points.
        support_share: Share of the views whose support was seen.
        taken_share: Share of the views in which what is nearest to the table is taken for it.
    """

    elevation_deg: tuple[float, float] = (5.0, 75.0)
    sensors: tuple[SensorModel, ...] = (
        SensorModel.gaussian(0.001),
        SensorModel.realsense(),
        SensorModel.kinect(),
        SensorModel.gaussian(0.002),
    )
    hidden_share: float = 0.2
    whole_share: float = 0.55
    viewpoint_share: float = 0.67
    support_share: float = 0.8
    taken_share: float = 0.5


# As the bench of completions looks at things, with all that the sensor saw.
PLAIN = SightConfig((20.0, 60.0), (SensorModel.gaussian(0.001),), 0.0, 1.0, 1.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class SeenThing:
    """A thing as one camera saw it.

    Attributes:
        thing: What it is.
        detection: World frame; the table is z = 0.
        mesh: The true mesh in that frame.
    """

    thing: Thing
    detection: Detection
    mesh: trimesh.Trimesh


def seen_things(thing: Thing, num_views: int, config: SightConfig = SightConfig()) -> Iterator[SeenThing]:
    """Views of a thing, the same for the same arguments; one that is never in sight gives fewer."""
    mesh = thing.load_mesh()
    for view in range(num_views):
        rng = thing.rng(view)
        for _ in range(_TRIES):
            seen = _seen(thing, mesh, rng, config)
            if seen is not None:
                yield seen
                break


def _seen(thing: Thing, mesh: trimesh.Trimesh, rng: np.random.Generator, config: SightConfig) -> SeenThing | None:
    placed = mesh.copy()
    placed.apply_transform(_rest(thing, mesh, rng))
    distance_m = max(rng.uniform(*_DISTANCE_M), _CLEAR * float(placed.extents.max()))
    target = placed.bounds.mean(axis=0) + rng.uniform(-0.1, 0.1, 3) * placed.extents.max()
    camera = sample_viewpoint(rng, elevation_deg=config.elevation_deg, distance_m=distance_m, target=target)
    K = intrinsics(_WIDTH, _HEIGHT, _FOV_DEG)
    image, index = render_mesh_view(
        [placed], T_world_camera=camera, K=K, width=_WIDTH, height=_HEIGHT, table_height=0.0
    )
    if rng.random() < config.hidden_share and (index == 0).any():
        image, index = _behind_a_board(image, index, rng)
    image = apply_sensor(image, config.sensors[rng.integers(len(config.sensors))], rng)
    mask = (index == 0) & (image.depth_m > 0)
    if rng.random() < config.taken_share:
        with np.errstate(invalid="ignore"):
            mask &= image.points()[..., 2] > rng.uniform(0, _LOST_BELOW_M)
    if mask.sum() < _LEAST_PX:
        return None
    return SeenThing(thing, _told(cloud_of(image, mask), image, mask, rng, config), placed)


def _rest(thing: Thing, mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    if thing.kind not in FAMILIES or rng.random() < _ANYHOW:
        return draw_stable_rest(mesh, rng)
    return draw_rest(np.asarray(mesh.vertices), rng, _FALLEN, ways_of_shape(thing.kind, thing.number))[1]


def _behind_a_board(image: DepthImage, index: np.ndarray, rng: np.random.Generator) -> tuple[DepthImage, np.ndarray]:
    """Up to half of the thing behind the straight edge of something nearer."""
    along = across_edge(index.shape, rng.uniform(0, 2 * np.pi))
    board = along < np.quantile(along[index == 0], rng.uniform(0.1, 0.5))
    near_m = float(image.depth_m[index == 0].min()) - rng.uniform(0.02, 0.15)
    depth = np.where(board, near_m, image.depth_m)
    return DepthImage(depth.astype(np.float32), image.K, image.T_world_camera), np.where(board, 1, index)


def _told(
    cloud: PointCloud, image: DepthImage, mask: np.ndarray, rng: np.random.Generator, config: SightConfig
) -> Detection:
    """A detection that tells all that was seen, or its points and viewpoint, or nothing but points."""
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    whole, viewpoint = rng.random() < config.whole_share, rng.random() < config.viewpoint_share
    return Detection(
        cloud=cloud if whole or viewpoint else PointCloud(cloud.points),
        up=UP,
        support=SupportPlane(UP, 0.0) if rng.random() < config.support_share else None,
        category="",
        scores={},
        box=OrientedBox(make_T(None, (low + high) / 2), high - low),
        view=image if whole else None,
        mask=mask if whole else None,
    )


@dataclass(frozen=True, eq=False)
class Sample:
    """What the network is given, and what it shall say.

    Attributes:
        known: (c, x, y, z) int8 of `channels`, in steps of 1 / 127.
        distance: (x, y, z) int8, signed distances in steps of REACH / 127 cells.
    """

    known: np.ndarray
    distance: np.ndarray


def sample_of(seen: SeenThing) -> Sample:
    """The sample of a view.

    Raises:
        TooFewPoints: Too little was seen.
    """
    view = make_level_view(seen.detection)
    grid = grid_around(view)
    T_level_world = invert_T(view.T_world_level)
    mesh = trimesh.Trimesh(apply_T(T_level_world, seen.mesh.vertices), seen.mesh.faces, process=False)
    distance = signed_distances(mesh, grid, reach=REACH) / REACH
    return Sample(*(np.round(_LEVELS * array).astype(np.int8) for array in (channels(view, grid), distance)))


def cached_samples(
    things: Sequence[Thing], num_views: int, folder: Path, *, workers: int = 1, progress: Progress | None = None
) -> list[tuple[Path, int]]:
    """Files of samples, made where the cache lacks them, each with the number of a sample in it.

    Args:
        things: What is looked at.
        num_views: Views of each.
        folder: Cache.
        workers: Processes.
        progress: Wraps the stream of things.
    """
    make = partial(_make_samples, num_views=num_views, folder=folder)
    return [sample for samples in pmap(make, things, workers=workers, progress=progress) for sample in samples]


def _make_samples(thing: Thing, *, num_views: int, folder: Path) -> list[tuple[Path, int]]:
    path = folder / thing.kind / f"{thing.split}_{thing.number:06d}_{num_views}.npz"
    if not path.is_file():
        arrays: dict[str, np.ndarray] = {}
        for seen in seen_things(thing, num_views):
            try:
                sample = sample_of(seen)
            except TooFewPoints:
                continue
            number = len(arrays) // 2
            arrays |= {f"known_{number}": sample.known, f"distance_{number}": sample.distance}
        write_arrays(path, count=np.array(len(arrays) // 2), **arrays)
    with np.load(path) as stored:
        return [(path, number) for number in range(int(stored["count"]))]


def read_sample(path: Path, number: int) -> Sample:
    """One of the samples of a file of `cached_samples`."""
    with np.load(path) as stored:
        return Sample(stored[f"known_{number}"], stored[f"distance_{number}"])
