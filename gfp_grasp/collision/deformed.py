"""Convex parts of a primitive, deformed with its surface and hulled again in milliseconds.

The vertices of the parts are bound to the primitive's surface once. CoACD cuts a surface without moving it, so nearly
all of these vertices lie on the surface, and a point on a triangle moves with the triangle. One map moves all parts, so
neighbours stay neighbours. A part also takes along the primitive's vertices that lie within it: where the surface
bulges, the part bulges too. Only the corners that a part needs on the undeformed primitive are kept.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.collision.convex import convex_parts, needed_corners
from gfp_grasp.collision.levels import groups_of, merge_tree
from gfp_grasp.collision.parts import diagonal_m, within_parts
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.meshes import triangle_normals
from gfp_grasp.types import ConvexPart, GenericPrimitive, PartBinding

# Lengths are shares of the template's diagonal, which was about 0.2 m where they were chosen.
# CoACD's arithmetic scatters points of the surface by about 1e-8 of the size; this is far above it and below any wall.
_ON_SURFACE = 1 / 200_000  # 0.001 mm
_FEW = 12
# A corner can go where the part shrinks by less than the tolerance without it, as every second corner around a neck.
# So many stay that none is farther than the spacing from one that stayed, because a flat wall may bulge.
_TOLERANCE = 1 / 2000  # 0.1 mm
_SPACING = 1 / 40  # 5 mm


# Bindings of a primitive by the number of its parts, beside the one that is stored with it.
_bindings: WeakKeyDictionary[GenericPrimitive, dict[int, PartBinding]] = WeakKeyDictionary()


def deform_parts(
    primitive: GenericPrimitive,
    deformed_local: np.ndarray,
    *,
    count: int | None = None,
    max_vertices: int | None = None,
) -> tuple[ConvexPart, ...]:
    """Convex parts of a deformed primitive.

    Args:
        primitive: A primitive with parts; its variant is used where the vertices are the variant's.
        deformed_local: (v, 3) m, the vertices of the primitive or of a variant after the deformation, in any frame; the
            parts come in the same frame.
        count: Number of parts to which the primitive's parts are merged; None for all of them.
        max_vertices: Largest number of vertices of a part; None for no limit.

    Returns:
        The parts that MuJoCo compiles, in the primitive's order.

    Raises:
        InvalidMesh: The primitive has no parts, the vertices are not its own or not finite, or nothing solid is left.
        InvalidOption: count is below one, or max_vertices below four.
    """
    if (count is not None and count < 1) or (max_vertices is not None and max_vertices < 4):
        raise InvalidOption(f"{count} parts of {max_vertices} vertices; at least one of four is expected")
    primitive = matching_primitive(primitive, len(deformed_local))
    if not primitive.parts:
        raise InvalidMesh(f"primitive {primitive.category!r} has no convex parts: `gfp-grasp gps parts` makes them")
    vertices = np.asarray(deformed_local, dtype=np.float64)
    if vertices.shape != primitive.vertices.shape or not np.isfinite(vertices).all():
        raise InvalidMesh(f"deformed vertices of shape {vertices.shape} are not finite (v, 3)")
    most = len(primitive.parts)
    binding = _binding(primitive, most if count is None else min(count, most))
    parts, dropped = convex_parts(_moved(binding, primitive.vertices, vertices), max_vertices=max_vertices)
    if not parts:
        raise InvalidMesh(f"all {dropped} deformed parts are flat: the deformation has flattened the primitive")
    return parts


def _binding(primitive: GenericPrimitive, count: int) -> PartBinding:
    if primitive.binding is not None and len(primitive.binding.ends) == count:
        return primitive.binding
    levels = _bindings.setdefault(primitive, {})
    if count not in levels:
        levels[count] = bind_parts(primitive, count, gap_m=None)
    return levels[count]


def _moved(binding: PartBinding, before: np.ndarray, after: np.ndarray) -> list[np.ndarray]:
    """Points (n, 3) m of each part after the primitive's vertices have moved from before to after, both (v, 3) m."""
    triangles = after[binding.corners]
    (_, size_before), (normals, size) = _frames(before[binding.corners]), _frames(triangles)
    # The height above the surface scales with the triangle below.
    height = binding.height_m * size / np.maximum(size_before, 1e-12)
    feet = np.einsum("pc,pci->pi", binding.weights, triangles)
    return np.split(feet + normals * height[:, None], binding.ends[:-1])


def _groups(primitive: GenericPrimitive, count: int) -> list[list[int]]:
    merges = primitive.part_merges
    if len(merges) != len(primitive.parts) - 1:
        merges = merge_tree(primitive.parts)
    return groups_of(merges, len(primitive.parts), count)


def matching_primitive(primitive: GenericPrimitive, num_vertices: int) -> GenericPrimitive:
    """The primitive or the variant of it that has this many vertices.

    Raises:
        InvalidMesh: None has.
    """
    candidates = [primitive, *(variant.primitive for variant in primitive.variants)]
    for candidate in candidates:
        if num_vertices == len(candidate.vertices):
            return candidate
    counts = ", a variant of it ".join(str(len(candidate.vertices)) for candidate in candidates)
    raise InvalidMesh(f"{num_vertices} vertices came; primitive {primitive.category!r} has {counts}")


def bind_parts(primitive: GenericPrimitive, count: int, *, gap_m: np.ndarray | None) -> PartBinding:
    """Bind the parts of one level to the primitive's surface.

    Args:
        primitive: With parts.
        count: Number of parts of the level, at most that of the primitive.
        gap_m: (3,) m, what the binding says of where the primitive is hollow.
    """
    template = trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)
    size_m = diagonal_m(primitive.vertices)
    owned = within_parts(primitive.vertices, primitive.parts, margin_m=_ON_SURFACE * size_m)
    clouds = []
    for group in _groups(primitive, count):
        own = primitive.vertices[owned[:, group].any(axis=1)]
        clouds.append(_thinned(np.concatenate([*(primitive.parts[i].vertices for i in group), own]), size_m))
    points = np.concatenate(clouds)
    feet, face = _on_surface(template, points, size_m)
    corners = primitive.faces[face]
    triangles = primitive.vertices[corners]
    barycentric = _barycentric(triangles, feet)
    normals, _ = _frames(triangles)
    height = np.einsum("ij,ij->i", points - feet, normals)
    return PartBinding(corners, barycentric, height, np.cumsum([len(cloud) for cloud in clouds]), gap_m)


def _thinned(cloud: np.ndarray, size_m: float) -> np.ndarray:
    """Those of the points (n, 3) m that a part of a template of this size needs."""
    kept = needed_corners(cloud, _TOLERANCE * size_m)
    lonely = np.linalg.norm(cloud[:, None] - cloud[kept], axis=2).min(axis=1)
    while lonely.max() > _SPACING * size_m:
        kept = np.append(kept, lonely.argmax())
        lonely = np.minimum(lonely, np.linalg.norm(cloud - cloud[kept[-1]], axis=1))
    return cloud[kept]


def _on_surface(template: trimesh.Trimesh, points: np.ndarray, size_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Nearest places (n, 3) on a mesh, and their faces (n,). Most points lie on it: a few near faces are searched."""
    triangles = np.asarray(template.triangles)
    near = KDTree(triangles.mean(axis=1)).query(points, k=min(_FEW, len(triangles)))[1].reshape(len(points), -1)
    feet = trimesh.triangles.closest_point(triangles[near.ravel()], np.repeat(points, near.shape[1], axis=0))
    feet = feet.reshape(*near.shape, 3)
    distance = np.linalg.norm(feet - points[:, None], axis=2)
    best, rows = distance.argmin(axis=1), np.arange(len(points))
    feet, face = feet[rows, best], near[rows, best]
    off = np.flatnonzero(distance[rows, best] > _ON_SURFACE * size_m)
    if len(off):
        feet[off], _, face[off] = trimesh.proximity.closest_point(template, points[off])
    return feet, face


def _barycentric(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights (n, 3), not negative, of corners for points on triangles; the nearest corner's alone on a needle."""
    sides = np.stack([triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]], axis=2)
    gram = np.swapaxes(sides, 1, 2) @ sides
    needle = np.linalg.det(gram) <= 1e-18 * np.trace(gram, axis1=1, axis2=2) ** 2
    gram[needle] = np.eye(2)
    target = np.swapaxes(sides, 1, 2) @ (points - triangles[:, 0])[:, :, None]
    last = np.linalg.solve(gram, target)[:, :, 0]
    weights = np.clip(np.column_stack([1 - last.sum(axis=1), last]), 0, None)
    nearest = np.linalg.norm(triangles - points[:, None], axis=2).argmin(axis=1)
    weights[needle] = np.eye(3)[nearest[needle]]
    return weights / weights.sum(axis=1, keepdims=True)


def _frames(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (n, 3), zero where degenerate, and sizes (n,) m: the root of twice the area."""
    across = triangle_normals(triangles)
    area = np.linalg.norm(across, axis=1)
    return across / np.maximum(area, 1e-300)[:, None], np.sqrt(area)
