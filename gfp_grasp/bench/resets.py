"""Bench of the environment's memory: episodes come and go, and nothing of them may stay.

More objects than the environment keeps compiled, so that scenes are also thrown away and made anew.
"""

from __future__ import annotations

import time
from typing import Any

from gfp_grasp.bench.speed import resident_mb
from gfp_grasp.envs import GfpGraspEnv
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import label_of

_POINTS = 10  # at which memory is measured
# A small picture: it takes less time, and what stays of an episode is not its picture.
_SMALL = {"image_width": 120, "image_height": 90, "num_points": 256}


def bench_resets(
    objects: str = "cup,mug,bottle",
    *,
    resets: int = 10_000,
    completer: str = "mirror",
    limit: int = 20,
    seed: int = 0,
    progress=None,
    **options: object,
) -> dict[str, Any]:
    """Memory of the process over many resets of one environment.

    Args:
        objects: Families, or a folder of meshes.
        resets: How many.
        completer: Name; a cheap one measures the environment, another one itself as well.
        limit: Objects in all; each is loaded once before the count begins, as parts that are not in the cache yet
            would be made in the first resets.
        seed: Of the first reset; those after it go on from there.
        progress: Wraps the stream of resets.
        **options: More of `gfp_grasp.envs.config.EnvConfig`; the picture is small unless they say otherwise.

    Returns:
        {"settings", "rss_mb": resident memory in MB at ten points of the run, "resets_per_s": of CPU time}.

    Raises:
        InvalidOption: Fewer than ten resets, or an option that the environment refuses.
    """
    if resets < _POINTS:
        raise InvalidOption(f"resets is {resets}; at least {_POINTS} are expected, for as many points of measurement")
    chosen = {"objects": objects, "completer": completer, "limit": limit, **_SMALL, **options}
    env = GfpGraspEnv(**chosen)
    for number in range(len(env.sources)):
        env.reset(seed=seed, options={"object": number})
    marks = {resets * (i + 1) // _POINTS for i in range(_POINTS)}
    resident, seconds = [], 0.0
    for done in (progress or (lambda stream, total: stream))(range(1, resets + 1), resets):
        start = time.process_time()
        env.reset(seed=seed if done == 1 else None)
        seconds += time.process_time() - start
        if done in marks:
            resident.append(resident_mb())
    env.close()
    return {
        "settings": {
            **chosen,
            "objects": label_of(objects),
            "num_objects": len(env.sources),
            "resets": resets,
            "seed": seed,
        },
        "rss_mb": resident,
        "resets_per_s": round(resets / seconds, 2),
    }
