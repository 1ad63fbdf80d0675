"""Stands for what the comparison with other networks is made of: blocks, weights, methods and the other benches."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import box_part
from toy_bodies import refined

from gfp_grasp.bench import completion, peer_groups, peers
from gfp_grasp.bench.methods import Answer
from gfp_grasp.journal import Journal
from gfp_grasp.peers import check_trained
from gfp_grasp.score import Report, ScoreRow

BLOCKS = {"cup__a": (0.06, 0.05, 0.08), "box__b": (0.08, 0.05, 0.1), "c": (0.07, 0.06, 0.05)}


def write_block(path: Path, *extents: float) -> None:
    refined(box_part([0, 0, 0], list(extents)).to_trimesh(), 0.01).export(path)


def write_blocks(folder: Path) -> Path:
    """Blocks that are called a cup, a box, and nothing."""
    folder.mkdir(parents=True)
    for name, extents in BLOCKS.items():
        write_block(folder / f"{name}.ply", *extents)
    return folder


class Shipped:
    """Writes the files that ship, in a folder of its own; there are none before, and no network is loaded.

    Attributes:
        folder: Folder of the folders `weights` and `gps`.
    """

    def __init__(self, patch: pytest.MonkeyPatch, folder: Path) -> None:
        self.folder = folder
        for name in ("weights", "gps"):
            (folder / name).mkdir(parents=True)
        patch.setattr("gfp_grasp.peers.catalogue.data_dir", lambda name: folder / name)
        patch.setattr("gfp_grasp.bench.digests.data_dir", lambda name: folder / name)
        patch.setattr("gfp_grasp.peers.load_network", check_trained, raising=False)

    def __call__(self, *peers: str, content: str = "first") -> None:
        """Weights of peers, by the names of their files."""
        for peer in peers:
            self.write(f"weights/peer_{peer}.safetensors", content)

    def write(self, file: str, content: str) -> None:
        """A file by its path below the folder."""
        (self.folder / file).write_text(content)


class Parts:
    """Stands for the other benches; keeps what they were asked, and answers with little.

    Attributes:
        methods: Methods, completers and rows of each call, by part.
        score: How the score was last asked.
        journals: Journals of the score by completer, of the last call each.
        stop_at: Completer at which the score is stopped.
    """

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.methods: dict[str, list[tuple[str, ...]]] = {"cost": [], "score": [], "kitti": []}
        self.score: dict[str, Any] = {}
        self.journals: dict[str, Path | None] = {}
        self.stop_at = ""
        patch.setattr(peers, "measure_costs", self.measure_costs)
        patch.setattr(peers, "bench_kitti", self.bench_kitti)
        patch.setattr(peers, "score", self.try_grasps)

    def measure_costs(self, methods, *, objects, limit, seed, progress):
        self.methods["cost"].append(methods)
        return {name: {"ms": 1.0, "made_in": len(self.methods["cost"])} for name in methods}

    def bench_kitti(self, data, *, config, workers, progress):
        self.methods["kitti"].append(config.rows)
        return {"rows": {row: {"things": 2, "mmd_m": 0.1, "each": [1, 2]} for row in config.rows}}

    def try_grasps(self, objects, completers, *, config, workers, journal, progress):
        (completer,) = completers
        self.methods["score"].append(completers)
        self.score = {"objects": objects, "config": config}
        self.journals[completer] = journal
        if journal is not None:
            Journal(journal, {"seed": config.seed, "completers": list(completers)})
        if completer == self.stop_at:
            raise KeyboardInterrupt
        return Report({"no_grip": []}, (score_row(completer),))


def score_row(completer: str) -> ScoreRow:
    held = completer == "oracle"
    return ScoreRow(
        object="a", category="cup", completer=completer, view=0, episode_seed=1, success=held,
        reason="held" if held else "slipped", lift_m=0.2, slip_m=0.0, falls_free=True, least_friction=0.5,
        margin=2.0 if held else 0.5, mass_kg=0.1, friction=0.7, grip_n=20.0, completed_success=held,
        completed_reason="held" if held else "slipped", quality=0.5, width_m=0.05, cd_m=0.001, f_score=0.9,
        timings_s={"plan": 0.5},
    )  # fmt: skip


def few_methods(patch: pytest.MonkeyPatch) -> None:
    """Few methods and one hidden share, so that real completions take seconds."""
    patch.setattr(peers, "BEFORE", ("partial", "told-pcrnet"))
    patch.setattr(peers, "AFTER", ("gfpnet",))
    patch.setattr(peer_groups, "HIDDEN", (0.6,))


def methods_that_are_asked(patch: pytest.MonkeyPatch) -> list[tuple[str, int, str]]:
    """Methods that all answer with most of the vertices of the truth; true class, points that were seen, and method."""
    asked = []

    def run(method, view, told, given, *, library):
        asked.append((given, len(view.cloud.points), method))
        return Answer(np.asarray(view.mesh.vertices)[1:])

    patch.setattr(completion, "run_method", run)
    return asked
