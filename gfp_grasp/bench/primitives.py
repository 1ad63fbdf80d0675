"""What the primitives of a library are like, and how near their modes come to whole real meshes of their classes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gfp_grasp.meshes import make_solid
from gfp_grasp.parallel import Progress, one_thread, pmap
from gfp_grasp.primitives import PrimitiveLibrary, fit_full_surface
from gfp_grasp.scenes import ObjectSource, load_objects

_FROM_CARD = (
    "vertices", "modes", "variance_kept", "generalization_mm", "generalization_percent", "specificity_mm", "parts",
    "parts_error_mm", "members_used", "members_dropped", "build_s",
)  # fmt: skip


def bench_primitives(
    data: Sequence[Path] = (),
    *,
    library: PrimitiveLibrary | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Figures of every primitive, and the best fit of its class to each mesh of some folders.

    Args:
        data: Folders of files `<class>__<name>.<suffix>`, upright, m; files of other classes are left out.
        library: None takes the classes that ship.
        workers: Number of processes.
        progress: Wraps the stream of fits.

    Returns:
        {"rows": {primitive: figures of its card}, "bytes": size of all primitives together,
        "fits": [{"mesh", "category", "primitive", "length_m", "error_mm", "error_percent"}]}. An error is the mean
        distance between the two surfaces, from each to the other and averaged; its percentage is that of the longest
        extent. The best fit among a class and its subcategories counts.
    """
    library = PrimitiveLibrary.shipped() if library is None else library
    sources = [source for folder in data for source in load_objects(folder) if source.category in library.categories]
    fits = list(pmap(partial(_best_fit, library=library), sources, workers=workers, progress=progress))
    rows = {name: {key: library.primitive(name).card.get(key) for key in _FROM_CARD} for name in library.names}
    size = sum(path.stat().st_size for folder in library.folders for path in folder.iterdir() if path.is_file())
    return {"rows": rows, "bytes": size, "fits": fits}


def _best_fit(source: ObjectSource, *, library: PrimitiveLibrary) -> dict[str, Any]:
    with one_thread():
        solid, _ = make_solid(source.load_mesh())
        errors = {p.name: fit_full_surface(p, solid)[1] for p in library.members_of(source.category)}
    best = min(errors, key=lambda name: errors[name])
    length_m = float(np.max(solid.extents))
    return {
        "mesh": source.name,
        "category": source.category,
        "primitive": best,
        "length_m": round(length_m, 4),
        "error_mm": round(1e3 * errors[best], 3),
        "error_percent": round(100 * errors[best] / length_m, 3),
    }
