"""Completers by name, and those that fit no primitive: hulls of the observed points, networks, and the truth."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import trimesh

from gfp_grasp.classfree import hull_of, refined
from gfp_grasp.collision import within_bounds
from gfp_grasp.complete import CompleteConfig, complete_detection
from gfp_grasp.completion import Completion
from gfp_grasp.deform import DeformConfig
from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption, UnknownCompleter
from gfp_grasp.level import mark_shape
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.peers import PEERS, TRUE_BOX, check_trained, true_box
from gfp_grasp.plugins import imported_function
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import icp_config, pcrnet_config
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import (
    UNKNOWN,
    CollisionMesh,
    ConvexPart,
    Detection,
    OrientedBox,
    TrueObject,
)

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
        """The known parts, within the bounds that other objects of a scene set."""
        return within_bounds(self.known_parts, self.bounds) if len(self.bounds) else self.known_parts


# Share of the points, at both edges of the silhouette together, that tell how deep the object's middle lies.
_SILHOUETTE_SHARE = 0.04
# A viewer whose level distance from the points is less than this looks from straight above.
_ABOVE_M = 1e-6


def complete_as_observed(detection: Detection) -> Completion:
    """Convex hull of the observed points.

    Raises:
        InvalidCloud: The points lie on a plane or a line.
    """
    return _complete_by_hull(np.asarray(detection.cloud.points), detection)


def complete_by_mirror(detection: Detection) -> Completion:
    """Convex hull of the observed points and their mirror image.

    Raises:
        InvalidCloud: The points lie on a plane or a line, or the cloud has no viewpoint.
    """
    return _complete_by_hull(mirror_cloud(detection), detection)


def mirror_cloud(detection: Detection) -> np.ndarray:
    """The observed points and then their mirror image, (2n, 3) m.

    The mirror is a plane along up that faces the camera. It stands at the depth of the silhouette's edges, which is the
    middle of a round or boxy object, or at the middle depth of what was seen, whichever is deeper.

    Raises:
        InvalidCloud: The cloud has no viewpoint.
    """
    points, up = np.asarray(detection.cloud.points), detection.up
    if detection.cloud.viewpoint is None:
        raise InvalidCloud("the mirror completer needs the cloud's viewpoint: give where the camera stood")
    away = points.mean(axis=0) - detection.cloud.viewpoint
    away = away - (away @ up) * up
    if np.linalg.norm(away) < _ABOVE_M:  # any plane along up will do
        away = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    away = away / np.linalg.norm(away)
    depth, across = points @ away, points @ np.cross(up, away)
    low, high = np.quantile(across, [_SILHOUETTE_SHARE / 2, 1 - _SILHOUETTE_SHARE / 2])
    edge = float(np.mean([np.median(depth[across <= low]), np.median(depth[across >= high])]))
    middle = max(edge, float(np.mean(np.quantile(depth, [0.01, 0.99]))))
    mirrored = points - 2.0 * (depth - middle)[:, None] * away
    return np.concatenate([points, mirrored])


def _complete_by_hull(points: np.ndarray, detection: Detection) -> Completion:
    hull = hull_of(points)
    part = ConvexPart(np.asarray(hull.vertices), np.asarray(hull.faces))
    exact = CollisionMesh((part,), (0.0, 0.0, 0.0), "hull", 0.0)
    return CompletionInParts(mark_shape(refined(hull), detection), detection, exact)


def complete_without_class(detection: Detection) -> Completion:
    """The class-free completion; its category is `UNKNOWN`.

    Its convex parts come of plane cuts; CoACD's, in seconds or minutes: `completion.collide(CollisionConfig("coacd"))`.

    Raises:
        TooFewPoints: Too few points.
        NoSurface: Nothing solid is found around the points.
    """
    from gfp_grasp.classfree import complete_classfree  # torch is loaded where it is needed only

    return Completion(complete_classfree(detection), replace(detection, category=UNKNOWN))


class ToldTruth(ABC):
    """A completer that is told what a simulator holds of the object: a bound or a comparison, of no use on a robot."""

    @abstractmethod
    def placed(self, detection: Detection, truth: TrueObject, T_world_object: np.ndarray) -> Completion:
        """Complete an object that the simulator holds, at its pose (4, 4)."""


class Oracle(ToldTruth):
    """The true mesh as its own completion; no other completer is given the true shape."""

    def __call__(
        self, detection: Detection, truth: trimesh.Trimesh | None = None, collision: CollisionMesh | None = None
    ) -> Completion:
        """Complete an object by its true mesh.

        Args:
            detection: The object as it was seen; it tells what was observed.
            truth: True mesh in the world frame.
            collision: Convex parts of the true mesh, world frame.

        Raises:
            InvalidOption: The truth is missing, as for any other completer.
        """
        if truth is None or collision is None:
            raise InvalidOption("the oracle needs the true mesh and its convex parts: use it in a simulator only")
        return CompletionInParts(mark_shape(truth, detection), detection, collision)

    def placed(self, detection: Detection, truth: TrueObject, T_world_object: np.ndarray) -> Completion:
        """Complete an object by what the simulator holds of it, at its pose (4, 4)."""
        known = truth.collision
        parts = tuple(ConvexPart(apply_T(T_world_object, part.vertices), part.faces) for part in known.parts)
        mesh = truth.mesh.copy()
        mesh.apply_transform(T_world_object)
        return self(detection, mesh, replace(known, parts=parts))


def complete_as_peer(detection: Detection, name: str) -> Completion:
    """The completion of another network, in a cube around what was seen; its category is `UNKNOWN`.

    Args:
        detection: The object as it was seen.
        name: One of `gfp_grasp.peers.PEERS`.

    Raises:
        NotTrained: Its weights do not ship; the message has the command that trains it.
        TooFewPoints: Too few points.
        NoSurface: The network finds nothing solid.
    """
    from gfp_grasp.peers import complete_by_peer  # torch is loaded where it is needed only

    return Completion(complete_by_peer(detection, name), replace(detection, category=UNKNOWN))


@dataclass(frozen=True)
class InTrueBox(ToldTruth):
    """Another network, told the true box, as its paper normalises objects; it is not told the shape.

    Attributes:
        name: One of `gfp_grasp.peers.PEERS`.
    """

    name: str

    def __call__(self, detection: Detection, box: OrientedBox | None = None) -> Completion:
        """Complete an object within its true box.

        Args:
            detection: The object as it was seen.
            box: The true box, along the object's own axes, world frame.

        Raises:
            InvalidOption: The box is missing, as for any other completer.
            NotTrained, TooFewPoints, NoSurface: As `complete_as_peer` does.
        """
        if box is None:
            raise InvalidOption(
                f"{self.name}{TRUE_BOX} needs the true box: use it in a simulator only, or {self.name!r}, which does "
                "without"
            )
        from gfp_grasp.peers import complete_by_peer

        return Completion(complete_by_peer(detection, self.name, box=box), replace(detection, category=UNKNOWN))

    def placed(self, detection: Detection, truth: TrueObject, T_world_object: np.ndarray) -> Completion:
        """Complete an object within the box that the simulator's mesh has at its pose (4, 4)."""
        return self(detection, true_box(truth.mesh, T_world_object))


# What answers with a primitive whatever speaks against it.
_ALWAYS = CompleteConfig(unknown_above=1.0, fall_back=False)
# Completers that fit a primitive, and how each of them does it; the paper's have one whatever they see.
CONFIGS: Mapping[str, CompleteConfig] = {
    "icp": replace(_ALWAYS, fit=icp_config(), deform=DeformConfig(method="none"), subcategories=False),
    "pcrnet": replace(_ALWAYS, fit=pcrnet_config(), deform=DeformConfig(method="none"), subcategories=False),
    "registration": CompleteConfig(deform=DeformConfig(method="none")),
    "gfs": replace(_ALWAYS, deform=DeformConfig(method="gfs")),
    "gfpnet-oneshot": replace(_ALWAYS, deform=DeformConfig(method="gfpnet-oneshot")),
    "gfpnet-paper": replace(_ALWAYS, deform=DeformConfig(method="gfpnet-paper")),
    "gfpnet": CompleteConfig(),
}
# Completers that do not ask for the class.
_WITHOUT_CLASS: Mapping[str, Completer] = {
    "oracle": Oracle(),
    "observed": complete_as_observed,
    "mirror": complete_by_mirror,
    "classfree": complete_without_class,
}
COMPLETERS = (*_WITHOUT_CLASS, *CONFIGS)
# Other networks, as a user has them and as their papers normalise; they stand in comparisons where they are named.
# {completer: (peer, whether it is told the true box)}.
PEER_COMPLETERS: Mapping[str, tuple[str, bool]] = {
    f"{name}{TRUE_BOX if boxed else ''}": (name, boxed) for name in PEERS for boxed in (False, True)
}


def get_completer(name: str, *, library: PrimitiveLibrary | None = None) -> Completer:
    """A completer by name.

    Args:
        name: `observed` (hull of what was seen), `mirror` (hull of the cloud and its reflection in the vertical plane
            through its middle that faces the camera), `classfree` (a network that knows no class), `icp` and `pcrnet`
            (the mean primitive, placed rigidly), `registration` (the fitted primitive, undeformed), that deformed by
            `gfs` (active contour), `gfpnet-oneshot` or `gfpnet-paper` (the paper's networks) or `gfpnet` (the package's
            method), `oracle` (the true mesh; see `Oracle`), one of PEER_COMPLETERS (another network, such as `pcn`, or
            `pcn-true-box`, which is told the true box; see `InTrueBox`), or `package.module:function`, a function of a
            Detection that returns a trimesh.Trimesh in the world frame or a Completion.
        library: The classes that there are for the package's own completers; None for those that ship.

    Returns:
        A function of a detection; one that is told the truth is a `ToldTruth`, which takes it as well.

    Raises:
        NotTrained: The weights of the other network do not ship; the message has the command that trains it.
        UnknownCompleter: The name is none of these, or cannot be imported.
    """
    if name in _WITHOUT_CLASS:
        return _WITHOUT_CLASS[name]
    if name in CONFIGS:
        config = CONFIGS[name] if library is None else replace(CONFIGS[name], library=library)
        return partial(complete_detection, config=config)
    if name in PEER_COMPLETERS:
        return _peer(name)
    on_offer = ", ".join((*COMPLETERS, *PEER_COMPLETERS))
    function = imported_function(name, what="completer", of="a Detection", on_offer=on_offer, error=UnknownCompleter)
    return _checked(function)


def check_network(name: str) -> None:
    """Load the network of one of PEER_COMPLETERS, so that what is wrong with it is told before any work is done.

    Raises:
        NotTrained: Its weights do not ship; the message has the command that trains it.
        UnreadableFile: The file holds no weights of it.
    """
    from gfp_grasp.peers import load_network  # torch is loaded where it is needed only

    peer, boxed = PEER_COMPLETERS[name]
    load_network(peer, true_box=boxed)


def needs_class(name: str) -> bool:
    """Whether a completer, by name, looks at the class of its detection."""
    return name not in _WITHOUT_CLASS and name not in PEER_COMPLETERS  # a user's own may ask for the class


def _peer(completer: str) -> Completer:
    """A completer of PEER_COMPLETERS; its weights are loaded at its first call."""
    name, boxed = PEER_COMPLETERS[completer]
    check_trained(name, true_box=boxed)
    return InTrueBox(name) if boxed else partial(complete_as_peer, name=name)


def _checked(function: Callable[[Detection], object]) -> Completer:
    """A user's function as a completer: its mesh is checked, made solid and marked."""

    def complete(detection: Detection) -> Completion:
        answer = function(detection)
        if isinstance(answer, Completion):
            return answer
        if not isinstance(answer, trimesh.Trimesh):
            raise InvalidMesh(
                f"the completer returned a {type(answer).__name__}; a trimesh.Trimesh or Completion is expected"
            )
        mesh = check_mesh(answer)
        solid = mesh if mesh.is_volume else make_solid(mesh)[0]
        return Completion(mark_shape(solid, detection), detection)

    return complete
