"""Things of no class, kind by kind: those that the shipped classifier learnt to tell from the classes."""

import json
from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.shapes import make_assorted

# Whoever changes a kind on purpose trains the classifier again and writes this file anew: `measured` of kind after
# kind, the first member and the fourth in turn.
KNOWN = json.loads((Path(__file__).parent / "known_assorted.json").read_text(encoding="utf-8"))
NUM_MAKERS = 12


def measured(kind: int) -> list[float]:
    """Vertices; extents (mm), centre of mass (mm), volume (cm^3), area (cm^2) and mean vertex (mm)."""
    mesh = make_assorted(kind, 3 * (kind // NUM_MAKERS % 2))
    lengths = [*mesh.extents, *mesh.center_mass, *mesh.vertices.mean(axis=0)]
    sizes = [*(1e3 * length for length in lengths), 1e6 * mesh.volume, 1e4 * mesh.area]
    return [len(mesh.vertices), *(round(float(size), 4) for size in sizes)]


@pytest.mark.parametrize("maker", range(NUM_MAKERS))
def test_kinds_are_those_that_the_shipped_classifier_was_trained_against(maker: int) -> None:
    assert len(KNOWN) % NUM_MAKERS == 0
    for kind in range(maker, len(KNOWN), NUM_MAKERS):
        np.testing.assert_allclose(measured(kind), KNOWN[kind], rtol=1e-4, atol=2e-3, err_msg=f"kind {kind}")
