"""Samples that the planner works on: of a completed surface, of its parts and of what stands about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.camera import cloud_of
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import Detection

_REACH_M = 0.35  # neighbours farther from the object than this are out of the gripper's way


class Graspable(Protocol):
    """What the planner looks at; `Completion` is one."""

    @property
    def mesh(self) -> trimesh.Trimesh: ...
    @property
    def parts(self) -> tuple[trimesh.Trimesh, ...]: ...
    @property
    def observed(self) -> np.ndarray: ...
    @property
    def sigma_m(self) -> np.ndarray: ...
    @property
    def detection(self) -> Detection: ...


@dataclass(frozen=True, eq=False)
class Surface:
    """Samples that the pads may touch.

    Attributes:
        points: (n, 3) m, world frame.
        normals: (n, 3) outward.
        certainty: (n,) how certain the points are to be real, 0 to 1.
    """

    points: np.ndarray
    normals: np.ndarray
    certainty: np.ndarray


def surface_of(completion: Graspable, config: GraspConfig, rng: np.random.Generator) -> Surface:
    """`config.num_points` samples of the completed mesh."""
    mesh = completion.mesh
    points, normals, face = sample_surface(mesh, config.num_points, rng)
    return Surface(points, normals, _certainty(completion, config)[mesh.faces[face]].mean(axis=1))


def obstacle_of(completion: Graspable, surface: Surface, config: GraspConfig, rng: np.random.Generator) -> np.ndarray:
    """Points (k, 3) m that the gripper keeps clear of, in no order: on the mesh, its parts, and what stands about."""
    parts = [part for part in completion.parts if part.area > 0]
    areas = np.array([part.area for part in parts])
    counts = np.ceil(config.num_points / 2 * areas / areas.sum()).astype(int) if len(parts) else []
    of_parts = [sample_surface(part, int(n), rng)[0] for part, n in zip(parts, counts, strict=True)]
    corners = [np.asarray(part.vertices) for part in completion.parts]
    neighbours = _neighbours(completion.detection, config)
    return rng.permutation(np.concatenate([surface.points, *of_parts, *corners, neighbours]))


def _certainty(completion: Graspable, config: GraspConfig) -> np.ndarray:
    """How certain each vertex (v,) is to be where it was completed; 0 where nobody says how certain it is."""
    if np.isinf(config.doubt_length_m):
        return np.ones(len(completion.observed))
    guessed = np.exp(-np.nan_to_num(completion.sigma_m, nan=np.inf) / config.doubt_length_m)
    return np.where(completion.observed, 1.0, guessed)


def _neighbours(detection: Detection, config: GraspConfig) -> np.ndarray:
    """Points (n, 3) m on what else stands about: off the support, and off the object."""
    view, support = detection.view, detection.support
    if view is None or support is None:
        return np.empty((0, 3))
    points = cloud_of(view, None if detection.mask is None else ~detection.mask).points
    points = points[support.distances(points) > config.neighbour_gap_m]
    own = np.asarray(detection.cloud.points)
    points = points[np.linalg.norm(points - own.mean(axis=0), axis=1) < _REACH_M]
    if not len(points):
        return points
    apart = KDTree(own).query(points, distance_upper_bound=config.neighbour_gap_m)[0]
    return points[np.isinf(apart)]
