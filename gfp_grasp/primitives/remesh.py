"""Adaptive isotropic remeshing of closed surfaces: even triangles, fine where the surface bends, coarse elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.meshes import triangle_normals, vertex_normals
from gfp_grasp.primitives.surface import Surface, untangle

# Botsch and Kobbelt 2004: splitting above 4/3 and collapsing below 4/5 of the wanted length cannot undo each other.
_SPLIT, _COLLAPSE = 4.0 / 3.0, 4.0 / 5.0
# Wanted lengths grow by at most this much for each metre along the surface, so that triangles stay even.
_GRADING = 0.4
# A collapse or flip that turns a face by more than this (60 degrees) would fold the surface.
_MAX_TURN = 0.5
# Edges with a larger dihedral angle (40 degrees) are features and are not flipped away.
_FEATURE = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class RemeshConfig:
    """How fine a remeshed surface is.

    Attributes:
        tolerance: Distance from chord to surface, as a share of the mesh's diagonal.
        min_edge: Shortest wanted edge, as a share of the diagonal.
        max_edge: Longest wanted edge, as a share of the diagonal.
        iterations: Rounds of split, collapse, flip and relaxation.
    """

    tolerance: float = 0.0012
    min_edge: float = 0.014
    max_edge: float = 0.045
    iterations: int = 6

    def __post_init__(self) -> None:
        if not (self.tolerance > 0 and 0 < self.min_edge <= self.max_edge < 1 and self.iterations >= 1):
            raise InvalidOption(f"{self}: 0 < tolerance, 0 < min_edge <= max_edge < 1 and iterations >= 1 are expected")


def remesh(
    mesh: trimesh.Trimesh, rng: np.random.Generator, *, config: RemeshConfig = RemeshConfig()
) -> trimesh.Trimesh:
    """A closed mesh of the same surface with well-shaped triangles.

    Edge lengths follow curvature as in Dunyach et al., Eurographics 2013 (short papers), equation 2; the rounds of
    split, collapse, flip and tangential relaxation are those of Botsch and Kobbelt, SGP 2004.

    Args:
        mesh: A closed volume, m.
        rng: Draws the samples onto which vertices are projected.
        config: How fine.

    Raises:
        InvalidMesh: The mesh is not closed.
    """
    if not mesh.is_watertight:
        raise InvalidMesh("only closed meshes are remeshed here: repair it first (gfp_grasp.meshes.make_solid)")
    diagonal = float(np.linalg.norm(mesh.extents))
    fine = refine(mesh, config.min_edge * diagonal)
    wanted = _WantedLength(fine, config, diagonal)
    surface = Surface(mesh, rng, count=20000)
    coarse = refine(mesh, config.max_edge * diagonal)
    vertices, faces = np.array(coarse.vertices), np.array(coarse.faces)
    for _ in range(config.iterations):
        vertices, faces = _split(vertices, faces, wanted)
        vertices, faces = _collapse(vertices, faces, wanted)
        faces = _flip(vertices, faces)
        vertices = _relax(vertices, faces, surface, diagonal)
    result = trimesh.Trimesh(untangle(vertices, faces), faces, process=False)
    if not result.is_volume:
        raise InvalidMesh("remeshing did not end in a closed volume: the mesh is thinner than its shortest wanted edge")
    return result


def refine(mesh: trimesh.Trimesh, max_edge_m: float) -> trimesh.Trimesh:
    """The same closed surface, its edges split evenly until they are about max_edge_m long at most."""
    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.uint64))
    )
    if solid.is_empty():
        raise InvalidMesh(f"the mesh is not a closed manifold ({solid.status()}): repair it first")
    fine = solid.refine_to_length(max_edge_m).to_mesh64()
    vertices = np.array(fine.vert_properties, dtype=np.float64)[:, :3]
    return trimesh.Trimesh(vertices, np.array(fine.tri_verts, dtype=np.int64), process=False)


class _WantedLength:
    """Wanted edge length (n,) m at points of the surface, from its curvature."""

    def __init__(self, fine: trimesh.Trimesh, config: RemeshConfig, diagonal: float) -> None:
        points, edges = np.asarray(fine.vertices), fine.edges_unique
        normals = vertex_normals(points, fine.faces)
        lengths = np.maximum(np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1), 1e-12)
        bend = np.linalg.norm(normals[edges[:, 0]] - normals[edges[:, 1]], axis=1) / lengths
        curvature = np.zeros(len(points))
        for side in (0, 1):
            np.maximum.at(curvature, edges[:, side], bend)
        tolerance = config.tolerance * diagonal
        wanted = np.sqrt(np.maximum(6 * tolerance / np.maximum(curvature, 1e-9) - 3 * tolerance**2, 0))
        wanted = np.clip(wanted, config.min_edge * diagonal, config.max_edge * diagonal)
        for _ in range(20):
            before = wanted.copy()
            for a, b in ((0, 1), (1, 0)):
                np.minimum.at(wanted, edges[:, a], before[edges[:, b]] + _GRADING * lengths)
            if np.array_equal(before, wanted):
                break
        self._tree, self._wanted = KDTree(points), wanted

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self._wanted[self._tree.query(points)[1]]


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unique edges (e, 2), ascending, and the edge of each side (f, 3): side i runs from corner i to corner i + 1."""
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, index = np.unique(sides, axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def _split(vertices: np.ndarray, faces: np.ndarray, wanted: _WantedLength) -> tuple[np.ndarray, np.ndarray]:
    """Halve every edge that is too long, all at once: each face falls into one to four."""
    edges, sides = _edges(faces)
    middle = vertices[edges].mean(axis=1)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    long = lengths > _SPLIT * wanted(middle)
    new_index = np.full(len(edges), -1)
    new_index[long] = len(vertices) + np.arange(long.sum())
    mid = new_index[sides]
    count = (mid >= 0).sum(axis=1)
    pieces = [faces[count == 0]]
    for number in (1, 2, 3):
        chosen = count == number
        f, m = faces[chosen], mid[chosen]
        # Turn each face so that its pattern is: side 0 split; sides 0 and 1 split; all split.
        start = np.zeros(len(f), dtype=int)
        for turn in (0, 1, 2):
            pattern = (m[:, turn] >= 0) & ((m[:, (turn + 1) % 3] >= 0) if number >= 2 else True)
            start[pattern] = turn
        order = (start[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(f, order, 1).T
        ab, bc, ca = np.take_along_axis(m, order, 1).T
        if number == 1:
            pieces += [np.stack([a, ab, c], 1), np.stack([ab, b, c], 1)]
        elif number == 2:
            pieces += [np.stack([ab, b, bc], 1), np.stack([a, ab, bc], 1), np.stack([a, bc, c], 1)]
        else:
            pieces += [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.vstack([vertices, middle[long]]), np.vstack(pieces)


def _collapse(vertices: np.ndarray, faces: np.ndarray, wanted: _WantedLength) -> tuple[np.ndarray, np.ndarray]:
    """Merge the ends of edges that are too short, shortest first, no two whose neighbourhoods touch."""
    for _ in range(4):
        edges, _ = _edges(faces)
        lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        ratio = lengths / wanted(vertices[edges].mean(axis=1))
        candidates = np.flatnonzero(ratio < _COLLAPSE)
        candidates = candidates[np.argsort(ratio[candidates])]
        rings, around = _rings(faces, len(vertices))
        normals = _unit_normals(vertices, faces)
        spread = _bend(normals, faces, len(vertices))
        locked = np.zeros(len(vertices), dtype=bool)
        target = np.arange(len(vertices))
        moved = vertices.copy()
        for i, j in edges[candidates]:
            if locked[i] or locked[j] or len(rings[i] & rings[j]) != 2:
                continue
            # A vertex on a feature keeps its place; between equals the middle is best.
            keep = 0.5 if abs(spread[i] - spread[j]) < 0.1 else float(spread[j] > spread[i])
            place = (1 - keep) * vertices[i] + keep * vertices[j]
            if not _stays_flat(vertices, faces, normals, around[i] ^ around[j], (i, j), place):
                continue
            moved[i], target[j] = place, i
            locked[[i, j, *rings[i], *rings[j]]] = True
        if (target == np.arange(len(vertices))).all():
            break
        vertices, faces = _compact(moved, target[faces])
    return vertices, faces


def _rings(faces: np.ndarray, count: int) -> tuple[list[set[int]], list[set[int]]]:
    """Neighbours of each vertex, and the faces around it."""
    rings: list[set[int]] = [set() for _ in range(count)]
    around: list[set[int]] = [set() for _ in range(count)]
    for index, (a, b, c) in enumerate(faces.tolist()):
        rings[a].update((b, c))
        rings[b].update((a, c))
        rings[c].update((a, b))
        around[a].add(index)
        around[b].add(index)
        around[c].add(index)
    return rings, around


def _bend(normals: np.ndarray, faces: np.ndarray, count: int) -> np.ndarray:
    """How much the faces around each vertex disagree (v,): 0 where flat, towards 1 at a spike."""
    index, repeated = faces.ravel(), np.repeat(normals, 3, axis=0)
    total = np.stack([np.bincount(index, repeated[:, i], minlength=count) for i in range(3)], axis=1)
    return 1 - np.linalg.norm(total, axis=1) / np.maximum(np.bincount(index, minlength=count), 1)


def _stays_flat(vertices, faces, normals, index: set[int], ends: tuple[int, int], place: np.ndarray) -> bool:
    """Whether the faces that survive a collapse keep their side and do not become needles."""
    index_array = np.fromiter(index, dtype=int)
    corners = vertices[faces[index_array]]
    for end in ends:
        corners[faces[index_array] == end] = place
    cross = triangle_normals(corners)
    area = np.linalg.norm(cross, axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    if (area < 0.1 * longest**2).any():
        return False
    return bool(((cross * normals[index_array]).sum(axis=1) > _MAX_TURN * area).all())


def _compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    alive = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    used, inverse = np.unique(faces[alive], return_inverse=True)
    return vertices[used], inverse.reshape(-1, 3)


def _flip(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Flip edges where that brings the valences nearer to six."""
    faces = faces.copy()
    for _ in range(3):
        edges, sides = _edges(faces)
        order = np.argsort(sides.ravel(), kind="stable").reshape(-1, 2)  # closed: two sides an edge
        face, corner = order // 3, order % 3
        opposite = faces[face, (corner + 2) % 3]
        valence = np.bincount(edges.ravel(), minlength=len(vertices))
        a, b, c, d = edges[:, 0], edges[:, 1], opposite[:, 0], opposite[:, 1]
        gain = sum(np.abs(valence[x] - 6) for x in (a, b, c, d)) - (
            np.abs(valence[a] - 7) + np.abs(valence[b] - 7) + np.abs(valence[c] - 5) + np.abs(valence[d] - 5)
        )
        normals = _unit_normals(vertices, faces)
        old = normals[face[:, 0]] + normals[face[:, 1]]
        smooth = (normals[face[:, 0]] * normals[face[:, 1]]).sum(axis=1) > _FEATURE
        # Side 0 runs x -> y in its own face; after the flip the faces are (c, x, d) and (d, y, c).
        x, y = faces[face[:, 0], corner[:, 0]], faces[face[:, 0], (corner[:, 0] + 1) % 3]
        first, second = np.stack([c, x, d], 1), np.stack([d, y, c], 1)
        old /= np.maximum(np.linalg.norm(old, axis=1, keepdims=True), 1e-12)
        fits = smooth & (gain > 0)
        for new in (first, second):
            fits &= (_unit_normals(vertices, new) * old).sum(axis=1) > 0.8
        key = np.sort(np.stack([c, d], 1), axis=1) @ np.array([len(vertices), 1])
        fits &= ~np.isin(key, edges @ np.array([len(vertices), 1]))
        locked = np.zeros(len(vertices), dtype=bool)
        done = 0
        for edge in np.flatnonzero(fits)[np.argsort(-gain[fits], kind="stable")]:
            touched = [a[edge], b[edge], c[edge], d[edge]]
            if locked[touched].any():
                continue
            faces[face[edge, 0]], faces[face[edge, 1]] = first[edge], second[edge]
            locked[touched] = True
            done += 1
        if not done:
            break
    return faces


def _relax(vertices: np.ndarray, faces: np.ndarray, surface: Surface, diagonal: float) -> np.ndarray:
    """Slide vertices along the surface towards the middle of their neighbours; those on features stay."""
    edges, _ = _edges(faces)
    for _ in range(3):
        normals = vertex_normals(vertices, faces)
        face_normals = _unit_normals(vertices, faces)
        flat = np.ones(len(vertices))
        for corner in range(3):
            np.minimum.at(flat, faces[:, corner], (face_normals * normals[faces[:, corner]]).sum(axis=1))
        total, count = np.zeros_like(vertices), np.bincount(edges.ravel(), minlength=len(vertices))
        for i, j in ((0, 1), (1, 0)):
            np.add.at(total, edges[:, i], vertices[edges[:, j]])
        step = total / np.maximum(count, 1)[:, None] - vertices
        step -= (step * normals).sum(axis=1, keepdims=True) * normals
        vertices = vertices + 0.6 * np.where(flat[:, None] > 0.85, step, 0.0)
    return surface.closest(vertices, vertex_normals(vertices, faces), normal_weight_m=0.02 * diagonal)[0]


def _unit_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    normals = triangle_normals(corners)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
