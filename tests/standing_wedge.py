"""The wedge as it stands on a floor, seen whole or in half, and a fit of few steps for it."""

from dataclasses import replace

import numpy as np
import trimesh
from toy_wedge import UP, toy_evidence, wedge_primitive, wedge_state

from gfp_grasp.meshes import sample_surface
from gfp_grasp.register import FitConfig, RefineConfig
from gfp_grasp.transforms import rotation_about, rotation_between

QUICK = RefineConfig(steps=(0.2, 0.15, 0.1, 0.08), num_points=100, num_samples=300)
LIGHT = FitConfig(
    quick=QUICK,
    middle=replace(QUICK, steps=(0.08, 0.06, 0.05)),
    thorough=replace(QUICK, steps=(0.04, 0.03), num_points=200),
    num_kept=2,
    roundness=False,
)


def surface_points(state, primitive, count=4000):
    """Points (n, 3) of a posed primitive's whole surface, and their normals."""
    return sample_surface(posed_mesh(state, primitive), count, np.random.default_rng(1))[:2]


def posed_mesh(state, primitive):
    """The mesh of a primitive in a state."""
    vertices = state.world(primitive.shape(state.coefficients, np.ones(3)))
    return trimesh.Trimesh(vertices, primitive.faces, process=False)


def standing_wedge(R: np.ndarray, **changes):
    """The mean of the wedge at a rotation, its axis where it belongs."""
    return wedge_state(R=R, axis_world=R[:, 2], log_scale=np.zeros(3), coefficients=np.zeros(3), **changes)


def whole_view(state, primitive, viewpoint, **changes):
    """A view in which the whole surface is seen, down to the floor that it stands on."""
    points, normals = surface_points(state, primitive)
    lowest = float((points @ UP).min())
    return toy_evidence(points, normals, viewpoint=viewpoint, **{"floor_m": lowest, **changes})


def half_seen_wedge():
    """State of a wedge that stands upright, and a view of what faces the viewpoint of it."""
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    truth = standing_wedge(R)
    points, normals = surface_points(truth, wedge_primitive(), 1500)
    viewpoint = truth.t + 2 * R[:, 0] + 0.7 * R[:, 1] + UP
    seen = np.einsum("ni,ni->n", normals, viewpoint - points) > 0
    lowest = float((points @ UP).min())
    return truth, toy_evidence(points[seen], normals[seen], viewpoint=viewpoint, floor_m=lowest, sigma_m=0.001)
