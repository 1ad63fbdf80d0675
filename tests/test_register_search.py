"""Where the fit starts, which starts go on, and what is chosen in the end."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from toy_primitive import toy_cup_primitive
from toy_wedge import UP, face_normals, positions, toy_evidence, wedge_primitive, wedge_state, with_viewpoint

from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import FitDiverged
from gfp_grasp.level import guessed_silhouette
from gfp_grasp.meshes import sample_surface
from gfp_grasp.register import (
    FitConfig,
    RefineConfig,
    fit_best,
    icp_config,
    pcrnet,
    pcrnet_config,
    pruning,
)
from gfp_grasp.register import fit as fit_module
from gfp_grasp.register.occlusion import blocking_cost, truncation_cost
from gfp_grasp.register.pruning import Search, distinct_leaders, search_starts, total_cost, within_margin
from gfp_grasp.register.starts import _complete_ends, _cosine_in_picture, make_starts
from gfp_grasp.transforms import rotation_about, rotation_between
from gfp_grasp.types import TABLETOP, PointCloud, Symmetry

QUICK = RefineConfig(steps=(0.2, 0.15, 0.1, 0.08), num_points=100, num_samples=300)
LIGHT = FitConfig(
    quick=QUICK,
    middle=replace(QUICK, steps=(0.08, 0.06, 0.05)),
    thorough=replace(QUICK, steps=(0.04, 0.03), num_points=200),
    num_kept=2,
    roundness=False,
)


def _surface(state, primitive, count=4000):
    """Points (n, 3) of a posed primitive's whole surface, and their normals."""
    return sample_surface(_mesh(state, primitive), count, np.random.default_rng(1))[:2]


def _mesh(state, primitive):
    import trimesh

    vertices = state.world(primitive.shape(state.coefficients, np.ones(3)))
    return trimesh.Trimesh(vertices, primitive.faces, process=False)


def _wedge_standing(R: np.ndarray, **changes):
    return wedge_state(R=R, axis_world=R[:, 2], log_scale=np.zeros(3), coefficients=np.zeros(3), **changes)


def _evidence_of(state, primitive, viewpoint, **changes):
    points, normals = _surface(state, primitive)
    lowest = float((points @ UP).min())
    return toy_evidence(points, normals, viewpoint=viewpoint, **{"floor_m": lowest, **changes})


# ---- starts


@pytest.mark.parametrize("hypothesis", ["upright", "upside_down"])
def test_a_standing_start_is_the_truth_where_the_whole_surface_is_seen(hypothesis):
    axis = UP if hypothesis == "upright" else -UP
    R = rotation_between((0, 0, 1), axis) @ rotation_about((0, 0, 1), 0.8)
    truth, primitive = _wedge_standing(R), wedge_primitive()
    evidence = _evidence_of(truth, primitive, truth.t + 2 * R[:, 0] + UP)
    found = make_starts(primitive, evidence, (hypothesis,))
    assert len(found) == 8
    best = min(found, key=lambda state: np.abs(state.R - R).max())
    # The direction to the viewer is taken from the middle of the points, a few centimetres off the axis.
    assert np.abs(best.R - R).max() < 0.03
    assert np.abs(best.t - truth.t).max() < 0.003
    assert np.abs(best.log_scale).max() < 0.06
    assert not best.coefficients.any()
    turns = sorted(Rotation.from_matrix(best.R.T @ state.R).as_rotvec()[2] for state in found)
    assert np.diff(turns) == pytest.approx(np.pi / 4)
    for state in found:
        assert state.R[:, 2] == pytest.approx(axis)
        assert state.axis_world == pytest.approx(axis)
        assert state.axis_sigma_rad == pytest.approx(np.deg2rad(1))
        assert state.hypothesis == hypothesis


def test_a_standing_start_reaches_down_to_the_floor():
    R = rotation_between((0, 0, 1), UP)
    truth, primitive = _wedge_standing(R), wedge_primitive()
    evidence = _evidence_of(truth, primitive, truth.t + 2 * R[:, 0])
    lower = replace(evidence, floor_m=evidence.floor_m - 0.01)
    for hypothesis in ("upright", "upside_down"):
        for near, far in zip(*(make_starts(primitive, e, (hypothesis,)) for e in (evidence, lower)), strict=True):
            ends = [np.quantile(_mesh(state, primitive).vertices @ UP, (0, 1)) for state in (near, far)]
            assert ends[0][0] == pytest.approx(evidence.floor_m, abs=0.001)
            assert ends[1][0] == pytest.approx(evidence.floor_m - 0.01, abs=0.001)
            assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-6)


def test_the_near_side_of_a_start_is_the_near_side_of_the_points():
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    truth, primitive = _wedge_standing(R), wedge_primitive()
    whole = _evidence_of(truth, primitive, truth.t + 2 * R[:, 0])
    half = whole.points @ R[:, 0] > np.median(whole.points @ R[:, 0])
    evidence = replace(whole, points=whole.points[half], normals=whole.normals[half])
    bound = 2 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    found = [s for s in make_starts(primitive, evidence, ("upright",)) if (np.abs(s.log_scale) < bound - 1e-9).all()]
    assert len(found) >= 2
    for state in found:
        nearest = float((_mesh(state, primitive).vertices @ R[:, 0]).max())
        assert nearest == pytest.approx(float((whole.points @ R[:, 0]).max()), abs=0.004)


def test_a_lying_start_is_the_truth_of_a_long_body():
    # The wedge's z is made its longest side, and it lies with x up.
    flat = np.cross(UP, (0.4, 1.0, 0.2))
    axis = flat / np.linalg.norm(flat)
    R = np.column_stack([UP, np.cross(axis, UP), axis])
    primitive = wedge_primitive()
    longer = replace(primitive, vertices=primitive.vertices * (0.5, 0.5, 4.0), modes=primitive.modes * 0.1)
    truth = replace(_wedge_standing(R))
    evidence = _evidence_of(truth, longer, truth.t + 2 * np.cross(axis, UP) + UP)
    found = make_starts(longer, evidence, ("lying",))[:4]
    best = min(found, key=lambda state: np.abs(state.R - R).max())
    assert np.abs(best.R - R).max() < 0.1
    assert np.abs(best.t - truth.t).max() < 0.02
    assert np.abs(best.log_scale).max() < 0.1
    heights = _mesh(best, longer).vertices @ UP
    assert heights.min() == pytest.approx(evidence.floor_m, abs=1e-6)
    assert heights.max() == pytest.approx(float((evidence.points @ UP).max()), abs=0.004)
    assert best.axis_sigma_rad == pytest.approx(np.deg2rad(15))
    directions = np.array([state.R[:, 2] for state in found])
    assert directions @ UP == pytest.approx(np.zeros(4), abs=1e-12)
    assert directions.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.sort(np.abs(directions @ axis)) == pytest.approx([0, 0, 1, 1], abs=0.1)


@pytest.mark.parametrize(("share", "num_flat"), [(1.8, 2), (1.1, 0)])
def test_a_body_that_lies_wider_than_high_has_flat_starts_too(share, num_flat):
    flat = np.cross(UP, (0.4, 1.0, 0.2))
    axis = flat / np.linalg.norm(flat)
    R = np.column_stack([UP, np.cross(axis, UP), axis])
    primitive = wedge_primitive()
    extent = np.ptp(primitive.vertices, axis=0)
    # It lies with x up; y is made wider than x, and z much longer than both.
    stretch = np.array([1.0, share * extent[0] / extent[1], 4 * extent[0] / extent[2]])
    spread = 0.3 * np.eye(3)  # a class whose members differ as much as that
    longer = replace(primitive, vertices=primitive.vertices * stretch, log_scale_cov=spread)
    truth = replace(_wedge_standing(R))
    evidence = _evidence_of(truth, longer, truth.t + 2 * np.cross(axis, UP) + UP)
    found = make_starts(longer, evidence, ("lying",))
    # Across the long side the points are wider than high in any case.
    along = [state for state in found[4:] if abs(state.R[:, 2] @ axis) > 0.9]
    assert (len(along), len(found)) == (num_flat, 6 + num_flat)
    for state in along:
        own, seen = _mesh(state, longer).vertices @ state.R, evidence.points @ state.R
        assert state.R[:, 0] == pytest.approx(UP, abs=1e-9)
        assert np.ptp(own, axis=0) == pytest.approx(np.ptp(seen, axis=0), rel=0.05)
        assert own.max(axis=0) == pytest.approx(seen.max(axis=0), abs=0.01)
    for state in found[:4]:
        assert state.log_scale[0] == state.log_scale[1]


@pytest.mark.parametrize(
    ("order", "turns_deg"),
    [(np.inf, [0, 45]), (2, [0, 60, 120]), (4, [0, 30, 60]), (1, [0, 45, 90, 135, 180, 225, 270, 315])],
)
def test_starts_are_turned_by_what_the_symmetry_does_not_hide(order, turns_deg):
    primitive = replace(wedge_primitive(), symmetry=Symmetry(np.array([0.0, 0, 1]), order))
    truth = _wedge_standing(rotation_between((0, 0, 1), UP))
    evidence = _evidence_of(truth, primitive, truth.t + np.array([2.0, 0.3, 1.0]))
    found = make_starts(primitive, evidence, ("upright",))
    turned = [Rotation.from_matrix(found[0].R.T @ state.R).as_rotvec(degrees=True)[2] % 360 for state in found]
    assert turned == pytest.approx(turns_deg, abs=1e-6)


def test_a_start_is_no_larger_or_smaller_than_twice_the_spread_of_the_class():
    primitive = wedge_primitive()
    truth = _wedge_standing(rotation_between((0, 0, 1), UP))
    huge = replace(truth, log_scale=np.full(3, 2.0))
    bound = 2 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    for state, sign in ((huge, 1), (replace(truth, log_scale=np.full(3, -2.0)), -1)):
        for start in make_starts(primitive, _evidence_of(state, primitive, truth.t + 9.0), ("upright",)):
            assert start.log_scale == pytest.approx(sign * bound)


def test_seen_from_straight_above_the_shortest_side_of_the_points_faces_the_viewer():
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    primitive = wedge_primitive()
    truth = _wedge_standing(R)
    points, normals = _surface(truth, primitive)
    for viewpoint in (None, points.mean(axis=0) + 2.0 * UP):
        view = toy_evidence(points, normals, viewpoint=viewpoint, oriented=viewpoint is not None)
        state = make_starts(primitive, view, ("upright",))[0]
        assert state.R[:, 2] == pytest.approx(UP)
        assert abs(state.R[:, 0] @ R[:, 1]) > 0.95  # the wedge is 12 cm along x and 8 along y


@pytest.mark.parametrize(
    ("up", "across", "height", "width"),
    [
        (0.1, 0.2, (0.0, 1.0), (-0.5, 0.5)),
        (0.9, 0.0, (0.0, 2.0), (-0.5, 0.5)),  # as high as it is wide, by the primitive's proportions
        (-0.9, 0.0, (-1.0, 1.0), (-0.5, 0.5)),
        (0.0, 0.6, (0.0, 1.0), (-0.5, 0.75)),
        (0.0, -0.6, (0.0, 1.0), (-0.75, 0.5)),
        (0.6, -0.6, (0.0, 2.0), (-2.0, 0.5)),  # nothing but the primitive's own size is known
    ],
)
def test_an_end_that_is_hidden_goes_on_to_the_proportions_of_the_primitive(up, across, height, width):
    own_height, own_width = 2.0, 2.5 if up and across and abs(up) > 0.5 and abs(across) > 0.5 else 1.0
    if abs(across) > 0.5 and abs(up) < 0.5:
        own_height, own_width = 0.8, 1.0
    found = _complete_ends((0.0, 1.0), own_height, up, (-0.5, 0.5), own_width, across)
    assert found[0] == pytest.approx(height)
    assert found[1] == pytest.approx(width)


def test_what_is_cut_off_was_never_seen_whole():
    """The primitive is shorter than what was seen: a seventh of the object is hidden all the same."""
    assert _complete_ends((0.0, 1.7), 1.0, 0.9, (-0.5, 0.5), 1.0, 0.0) == ((0.0, pytest.approx(2.0)), (-0.5, 0.5))


def test_a_start_of_what_is_cut_off_goes_on_beyond_the_cut_and_only_there():
    R = rotation_between((0, 0, 1), UP)
    truth, primitive = _wedge_standing(R), wedge_primitive()
    viewpoint = truth.t + 2 * R[:, 0]
    whole = _evidence_of(truth, primitive, viewpoint)
    aside = whole.points @ R[:, 1]
    for sign in (1, -1):
        seen = sign * aside < np.median(sign * aside)
        half = replace(whole, points=whole.points[seen], normals=whole.normals[seen])
        tilted = sign * (R[:, 1] + 0.1 * UP)
        cut = replace(half, cut=tilted / np.linalg.norm(tilted))
        state = make_starts(primitive, cut, ("upright",))[0]
        found = np.quantile(_mesh(state, primitive).vertices @ R[:, 1], (0, 1))
        assert found == pytest.approx((aside.min(), aside.max()), abs=0.012)


# ---- what a state costs beyond the posterior


def _off_points(state, viewpoint, depths_m):
    """Points on lines of sight, each by its depth behind where the line first meets the surface."""
    rng = np.random.default_rng(2)
    mesh = _mesh(state, wedge_primitive())
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
    vertices, cut = _mesh(state, primitive).vertices, np.array([0.6, -0.64, 0.48])
    along = np.sort(vertices @ cut)
    end = along[-1] + 0.001 if beyond == 0 else np.quantile(along, 1 - beyond)
    across = np.cross(cut, UP)
    viewpoint = end * cut + 3 * across
    evidence = toy_evidence(vertices[:20], viewpoint=viewpoint, cut=cut)
    assert truncation_cost(state, primitive, evidence) == pytest.approx(cost, abs=0.6)
    assert truncation_cost(state, primitive, replace(evidence, cut=None)) == 0


def test_hypotheses_pay_by_the_priors_of_the_class_and_those_it_never_has_are_left_out():
    truth = _wedge_standing(rotation_between((0, 0, 1), UP))
    primitive = wedge_primitive()
    evidence = _evidence_of(truth, primitive, truth.t + np.array([2.0, 0.3, 1.0]))
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


def _half_seen_wedge():
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    truth = _wedge_standing(R)
    points, normals = _surface(truth, wedge_primitive(), 1500)
    viewpoint = truth.t + 2 * R[:, 0] + 0.7 * R[:, 1] + UP
    seen = np.einsum("ni,ni->n", normals, viewpoint - points) > 0
    lowest = float((points @ UP).min())
    return truth, toy_evidence(points[seen], normals[seen], viewpoint=viewpoint, floor_m=lowest, sigma_m=0.001)


def test_the_truth_is_found_among_the_starts_of_a_wedge():
    truth, evidence = _half_seen_wedge()
    primitive = wedge_primitive()
    fit = fit_best(evidence, [(primitive, 0.0)], config=LIGHT)
    assert fit.hypothesis == "upright"
    expected = _mesh(truth, primitive).vertices
    assert np.linalg.norm(fit.vertices_world() - expected, axis=1).mean() < 0.006
    assert fit.residual_m < 0.001


@pytest.mark.parametrize("better", [0, 1])
def test_the_better_of_two_rivals_is_chosen_whichever_comes_first(better):
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
    size = (1.1, 0.9, 1.2)
    for config in (icp_config(size=size), replace(LIGHT, size=size, refine=False)):
        fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(config, hypotheses=("upright",)))
        assert fit.scale == pytest.approx(size)
        assert not fit.coefficients.any()
    assert pcrnet_config(size=size).start == "pcrnet"
    assert not pcrnet_config().refine
    assert icp_config().refine


def test_points_that_no_start_explains_diverge_by_the_name_of_the_class_and_the_miss():
    _, evidence = _half_seen_wedge()
    config = replace(LIGHT, max_residual=1e-5, hypotheses=("upright",))
    with pytest.raises(FitDiverged, match=r"wedge: .* \d\.\d mm, 0 mm is allowed"):
        fit_best(evidence, [(wedge_primitive(), 0.0)], config=config)


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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
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


def test_what_a_surface_hides_and_where_it_ends_counts_in_the_end(monkeypatch):
    _, evidence = _half_seen_wedge()
    costs = []
    for blocking, truncation in ((0.0, 0.0), (3.0, 0.0), (3.0, 7.0)):
        monkeypatch.setattr(pruning, "blocking_cost", lambda *_, blocking=blocking: blocking)
        monkeypatch.setattr(pruning, "truncation_cost", lambda *_, truncation=truncation: truncation)
        config = replace(LIGHT, hypotheses=("upright",))
        costs.append(search_starts(evidence, [(wedge_primitive(), 0.0)], config).cost)
    assert np.diff(costs) == pytest.approx([3.0, 7.0])


def test_a_direction_is_compared_with_the_cut_as_it_is_seen():
    points = np.random.default_rng(0).normal(scale=0.01, size=(50, 3))
    points -= points.mean(axis=0)
    evidence = toy_evidence(points, viewpoint=np.array([2.0, 0, 0]), cut=np.array([0.0, 0.6, 0.8]))
    for direction, cosine in (((0.8, 0.6, 0.0), 0.6), ((-0.8, 0.6, 0.0), 0.6), ((0.6, 0.0, -0.8), -0.8)):
        assert _cosine_in_picture(evidence, np.array(direction)) == pytest.approx(cosine)


# ---- what is asked in the end


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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
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
    _, evidence = _half_seen_wedge()
    states = [wedge_state(cost=10.0), wedge_state(cost=10.5, hypothesis="lying")]
    monkeypatch.setattr(fit_module, "search_starts", lambda *_: Search(wedge_primitive(), 0.0, states))
    monkeypatch.setattr(fit_module, "try_circular", lambda state, *_: replace(state, cost=state.cost + 2))
    for roundness, cost, margin in ((True, 12.0, 1.0), (False, 10.0, 1.05)):
        fit = fit_best(evidence, [(wedge_primitive(), 0.0)], config=replace(LIGHT, roundness=roundness))
        assert (fit.cost, fit.margin) == pytest.approx((cost, margin))


# ---- PCRNet


def test_the_network_moves_starts_in_its_own_upright_unit_frame(monkeypatch):
    _, evidence = _half_seen_wedge()
    turn, shift, seen = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix(), np.array([0.2, -0.1, 0.05]), []

    def network(template, cloud):
        seen.extend([template.numpy(), cloud.numpy()])
        size = (len(template), 1, 1)
        return torch.tensor(turn, dtype=torch.float32).repeat(size), torch.tensor(shift).float().repeat(size[:2])

    monkeypatch.setattr(pcrnet, "load_pcrnet", lambda: network)
    states = make_starts(wedge_primitive(), evidence, ("upright",))[:2]
    moved = pcrnet.correct_starts(states, wedge_primitive(), evidence)
    template, cloud = seen
    assert template.shape == cloud.shape == (2, 128, 3)
    to_level = rotation_between(UP, (0, 0, 1))
    for i, (before, after) in enumerate(zip(states, moved, strict=True)):
        assert template[i].mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-5)
        assert (template[i] ** 2).sum(axis=1).mean() == pytest.approx(1, rel=1e-5)
        _, _, centre, radius = pcrnet.network_input(before, wedge_primitive(), evidence.points)
        # The cloud is there in the units of the template, and points of it are points that were seen.
        back = centre + radius * cloud[i].astype(np.float64) @ to_level
        assert KDTree(evidence.points).query(back)[0].max() < 1e-6
        # What the network does to the template there, it does to the start here.
        vertices = wedge_primitive().vertices[::50]
        there = ((before.world(vertices) - centre) / radius) @ to_level.T
        expected = centre + radius * (there @ turn.T + shift) @ to_level
        assert after.world(vertices) == pytest.approx(expected, abs=1e-5)
        assert np.array_equal(after.log_scale, before.log_scale)
    assert pcrnet.correct_starts([], wedge_primitive(), evidence) == []


def test_poses_of_all_iterations_are_put_together():
    network = pcrnet.PCRNet()
    pose = np.array([0.9, 0.1, -0.2, 0.3, 0.05, -0.04, 0.1])
    seen = []

    class Encoder(torch.nn.Module):
        def forward(self, points):
            seen.append(points.detach().numpy())
            return torch.zeros(1, points.shape[1], 1024)

    class Decoder(torch.nn.Module):
        def forward(self, code):
            return torch.tensor(pose, dtype=torch.float32)[None]

    network.encode, network.decode = Encoder(), Decoder()  # type: ignore[assignment]
    template = torch.tensor(np.random.default_rng(0).normal(size=(1, 7, 3)), dtype=torch.float32)
    R, t = network(template, template + 1, iterations=3)
    turn = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
    assert R[0].numpy() == pytest.approx(np.linalg.matrix_power(turn, 3), abs=1e-5)
    assert t[0].numpy() == pytest.approx(pose[4:] + turn @ pose[4:] + turn @ turn @ pose[4:], abs=1e-5)
    cloud, *moved = seen
    assert np.allclose(cloud, template.numpy() + 1)
    assert len(moved) == 3
    for before, after in pairwise(moved):
        assert after[0] == pytest.approx(before[0] @ turn.T + pose[4:], abs=1e-5)


def test_samples_of_the_normals_are_those_of_the_moved_faces():
    from gfp_grasp.register.posterior import StateSurface, shape_model
    from gfp_grasp.register.state import StateBatch

    state, primitive = wedge_state(), wedge_primitive()
    surface = StateSurface(StateBatch.of([state], 3), shape_model(primitive, 60, 3))
    assert surface.world[0] == pytest.approx(positions(state, primitive))
    assert surface.normals[0] == pytest.approx(face_normals(state, primitive), abs=1e-9)
