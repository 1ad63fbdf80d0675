"""Which sample of a surface each observed point is seen to lie on."""

from __future__ import annotations

import numpy as np

from gfp_grasp.register.evidence import Evidence

# A difference of normals of one unit (60 degrees) counts like this distance when neighbours are sought (thin walls).
_NORMAL_LENGTH_M = 0.02
_MIN_NORMAL_COSINE = 0.5


def correspond(world: np.ndarray, normals: np.ndarray, evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Nearest sample of each point in position and normal; where there is a viewpoint, of those that face it.

    Args:
        world: (s, m, 3) m, samples of the surface of s states.
        normals: (s, m, 3) unit.
        evidence: n points.

    Returns:
        Index (s, n) of the sample, and whether the normals agree (s, n) bool.
    """
    shape = (len(world), len(evidence.points))
    index, agrees = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    facing = np.ones(world.shape[:2], dtype=bool)
    if evidence.viewpoint is not None:
        facing = np.einsum("smi,smi->sm", normals, evidence.viewpoint - world) > 0
    # Near the origin float32 tells samples apart that lie micrometres from each other.
    origin = evidence.points.mean(axis=0)
    features = np.concatenate([world - origin, _NORMAL_LENGTH_M * normals], axis=2, dtype=np.float32)
    # The largest dot product less half the square is the nearest. For a tree that is asked once these are too few.
    half = 0.5 * np.einsum("smi,smi->sm", features, features)
    asked, turned_over = (
        np.hstack([evidence.points - origin, sign * _NORMAL_LENGTH_M * evidence.normals], dtype=np.float32)
        for sign in (1.0, -1.0)
    )
    for i, faces in enumerate(facing):
        seen = np.flatnonzero(faces)
        if len(seen) == 0:
            continue
        own, own_half = features[i, seen], half[i, seen]
        closest, nearness = nearest(asked, own, own_half)
        if not evidence.oriented:
            other, other_nearness = nearest(turned_over, own, own_half)
            closest = np.where(other_nearness > nearness, other, closest)
        index[i] = seen[closest]
        cosine = np.einsum("ni,ni->n", evidence.normals, normals[i, index[i]])
        agrees[i] = (cosine if evidence.oriented else np.abs(cosine)) > _MIN_NORMAL_COSINE
    return index, agrees


def nearest(asked: np.ndarray, features: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (n,) of the features (m, c) nearest to each of (n, c), and how near (n,), more being nearer.

    Args:
        half: (m,) half the square of each feature.
    """
    nearness = asked @ features.T
    nearness -= half
    index = nearness.argmax(axis=1)
    return index, nearness[np.arange(len(index)), index]
