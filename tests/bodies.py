"""Bodies of known measures that are alike from no two sides, and stand away from the origin."""

import numpy as np
import trimesh

from gfp_grasp.transforms import make_T
from gfp_grasp.types import ConvexPart

TURN = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.1]))[:3, :3]
AWAY = np.array([0.3, -0.2, 0.5])
TILTED = make_T(TURN, AWAY)

# A ramp 60 mm long, 40 mm wide and 30 mm high: its slope faces (30, 0, 60).
WEDGE = 1e-3 * np.array([[0, 0, 0], [60, 0, 0], [0, 40, 0], [60, 40, 0], [0, 0, 30], [0, 40, 30]], dtype=float)
WEDGE_M3 = 0.5 * 0.06 * 0.04 * 0.03
SLOPE = np.array([1.0, 0.0, 2.0]) / np.sqrt(5)


def box_part(low: list[float], high: list[float]) -> ConvexPart:
    """A box as a convex part."""
    solid = trimesh.creation.box(bounds=[low, high])
    return ConvexPart(solid.vertices, solid.faces)


def l_shape() -> trimesh.Trimesh:
    """A bar of 100 x 20 x 20 mm along x, and a second one of 60 mm along y from its beginning."""
    return trimesh.boolean.union([part.to_trimesh() for part in l_parts()])


def l_parts() -> tuple[ConvexPart, ConvexPart]:
    """The two boxes, side by side, that the L consists of."""
    return box_part([0, 0, 0], [0.1, 0.02, 0.02]), box_part([0, 0.02, 0], [0.02, 0.06, 0.02])


def trough() -> tuple[trimesh.Trimesh, tuple[ConvexPart, ...]]:
    """A trough that is 60 x 40 x 50 mm inside and open above, in fine triangles, and the five boxes it consists of.

    Its walls have 4 mm, its floor 30 mm; the inside begins at (0, 0, 0).
    """
    t, x, y, z, floor = 0.004, 0.06, 0.04, 0.05, 0.03
    solid = trimesh.boolean.difference(
        [
            trimesh.creation.box(bounds=[[-t, -t, -floor], [x + t, y + t, z]]),
            trimesh.creation.box(bounds=[[0, 0, 0], [x, y, 2 * z]]),
        ]
    )
    while solid.edges_unique_length.max() > 0.008:
        solid = solid.subdivide()
    parts = (
        box_part([-t, -t, -floor], [x + t, y + t, 0]),
        box_part([-t, -t, 0], [0, y + t, z]),
        box_part([x, -t, 0], [x + t, y + t, z]),
        box_part([0, -t, 0], [x, 0, z]),
        box_part([0, y, 0], [x, y + t, z]),
    )
    return solid, parts


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    """The meshes as one, each with its own vertices."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return trimesh.Trimesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False)


def moved(mesh: trimesh.Trimesh, offset: list[float]) -> trimesh.Trimesh:
    """The mesh somewhere else."""
    return trimesh.Trimesh(mesh.vertices + offset, mesh.faces, process=False)
