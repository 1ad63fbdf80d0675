"""Which class a partial view shows: a network embeds it, and a class is as likely as its prototypes are near.

A class brings prototypes: embedded views of its own members, so a class that is
added takes part at once (prototypical networks, arXiv:1703.05175; several prototypes a class, arXiv:1909.05235).
Primitives bring those of depth cameras; those of a LiDAR come with its network, and a class that it has none of takes
part as one that nothing is known of.
Letters: c channels of an embedding, k prototypes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from gfp_grasp.detect.proposal import load_card, load_prototypes, look, weights_of
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import TABLETOP, GenericPrimitive, SensorProfile, SupportPlane

# A class with many prototypes is the weaker at each of them: 1 would be a mixture of bells, which is told too little of
# how wide a class is that has few members; 0 would favour classes with many prototypes.
_DILUTION = 0.5
_IN_PRIMITIVES = "proposal"  # the weights whose prototypes primitives bring


@dataclass(frozen=True)
class Calibration:
    """How distances become probabilities.

    Attributes:
        temperature: Distance (one less the cosine) over which the weight of a prototype falls by e.
        reach: Distance beyond which an object is more likely to be a thing of no class.
    """

    temperature: float
    reach: float


class Prototypes(NamedTuple):
    """What the members of a class look like.

    Attributes:
        vectors: (k, c) unit embeddings.
        weights: (k,) share of the members that each stands for; they sum to one.
        member: (k,) number of the primitive, among those of the class, whose prototype each is.
    """

    vectors: np.ndarray
    weights: np.ndarray
    member: np.ndarray


def classify(
    points: np.ndarray,
    up: np.ndarray,
    support: SupportPlane | None = None,
    *,
    viewpoint: np.ndarray | None = None,
    sensor: SensorProfile = TABLETOP,
    library: PrimitiveLibrary | None = None,
) -> dict[str, float]:
    """Probability of each class of a library for the points of one object.

    Args:
        points: (n, 3) m, one object, no table; any n > 0, in any order that is the same each time.
        up: (3,) the support's normal.
        support: The table; None takes the lowest points for it.
        viewpoint: (3,) m, where the camera stood; None is less sure.
        sensor: What saw them.
        library: The classes that there are; None takes the shipped ones.

    Returns:
        Calibrated probabilities, which sum to one. An object that is like no class gets an even spread.

    Raises:
        UnreadableFile: A class has no prototypes of this network; the message says how to make them.
    """
    seen = look(points, up, support, viewpoint=viewpoint, sensor=sensor)
    return scores_in(seen.embedding, library or PrimitiveLibrary.shipped(), sensor)


def scores_in(embedding: np.ndarray, library: PrimitiveLibrary, sensor: SensorProfile = TABLETOP) -> dict[str, float]:
    """Calibrated probability of each class of a library for an embedded object (c,), see `class_scores`.

    To a LiDAR these are the classes that its network knows and those that do not ship.
    """
    return class_scores(embedding, library_prototypes(library, sensor), load_calibration(weights_of(sensor)))


def distance_in(embedding: np.ndarray, library: PrimitiveLibrary, sensor: SensorProfile = TABLETOP) -> float:
    """Distance (one less the cosine) of an embedded object (c,) from the nearest prototype of any class."""
    vectors = np.concatenate([own.vectors for own in library_prototypes(library, sensor).values()])
    return max(1.0 - float((vectors @ embedding).max(initial=-1.0)), 0.0)


def shares_in(
    embedding: np.ndarray, members: Sequence[GenericPrimitive], sensor: SensorProfile = TABLETOP
) -> dict[str, float]:
    """Probability of each primitive of one class, by its name, given that an embedded object (c,) is of that class.

    Where one of them has no prototypes of the sensor's network, these are the shares that their cards state.
    """
    shares = np.array([primitive.spec.share for primitive in members])
    odds = shares / shares.sum()
    if weights_of(sensor) == _IN_PRIMITIVES and all(map(_is_known, members)):
        whole, calibration = mixed(tuple(members)), load_calibration()
        near = (whole.vectors @ embedding - 1.0) / calibration.temperature + _DILUTION * np.log(whole.weights)
        floor = np.log(odds) - calibration.reach / calibration.temperature
        masses = np.array([np.logaddexp.reduce(near[whole.member == k], initial=low) for k, low in enumerate(floor)])
        odds = np.exp(masses - masses.max())
    return {p.name: float(share) for p, share in zip(members, odds / odds.sum(), strict=True)}


def class_scores(
    embedding: np.ndarray, prototypes: Mapping[str, Prototypes], calibration: Calibration
) -> dict[str, float]:
    """Probability of each class for an embedded object.

    A class is a sum of bells about its prototypes. Each class also has an even share of a floor, which decides
    where all prototypes are far: what is like no class gets an even spread.

    Args:
        embedding: (c,) unit vector.
        prototypes: Prototypes of each class.
        calibration: Temperature and reach.

    Returns:
        Probabilities, which sum to one.
    """
    scores = score_table(embedding[None], list(prototypes.values()), calibration)[0]
    return dict(zip(prototypes, scores.tolist(), strict=True))


def score_table(embeddings: np.ndarray, prototypes: Sequence[Prototypes], calibration: Calibration) -> np.ndarray:
    """Probabilities (e, classes) of embedded objects (e, c), see `class_scores`."""
    masses = []
    for own in prototypes:
        if not len(own.vectors):
            masses.append(np.full(len(embeddings), -np.inf))
            continue
        near = (embeddings @ own.vectors.T - 1.0) / calibration.temperature + _DILUTION * np.log(own.weights)
        highest = near.max(axis=1)
        masses.append(highest + np.log(np.exp(near - highest[:, None]).sum(axis=1)))
    raised = np.logaddexp(np.array(masses).T, -calibration.reach / calibration.temperature)
    raised = np.exp(raised - raised.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)


def library_prototypes(library: PrimitiveLibrary, sensor: SensorProfile = TABLETOP) -> dict[str, Prototypes]:
    """The prototypes of each class of a library, those of its subcategories by their share.

    Raises:
        UnreadableFile: A primitive has no prototypes, or those of another network.
    """
    weights = weights_of(sensor)
    if weights != _IN_PRIMITIVES:
        known, shipped = load_prototypes(weights), PrimitiveLibrary.shipped().categories
        classes = [name for name in library.categories if name in known or name not in shipped]
        none = Prototypes(np.empty((0, load_card(weights)["config"]["channels"])), np.empty(0), np.empty(0, np.int64))
        return {name: mixture([known[name]], [1.0]) if name in known else none for name in classes}
    return {category: mixed(library.members_of(category)) for category in library.categories}


@lru_cache(maxsize=256)
def mixed(members: tuple[GenericPrimitive, ...]) -> Prototypes:
    """The prototypes of a class and of its subcategories together."""
    for primitive in members:
        if not _is_known(primitive):
            raise UnreadableFile(
                f"the primitive of {primitive.name} has no prototypes of this package's classifier: "
                "`gfp-grasp gps prototypes --gps FOLDER` makes them"
            )
    return mixture([primitive.prototypes for primitive in members], [primitive.spec.share for primitive in members])


def _is_known(primitive: GenericPrimitive) -> bool:
    """Whether a primitive has prototypes, and of the network that ships."""
    return bool(len(primitive.prototypes)) and primitive.card.get("prototypes_sha256") == load_card()["sha256"]


def mixture(vectors: Sequence[np.ndarray], shares: Sequence[float]) -> Prototypes:
    """Prototypes (k, c) of several groups of members as one class, each group by its share of all."""
    weights = np.concatenate([np.full(len(own), share / len(own)) for own, share in zip(vectors, shares, strict=True)])
    member = np.repeat(np.arange(len(vectors)), [len(own) for own in vectors])
    return Prototypes(np.concatenate(vectors).astype(np.float64), weights / weights.sum(), member)


def load_calibration(weights: str = "proposal") -> Calibration:
    """Temperature and reach of a shipped network."""
    metrics = load_card(weights)["metrics"]
    return Calibration(float(metrics["temperature"]), float(metrics["reach"]))
