"""A cup of five boxes and an L that stands askew, each with its convex parts, to be written to files."""

import numpy as np
import trimesh

from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import ConvexPart


def cup() -> tuple[trimesh.Trimesh, list[ConvexPart]]:
    """A square cup, 80 mm wide and 100 mm high with walls of 4 mm, made of five boxes; standing off the origin."""
    offset = np.array([0.3, -0.2, 0.5])
    outer = trimesh.creation.box(bounds=[[-0.04, -0.04, 0], [0.04, 0.04, 0.1]])
    inner = trimesh.creation.box(bounds=[[-0.036, -0.036, 0.004], [0.036, 0.036, 0.2]])
    mesh = trimesh.boolean.difference([outer, inner])
    mesh.apply_translation(offset)
    bounds = [
        [[-0.04, -0.04, 0], [0.04, 0.04, 0.004]],
        [[-0.04, -0.04, 0.004], [-0.036, 0.04, 0.1]],
        [[0.036, -0.04, 0.004], [0.04, 0.04, 0.1]],
        [[-0.036, -0.04, 0.004], [0.036, -0.036, 0.1]],
        [[-0.036, 0.036, 0.004], [0.036, 0.04, 0.1]],
    ]
    boxes = [trimesh.creation.box(bounds=bound) for bound in bounds]
    return mesh, [ConvexPart(box.vertices + offset, box.faces) for box in boxes]


def askew() -> tuple[trimesh.Trimesh, list[ConvexPart]]:
    """An L of two boxes, turned about a generic axis and off the origin: no product of inertia is zero."""
    boxes = [
        trimesh.creation.box(bounds=[[0.0, -0.02, 0.0], [0.03, 0.03, 0.1]]),
        trimesh.creation.box(bounds=[[0.03, -0.02, 0.0], [0.08, 0.03, 0.02]]),
    ]
    whole = trimesh.boolean.union([*boxes, trimesh.creation.box(bounds=[[0, -0.02, 0], [0.05, 0.03, 0.02]])])
    T = make_T(rotation_about((1, 2, 3), 1.1), (0.3, -0.2, 0.5))
    for mesh in (whole, *boxes):
        mesh.apply_transform(T)
    return whole, [ConvexPart(box.vertices, box.faces) for box in boxes]
