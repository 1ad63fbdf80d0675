"""Things of no class: sound, metric, the same for their number, and not the same in two splits."""

import numpy as np
import pytest
from moments import assert_known

from gfp_grasp.errors import InvalidOption
from gfp_grasp.shapes import MIXTURES, SPLITS, make_mixture

LONGEST_M = {
    "apple-like": (0.03, 0.2),
    "tool-like": (0.08, 0.35),
    "toy-like": (0.05, 0.3),
    "union": (0.03, 0.4),
    "revolution": (0.03, 0.35),
    "sweep": (0.06, 0.35),
    "shell": (0.04, 0.35),
}
FEW = range(10)


@pytest.mark.parametrize("kind", MIXTURES)
def test_every_mixture_is_one_closed_volume_of_the_size_of_its_kind_on_the_ground(kind: str) -> None:
    for mesh in (make_mixture(kind, number) for number in FEW):
        assert mesh.is_volume
        assert mesh.body_count == 1
        low, high = LONGEST_M[kind]
        assert low <= mesh.extents.max() * (1 + 1e-9)
        assert mesh.extents.max() <= high * (1 + 1e-9)
        np.testing.assert_allclose(mesh.bounds[0, 2], 0.0, atol=1e-9)
        np.testing.assert_allclose(mesh.bounds[:, :2].sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", MIXTURES)
def test_a_mixture_is_the_one_of_its_kind_split_and_number(kind: str) -> None:
    mesh = make_mixture(kind, 3, split="val")
    np.testing.assert_array_equal(make_mixture(kind, 3, split="val").vertices, mesh.vertices)
    others = [make_mixture(kind, 4, split="val"), *(make_mixture(kind, 3, split=s) for s in SPLITS if s != "val")]
    assert min(np.abs(other.extents - mesh.extents).max() for other in others) > 1e-5


@pytest.mark.parametrize("kind", MIXTURES)
def test_mixtures_are_those_that_the_shipped_network_was_trained_on(kind: str) -> None:
    """Whoever changes a kind on purpose trains the network again and writes the known answer anew."""
    sizes = [[*mesh.extents, *mesh.center_mass, np.cbrt(mesh.volume)] for mesh in (make_mixture(kind, n) for n in FEW)]
    assert_known(f"mixtures {kind}", sizes, rel=1e-4)


def test_shells_are_thin_and_apples_are_not() -> None:
    def fullness(kind: str) -> float:
        return float(np.median([m.volume / m.convex_hull.volume for m in (make_mixture(kind, n) for n in FEW)]))

    assert fullness("shell") < 0.45
    assert fullness("apple-like") > 0.85


def test_a_kind_or_split_that_there_is_not_is_refused() -> None:
    with pytest.raises(InvalidOption, match="apple-like"):
        make_mixture("pear-like", 0)
    with pytest.raises(InvalidOption, match="val"):
        make_mixture("union", 0, split="dev")
