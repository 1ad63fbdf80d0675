"""How oval a member of a class is: the second harmonic of its radius.

Most cups and bottles are exactly as deep as they are wide, and the rest by any ratio. Modes with a Gaussian prior
cannot say so, and of the depth a single view says least; so "it is not oval" is asked as a hypothesis (see fit.py).
A square body is not oval either.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gfp_grasp.meshes import vertex_normals
from gfp_grasp.types import OUTSIDE, GenericPrimitive

_BANDS = 8  # of the height, each with an ovality of its own
_MIN_VERTICES = 12


@lru_cache(maxsize=32)
def ovality_gram(primitive: GenericPrimitive) -> np.ndarray:
    """Quadratic form of the ovality of a primitive's body.

    With u (3 * (1 + k),) the scales of x, y and z, each times (1, the coefficients), u @ gram @ u is the mean square,
    m2, of the second harmonic of the radius over bands of the height.

    Returns:
        (3 * (1 + k), 3 * (1 + k)), in the order of u.
    """
    normals = vertex_normals(primitive.vertices, primitive.faces)
    side = (primitive.regions == OUTSIDE) & (np.abs(normals[:, 2]) < 0.7)
    basis = np.concatenate([primitive.vertices[None], primitive.modes])[:, side]  # (1 + k, v, 3)
    vertices = primitive.vertices[side]
    angle = np.arctan2(vertices[:, 1], vertices[:, 0])
    radial = np.column_stack([np.cos(angle), np.sin(angle)])
    bands = np.array_split(np.argsort(vertices[:, 2], kind="stable"), _BANDS)
    gram = np.zeros((3 * len(basis), 3 * len(basis)))
    x_and_y = slice(0, 2 * len(basis))
    for band in bands:
        if len(band) < _MIN_VERTICES:
            continue
        waves = np.column_stack([np.ones(len(band)), np.cos(2 * angle[band]), np.sin(2 * angle[band])])
        fit = np.linalg.lstsq(waves, np.eye(len(band)), rcond=None)[0][1:]  # (2, v): amplitudes of a radius
        rows = np.concatenate([(basis[:, band, axis] * radial[band, axis]) @ fit.T for axis in (0, 1)])
        gram[x_and_y, x_and_y] += rows @ rows.T / _BANDS
    return gram


def scaled_modes(coefficients: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(s, 3, 1 + k), each of the scales (s, 3) times (1, the coefficients (s, k)): the u of `ovality_gram`."""
    return scale[:, :, None] * np.insert(coefficients, 0, 1.0, axis=1)[:, None, :]


@lru_cache(maxsize=32)
def round_share(primitive: GenericPrimitive, limit_m: float) -> float:
    """Share of the members that a primitive was built from whose ovality is below a limit, held to [0.05, 0.95]."""
    k = len(primitive.modes)
    samples = primitive.coefficient_samples
    u = scaled_modes(samples[:, :k], np.exp(samples[:, k:])).reshape(len(samples), -1)
    oval = np.sqrt(np.einsum("si,ij,sj->s", u, ovality_gram(primitive), u))
    return float(np.clip((oval < limit_m).mean(), 0.05, 0.95))
