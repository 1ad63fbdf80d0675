"""Which member the running template starts from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.meshes import sample_surface

_NUM_SAMPLES = 400
# Weight of normals against positions in unit boxes: the two sides of a wall are then as far apart as half the object.
_NORMAL_WEIGHT = 0.25


def choose_template(members: Sequence[trimesh.Trimesh], rng: np.random.Generator, *, num_candidates: int = 24) -> int:
    """Index of the most central member among those of the commonest topology.

    Members are compared in unit boxes, by position and normal, so that scale plays no part.

    Args:
        members: Closed, in one orientation.
        rng: Chooses candidates and draws samples.
        num_candidates: As many are compared with each other.
    """
    commonest = Counter(int(member.euler_number) for member in members).most_common(1)[0][0]
    fitting = [i for i, member in enumerate(members) if member.euler_number == commonest]
    chosen = rng.permutation(fitting)[:num_candidates]
    features = [_features(members[i], rng) for i in chosen]
    trees = [KDTree(feature) for feature in features]
    distance = np.array([[tree.query(feature)[0].mean() for tree in trees] for feature in features])
    # The median, not the mean: a few outliers do not decide which one is central.
    return int(chosen[np.median(distance + distance.T, axis=1).argmin()])


def _features(mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    points, normals, _ = sample_surface(mesh, _NUM_SAMPLES, rng)
    return np.hstack([(points - mesh.bounds[0]) / mesh.extents, normals * _NORMAL_WEIGHT])
