"""What a start costs beyond the posterior, which starts go on, and which is the best in the end."""

from dataclasses import replace

import numpy as np
import pytest
from standing_wedge import LIGHT, half_seen_wedge, posed_mesh, standing_wedge, whole_view
from toy_primitive import toy_cup_primitive
from toy_wedge import UP, toy_evidence, wedge_primitive, wedge_state, with_viewpoint

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import FitDiverged
from gfp_grasp.register import RefineConfig, fit_best, icp_config, make_starts, pcrnet_config, pruning
from gfp_grasp.register.occlusion import blocking_cost, truncation_cost
from gfp_grasp.register.pruning import Search, distinct_leaders, search_starts, total_cost, within_margin
from gfp_grasp.transforms import rotation_about, rotation_between

# ---- what a state costs beyond the posterior


def _off_points(state, viewpoint, depths_m):
    """Points on lines of sight, each by its depth behind where the line first meets the surface."""
    rng = np.random.default_rng(2)
    mesh = posed_mesh(state, wedge_primitive())
    rays = mesh.vertices.mean(axis=0) + 0.01 * rng.normal(size=(len(depths_m), 3)) - viewpoint
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = cast_rays([(mesh.vertices, mesh.faces)], viewpoint, rays)[0]
    return viewpoint + (distance + depths_m)[:, None] * rays


def test_a_surface_pays_for_each_point_that_it_hides():
    state, config = wedge_state(), RefineConfig(unit_m=0.1, steps=(0.1, 0.05), misfit=0.02, effective_points=70)
    viewpoint = state.t + np.array([0.5, -0.4, 0.6])
    depths = np.repeat([0.0, -0.05, 0.008, 0.02], [10, 10, 10, 20])
    evidence = toy_evidence(_off_points(state, viewpoint, depths), viewpoint=viewpoint)
    cost = blocking_cost(state, wedge_primitive(), evidence, config)
    assert cost == pytest.approx(0.5 * 70 * 0.4 * 0.005**2 / (0.0013**2 + 0.002**2), rel=1e-9)
    assert blocking_cost(state, wedge_primitive(), with_viewpoint(evidence, None), config) == 0


@pytest.mark.parametrize(("beyond", "cost"), [(0.0, 30.0), (0.075, 15.0), (0.15, 0.0), (0.6, 0.0)])
def test_a_surface_that_ends_at_the_edge_of_what_hides_it_pays(beyond, cost):
    state, primitive = wedge_state(), wedge_primitive()
    vertices, cut = posed_mesh(state, primitive).vertices, np.array([0.6, -0.64, 0.48])
    along = np.sort(vertices @ cut)
    end = along[-1] + 0.001 if beyond == 0 else np.quantile(along, 1 - beyond)
    across = np.cross(cut, UP)
    viewpoint = end * cut + 3 * across
    evidence = toy_evidence(vertices[:20], viewpoint=viewpoint, cut=cut)
    assert truncation_cost(state, primitive, evidence) == pytest.approx(cost, abs=0.6)
    assert truncation_cost(state, primitive, replace(evidence, cut=None)) == 0


def test_hypotheses_pay_by_the_priors_of_the_class_and_those_it_never_has_are_left_out():
    truth = standing_wedge(rotation_between((0, 0, 1), UP))
    primitive = wedge_primitive()
    evidence = whole_view(truth, primitive, truth.t + np.array([2.0, 0.3, 1.0]))
    rests = {"upright": 0.5, "lying": 0.1}
    primitive = replace(primitive, spec=replace(primitive.spec, rests=rests))
    found = make_starts(primitive, evidence, ("upright", "upside_down", "lying"))
    costs = {state.hypothesis: total_cost(replace(state, cost=1.5)) for state in found}
    assert costs == pytest.approx({"upright": 1.5, "lying": 1.5 + np.log(5)}, abs=1e-5)
    # Where nothing else is asked for, the class may be mistaken.
    assert {state.hypothesis for state in make_starts(primitive, evidence, ("upside_down",))} == {"upside_down"}


# ---- which starts go on


def test_leaders_are_no_place_twice_and_hold_the_best_of_every_hypothesis():
    base = wedge_state(cost=1.0)
    here = replace(base, cost=2.0, t=base.t + np.array([0.002, 0, 0]))
    there = replace(base, cost=3.0, t=base.t + np.array([0.004, 0, 0]))
    turned = replace(base, cost=4.0, R=base.R @ rotation_about((0, 0, 1), 0.2))
    flipped = replace(base, cost=5.0, hypothesis="upside_down")
    worse = replace(base, cost=6.0, hypothesis="upside_down", t=base.t + 0.1)
    lying = replace(base, cost=7.0, hypothesis="lying")
    states = [base, here, there, turned, flipped, worse, lying]
    for keep, costs in ((1, [1, 5, 7]), (2, [1, 3, 5, 7]), (3, [1, 3, 4, 5, 7]), (9, [1, 3, 4, 5, 6, 7])):
        assert sorted(state.cost for state in distinct_leaders(states, keep, 0.1)) == costs


def test_a_rival_goes_on_while_it_is_no_farther_behind_than_it_may_be():
    searches = [
        Search(wedge_primitive(), odds, [wedge_state(cost=cost, rest_cost=rare)])
        for cost, odds, rare in (
            (9.0, 0.0, 0.0),
            (2.0, 1.0, 4.0),
            (7.0, 10.0, 0.0),
            (11.0, 6.1, 0.0),
        )
    ]
    assert [r.cost for r in searches] == pytest.approx([9.0, 7.0, 17.0, 17.1])
    assert within_margin(searches, 10.0) == searches[:3]
    assert within_margin(searches, 1.0) == [searches[1]]
    poor = [Search(wedge_primitive(), 0.0, [wedge_state(cost=cost, rest_cost=0.0)]) for cost in (1001.0, 800.0, 999.0)]
    assert within_margin(poor, 10.0) == poor[1:]  # a quarter of the least cost


def test_the_truth_is_found_among_the_starts_of_a_wedge():
    truth, evidence = half_seen_wedge()
    primitive = wedge_primitive()
    fit = fit_best(evidence, [(primitive, 0.0)], config=LIGHT)
    assert fit.hypothesis == "upright"
    expected = posed_mesh(truth, primitive).vertices
    assert np.linalg.norm(fit.vertices_world() - expected, axis=1).mean() < 0.006
    assert fit.residual_m < 0.001


@pytest.mark.parametrize("better", [0, 1])
def test_the_better_of_two_rivals_is_chosen_whichever_comes_first(better):
    _, evidence = half_seen_wedge()
    wedge, cup = wedge_primitive(), toy_cup_primitive()
    config = replace(LIGHT, hypotheses=("upright",), rival_margin=1e9, rival_margin_quick=1e9)
    rivals = [(wedge, 0.0), (cup, 0.0)] if better == 0 else [(cup, 0.0), (wedge, 0.0)]
    assert fit_best(evidence, rivals, config=config).primitive is wedge
    # Odds decide between equals; the cost of the fit is that of the points and the class alone.
    twin = replace(wedge, category="twin", spec=None)
    likely, rare = (wedge, 1.0), (twin, 3.0)
    fit = fit_best(evidence, [likely, rare] if better == 0 else [rare, likely], config=config)
    assert fit.primitive is wedge
    assert fit.cost == pytest.approx(fit_best(evidence, [(wedge, 0.0)], config=config).cost)


def test_the_margin_is_the_cost_of_the_best_other_hypothesis_over_the_best():
    _, evidence = half_seen_wedge()
    found = search_starts(evidence, [(wedge_primitive(), 0.0)], LIGHT)
    assert {state.hypothesis for state in found.states} == {"upright", "upside_down", "lying"}
    assert found.best.hypothesis == "upright"
    by_cost = sorted(found.states, key=total_cost)
    other = next(state for state in by_cost if state.hypothesis != "upright")
    fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=LIGHT)
    assert fit.margin == pytest.approx(total_cost(other) / total_cost(found.best))
    assert fit.margin > 1.5
    assert fit.cost == pytest.approx(total_cost(found.best))
    alone = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(LIGHT, hypotheses=("upright",)))
    assert alone.margin == float("inf")


def test_starts_that_fall_behind_get_no_more_steps_but_are_kept(monkeypatch):
    _, evidence = half_seen_wedge()
    counts = []
    refine = pruning.refine

    def counting(states, primitive, evidence, config):
        counts.append((len(config.steps), len(states)))
        return refine(states, primitive, evidence, config)

    monkeypatch.setattr(pruning, "refine", counting)
    found = search_starts(evidence, [(wedge_primitive(), 0.0)], replace(LIGHT, kept_share=0.25, prune_margin=0.0))
    # Two of the quick steps for 8 + 8 + 6 starts; the other two for a quarter of them, with one of each hypothesis.
    (head, tail, middle, thorough) = counts
    assert head == (2, 22)
    assert tail[0] == 2
    assert 5 <= tail[1] <= 7
    assert middle[0] == 3
    assert 1 <= middle[1] <= 4
    assert thorough == (2, 1)
    assert len(found.states) >= 3
    counts.clear()
    everything = replace(LIGHT, kept_share=1.0, prune_margin=1e9, hypotheses=("upright",), num_kept=8)
    monkeypatch.setattr(pruning, "_ABANDON_MARGIN", 1e9)
    search_starts(evidence, [(wedge_primitive(), 0.0)], everything)
    assert counts[0] == (2, 8)
    assert counts[2][1] == counts[3][1] > 1


def test_a_size_given_is_that_of_every_start_and_no_refinement_leaves_it():
    _, evidence = half_seen_wedge()
    size = (1.1, 0.9, 1.2)
    for config in (icp_config(size=size), replace(LIGHT, size=size, refine=False)):
        fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(config, hypotheses=("upright",)))
        assert fit.scale == pytest.approx(size)
        assert not fit.coefficients.any()
    assert pcrnet_config(size=size).start == "pcrnet"
    assert not pcrnet_config().refine
    assert icp_config().refine


def test_points_that_no_start_explains_diverge_by_the_name_of_the_class_and_the_miss():
    _, evidence = half_seen_wedge()
    config = replace(LIGHT, max_residual=1e-5, hypotheses=("upright",))
    with pytest.raises(FitDiverged, match=r"wedge: .* \d\.\d mm, 0 mm is allowed"):
        fit_best(evidence, [(wedge_primitive(), 0.0)], config=config)


def test_what_a_surface_hides_and_where_it_ends_counts_in_the_end(monkeypatch):
    _, evidence = half_seen_wedge()
    costs = []
    for blocking, truncation in ((0.0, 0.0), (3.0, 0.0), (3.0, 7.0)):
        monkeypatch.setattr(pruning, "blocking_cost", lambda *_, blocking=blocking: blocking)
        monkeypatch.setattr(pruning, "truncation_cost", lambda *_, truncation=truncation: truncation)
        config = replace(LIGHT, hypotheses=("upright",))
        costs.append(search_starts(evidence, [(wedge_primitive(), 0.0)], config).cost)
    assert np.diff(costs) == pytest.approx([3.0, 7.0])
