"""Prototypes, by which a class is known: embedded views of its members, a few that stand for all of them.

Where the members are not at hand, they are those that the primitive was built from, as its own modes and scale say they
were: prototypes can be made anew for another network from the primitive alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh
from scipy.cluster.vq import kmeans2

from gfp_grasp.assets import data_file
from gfp_grasp.detect import ProposalNet, look
from gfp_grasp.parallel import one_thread
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train.proposal_data import TABLE, VIEWS
from gfp_grasp.train.rests import ways_of_resting
from gfp_grasp.train.views import views_of_mesh
from gfp_grasp.types import TABLETOP, GenericPrimitive

NUM_PROTOTYPES = 16
_NUM_VIEWS = 192  # of all members together: ten seconds


@one_thread()
def make_prototypes(
    primitive: GenericPrimitive,
    *,
    meshes: Sequence[trimesh.Trimesh] | None = None,
    network: ProposalNet | None = None,
    seed: int = 0,
    num_views: int = _NUM_VIEWS,
) -> np.ndarray:
    """Look at the members of a class from all sides, as they rest, and keep what is typical.

    Args:
        primitive: Primitive of a class or of a subcategory.
        meshes: Its members, m, z up; None takes what the primitive says of those that it was built from.
        network: Network that embeds; None takes the shipped one.
        seed: Seed of the views and of the clustering.
        num_views: Number of views of all members together.

    Returns:
        (k, c) unit vectors, k at most NUM_PROTOTYPES.
    """
    rng = np.random.default_rng(seed)
    count = len(primitive.coefficient_samples) if meshes is None else len(meshes)
    source, ways = ObjectSource(primitive.name, primitive.name), ways_of_resting(primitive.spec.rests)
    embedded = []
    for number in np.resize(rng.permutation(count), num_views).tolist():
        mesh = _member(primitive, number) if meshes is None else meshes[number]
        for view in views_of_mesh(source, mesh, rng, num_views=1, config=VIEWS, ways=ways):
            above = view.points[view.points[:, 2] > TABLETOP.floor_m]
            if len(above):
                embedded.append(look(above, TABLE.normal, TABLE, viewpoint=view.viewpoint, network=network).embedding)
    return cluster(np.array(embedded), seed=seed)


def _member(primitive: GenericPrimitive, number: int) -> trimesh.Trimesh:
    """One of the members that a primitive was built from, as its modes and scale give it."""
    coefficients, log_scale = np.split(primitive.coefficient_samples[number], [len(primitive.modes)])
    return trimesh.Trimesh(primitive.shape(coefficients, np.exp(log_scale)), primitive.faces, process=False)


def with_prototypes(
    primitive: GenericPrimitive, *, meshes: Sequence[trimesh.Trimesh] | None = None, seed: int = 0
) -> GenericPrimitive:
    """The primitive with prototypes of the shipped network, whose sha256 its card then names."""
    weights = data_file("weights", "proposal.safetensors")
    card = {**primitive.card, "prototypes_sha256": hashlib.sha256(weights.read_bytes()).hexdigest()}
    return replace(primitive, prototypes=make_prototypes(primitive, meshes=meshes, seed=seed), card=card)


def cluster(embedded: np.ndarray, *, count: int = NUM_PROTOTYPES, seed: int = 0) -> np.ndarray:
    """Unit vectors (k, c) that stand for embedded views (n, c): the middles of k-means clusters, k at most count."""
    if len(embedded) <= count:
        return embedded
    middles, labels = kmeans2(embedded, count, minit="++", rng=np.random.default_rng(seed))
    middles = middles[np.bincount(labels, minlength=count) > 0]
    return middles / np.linalg.norm(middles, axis=1, keepdims=True)
