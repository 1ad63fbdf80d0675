"""Patches of a mesh's grid of vertices that are left out, and the tubes that grow out of their outlines.

A patch is (r, c) numbers of vertices; seen from outside, its columns go to the right and its rows up. Bodies of equal
faces with tubes of equal counts have equal faces.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike


def with_cap(body: trimesh.Trimesh, patch: np.ndarray, at: ArrayLike, profile: np.ndarray) -> trimesh.Trimesh:
    """A body with a round cap on a flat patch, at a right angle to it.

    Args:
        body: Its patch is a rectangle.
        patch: (r, c).
        at: (3,) m, middle of the cap, on the patch.
        profile: (n, 2) m of radius and height above the patch, from the cap's outline, within the patch, to the middle
            of its top.
    """
    grid = body.vertices[patch]
    sides = np.stack([grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]])
    right, up = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    circle = section_of(patch, 2.0) @ [right, up]
    rings = np.asarray(at) + profile[:, :1, None] * circle + profile[:, 1:, None] * np.cross(right, up)
    # Without a ring halfway, faces from the outline of a large patch to a small cap would be needles.
    halfway = (body.vertices[outline(patch)] + rings[:1]) / 2
    return with_closed_tube(body.vertices, body.faces, patch, np.concatenate([halfway, rings[:-1]]), rings[-1, 0])


def with_closed_tube(
    vertices: np.ndarray, faces: np.ndarray, patch: np.ndarray, rings: np.ndarray, tip: np.ndarray
) -> trimesh.Trimesh:
    """A body with one tube that ends in a point.

    Args:
        vertices: (v, 3) m of the body.
        faces: (f, 3) of the body.
        patch: Where the tube begins.
        rings: (n, k, 3) m that follow the outline of the patch, with as many vertices.
        tip: (3,) m.
    """
    numbers = np.concatenate([outline(patch)[None], numbered(len(vertices), rings)])
    vertices = np.concatenate([vertices, rings.reshape(-1, 3), [tip]])
    end = np.stack([numbers[-1], np.roll(numbers[-1], -1), np.full(numbers.shape[1], len(vertices) - 1)], axis=1)
    return of_used(vertices, [without(faces, patch), between(numbers), end])


def outline(patch: np.ndarray) -> np.ndarray:
    """Numbers (k,) of the vertices around a patch from the lower left, turning left."""
    return np.concatenate([patch[0, :-1], patch[:-1, -1], patch[-1, :0:-1], patch[:0:-1, 0]])


def section_of(patch: np.ndarray, power: float) -> np.ndarray:
    """Places (k, 2) within -1 .. 1, to the right and up, of the vertices of a superellipse, one for each of an outline.

    Args:
        patch: (r, c).
        power: Exponent; 2 is a circle.
    """
    num_rows, num_columns = patch.shape
    up, right = np.meshgrid(np.linspace(-1, 1, num_rows), np.linspace(-1, 1, num_columns), indexing="ij")
    corner = np.pi / 2 * (num_rows - 1) / (num_rows + num_columns - 2)
    toward = np.stack([outline(right), outline(up) * np.tan(corner)], axis=1)
    return toward / (np.abs(toward) ** power).sum(axis=1, keepdims=True) ** (1 / power)


def numbered(first: int, tube: np.ndarray) -> np.ndarray:
    """Numbers (n, k) of the vertices of a tube (n, k, 3) that are added behind so many others."""
    return first + np.arange(tube.shape[0] * tube.shape[1]).reshape(tube.shape[:2])


def between(rings: np.ndarray) -> np.ndarray:
    """Faces between rings (n, k) of vertex numbers that turn left about the way they go."""
    here, there = rings[:-1], np.roll(rings, -1, axis=1)[:-1]
    up, over = rings[1:], np.roll(rings, -1, axis=1)[1:]
    quads = np.stack([here, there, over, up], axis=2).reshape(-1, 4)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def without(faces: np.ndarray, *patches: np.ndarray) -> np.ndarray:
    """The faces (f, 3) that are not within any of the patches."""
    return faces[~np.any([np.isin(faces, patch).all(axis=1) for patch in patches], axis=0)]


def of_used(vertices: np.ndarray, faces: Sequence[np.ndarray]) -> trimesh.Trimesh:
    """The mesh of these faces without the vertices that none of them has, such as those within a patch."""
    used, renumbered = np.unique(np.concatenate(faces), return_inverse=True)
    return trimesh.Trimesh(vertices[used], renumbered.reshape(-1, 3), process=False)
