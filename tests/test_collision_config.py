"""Options of the engines and budgets of parts: legal to their bounds, and no farther."""

import pytest

from gfp_grasp.collision import CollisionConfig, DecomposeConfig
from gfp_grasp.errors import InvalidOption

BOUNDS = {
    "threshold": (0.01, 1.0),
    "max_convex_hull": (1, 100_000),
    "preprocess_resolution": (20, 100),
    "resolution": (1000, 10_000),
    "mcts_nodes": (10, 40),
    "mcts_iterations": (60, 2000),
    "mcts_max_depth": (2, 7),
    "max_ch_vertex": (4, 100_000),
    "seed": (0, 2**32 - 1),
    "memory_limit_mb": (512, 2**31),
    "attempts": (1, 20),
    "vhacd_resolution": (10_000, 10_000_000),
}


@pytest.mark.parametrize("name", sorted(BOUNDS))
def test_both_bounds_are_legal_and_nothing_beyond_them_is(name: str):
    low, high = BOUNDS[name]
    step = 1e-6 if name == "threshold" else 1
    for value in (low, high):
        assert getattr(DecomposeConfig(**{name: value}), name) == value
    for value in (low - step, high + step):
        with pytest.raises(InvalidOption, match=f"{name} is {value!r}"):
            DecomposeConfig(**{name: value})
    for value in (True, "1", None, float("nan")):
        if (name, value) != ("memory_limit_mb", None):
            with pytest.raises(InvalidOption, match=name):
                DecomposeConfig(**{name: value})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", ["pca", "merge", "decimate", "extrude", "real_metric", "cache"])
def test_a_switch_is_true_or_false(name: str):
    assert getattr(DecomposeConfig(**{name: True}), name) is True  # pyright: ignore[reportArgumentType]
    for value in (1, 0, None, "no"):
        with pytest.raises(InvalidOption, match=f"{name}.*True or False"):
            DecomposeConfig(**{name: value})  # pyright: ignore[reportArgumentType]


def test_no_time_and_no_concavity_are_refused():
    for options in ({"time_limit_s": 0.0}, {"real_metric": True, "threshold": 0.0}):
        with pytest.raises(InvalidOption, match="above 0"):
            DecomposeConfig(**options)  # pyright: ignore[reportArgumentType]


def test_no_limit_of_parts_or_memory_is_legal():
    assert DecomposeConfig(max_convex_hull=-1, memory_limit_mb=None).memory_limit_mb is None


def test_coacd_is_told_its_own_options_and_vhacd_its_own():
    config = DecomposeConfig(threshold=0.02, seed=3, vhacd_resolution=12_345)
    coacd = config.engine_options()
    assert (coacd["threshold"], coacd["seed"]) == (0.02, 3)
    assert not {"engine", "vhacd_resolution", "time_limit_s", "memory_limit_mb", "attempts", "cache"} & set(coacd)
    of_vhacd = {"maxConvexHulls": 64, "maxNumVerticesPerCH": 64, "resolution": 12_345, "asyncACD": False}
    assert DecomposeConfig(engine="vhacd", vhacd_resolution=12_345).engine_options() == of_vhacd
    few = DecomposeConfig(engine="vhacd", max_convex_hull=5, decimate=True, max_ch_vertex=9)
    assert few.engine_options() == {**of_vhacd, "maxConvexHulls": 5, "maxNumVerticesPerCH": 9, "resolution": 400_000}


@pytest.mark.parametrize("options", [{"max_parts": 1}, {"max_vertices_per_part": 4}, {"tolerance_m": 1e-9}, {}])
def test_the_smallest_budgets_are_legal(options: dict):
    config = CollisionConfig(**options)
    assert all(getattr(config, name) == value for name, value in options.items())


@pytest.mark.parametrize("name", ["max_parts", "max_vertices_per_part", "tolerance_m"])
@pytest.mark.parametrize("value", [True, False, "4", float("inf"), -1, [4]])
def test_a_budget_that_is_no_number_is_refused(name: str, value: object):
    with pytest.raises(InvalidOption, match=name):
        CollisionConfig(**{name: value})  # pyright: ignore[reportArgumentType]
