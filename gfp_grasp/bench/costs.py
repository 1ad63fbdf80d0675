"""What a completion costs on one core: milliseconds, memory and weights, each method in a process of its own."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from safetensors import safe_open

from gfp_grasp.assets import data_dir, data_file
from gfp_grasp.bench.memory import peak_mb
from gfp_grasp.bench.methods import ObjectView, run_method, view_object
from gfp_grasp.completers import PEER_COMPLETERS
from gfp_grasp.errors import GfpGraspError, InvalidOption, WorkerLost
from gfp_grasp.parallel import Progress
from gfp_grasp.peers import weights_stem
from gfp_grasp.scenes import load_objects

# Files of the networks that a method may come to read.
_PROPOSALS = ("proposal", "proposal_lidar")
_PAPER = (*_PROPOSALS, "pcrnet", "pcrnet_lidar")
NETWORKS: Mapping[str, tuple[str, ...]] = {
    "classfree": ("classfree",),
    "told-pcrnet": _PAPER,
    "told-pcrnet-gfs": _PAPER,
    "told-pcrnet-gfpnet-paper": (*_PAPER, "gfpnet_paper"),
    "registration": (*_PROPOSALS, "classfree"),
    "gfpnet": (*_PROPOSALS, "classfree", "gfpnet"),
    **{name: (weights_stem(peer, true_box=true_box),) for name, (peer, true_box) in PEER_COMPLETERS.items()},
}
# Those that fit the primitives of classes as well.
WITH_PRIMITIVES = ("told-pcrnet", "told-pcrnet-gfs", "told-pcrnet-gfpnet-paper", "registration", "gfpnet")
WITHOUT_NETWORK = ("observed", "mirror")
_CHILD = "from gfp_grasp.bench.costs import answer_parent; answer_parent()"
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
# One view with its true class.
Sight = tuple[ObjectView, str]


def measure_costs(
    methods: Sequence[str],
    *,
    objects: str = "household",
    limit: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, dict[str, Any]]:
    """Cost of a completion by each method; nothing else should run beside it.

    Args:
        methods: Some of NETWORKS and of WITHOUT_NETWORK.
        objects: What is completed, as `load_objects` takes it.
        limit: Most objects.
        seed: Seed of the views.
        progress: Wraps the stream of methods.

    Returns:
        {method: {"ms": median of its answers on one thread, None where it has no answer, "first_ms": the first, with
        all that is loaded for it, "memory_mb": the most that the process held after the first, less what one held that
        had the same views and completed nothing, "weights_mb" and "parameters" of its networks, as files have them,
        "primitives_mb" of all classes, of those that fit one}}.

    Raises:
        InvalidOption: A method that costs are not known of.
        WorkerLost: A process died.
    """
    legal = (*NETWORKS, *WITHOUT_NETWORK)
    if not set(methods) <= set(legal):
        raise InvalidOption(f"methods are {', '.join(methods)}; some of {', '.join(legal)} are expected")
    sights = [
        (view_object(source.load_mesh(), np.random.default_rng([seed, number])), source.category)
        for number, source in enumerate(load_objects(objects, limit=limit))
    ]
    idle_mb = _in_child(None, sights)["peak_mb"]
    found = {}
    for method in (progress or (lambda stream, total: stream))(methods, len(methods)):
        told = _in_child(method, sights)
        found[method] = {
            "ms": None if not told["ms"] else round(float(np.median(told["ms"])), 1),
            "first_ms": told["first_ms"],
            "memory_mb": round(told["peak_mb"] - idle_mb, 1),
            **_weights_of(method),
        }
    return found


def answer_parent() -> None:
    """What a process does that `measure_costs` starts: it reads a method and views, and writes what they cost."""
    method, sights = pickle.load(sys.stdin.buffer)
    told: dict[str, Any] = {"ms": []}
    if method is not None:
        first, *others = sights
        told["first_ms"] = round(_ms(method, first)[0], 1)
        told["peak_mb"] = peak_mb()
        timed = [_ms(method, sight) for sight in others or sights]
        told["ms"] = [ms for ms, answered in timed if answered]
    sys.stdout.write(json.dumps({"peak_mb": peak_mb(), **told}))


def _ms(method: str, sight: Sight) -> tuple[float, bool]:
    """Milliseconds of a completion, and whether there was an answer."""
    view, category = sight
    answered, start = False, time.perf_counter()
    with warnings.catch_warnings(), suppress(GfpGraspError):
        warnings.simplefilter("ignore")
        run_method(method, view, None, category)
        answered = True
    return 1000 * (time.perf_counter() - start), answered


def _in_child(method: str | None, sights: Sequence[Sight]) -> dict[str, Any]:
    child = subprocess.run(
        [sys.executable, "-c", _CHILD],
        input=pickle.dumps((method, sights)),
        stdout=subprocess.PIPE,
        env={**os.environ, **_ONE_THREAD},
        check=False,
    )
    if child.returncode:
        raise WorkerLost(
            f"the process that completed by {method} died with {child.returncode}: is there memory enough?"
        )
    return json.loads(child.stdout)


def _weights_of(method: str) -> dict[str, Any]:
    files = [data_file("weights", f"{stem}.safetensors") for stem in NETWORKS.get(method, ())]
    primitives = list(data_dir("gps").glob("*.safetensors")) if method in WITH_PRIMITIVES else []
    figures: dict[str, Any] = {"weights_mb": _mb(files), "parameters": sum(_count(file) for file in files)}
    return figures | ({"primitives_mb": _mb(primitives)} if primitives else {})


def _mb(files: Sequence[os.PathLike[str]]) -> float:
    return round(sum(os.path.getsize(file) for file in files) / 1e6, 2)


def _count(file: os.PathLike[str]) -> int:
    """Numbers in a file of weights."""
    with safe_open(file, framework="np") as stored:
        return sum(int(np.prod(stored.get_slice(key).get_shape())) for key in stored.keys())  # noqa: SIM118
