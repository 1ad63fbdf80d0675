"""Benches: the figures of the README and of docs/, each measured by one function and written as JSON.

A bench loads what it measures, networks and simulator among it, when it is first asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gfp_grasp.bench.ablation import AblationConfig, bench_ablation
    from gfp_grasp.bench.collision import METHODS as PARTS_METHODS
    from gfp_grasp.bench.collision import bench_collision
    from gfp_grasp.bench.completion import CompletionConfig, bench_completion
    from gfp_grasp.bench.detection import bench_detection
    from gfp_grasp.bench.finding import paint_rooms
    from gfp_grasp.bench.hollow import bench_hollow
    from gfp_grasp.bench.hostile import HostileConfig, bench_hostile
    from gfp_grasp.bench.kitti import KittiConfig, bench_kitti
    from gfp_grasp.bench.methods import BRIEF, METHODS
    from gfp_grasp.bench.openset import bench_openset
    from gfp_grasp.bench.peer_groups import PeersConfig
    from gfp_grasp.bench.peer_shapes import shapes_of_peers
    from gfp_grasp.bench.peers import bench_peers
    from gfp_grasp.bench.primitives import bench_primitives
    from gfp_grasp.bench.ready import ReadyConfig, bench_ready
    from gfp_grasp.bench.ready_table import check_pages, ready_cells, ready_headings, write_pages
    from gfp_grasp.bench.registration import RegistrationConfig, bench_registration
    from gfp_grasp.bench.search import SearchConfig, bench_search
    from gfp_grasp.bench.speed import bench_resets, bench_speed, bench_stability
    from gfp_grasp.bench.trial import bench_trial

_HOMES = {
    "BRIEF": ("methods", "BRIEF"),
    "METHODS": ("methods", "METHODS"),
    "PARTS_METHODS": ("collision", "METHODS"),
    "AblationConfig": ("ablation", "AblationConfig"),
    "CompletionConfig": ("completion", "CompletionConfig"),
    "HostileConfig": ("hostile", "HostileConfig"),
    "ReadyConfig": ("ready", "ReadyConfig"),
    "RegistrationConfig": ("registration", "RegistrationConfig"),
    "SearchConfig": ("search", "SearchConfig"),
    "bench_ablation": ("ablation", "bench_ablation"),
    "bench_collision": ("collision", "bench_collision"),
    "bench_completion": ("completion", "bench_completion"),
    "bench_detection": ("detection", "bench_detection"),
    "bench_hollow": ("hollow", "bench_hollow"),
    "bench_hostile": ("hostile", "bench_hostile"),
    "KittiConfig": ("kitti", "KittiConfig"),
    "bench_kitti": ("kitti", "bench_kitti"),
    "PeersConfig": ("peer_groups", "PeersConfig"),
    "bench_openset": ("openset", "bench_openset"),
    "bench_peers": ("peers", "bench_peers"),
    "bench_primitives": ("primitives", "bench_primitives"),
    "bench_ready": ("ready", "bench_ready"),
    "bench_registration": ("registration", "bench_registration"),
    "bench_resets": ("speed", "bench_resets"),
    "bench_search": ("search", "bench_search"),
    "bench_speed": ("speed", "bench_speed"),
    "bench_stability": ("speed", "bench_stability"),
    "bench_trial": ("trial", "bench_trial"),
    "check_pages": ("ready_table", "check_pages"),
    "paint_rooms": ("finding", "paint_rooms"),
    "ready_cells": ("ready_table", "ready_cells"),
    "ready_headings": ("ready_table", "ready_headings"),
    "shapes_of_peers": ("peer_shapes", "shapes_of_peers"),
    "write_pages": ("ready_table", "write_pages"),
}

__all__ = [
    "BRIEF",
    "METHODS",
    "PARTS_METHODS",
    "AblationConfig",
    "CompletionConfig",
    "HostileConfig",
    "KittiConfig",
    "PeersConfig",
    "ReadyConfig",
    "RegistrationConfig",
    "SearchConfig",
    "bench_ablation",
    "bench_collision",
    "bench_completion",
    "bench_detection",
    "bench_hollow",
    "bench_hostile",
    "bench_kitti",
    "bench_openset",
    "bench_peers",
    "bench_primitives",
    "bench_ready",
    "bench_registration",
    "bench_resets",
    "bench_search",
    "bench_speed",
    "bench_stability",
    "bench_trial",
    "check_pages",
    "paint_rooms",
    "ready_cells",
    "ready_headings",
    "shapes_of_peers",
    "write_pages",
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        home, own = _HOMES[name]
        return getattr(import_module(f"{__name__}.{home}"), own)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
