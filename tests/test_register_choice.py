"""What is asked of the best of all starts: what it is measured by, whether it is cut off, and whether it is round."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from standing_wedge import LIGHT, half_seen_wedge
from toy_wedge import UP, wedge_primitive, wedge_state

from gfp_grasp.level import guessed_silhouette
from gfp_grasp.register import FitConfig, fit_best
from gfp_grasp.register import fit as fit_module
from gfp_grasp.register.pruning import Search
from gfp_grasp.types import TABLETOP, PointCloud


def _enlarged(view, factor: float):
    """Everything that a view of a wedge says, at another scale."""
    return replace(
        view,
        cloud=PointCloud(view.cloud.points * factor, view.viewpoint * factor),
        points=view.points * factor,
        floor_m=view.floor_m * factor,
        floor_sigma_m=(view.floor_sigma_m[0] * factor, view.floor_sigma_m[1] * factor),
        sigma_m=view.sigma_m * factor,
    )


def test_an_object_a_hundred_times_as_large_is_fitted_as_well():
    _, evidence = half_seen_wedge()
    wedge = wedge_primitive()
    huge = replace(wedge, vertices=wedge.vertices * 100, modes=wedge.modes * 100)
    config = replace(LIGHT, roundness=True)
    small, large = (
        fit_best(view, [(primitive, 0.0)], config=config)
        for view, primitive in ((evidence, wedge), (_enlarged(evidence, 100), huge))
    )
    assert large.vertices_world() / 100 == pytest.approx(small.vertices_world(), abs=1e-5)
    assert large.residual_m / 100 == pytest.approx(small.residual_m, rel=1e-2)
    assert large.cost == pytest.approx(small.cost, rel=1e-3)
    assert large.margin == pytest.approx(small.margin, rel=1e-2)


def test_costs_of_rivals_are_in_one_unit_which_a_rival_of_unusual_size_does_not_change(monkeypatch):
    _, evidence = half_seen_wedge()
    wedge = wedge_primitive()
    size_m = wedge.size_m
    assert size_m == pytest.approx(float(np.cbrt(np.ptp(wedge.vertices, axis=0).prod())))
    plate = replace(wedge, vertices=wedge.vertices * (1, 1, 1e-6))
    extents = np.ptp(plate.vertices, axis=0)
    assert plate.size_m == pytest.approx(float(np.cbrt(0.1 * extents[0] * extents[1] * np.hypot(*extents[:2]))))
    units = []

    def searched(evidence, candidates, config):
        units.extend(getattr(config, name).unit_m for name in ("quick", "middle", "thorough"))
        return Search(wedge, 0.0, [wedge_state(cost=1.0)])

    monkeypatch.setattr(fit_module, "search_starts", searched)
    larger = [replace(wedge, vertices=wedge.vertices * factor) for factor in (1.1, 5.0)]
    fit_best(evidence, [(primitive, 0.0) for primitive in (wedge, *larger)], config=LIGHT)
    assert units == pytest.approx([1.1 * size_m] * 3)


def _asked_for_an_occluder(
    monkeypatch, evidence, violations, costs, *, foot: bool = False, found=("clear", "faint"), **changes: object
) -> tuple[list[str | None], float]:
    """Which edges are asked for, and the cost of the answer, where fits have these costs, of free space and in all."""
    calls, next_cost, violation = [], iter(costs), iter(violations)

    def cut_off(seen, *, edge):
        calls.append(edge)
        below = np.inf if foot else 0.002
        return replace(seen, cut=UP, floor_sigma_m=(0.002, below)) if edge in found else seen

    def search(evidence, candidates, config):
        return Search(candidates[0][0], 0.0, [wedge_state(cost=next(next_cost), residual_m=0.001)])

    monkeypatch.setattr(fit_module, "cut_off", cut_off)
    monkeypatch.setattr(fit_module, "search_starts", search)
    monkeypatch.setattr(fit_module, "evaluate_free_space", lambda *_: next(violation))
    monkeypatch.setattr(fit_module, "hidden_end", lambda *_: 0)
    fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(LIGHT, roundness=False, **changes))
    return calls, fit.cost


def test_only_a_guessed_outline_is_taken_for_cut_off_and_only_by_what_is_clearly_likelier(monkeypatch):
    _, evidence = half_seen_wedge()
    assert evidence.viewpoint is not None
    silhouette = guessed_silhouette(evidence.points, evidence.viewpoint, TABLETOP)
    guessed = replace(evidence, silhouette=silhouette)
    ask = partial(_asked_for_an_occluder, monkeypatch)
    assert ask(guessed, [0.9], [50.0], foot=True) == ([], 50.0)
    assert ask(guessed, [1.1, 1.1], [30.0, 24.9], foot=True) == (["clear"], 24.9)
    assert ask(guessed, [1.9, 1.9], [50.0], foot=False) == (["clear"], 50.0)  # an edge elsewhere is not worth a search
    assert ask(guessed, [2.1, 2.1], [30.0, 25.1]) == (["clear"], 30.0)
    assert ask(guessed, [2.1, 2.1], [30.0, 24.9]) == (["clear"], 24.9)
    assert ask(guessed, [2.1, 2.1], [100.0, 87.1]) == (["clear"], 100.0)
    assert ask(guessed, [2.1, 2.1], [100.0, 86.9]) == (["clear"], 86.9)
    assert ask(guessed, [9.0, 7.9], [30.0, 24.9]) == (["clear"], 24.9)
    assert ask(guessed, [9.0, 8.1, 7.9], [30.0, 26.0, 24.9]) == (["clear", "faint"], 24.9)
    assert ask(guessed, [9.0, 8.1, 8.1], [30.0, 24.9, 19.8], found=()) == (["clear", "faint", None], 24.9)
    assert ask(guessed, [9.0, 8.1, 8.1], [30.0, 24.9, 19.8, 14.7]) == (["clear", "faint", None], 14.7)
    assert ask(guessed, [], [50.0], occlusion=False) == ([], 50.0)
    assert ask(replace(guessed, silhouette=replace(silhouette, certain=True)), [], [50.0]) == ([], 50.0)
    assert ask(replace(guessed, silhouette=None), [], [50.0]) == ([], 50.0)


def test_lengths_are_measured_by_the_likeliest_primitives(monkeypatch):
    _, evidence = half_seen_wedge()
    units = []

    def search(evidence, candidates, config):
        units.append(config.thorough.unit_m)
        return Search(candidates[0][0], 0.0, [wedge_state(cost=5.0, residual_m=0.001)])

    monkeypatch.setattr(fit_module, "search_starts", search)
    wedge = wedge_primitive()
    sizes = {k: replace(wedge, vertices=k * wedge.vertices) for k in (1, 2, 3, 4, 5, 60, 70)}
    likely = [(sizes[k], 0.1 * k) for k in (5, 3, 1, 2, 4)]
    config = replace(LIGHT, roundness=False, occlusion=False)
    for candidates in (likely, [(sizes[60], 9.0), *likely, (sizes[70], 8.0)]):
        fit_best(evidence, candidates, config=config)
    assert units == pytest.approx([3 * wedge.size_m] * 2)


@pytest.mark.parametrize(
    ("share", "round_cost", "is_round"), [(0.5, 12.9, True), (0.5, 13.1, False), (0.9, 15.0, True), (0.9, 15.3, False)]
)
def test_a_round_body_is_believed_by_the_share_of_the_class_that_is_round(monkeypatch, share, round_cost, is_round):
    _, evidence = half_seen_wedge()
    state = wedge_state(cost=10.0)
    rounded = wedge_state(cost=round_cost - 2.0, residual_m=1.0)
    weights = []
    monkeypatch.setattr(fit_module, "refine", lambda *given: weights.append(given[3].ellipticity) or [rounded])
    monkeypatch.setattr(fit_module, "blocking_cost", lambda *_: 2.0)
    monkeypatch.setattr(fit_module, "circular_share", lambda *_: share)
    found = fit_module.try_circular(state, wedge_primitive(), evidence, FitConfig())
    assert found.cost == pytest.approx(round_cost if is_round else 10.0)
    assert weights == [0.0031]  # 0.3 mm on a cup


def test_a_rounder_body_may_cost_more_than_another_hypothesis_but_the_margin_is_at_least_one(monkeypatch):
    _, evidence = half_seen_wedge()
    states = [wedge_state(cost=10.0), wedge_state(cost=10.5, hypothesis="lying")]
    monkeypatch.setattr(fit_module, "search_starts", lambda *_: Search(wedge_primitive(), 0.0, states))
    monkeypatch.setattr(fit_module, "try_circular", lambda state, *_: replace(state, cost=state.cost + 2))
    for roundness, cost, margin in ((True, 12.0, 1.0), (False, 10.0, 1.05)):
        fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(LIGHT, roundness=roundness))
        assert (fit.cost, fit.margin) == pytest.approx((cost, margin))
