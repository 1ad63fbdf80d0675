"""One look at the points of an object: an embedding that its class is known by, how it rests and is turned, its box.

One network answers all of it in one pass, however many classes there are. It holds no list of classes: an embedding is
compared with prototypes (`gfp_grasp.detect.classifier`), and pose and box are the object's own, for whatever class.
Letters: b clouds, n points, c channels of an embedding.
"""

from __future__ import annotations

import json
from functools import cache
from typing import Generic, NamedTuple, TypeVar

import numpy as np
import torch
from safetensors.torch import load_file
from scipy.spatial import KDTree
from torch import Tensor, nn

from gfp_grasp.assets import data_file
from gfp_grasp.networks import in_single
from gfp_grasp.parallel import one_thread
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about, rotation_between
from gfp_grasp.types import RESTS, TABLETOP, OrientedBox, Proposal, SensorProfile, SupportPlane

POOL_POINTS = 1200  # at this density the surroundings are looked at, and of these
NUM_POINTS = 768  # go into the network
NUM_FEATURES = 12
NUM_CHANNELS = 64
_SCALE_M = 0.1  # the size of things at which the logarithm of size is zero
_NEIGHBOURS = 24
PROTOTYPES = "prototypes."  # begins the names of tensors of a weights file that are prototypes of a class
_YAWS = 4  # where nobody knows the viewpoint, the answer is a mean over turns about up
_LEAST_FRONT = 1e-3
Array = TypeVar("Array", Tensor, np.ndarray)


class Look(NamedTuple, Generic[Array]):
    """What the network says of clouds, in their own frames and units of their own size.

    Attributes:
        embedding: (b, c) unit vectors.
        rests: (b, 3) logits of RESTS.
        up: (b, 3), the object's z axis; the shorter, the less sure.
        front: (b, 3), its x axis, likewise; of a body of revolution it says nothing.
        log_extents: (b, 3) logarithms of its extents along its own axes.
        centre: (b, 3), the middle of its box.
    """

    embedding: Array
    rests: Array
    up: Array
    front: Array
    log_extents: Array
    centre: Array


class ProposalNet(nn.Module):
    """PointNet with two looks around: (b, n, NUM_FEATURES) features to a Look.

    After a max-pooling every point is seen next to the whole cloud, without which "beyond the body's radius", that is a
    handle, cannot be said.
    """

    def __init__(self, num_channels: int = NUM_CHANNELS, *, width: int = 64) -> None:
        super().__init__()
        self.near = nn.Sequential(
            nn.Linear(NUM_FEATURES, width), nn.LayerNorm(width), nn.ReLU(), nn.Linear(width, 2 * width)
        )  # fmt: skip
        self.around = nn.Sequential(
            nn.LayerNorm(4 * width), nn.ReLU(), nn.Linear(4 * width, 2 * width), nn.ReLU(),
            nn.Linear(2 * width, 2 * width),
        )  # fmt: skip
        self.again = nn.Sequential(
            nn.LayerNorm(4 * width), nn.ReLU(), nn.Linear(4 * width, 2 * width), nn.ReLU(),
            nn.Linear(2 * width, 4 * width),
        )  # fmt: skip
        self.trunk = nn.Sequential(nn.Linear(8 * width, 4 * width), nn.LayerNorm(4 * width), nn.ReLU())
        self.kind = nn.Sequential(
            nn.Linear(4 * width, 2 * width), nn.ReLU(), nn.Dropout(0.1), nn.Linear(2 * width, num_channels)
        )  # fmt: skip
        self.pose = nn.Sequential(nn.Linear(4 * width, 2 * width), nn.ReLU(), nn.Linear(2 * width, len(RESTS) + 12))

    def forward(self, features: Tensor) -> Look[Tensor]:
        points = self.near(features)
        points = points + self.around(_beside_whole(points))
        points = self.again(_beside_whole(points))
        whole = self.trunk(torch.cat([points.max(dim=1).values, points.mean(dim=1)], dim=1))
        embedding = nn.functional.normalize(self.kind(whole).float(), dim=1)
        return Look(embedding, *self.pose(whole).float().split([len(RESTS), 3, 3, 3, 3], dim=1))


def _beside_whole(points: Tensor) -> Tensor:
    """(b, n, 2 c): each point's channels (b, n, c) and the largest of all points."""
    return torch.cat([points, points.max(dim=1, keepdim=True).values.expand_as(points)], dim=2)


def look(
    points: np.ndarray,
    up: np.ndarray,
    support: SupportPlane | None = None,
    *,
    viewpoint: np.ndarray | None = None,
    sensor: SensorProfile = TABLETOP,
    network: ProposalNet | None = None,
) -> Proposal:
    """What the points of one object look like to the network; pose and box in the world frame.

    Args:
        points: (n, 3) m, one object, no table; any n > 0, in any order that is the same each time.
        up: (3,) the support's normal.
        support: The table; None takes the lowest points for it.
        viewpoint: (3,) m, where the camera stood; None is less sure.
        sensor: What saw them: each kind of sensor has a network of its own.
        network: None takes the shipped one, of which alone it is known what classes it has learnt from.
    """
    T_world_seen = seen_frame(points, up, support, viewpoint, floor_m=sensor.floor_m)
    T_seen_world = invert_T(T_world_seen)
    local = apply_T(T_seen_world, points)
    eye = None if viewpoint is None else apply_T(T_seen_world, viewpoint)
    rng = np.random.default_rng(0)
    cloud = sample_points(with_surface(sample_points(local, POOL_POINTS, rng), eye), NUM_POINTS, rng)
    turns = [rotation_about((0, 0, 1), 2 * np.pi * k / _YAWS) for k in range(1 if eye is not None else _YAWS)]
    own = network or load_network(weights_of(sensor))
    answer = look_at_clouds(np.stack([turned_cloud(cloud, R) for R in turns]), own)
    embedding = answer.embedding.mean(axis=0)
    vectors = {name: np.mean([v @ R for v, R in zip(getattr(answer, name), turns, strict=True)], axis=0)
               for name in ("up", "front", "centre")}  # fmt: skip
    size = size_of(cloud[:, :3])
    logits = answer.rests.mean(axis=0)
    odds = np.exp(logits - logits.max())
    extents = size * np.exp(answer.log_extents.mean(axis=0))
    T_seen_box = make_T(_rotation(vectors["up"], vectors["front"]), size * vectors["centre"])
    return Proposal(
        box=OrientedBox(T_world_seen @ T_seen_box, extents),
        rests=dict(zip(RESTS, (odds / odds.sum()).tolist(), strict=True)),
        sure_of_front=float(min(np.linalg.norm(vectors["front"]), 1.0)),
        classes=tuple(load_card(weights_of(sensor))["data"]["classes"]) if network is None else (),
        embedding=embedding / np.linalg.norm(embedding),
    )


def look_at_clouds(clouds: np.ndarray, network: ProposalNet) -> Look[np.ndarray]:
    """The network's answer, as arrays, for clouds (b, n, 9) of `with_surface`."""
    device = next(network.parameters()).device
    with one_thread(), torch.inference_mode():
        parts = [network(part) for part in torch.from_numpy(features(clouds)).to(device).split(64)]
        return Look(*(torch.cat(column).cpu().double().numpy() for column in zip(*parts, strict=True)))


def seen_frame(
    points: np.ndarray,
    up: np.ndarray,
    support: SupportPlane | None,
    viewpoint: np.ndarray | None,
    *,
    floor_m: float = TABLETOP.floor_m,
) -> np.ndarray:
    """T_world_seen (4, 4): z along up from the support, x towards the viewer, the ground outline's middle at zero."""
    R = rotation_between(up, (0.0, 0.0, 1.0))
    if viewpoint is not None:
        toward = R @ (viewpoint - points.mean(axis=0))
        R = rotation_about((0, 0, 1), -float(np.arctan2(toward[1], toward[0]))) @ R
    level = points @ R.T
    low, high = np.percentile(level, (1, 99), axis=0)
    height_m = float(low[2]) - floor_m if support is None else support.height_m
    return make_T(R.T, np.append((low[:2] + high[:2]) / 2, height_m) @ R)


def sample_points(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, c) rows of (n, c), each point at most once where there are enough."""
    if len(points) >= count:
        return points[rng.choice(len(points), count, replace=False)]
    return points[np.concatenate([np.arange(len(points)), rng.integers(len(points), size=count - len(points))])]


def with_surface(points: np.ndarray, viewpoint: np.ndarray | None) -> np.ndarray:
    """(n, 9): points in the seen frame with what their surroundings look like.

    The covariance of the nearest 24 points, with eigenvalues e0 <= e1 <= e2, tells how level the surface is (|z| of the
    normal), how rough (e0 / e1) and how much like a wire (1 - e1 / e2), as a handle is; then comes the normal, towards
    the viewpoint, or zeros where nobody knows that.
    """
    _, near = KDTree(points).query(points, k=min(_NEIGHBOURS, len(points)))
    local = points[near] - points[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))
    e0, e1, e2 = np.maximum(spread, 1e-12).T
    normals = axes[:, :, 0]
    if viewpoint is None:
        signed = np.zeros_like(normals)
    else:
        signed = normals * np.where(((viewpoint - points) * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    return np.column_stack([points, np.abs(normals[:, 2]), e0 / e1, 1 - e1 / e2, signed])


def features(cloud: np.ndarray) -> np.ndarray:
    """(..., n, NUM_FEATURES) float32 input of the network for (..., n, 9) clouds of with_surface.

    Points are in units of the cloud's own size, so a lorry is as easy to see as a toy; the size is a channel of its
    own, for it tells one from the other. The last channel says whether the viewpoint is known.
    """
    points = cloud[..., :3]
    radius = np.linalg.norm(points[..., :2], axis=-1, keepdims=True)
    size = size_of(points)[..., None, None]
    logs = np.broadcast_to(np.log(size / _SCALE_M), radius.shape)
    known = np.broadcast_to((cloud[..., 6:] != 0).any(axis=(-1, -2), keepdims=True), radius.shape)
    return np.concatenate([points / size, radius / size, cloud[..., 3:], logs, known], axis=-1).astype(np.float32)


def size_of(points: np.ndarray) -> np.ndarray:
    """(...,) m, within which nine in ten of the points (..., n, 3) in the seen frame lie: the network's unit.

    Pixels that fly off an edge would take a mean square along.
    """
    return np.quantile(np.linalg.norm(points, axis=-1), 0.9, axis=-1)


def turned_cloud(cloud: np.ndarray, R: np.ndarray) -> np.ndarray:
    """(n, 9) cloud of with_surface, turned or mirrored by R (3, 3), which leaves z alone."""
    return np.column_stack([cloud[:, :3] @ R.T, cloud[:, 3:6], cloud[:, 6:] @ R.T])


def _rotation(up: np.ndarray, front: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) whose z is along up and whose x is as near to front as it can be."""
    z = up / max(float(np.linalg.norm(up)), 1e-9)
    x = front - (front @ z) * z
    if np.linalg.norm(x) < _LEAST_FRONT:
        x = np.eye(3)[np.abs(z).argmin()]
        x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def weights_of(sensor: SensorProfile) -> str:
    """Name of the shipped weights that look at what a sensor saw: pictures of table tops, or scans of traffic."""
    return "proposal_lidar" if sensor.of_traffic else "proposal"


@cache
def load_network(weights: str = "proposal") -> ProposalNet:
    """A shipped network, in evaluation mode, loaded once."""
    config = load_card(weights)["config"]
    network = ProposalNet(config["channels"], width=config["width"])
    own = {name: tensor for name, tensor in _tensors(weights).items() if not name.startswith(PROTOTYPES)}
    network.load_state_dict(in_single(own))
    return network.eval()


@cache
def load_prototypes(weights: str) -> dict[str, np.ndarray]:
    """Unit vectors (k, c) of each class that a shipped network brings prototypes of; most are kept in primitives."""
    own = {k.removeprefix(PROTOTYPES): v for k, v in _tensors(weights).items() if k.startswith(PROTOTYPES)}
    return {name: nn.functional.normalize(vectors.double(), dim=1).numpy() for name, vectors in own.items()}


def _tensors(weights: str) -> dict[str, Tensor]:
    return load_file(data_file("weights", f"{weights}.safetensors"))


@cache
def load_card(weights: str = "proposal") -> dict:
    """How shipped weights came to be, and how their distances are calibrated."""
    return json.loads(data_file("weights", f"{weights}.json").read_text(encoding="utf-8"))
