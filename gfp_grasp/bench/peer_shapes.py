"""What the compared networks make of one view of each group: the meshes of the picture of `bench peers`."""

from __future__ import annotations

import warnings

import numpy as np
import trimesh

from gfp_grasp.bench.completion import view_of
from gfp_grasp.bench.methods import ObjectView, is_told_class, run_method
from gfp_grasp.bench.peer_groups import PeersConfig, groups_of, trained_of
from gfp_grasp.bench.peers import AFTER, BEFORE
from gfp_grasp.completers import PEER_COMPLETERS
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.transforms import apply_T, make_T, rotation_about

TRUTH = "truth"


def shapes_of_peers(config: PeersConfig) -> dict[str, dict[str, trimesh.Trimesh | np.ndarray]]:
    """Complete a view of the first object of each group, of a class that no group before it has shown.

    Args:
        config: The objects and the peers, of which those that have weights are drawn, as they are used: around what was
            seen.

    Returns:
        {group: {method: mesh, or points (n, 3), m}}, the truth first. In their frame the camera looks along +x, z is
        up, and the truth stands on z = 0. A method that has no answer is left out.
    """
    trained, _ = trained_of(config.peers, ())
    peers = tuple(name for name in trained if not PEER_COMPLETERS[name][1])  # those that are not told the true box
    found: dict[str, dict[str, trimesh.Trimesh | np.ndarray]] = {}
    shown: set[str] = set()
    for group in groups_of(config):
        new = [source for source in group.sources if source.category not in shown]
        if group.hidden is not None or not new:
            continue
        source = new[0]
        shown.add(source.category)
        view = view_of(source, 0, group.views)
        T = _towards_x(view)
        found[group.name] = {}
        for method in (TRUTH, *BEFORE, *peers, *AFTER):
            if is_told_class(method) and not source.category:
                continue
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    surface = run_method(method, view, None, source.category).surface
            except GfpGraspError:
                continue
            found[group.name][method] = _moved(surface, T)
    return found


def _towards_x(view: ObjectView) -> np.ndarray:
    """(4, 4) pose of the world in a frame whose x axis points away from the camera."""
    low, high = view.mesh.bounds
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    away = middle - view.cloud.viewpoint
    R = rotation_about((0, 0, 1), -np.arctan2(away[1], away[0]))
    return make_T(R, -R @ middle)


def _moved(surface: trimesh.Trimesh | np.ndarray, T: np.ndarray) -> trimesh.Trimesh | np.ndarray:
    if isinstance(surface, np.ndarray):
        return apply_T(T, surface)
    return surface.copy().apply_transform(T)
