"""What the classifier learns from: partial views of the members of classes, and of kinds of things of no class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np

from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.shapes import make_assorted, make_shape
from gfp_grasp.train.views import ViewsConfig, cached_views, config_id, read_views, views_of_mesh, write_views
from gfp_grasp.transforms import apply_T, invert_T

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
        hidden = body_m is not None and not part_is_seen(view.points, view.T_world_object, body_m)
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


def part_is_seen(points: np.ndarray, T_world_object: np.ndarray, body_m: float) -> bool:
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
