"""A few numbers that stand for a whole array or mesh, so that a known answer fits into a line.

Known answers are kept in known_moments.json by name. Whoever changes an algorithm on purpose writes them anew, with
WRITE_KNOWN=1 in the environment of the tests, and looks at the difference.
"""

import json
import os
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

_PATH = Path(__file__).parent / "known_moments.json"


def moments(values: ArrayLike) -> list[float]:
    """Length, mean, root mean square and two sums with uneven weights: another order gives other numbers."""
    flat = np.asarray(values, dtype=np.float64).ravel()
    uneven = np.cos(1.7 * np.arange(len(flat)) ** 0.7)
    sums = len(flat), flat.mean(), np.sqrt((flat**2).mean()), uneven @ flat, uneven[::-1] @ flat
    return [float(value) for value in sums]


def assert_known(name: str, values: ArrayLike, *, rel: float = 1e-5) -> None:
    """The moments of the values are the known ones, to a share of the size of what is summed."""
    found, known = moments(values), json.loads(_PATH.read_text(encoding="utf-8"))
    if os.environ.get("WRITE_KNOWN"):
        known[name] = [float(f"{value:.9g}") for value in found]
        lines = [f"{json.dumps(key)}: {json.dumps(row)}" for key, row in sorted(known.items())]
        _PATH.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    expected = known[name]
    assert found[0] == expected[0], f"{name} has {found[0]} values"
    size = rel * max(expected[2], 1e-12)
    np.testing.assert_allclose(found[1:3], expected[1:3], rtol=0, atol=size, err_msg=name)
    np.testing.assert_allclose(found[3:], expected[3:], rtol=0, atol=size * expected[0] ** 0.5, err_msg=name)


def bent(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh sheared and bulged a little, so that no two of its edges are of one length."""
    x, y, z = np.asarray(mesh.vertices).T
    vertices = np.column_stack([x + 0.07 * y + 2.0 * z * z, y + 0.05 * z + 1.5 * x * z, z + 0.03 * x - 1.2 * x * y])
    return trimesh.Trimesh(vertices, mesh.faces, process=False)
