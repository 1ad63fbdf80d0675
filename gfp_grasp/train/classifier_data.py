"""What the classifier learns from: partial views of classes and other things, turned, thinned and cropped anew."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gfp_grasp.detect import FLOOR_M, NUM_CHANNELS, POOL_POINTS, features, sample_points, upright_points, with_surface
from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import make_assorted, make_shape
from gfp_grasp.train.loop import LoopConfig
from gfp_grasp.train.views import ViewsConfig, cached_views, config_id, read_views, views_of_mesh, write_views
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import SupportPlane

VIEWS = ViewsConfig(
    elevation_deg=(5.0, 70.0), distance_m=(0.4, 1.0), fallen_share=0.2, hidden_share=0.25, num_points=1500
)
CACHE = Path("runs/classifier")
_MIN_HANDLE_POINTS = 15


@dataclass(frozen=True, eq=False)
class Example:
    """A view with its class.

    Attributes:
        points: (n, 3) m, on the table z = 0.
        category: Its class, or the name of its kind where it is of no class.
        subcategory: Its own within the class; "" where none is known.
        answers: The classes that it may be taught as; several where the part that tells them apart is out of sight.
        accepted: The classes that count as right; of a class without such a part, also those it is easily taken for.
        resting: "upright", "upside_down" or "lying".
    """

    points: np.ndarray
    category: str
    subcategory: str
    answers: tuple[str, ...]
    accepted: tuple[str, ...]
    resting: str


def class_examples(
    category: str,
    split: str,
    *,
    num_views: int,
    alike: Sequence[str] = (),
    limit: int | None = None,
    data: Path | None = None,
    workers: int = 1,
    folder: Path = CACHE,
    progress=None,
) -> list[Example]:
    """Views of the members of one class, from the cache where they are in it.

    Args:
        category: Class.
        split: "train", "val" or "test".
        num_views: Number of views of each member.
        alike: Classes that a member counts as where the part that tells them apart is not in view.
        limit: At most so many members.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
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
        config=VIEWS,
        data=data,
        progress=progress,
    )
    examples = []
    for view in views:
        subcategory, body_m = _anatomy(view.source) if view.source.path is None else ("", None)
        hidden = body_m is not None and not part_in_view(view.points, view.T_world_object, body_m)
        either = (category, *alike)
        examples.append(
            Example(
                view.points,
                category,
                subcategory,
                answers=either if hidden else (category,),
                accepted=either if hidden or body_m is None else (category,),
                resting=view.resting,
            )
        )
    return examples


def alike_in(classes: Sequence[str], category: str) -> tuple[str, ...]:
    """Those of some classes that the card of a class says it is easily taken for; none where it has no card."""
    library = PrimitiveLibrary.shipped()
    return tuple(name for name in library.spec(category).alike if name in classes) if category in library else ()


def assorted_examples(
    kinds: Sequence[int], *, num_members: int, num_views: int, workers: int = 1, folder: Path = CACHE, progress=None
) -> list[Example]:
    """Views of kinds of things of no class; a kind counts as a class of its own."""
    jobs = [(kind, member) for kind in kinds for member in range(num_members)]
    render = partial(_assorted_views, num_views=num_views, folder=folder)
    return [example for views in pmap(render, jobs, workers=workers, progress=progress) for example in views]


def part_in_view(points: np.ndarray, T_world_object: np.ndarray, body_m: float) -> bool:
    """Whether points lie beyond the body's radius towards +x, where a handle is; noise stays within 3 mm."""
    local = apply_T(invert_T(T_world_object), points)
    return int((local[:, 0] > body_m + 0.003).sum()) >= _MIN_HANDLE_POINTS


@cache
def _anatomy(source: ObjectSource) -> tuple[str, float | None]:
    """Subcategory of a procedural shape, and the radius m of its body where a handle stands out of that."""
    shape = make_shape(source.family, source.seed)
    return shape.kind, float(np.abs(shape.mesh.vertices[:, 1]).max()) if shape.has_handle else None


def _assorted_views(job: tuple[int, int], *, num_views: int, folder: Path) -> list[Example]:
    kind, member = job
    name = f"assorted-{kind}"
    path = folder / "assorted" / f"{kind:05d}_{member:03d}_{num_views}_{config_id(VIEWS)}.npz"
    if not path.is_file():
        source = ObjectSource(f"{name}-{member}", name)
        rng = np.random.default_rng([kind, member])
        views = views_of_mesh(source, make_assorted(kind, member), rng, num_views=num_views, config=VIEWS)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_views(path, views)
    return [
        Example(v.points, name, "", (name,), (name,), v.resting) for v in read_views(path, ObjectSource(name, name))
    ]


UP = np.array([0.0, 0.0, 1.0])
_TRAIN_POINTS = 256  # a third of what is used later: max-pooling does not mind, and steps are thrice as fast


@dataclass(frozen=True)
class ClassifierConfig(LoopConfig):
    """Schedule and data of the classifier.

    Attributes:
        width: Width of the network.
        channels: Length of an embedding.
        views: Number of views of each member of a class of the training split.
        limit: Members of a class; None takes the whole split.
        kinds: Kinds of other things.
        members: Members of each of these kinds, two views each.
        share: Share of a batch that are views of classes; the rest are views of other things.
        proxies: Vectors that the views of one kind or subcategory are drawn to.
        kind_weight: Weight of the loss that tells subcategories of one class apart.
        unknown_table: Share of samples whose lowest point stands for the table.
    """

    steps: int = 3000
    batch: int = 64
    rate: float = 2e-3
    decay: float = 0.65
    bf16: bool = True
    width: int = 48
    channels: int = NUM_CHANNELS
    views: int = 3
    limit: int | None = None
    kinds: int = 60
    members: int = 8
    share: float = 0.6
    proxies: int = 2
    kind_weight: float = 0.2
    unknown_table: float = 0.3

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.width, self.channels, self.views, self.kinds, self.members, self.proxies) < 1:
            raise InvalidOption("width, channels, views, kinds, members and proxies must be at least 1")
        if not 0 <= self.unknown_table <= 1 or not 0 < self.share < 1:
            raise InvalidOption("unknown_table must be a share between 0 and 1, share one between them")


@dataclass(frozen=True, eq=False)
class Targets:
    """What the samples are, e of them.

    Attributes:
        pool: (e, POOL_POINTS, 6) clouds of `with_surface`, above the table.
        classes: (e, a) the probability of each class and of each kind of other things.
        kind: (e,) number of the kind among all kinds; -1 where it must not be asked for.
        class_of: (kinds,) number of the class of each kind.
        num_views: How many of the first samples are views of classes.
    """

    pool: Tensor
    classes: Tensor
    kind: Tensor
    class_of: Tensor
    num_views: int


def make_targets(
    examples: Sequence[Example], assorted: Sequence[Example], config: ClassifierConfig, cache: Path
) -> Targets:
    usable = [e for e in examples if _is_usable(e)]
    num_views = len(usable)
    usable += [e for e in assorted if _is_usable(e)]
    classes = list(dict.fromkeys(e.category for e in usable))
    kinds = list(dict.fromkeys((e.category, e.subcategory) for e in usable))
    target = np.zeros((len(usable), len(classes)), dtype=np.float32)
    for row, example in zip(target, usable, strict=True):
        row[[classes.index(answer) for answer in example.answers]] = 1 / len(example.answers)
    kind = [kinds.index((e.category, e.subcategory)) if len(e.answers) == 1 else -1 for e in usable]
    class_of = torch.tensor([classes.index(category) for category, _ in kinds])
    pool = torch.from_numpy(_pool(usable, config.seed, cache))
    return Targets(pool, torch.from_numpy(target), torch.tensor(kind), class_of, num_views)


def _pool(examples: Sequence[Example], seed: int, cache: Path) -> np.ndarray:
    """Clouds (e, POOL_POINTS, 6) with what their surroundings look like, which takes minutes: from the cache."""
    content = hashlib.sha256(f"{seed} {POOL_POINTS}".encode())
    for example in examples:
        content.update(example.points.tobytes())
    path = cache / f"pool_{content.hexdigest()[:16]}.npy"
    if not path.is_file():
        rng = np.random.default_rng(seed)
        clouds = [with_surface(sample_points(above_table(e), POOL_POINTS, rng)).astype(np.float32) for e in examples]
        np.save(path, np.stack(clouds))
    return np.load(path)


def _is_usable(example: Example) -> bool:
    return int((example.points[:, 2] > FLOOR_M).sum()) >= 30


def augmented_batches(targets: Targets, config: ClassifierConfig):
    """Endless batches: any yaw, mirrored, stretched a little, noisier, cropped, thinner, the table known or not."""
    own, total = targets.num_views, len(targets.pool)
    num_own = round(config.share * config.batch)

    def stream(generator: torch.Generator):
        rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        while True:
            order = rng.permutation(own)
            for start in range(0, max(own - num_own, 0) + 1, num_own):
                others = rng.integers(own, total, config.batch - num_own)
                index = np.concatenate([order[start : start + num_own], others])
                clouds = np.stack([_augmented(targets.pool[k].numpy(), rng, config) for k in index])
                yield torch.from_numpy(features(clouds)), targets.classes[index], targets.kind[index]

    return stream


def _augmented(cloud: np.ndarray, rng: np.random.Generator, config: ClassifierConfig) -> np.ndarray:
    points, surface = cloud[:, :3] * rng.uniform(0.93, 1.07, 3), cloud[:, 3:]
    if rng.random() < 0.1:  # a part is hidden
        along = points @ rng.normal(size=3)
        seen = along > np.quantile(along, rng.uniform(0.0, 0.4))
        points, surface = points[seen], surface[seen]
    kept = rng.permutation(len(points))[: _TRAIN_POINTS if rng.random() < 0.7 else int(rng.integers(80, _TRAIN_POINTS))]
    points, size = points[kept], float(np.ptp(cloud[:, 2]) + np.ptp(cloud[:, 0])) / 0.2
    points = points + size * rng.normal(scale=rng.uniform(0, 0.0015), size=points.shape)
    yaw, mirror = rng.uniform(0, 2 * np.pi), rng.choice([-1.0, 1.0])
    c, s = np.cos(yaw), np.sin(yaw)
    points = points @ np.array([[c, s * mirror, 0], [-s, c * mirror, 0], [0, 0, 1]])
    table = None if rng.random() < config.unknown_table else SupportPlane(UP, size * rng.normal(scale=0.002))
    points = upright_points(points, UP, table)
    points[:, :2] += size * rng.normal(scale=0.004, size=2)
    return sample_points(np.column_stack([points, surface[kept]]), _TRAIN_POINTS, rng)


def above_table(example: Example) -> np.ndarray:
    """The points (n, 3) m of an example that are clear of the table; all of them where none is."""
    above = example.points[example.points[:, 2] > FLOOR_M]
    return above if len(above) else example.points
