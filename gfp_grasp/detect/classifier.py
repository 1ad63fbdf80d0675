"""Which class a partial view shows: a small PointNet embeds it, and a class is as likely as its prototypes are near.

The network holds no list of classes. A class brings prototypes: embedded views of its own members, so a class that is
added takes part at once (prototypical networks, arXiv:1703.05175; several prototypes a class, arXiv:1909.05235).
Letters: b clouds, n points, c channels of an embedding, k prototypes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from safetensors.torch import load_file
from scipy.spatial import KDTree
from torch import nn

from gfp_grasp.assets import data_file
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.parallel import one_thread
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import GenericPrimitive, SupportPlane

POOL_POINTS = 1200  # at this density the surroundings are looked at, and of these
NUM_POINTS = 768  # go into the network
NUM_FEATURES = 8
NUM_CHANNELS = 48
FLOOR_M = (
    0.006  # what is nearer to the table is left out, in training as in use: a detector cannot tell it from the table
)
_SCALE_M = 0.1  # the size of things at which the logarithm of size is zero
_NEIGHBOURS = 24
# A class with many prototypes is the weaker at each of them: 1 would be a mixture of bells, which is told too little of
# how wide a class is that has few members; 0 would favour classes with many prototypes.
_DILUTION = 0.5
_YAWS = 4  # the answer is a mean over turns about up, for nothing in the network makes it blind to them


class EmbeddingNet(nn.Module):
    """PointNet with one look around: (b, n, 8) features to (b, c) unit vectors.

    After a first max-pooling every point is seen next to the whole cloud, without which "beyond the body's radius",
    that is a handle, cannot be said.
    """

    def __init__(self, num_channels: int = NUM_CHANNELS, *, width: int = 48) -> None:
        super().__init__()
        self.near = nn.Sequential(
            nn.Linear(NUM_FEATURES, width), nn.LayerNorm(width), nn.ReLU(), nn.Linear(width, 2 * width)
        )  # fmt: skip
        self.around = nn.Sequential(
            nn.LayerNorm(4 * width), nn.ReLU(), nn.Linear(4 * width, 2 * width), nn.ReLU(),
            nn.Linear(2 * width, 4 * width),
        )  # fmt: skip
        self.head = nn.Sequential(
            nn.Linear(8 * width, 2 * width), nn.LayerNorm(2 * width), nn.ReLU(), nn.Dropout(0.1),
            nn.Linear(2 * width, num_channels),
        )  # fmt: skip

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        near = self.near(features)
        whole = near.max(dim=1, keepdim=True).values.expand_as(near)
        around = self.around(torch.cat([near, whole], dim=2))
        embedding = self.head(torch.cat([around.max(dim=1).values, around.mean(dim=1)], dim=1))
        return nn.functional.normalize(embedding.float(), dim=1)


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
    """

    vectors: np.ndarray
    weights: np.ndarray


def classify(
    points: np.ndarray,
    up: np.ndarray,
    support: SupportPlane | None = None,
    *,
    library: PrimitiveLibrary | None = None,
    device: str = "cpu",
) -> dict[str, float]:
    """Probability of each class of a library for the points of one object.

    Args:
        points: (n, 3) m, one object, no table; any n > 0, in any order that is the same each time.
        up: (3,) the support's normal.
        support: The table; None takes the lowest points for it.
        library: The classes that there are; None takes the shipped ones.
        device: Where the network runs.

    Returns:
        Calibrated probabilities, which sum to one. An object that is like no class gets an even spread.

    Raises:
        UnreadableFile: A class has no prototypes of this network; the message says how to make them.
    """
    embedding = embed(points, up, support, network=load_embedding(device))
    return class_scores(embedding, library_prototypes(library or PrimitiveLibrary.shipped()), load_calibration())


def embed(
    points: np.ndarray, up: np.ndarray, support: SupportPlane | None = None, *, network: EmbeddingNet | None = None
) -> np.ndarray:
    """What the points of one object look like to the network.

    Args:
        points: (n, 3) m, one object, no table.
        up: (3,) the support's normal.
        support: The table; None takes the lowest points for it.
        network: None takes the shipped one.

    Returns:
        (c,) unit vector; a turn about up hardly changes it.
    """
    rng = np.random.default_rng(0)
    cloud = with_surface(sample_points(upright_points(points, up, support), POOL_POINTS, rng))
    cloud = sample_points(cloud, NUM_POINTS, rng)
    turned = np.stack([_turned(cloud, 2 * np.pi * k / _YAWS) for k in range(_YAWS)])
    mean = embed_clouds(turned, network or load_embedding()).mean(axis=0)
    return mean / np.linalg.norm(mean)


def embed_clouds(clouds: np.ndarray, network: EmbeddingNet) -> np.ndarray:
    """Unit vectors (b, c) of clouds (b, n, 6) of `with_surface`."""
    device = next(network.parameters()).device
    with one_thread(), torch.inference_mode():
        parts = torch.from_numpy(features(clouds)).to(device).split(64)
        return torch.cat([network(part) for part in parts]).cpu().double().numpy()


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
        near = (embeddings @ own.vectors.T - 1.0) / calibration.temperature + _DILUTION * np.log(own.weights)
        highest = near.max(axis=1)
        masses.append(highest + np.log(np.exp(near - highest[:, None]).sum(axis=1)))
    raised = np.logaddexp(np.array(masses).T, -calibration.reach / calibration.temperature)
    raised = np.exp(raised - raised.max(axis=1, keepdims=True))
    return raised / raised.sum(axis=1, keepdims=True)


def library_prototypes(library: PrimitiveLibrary) -> dict[str, Prototypes]:
    """The prototypes of each class of a library, those of its subcategories by their share.

    Raises:
        UnreadableFile: A primitive has no prototypes, or those of another network.
    """
    return {category: mixed(library.members_of(category)) for category in library.categories}


def mixed(members: Sequence[GenericPrimitive]) -> Prototypes:
    """The prototypes of a class and of its subcategories together."""
    sha256 = str(load_card()["sha256"])
    # A class is built from all of its members, so its subcategories may be without.
    members = [primitive for primitive in members if primitive is members[0] or len(primitive.prototypes)]
    for primitive in members:
        if not len(primitive.prototypes) or primitive.card.get("prototypes_sha256") != sha256:
            raise UnreadableFile(
                f"the primitive of {primitive.name} has no prototypes of this package's classifier: "
                "`gfp-grasp gps prototypes --gps FOLDER` makes them"
            )
    return mixture([primitive.prototypes for primitive in members], [primitive.spec.share for primitive in members])


def mixture(vectors: Sequence[np.ndarray], shares: Sequence[float]) -> Prototypes:
    """Prototypes (k, c) of several groups of members as one class, each group by its share of all."""
    weights = np.concatenate([np.full(len(own), share / len(own)) for own, share in zip(vectors, shares, strict=True)])
    return Prototypes(np.concatenate(vectors).astype(np.float64), weights / weights.sum())


def upright_points(points: np.ndarray, up: np.ndarray, support: SupportPlane | None) -> np.ndarray:
    """(n, 3) m with z above the support, along up, and the middle of their ground outline at x = y = 0."""
    level = points @ rotation_between(up, (0.0, 0.0, 1.0)).T
    low, high = np.percentile(level, (1, 99), axis=0)
    height_m = float(low[2]) - FLOOR_M if support is None else support.height_m
    return level - np.append((low[:2] + high[:2]) / 2, height_m)


def sample_points(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, c) rows of (n, c), each point at most once where there are enough."""
    if len(points) >= count:
        return points[rng.choice(len(points), count, replace=False)]
    return points[np.concatenate([np.arange(len(points)), rng.integers(len(points), size=count - len(points))])]


def with_surface(points: np.ndarray) -> np.ndarray:
    """(n, 6): upright points with what their surroundings look like, none of which a turn about up changes.

    Of the covariance of the nearest 24 points, eigenvalues e0 <= e1 <= e2: how level the surface is (|z| of the
    normal), how rough (e0 / e1) and how much like a wire (1 - e1 / e2), as a handle is.
    """
    _, near = KDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    local = points[near] - points[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))
    e0, e1, e2 = np.maximum(spread, 1e-12).T
    return np.column_stack([points, np.abs(axes[:, 2, 0]), e0 / e1, 1 - e1 / e2])


def features(cloud: np.ndarray) -> np.ndarray:
    """(..., n, 8) float32 input of the network for (..., n, 6) clouds of with_surface.

    Points are in units of the cloud's own size, so a lorry is as easy to see as a toy; the size is a channel of its
    own, for it tells one from the other.
    """
    points = cloud[..., :3]
    radius = np.linalg.norm(points[..., :2], axis=-1, keepdims=True)
    size = np.sqrt((points**2).sum(axis=-1).mean(axis=-1))[..., None, None]
    logs = np.broadcast_to(np.log(size / _SCALE_M), radius.shape)
    return np.concatenate([points / size, radius / size, cloud[..., 3:], logs], axis=-1).astype(np.float32)


def _turned(cloud: np.ndarray, yaw_rad: float) -> np.ndarray:
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turned = cloud.copy()
    turned[:, :2] = cloud[:, :2] @ np.array([[c, s], [-s, c]])
    return turned


@cache
def load_embedding(device: str = "cpu") -> EmbeddingNet:
    """The shipped network, in evaluation mode, loaded once."""
    config = load_card()["config"]
    network = EmbeddingNet(config["channels"], width=config["width"])
    state = load_file(data_file("weights", "classifier.safetensors"))
    network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    return network.eval().to(device)


@cache
def load_card() -> dict:
    """How the shipped weights came to be, and how their distances are calibrated."""
    return json.loads(data_file("weights", "classifier.json").read_text(encoding="utf-8"))


def load_calibration() -> Calibration:
    """Temperature and reach of the shipped network."""
    metrics = load_card()["metrics"]
    return Calibration(float(metrics["temperature"]), float(metrics["reach"]))
