"""From a detection, or its level view, to a completed shape without any class."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from gfp_grasp.classfree.grid import Grid, channels, grid_around
from gfp_grasp.classfree.network import DistanceNet, load_network
from gfp_grasp.classfree.surface import surface_from
from gfp_grasp.deform import stood
from gfp_grasp.level import make_level_view, mark_observed
from gfp_grasp.parallel import one_thread
from gfp_grasp.types import CompletedShape, Detection, LevelView


@one_thread()
def complete_classfree(detection: Detection, *, network: DistanceNet | None = None, seed: int = 0) -> CompletedShape:
    """Complete a detected object of which no class is known.

    Args:
        detection: One object, at least `level.MIN_POINTS` points; its class and scores are not looked at.
        network: None takes the shipped one.
        seed: Chooses the points that are kept where there are very many.

    Returns:
        The completed shape in the detection's frame, standing on its support; its `fit` is None.

    Raises:
        TooFewPoints: Too few points.
        NoSurface: The network finds nothing solid around the points.
    """
    view = make_level_view(detection, seed=seed)
    return complete_level(view, network=network).moved(view.T_world_level)


@one_thread()
def complete_level(view: LevelView, *, network: DistanceNet | None = None) -> CompletedShape:
    """As `complete_classfree`, of and in a level view.

    Raises:
        NoSurface: The network finds nothing solid around the points.
    """
    grid = grid_around(view)
    distance, log_scale = distances(view, grid, network or load_network())
    surface = surface_from(distance, log_scale, grid, view)
    vertices = stood(surface.vertices, surface.faces, view)
    observed, sigma_m = mark_observed(
        vertices, surface.faces, view.cloud, sensor_sigma_m=view.sigma_m, sigma_m=surface.sigma_m
    )
    return CompletedShape(
        trimesh.Trimesh(vertices, surface.faces, process=False), observed, sigma_m, made_by="classfree"
    )


def distances(view: LevelView, grid: Grid, network: DistanceNet) -> tuple[np.ndarray, np.ndarray]:
    """Signed distances (x, y, z) of cells from the object's surface, in cells, and logarithms of their scales."""
    known = torch.from_numpy(channels(view, grid))[None]
    with torch.inference_mode():
        distance, log_scale = network(known.to(next(network.parameters()).device))
    return distance[0].double().cpu().numpy(), log_scale[0].double().cpu().numpy()
