"""Ways from a detection to a completed shape, by name: the package's own, brackets around them, and the user's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import trimesh
from scipy.spatial import QhullError

from gfp_grasp.complete import CompleteConfig, Completion, complete_detection
from gfp_grasp.deform import DeformConfig
from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption, UnknownCompleter
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.observation import mark_observed
from gfp_grasp.plugins import imported_function
from gfp_grasp.register import icp_config, pcrnet_config
from gfp_grasp.types import CollisionMesh, CompletedShape, ConvexPart, Detection

# Those of the package that register a primitive, by what they do with it.
CONFIGS: Mapping[str, CompleteConfig] = {
    "icp": CompleteConfig(fit=icp_config(), deform=DeformConfig(method="none"), subcategories=False),
    "pcrnet": CompleteConfig(fit=pcrnet_config(), deform=DeformConfig(method="none"), subcategories=False),
    "registration": CompleteConfig(deform=DeformConfig(method="none")),
    "gfs": CompleteConfig(deform=DeformConfig(method="gfs")),
    "gfpnet-oneshot": CompleteConfig(deform=DeformConfig(method="gfpnet-oneshot")),
    "gfpnet-paper": CompleteConfig(deform=DeformConfig(method="gfpnet-paper")),
    "gfpnet": CompleteConfig(),
}
COMPLETERS = ("oracle", "observed", "mirror", *CONFIGS)
# These look at points alone, so that nobody has to load a network for them; a user's own may ask for the class.
_BLIND_TO_CLASS = ("oracle", "observed", "mirror")

# Edges of hulls are split to this length, so that seen and unseen surface can be told apart on them.
_EDGE_M = 0.008
# Share of the points at either edge of the silhouette that tell how deep the object's middle lies.
_SILHOUETTE_SHARE = 0.04
# Points with less spread than this across their plane, as a share of that along it, are flat but for rounding.
_FLAT = 1e-5

Completer = Callable[[Detection], Completion]


@dataclass(frozen=True, eq=False)
class CompletionInParts(Completion):
    """A completion whose convex parts are known from the start; they cost nothing.

    Attributes:
        known_parts: The parts, world frame.
    """

    known_parts: CollisionMesh

    @cached_property
    def collision(self) -> CollisionMesh:
        """The known parts."""
        return self.known_parts


def completer(name: str) -> Completer:
    """A completer by name.

    Args:
        name: `observed` (hull of what was seen), `mirror` (hull of the cloud and its reflection in the vertical plane
            through its middle that faces the camera), `icp` and `pcrnet` (the mean primitive, placed rigidly),
            `registration` (the fitted primitive, undeformed), that deformed by `gfs` (active contour),
            `gfpnet-oneshot` or `gfpnet-paper` (the paper's networks) or `gfpnet` (the package's method), `oracle` (the
            true mesh; see `Oracle`), or `package.module:function`, a function of a Detection that returns a
            trimesh.Trimesh in the world frame or a Completion.

    Returns:
        A function of a detection; for `oracle` an `Oracle`, which takes the truth as well.

    Raises:
        UnknownCompleter: The name is none of these, or cannot be imported.
    """
    built_in: dict[str, Completer] = {
        "oracle": Oracle(),
        "observed": complete_as_observed,
        "mirror": complete_by_mirror,
        **{name: partial(complete_detection, config=config) for name, config in CONFIGS.items()},
    }
    if name in built_in:
        return built_in[name]
    on_offer = ", ".join(COMPLETERS)
    return _of_user(
        imported_function(name, what="completer", of="a Detection", on_offer=on_offer, error=UnknownCompleter)
    )


def needs_class(name: str) -> bool:
    """Whether a completer, by name, looks at the class of its detection; without one it runs without torch."""
    return name not in _BLIND_TO_CLASS


class Oracle:
    """The true mesh as its own completion: the upper bracket, and the only completer that is given the truth."""

    needs_truth = True

    def __call__(
        self, detection: Detection, truth: trimesh.Trimesh | None = None, collision: CollisionMesh | None = None
    ) -> Completion:
        """Completion that is the truth.

        Args:
            detection: Of the object, for its support and what was observed.
            truth: True mesh in the world frame.
            collision: Its convex parts, world frame.

        Raises:
            InvalidOption: Called without the truth, as any other completer is.
        """
        if truth is None or collision is None:
            raise InvalidOption(
                "the oracle needs the true mesh and its convex parts; in a simulator only it can be had"
            )
        return CompletionInParts(_shape(truth, detection), detection, collision)


def complete_as_observed(detection: Detection) -> Completion:
    """Convex hull of the observed points.

    Raises:
        InvalidCloud: The points lie on a plane or a line.
    """
    return _hull_completion(np.asarray(detection.cloud.points), detection)


def complete_by_mirror(detection: Detection) -> Completion:
    """Convex hull of the observed points and their reflection.

    Raises:
        InvalidCloud: The points lie on a plane or a line, or the cloud has no viewpoint.
    """
    return _hull_completion(mirrored_cloud(detection), detection)


def mirrored_cloud(detection: Detection) -> np.ndarray:
    """The observed points and their reflection, (2n, 3) m.

    The mirror is the plane along up that faces the camera, at the depth of the silhouette's edges (the middle of a
    round or boxy object) or at the middle of what was seen, whichever is deeper.

    Raises:
        InvalidCloud: The cloud has no viewpoint.
    """
    points, up = np.asarray(detection.cloud.points), detection.up
    if detection.cloud.viewpoint is None:
        raise InvalidCloud("the mirror completer needs the cloud's viewpoint: give where the camera stood")
    away = points.mean(axis=0) - detection.cloud.viewpoint
    away = away - (away @ up) * up
    if np.linalg.norm(away) < 1e-6:  # seen from straight above: any vertical plane will do
        away = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    away = away / np.linalg.norm(away)
    depth, across = points @ away, points @ np.cross(up, away)
    low, high = np.quantile(across, [_SILHOUETTE_SHARE / 2, 1 - _SILHOUETTE_SHARE / 2])
    edge = float(np.mean([np.median(depth[across <= low]), np.median(depth[across >= high])]))
    middle = max(edge, float(np.mean(np.quantile(depth, [0.01, 0.99]))))
    mirrored = points - 2.0 * (depth - middle)[:, None] * away
    return np.concatenate([points, mirrored])


def _hull_completion(points: np.ndarray, detection: Detection) -> Completion:
    flat = f"{len(points)} points have no volume between them: a plane or a line has no hull"
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) < 4 or not spread[2] > _FLAT * spread[0]:
        raise InvalidCloud(flat)
    try:
        hull = trimesh.convex.convex_hull(points)
    except QhullError as error:
        raise InvalidCloud(flat) from error
    part = ConvexPart(np.asarray(hull.vertices), np.asarray(hull.faces))
    exact = CollisionMesh((part,), (0.0, 0.0, 0.0), "hull", 0.0)
    return CompletionInParts(_shape(_refine(hull), detection), detection, exact)


def _refine(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same solid with edges no longer than _EDGE_M and no T-junctions."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.uint64))
    )
    fine = solid.refine_to_length(_EDGE_M).to_mesh64()
    refined = trimesh.Trimesh(fine.vert_properties[:, :3], fine.tri_verts.astype(np.int64), process=False)
    return refined if refined.is_volume else mesh


def _shape(mesh: trimesh.Trimesh, detection: Detection) -> CompletedShape:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    observed, sigma = mark_observed(vertices, faces, detection, np.full(len(vertices), np.nan))
    return CompletedShape(mesh, observed, sigma)


def _of_user(function: Callable[[Detection], object]) -> Completer:
    def complete(detection: Detection) -> Completion:
        answer = function(detection)
        if isinstance(answer, Completion):
            return answer
        if not isinstance(answer, trimesh.Trimesh):
            raise InvalidMesh(
                f"the completer returned a {type(answer).__name__}; a trimesh.Trimesh or Completion is expected"
            )
        mesh = check_mesh(answer)
        return Completion(_shape(mesh if mesh.is_volume else make_solid(mesh)[0], detection), detection)

    return complete
