"""Options: the budget of a completed shape's parts, what CoACD and V-HACD may be asked for, and their limits."""

from __future__ import annotations

import math
import numbers
from dataclasses import asdict, dataclass
from typing import Literal

from gfp_grasp.errors import InvalidOption

_NOT_FOR_COACD = ("engine", "vhacd_resolution", "time_limit_s", "memory_limit_mb", "attempts", "cache")

# V-HACD knows no "as many as it takes"; these are its own defaults.
_VHACD_PARTS = _VHACD_VERTICES = 64


@dataclass(frozen=True)
class CollisionConfig:
    """Budget of the convex parts of a completed shape. No result exceeds max_parts or max_vertices_per_part.

    Attributes:
        max_parts: Largest number of parts.
        max_vertices_per_part: Largest number of vertices of a part; None for no limit.
        tolerance_m: 95 % of the surfaces of parts and mesh lie within this distance of each other. The fewest parts
            that achieve this are taken. None takes as many of max_parts as make a difference.
        engine: What splits a mesh that brings no parts of its own, or whose own parts miss their bound: "coacd", or
            "cuts" for few plane cuts, in a fifth of a second. "auto" is "cuts" for a network's mesh.
    """

    max_parts: int = 80
    max_vertices_per_part: int | None = None
    tolerance_m: float | None = None
    engine: Literal["auto", "coacd", "cuts"] = "auto"

    def __post_init__(self) -> None:
        _choice(self.engine, "engine", ("auto", "coacd", "cuts"))
        _whole(self.max_parts, "max_parts", 1, None)
        if self.max_vertices_per_part is not None:
            _whole(self.max_vertices_per_part, "max_vertices_per_part", 4, None, "; or None for no limit")
        if self.tolerance_m is not None:
            _number(self.tolerance_m, "tolerance_m", 0.0, math.inf, "; or None to take what makes a difference")


@dataclass(frozen=True)
class DecomposeConfig:
    """Options of CoACD 1.0.14 under their own names, and limits of the child process that runs it.

    Source: https://github.com/SarahWeiii/CoACD (Wei et al., SIGGRAPH 2022).

    V-HACD 4 (https://github.com/kmammou/v-hacd) uses max_convex_hull, decimate, max_ch_vertex, vhacd_resolution and
    the limits only.

    Attributes:
        threshold: Concavity that a part may keep, 0.01 to 1, where the mesh is scaled into a cube of half-width 1;
            metres if real_metric is set. A smaller threshold gives more parts.
        max_convex_hull: Most parts, by merging; -1 for no limit, which with V-HACD is its own 64.
        preprocess_mode: "off" has CoACD take the mesh as it is (`decompose` has made a manifold of it), "on" has CoACD
            remesh it, which inflates thin walls; "auto" is "off" at first, and "on" when that has failed thrice.
        preprocess_resolution: Resolution of the remeshing, 20 to 100.
        resolution: Samples for the distance between surface and hull, 1000 to 10000.
        mcts_nodes: Cutting planes a level of the tree search, 10 to 40.
        mcts_iterations: Iterations of the tree search, 60 to 2000.
        mcts_max_depth: Depth of the tree search, 2 to 7.
        pca: Turn the mesh to its principal axes first.
        merge: Merge parts after cutting.
        decimate: Limit the vertices of each part to max_ch_vertex.
        max_ch_vertex: Most vertices a part, at least 4; only with decimate. V-HACD keeps to 64 without it.
        extrude: Thicken neighbouring parts along their common faces.
        extrude_margin: Distance of that thickening, in the unit of threshold; only with extrude.
        apx_mode: Parts are convex hulls ("ch") or boxes ("box").
        seed: Seed of the search.
        real_metric: threshold is in metres.
        time_limit_s: Seconds for the repair and all attempts together. After half of them the repair skips to its last
            step, which can need 15 s and is not cut short; where nothing is left then, no attempt follows.
        memory_limit_mb: Address space of the child process in MiB; POSIX only, None for no limit.
        attempts: Largest number of attempts: the first as asked, the second with jitter, the others coarser.
        engine: "coacd", or "vhacd" (an extra of this package), whose time depends on vhacd_resolution.
        vhacd_resolution: Number of voxels in which V-HACD holds the mesh, 10 000 to 10 000 000.
        cache: Keep the parts on disk, and take them from there when the same is asked again; see `store`.
    """

    threshold: float = 0.05
    max_convex_hull: int = -1
    preprocess_mode: Literal["auto", "on", "off"] = "auto"
    preprocess_resolution: int = 50
    resolution: int = 2000
    mcts_nodes: int = 20
    mcts_iterations: int = 150
    mcts_max_depth: int = 3
    pca: bool = False
    merge: bool = True
    decimate: bool = False
    max_ch_vertex: int = 256
    extrude: bool = False
    extrude_margin: float = 0.01
    apx_mode: Literal["ch", "box"] = "ch"
    seed: int = 0
    real_metric: bool = False
    time_limit_s: float = 300.0
    memory_limit_mb: int | None = 4096
    attempts: int = 4
    engine: Literal["coacd", "vhacd"] = "coacd"
    vhacd_resolution: int = 400_000
    cache: bool = True

    def __post_init__(self) -> None:
        # The bounds are those that CoACD's command line documents; under real_metric the unit is the mesh's own.
        _number(self.threshold, "threshold", 0.0 if self.real_metric else 0.01, math.inf if self.real_metric else 1.0)
        if self.max_convex_hull != -1:
            _whole(self.max_convex_hull, "max_convex_hull", 1, 100_000, "; or -1 for no limit")
        _choice(self.preprocess_mode, "preprocess_mode", ("auto", "on", "off"))
        _whole(self.preprocess_resolution, "preprocess_resolution", 20, 100)
        _whole(self.resolution, "resolution", 1000, 10_000)
        _whole(self.mcts_nodes, "mcts_nodes", 10, 40)
        _whole(self.mcts_iterations, "mcts_iterations", 60, 2000)
        _whole(self.mcts_max_depth, "mcts_max_depth", 2, 7)
        for name in ("pca", "merge", "decimate", "extrude", "real_metric", "cache"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidOption(f"{name} is {getattr(self, name)!r}; True or False is expected")
        _whole(self.max_ch_vertex, "max_ch_vertex", 4, 100_000)
        _number(self.extrude_margin, "extrude_margin", 0.0, math.inf)
        _choice(self.apx_mode, "apx_mode", ("ch", "box"))
        _whole(self.seed, "seed", 0, 2**32 - 1)
        _number(self.time_limit_s, "time_limit_s", 0.0, math.inf)
        if self.memory_limit_mb is not None:
            # Below this not even numpy loads, and every attempt would be lost without a word of why.
            _whole(self.memory_limit_mb, "memory_limit_mb", 512, 2**31, "; or None for no limit")
        _whole(self.attempts, "attempts", 1, 20)
        _choice(self.engine, "engine", ("coacd", "vhacd"))
        _whole(self.vhacd_resolution, "vhacd_resolution", 10_000, 10_000_000)

    def coacd_options(self) -> dict[str, float | int | bool | str]:
        """Keyword arguments of coacd.run_coacd."""
        return {name: value for name, value in asdict(self).items() if name not in _NOT_FOR_COACD}

    def vhacd_options(self) -> dict[str, float | int | bool | str]:
        """Keyword arguments of vhacdx.compute_vhacd."""
        return {
            "maxConvexHulls": _VHACD_PARTS if self.max_convex_hull == -1 else self.max_convex_hull,
            "maxNumVerticesPerCH": self.max_ch_vertex if self.decimate else _VHACD_VERTICES,
            "resolution": self.vhacd_resolution,
            "asyncACD": False,  # its threads share out the work differently each time
        }

    def engine_options(self) -> dict[str, float | int | bool | str]:
        """Keyword arguments of the engine's own function."""
        return self.vhacd_options() if self.engine == "vhacd" else self.coacd_options()


def _number(value: object, name: str, low: float, high: float, also: str = "") -> None:
    number = float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else math.nan
    if not math.isfinite(number) or not low <= number <= high or number == 0.0:
        start = "above 0" if low == 0.0 else f"at least {low:g}"
        end = "" if high == math.inf else f", at most {high:g}"
        raise InvalidOption(f"{name} is {value!r}; a finite number {start}{end} is expected{also}")


def _whole(value: object, name: str, low: int, high: int | None, also: str = "") -> None:
    number = int(value) if isinstance(value, numbers.Integral) and not isinstance(value, bool) else None
    if number is None or number < low or (high is not None and number > high):
        end = "on" if high is None else f"to {high}"
        raise InvalidOption(f"{name} is {value!r}; a whole number from {low} {end} is expected{also}")


def _choice(value: object, name: str, legal: tuple[str, ...]) -> None:
    if value not in legal:
        raise InvalidOption(f"{name} is {value!r}; legal are {', '.join(legal)}")
