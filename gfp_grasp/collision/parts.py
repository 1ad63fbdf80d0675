"""Convex parts as arrays: which points lie within them, their volume, and how they are kept in a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes import triangle_normals
from gfp_grasp.transforms import cross
from gfp_grasp.types import ConvexPart

NEEDLE = 1e-9  # of the largest face of its part: the direction of a face this small is rounding


@dataclass(frozen=True, eq=False)
class PartFaces:
    """All faces of p convex parts, to be asked many times.

    Attributes:
        triangles: (f, 3, 3) m.
        owner: (f,) part of each.
        normals: (f, 3) outward, of length 1, or shorter for needles, whose direction is rounding only.
        areas_m2: (f,).
        planes: (f, 4) what a place (x, y, z, 1), m, is multiplied with for its height over each.
        bounds: (p + 1,) where the faces of each part begin.
        low: (p, 3) m, lower corner of the box of each part.
        high: (p, 3) m, its upper corner.
    """

    triangles: np.ndarray
    owner: np.ndarray
    normals: np.ndarray
    areas_m2: np.ndarray
    planes: np.ndarray
    bounds: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def of(parts: Sequence[ConvexPart]) -> PartFaces:
        """Those of at least one part."""
        sizes = [len(part.faces) for part in parts]
        bounds = np.concatenate([[0], np.cumsum(sizes)])
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        vertices = np.concatenate([part.vertices for part in parts])
        faces = np.concatenate([part.faces for part in parts]) + np.repeat(starts, sizes)[:, None]
        low, high = (end.reduceat(vertices, starts, axis=0) for end in (np.minimum, np.maximum))
        triangles = vertices[faces]
        owner = np.repeat(np.arange(len(parts)), sizes)
        vectors = area_vectors(triangles)
        areas = lengths(vectors)
        needle = areas <= NEEDLE * np.maximum.reduceat(areas, bounds[:-1])[owner]
        normals = vectors / np.where(needle, np.inf, areas)[:, None]
        offsets = np.einsum("ni,ni->n", normals, triangles[:, 0])
        offsets[needle] = np.inf  # nothing is above it
        planes = np.column_stack([normals, -offsets])
        return PartFaces(triangles, owner, normals, areas, planes, bounds, low, high)

    def within(self, points: np.ndarray, *, margin_m: float = 0.0) -> np.ndarray:
        """Which points (n, 3) m lie within which parts, (p, n) bool; `within_parts` tells of the margin."""
        places = _homogeneous(points)
        near = np.ones((len(self.low), len(points)), dtype=bool)
        for axis in range(3):  # a reduction over an axis of three is slow
            near &= places[axis] >= self.low[:, axis, None] - margin_m
            near &= places[axis] <= self.high[:, axis, None] + margin_m
        for part in np.flatnonzero(near.any(axis=1)):
            asked = np.flatnonzero(near[part])
            near[part, asked] = self._height(places[:, asked], int(part)) <= margin_m
        return near

    def height(self, points: np.ndarray, part: int) -> np.ndarray:
        """Height (n,) m of points (n, 3) over the plane of a part that they are farthest out of; negative within."""
        return self._height(_homogeneous(points), part)

    def _height(self, places: np.ndarray, part: int) -> np.ndarray:
        # In four dimensions with the offset: a product over three takes eight times as long.
        return (self.planes[self.bounds[part] : self.bounds[part + 1]] @ places).max(axis=0)


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.vstack([points.T, np.ones(len(points))])


def within_parts(points: np.ndarray, parts: Sequence[ConvexPart], *, margin_m: float = 0.0) -> np.ndarray:
    """Which points lie within which parts.

    Args:
        points: (n, 3) m.
        parts: p convex parts.
        margin_m: How far beyond every plane of a part still counts; negative for how deep a point must lie.

    Returns:
        (n, p) bool.
    """
    if not parts:
        return np.zeros((len(points), 0), dtype=bool)
    return PartFaces.of(parts).within(points, margin_m=margin_m).T


def volume_m3(part: ConvexPart) -> float:
    """Volume of a convex part."""
    return float(six_volumes((part.vertices - part.vertices[0])[part.faces]).sum()) / 6


def parts_to_arrays(
    parts: Sequence[ConvexPart], *, prefix: str = "part_", dtype: DTypeLike = np.float64
) -> dict[str, np.ndarray]:
    """Arrays that hold convex parts in a file of named arrays (.npz or .safetensors).

    Args:
        parts: p convex parts, m; there may be none.
        prefix: Begins the name of each array.
        dtype: Type of the vertices.

    Returns:
        `{prefix}sizes` (p, 2), numbers of vertices and faces of each part; `{prefix}vertices` (v, 3) of all parts, one
        part after the other; `{prefix}faces` (f, 3), which count the vertices of their own part.
    """
    sizes = [[len(part.vertices), len(part.faces)] for part in parts]
    return {
        f"{prefix}sizes": np.array(sizes, dtype=np.int64).reshape(-1, 2),
        f"{prefix}vertices": np.concatenate([np.zeros((0, 3)), *(part.vertices for part in parts)]).astype(dtype),
        f"{prefix}faces": np.concatenate([np.zeros((0, 3)), *(part.faces for part in parts)]).astype(np.int32),
    }


def parts_from_arrays(arrays: Mapping[str, np.ndarray], *, prefix: str = "part_") -> tuple[ConvexPart, ...]:
    """Convex parts from the arrays that `parts_to_arrays` made of them.

    Raises:
        InvalidMesh: An array is missing, is of another kind, or does not fit the others.
    """
    names = [f"{prefix}{name}" for name in ("sizes", "vertices", "faces")]
    missing = [name for name in names if name not in arrays]
    if missing:
        raise InvalidMesh(f"convex parts lack {', '.join(missing)}: is the file one of another version?")
    sizes, vertices, faces = (np.asarray(arrays[name]) for name in names)
    if (sizes.dtype.kind, vertices.dtype.kind, faces.dtype.kind) != ("i", "f", "i"):
        raise InvalidMesh(f"convex parts have {sizes.dtype}, {vertices.dtype}, {faces.dtype}; int, float, int expected")
    if sizes.ndim != 2 or sizes.shape[1] != 2 or (sizes < 4).any():
        raise InvalidMesh(f"sizes of convex parts have shape {sizes.shape}; (p, 2) from 4 on is expected")
    if vertices.shape != (sizes[:, 0].sum(), 3) or faces.shape != (sizes[:, 1].sum(), 3):
        raise InvalidMesh(f"{sizes.sum(axis=0)} vertices and faces are expected: {vertices.shape}, {faces.shape} came")
    if not np.isfinite(vertices).all():
        raise InvalidMesh("convex parts have vertices that are not finite")
    if (faces < 0).any() or (faces.max(axis=1, initial=-1) >= sizes[:, 0].repeat(sizes[:, 1])).any():
        raise InvalidMesh("convex parts have faces whose vertices are not there")
    if not len(sizes):
        return ()
    ends = np.cumsum(sizes, axis=0)[:-1]
    return tuple(map(ConvexPart, np.split(vertices, ends[:, 0]), np.split(faces, ends[:, 1])))


def diagonal_m(points: np.ndarray) -> float:
    """Diagonal of the box around points (n, 3) m along the axes: the size that lengths are shares of."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def six_volumes(corners: np.ndarray) -> np.ndarray:
    """Determinants (n,) of (n, 3, 3): six times the volume of the tetrahedron over the origin."""
    return np.einsum("ni,ni->n", corners[:, 0], cross(corners[:, 1], corners[:, 2]))


def area_vectors(triangles: np.ndarray) -> np.ndarray:
    """Normals (n, 3) of triangles (n, 3, 3), as long as the area, m2."""
    return triangle_normals(triangles) / 2


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (n,) of (n, 3); numpy's own take thrice as long."""
    return np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
