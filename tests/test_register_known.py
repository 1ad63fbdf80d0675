"""Registration to the number: its options, its starts, what it takes for hidden, and where fits of toys end."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from moments import assert_known
from toy_primitive import random_cup, see, toy_cup_primitive
from toy_wedge import toy_evidence, wedge_primitive, wedge_state

from gfp_grasp.errors import InvalidOption
from gfp_grasp.level import guessed_silhouette, make_level_view
from gfp_grasp.register import (
    FitConfig,
    PCRNet,
    RefineConfig,
    fit_primitive,
    icp_config,
    make_starts,
    network_input,
    pcrnet_config,
    size_of_extents,
)
from gfp_grasp.register.fit import try_circular
from gfp_grasp.register.occlusion import EDGES, _straight_edge, cut_off
from gfp_grasp.register.posterior import shape_model
from gfp_grasp.register.refine import evaluate_states, refine
from gfp_grasp.register.starts import _frame
from gfp_grasp.register.state import surface_samples
from gfp_grasp.register.terms import circular_share, ellipticity_gram
from gfp_grasp.types import TABLETOP, LevelView

REFINE = {
    "unit_m": None,
    "effective_points": 150.0,
    "misfit": 0.0104,
    "tangential": 0.05,
    "silhouette": (0.021, 0.042),
    "scale_slack": 1.5,
    "estimate_scale": True,
    "estimate_modes": True,
    "free_space": True,
    "support": True,
    "ellipticity": None,
    "num_points": 400,
    "num_samples": 1500,
    "num_modes": 24,
}
STEPS = (0.104, 0.073, 0.052, 0.042, 0.042, 0.031, 0.031, 0.031)
QUICK = {"steps": (0.208, 0.156, 0.104, 0.083, 0.0625), "num_points": 100, "num_samples": 400, "num_modes": 5}
MIDDLE = {"steps": (0.156, 0.104, 0.073, 0.052, 0.042), "num_points": 250, "num_samples": 1000}


def test_options_are_those_that_the_committed_figures_were_measured_with() -> None:
    assert asdict(RefineConfig()) == {**REFINE, "steps": STEPS}
    assert asdict(FitConfig()) == {
        "start": "proposal",
        "hypotheses": ("upright", "upside_down", "lying"),
        "quick": {**REFINE, **QUICK},
        "middle": {**REFINE, **MIDDLE},
        "thorough": {**REFINE, "steps": (0.042, 0.031, 0.031)},
        "kept_share": 0.4,
        "num_kept": 3,
        "prune_margin": 15.0,
        "rival_margin": 50.0,
        "rival_margin_quick": 25.0,
        "occlusion": True,
        "roundness": True,
        "size": None,
        "refine": True,
        "max_residual": 0.52,
    }


def test_icp_is_rigid_and_pcrnet_alone_is_not_refined() -> None:
    rigid = RefineConfig(estimate_scale=False, estimate_modes=False, free_space=False)
    icp, config = icp_config(size=(1.0, 1.1, 0.9)), FitConfig()
    assert icp == replace(
        config,
        start="box",
        roundness=False,
        size=(1.0, 1.1, 0.9),
        num_kept=1,
        quick=replace(rigid, steps=config.quick.steps),
        middle=replace(rigid, steps=config.middle.steps),
        thorough=replace(rigid, steps=config.thorough.steps),
    )
    ones = (1.0, 1.0, 1.0)
    assert pcrnet_config() == FitConfig(start="pcrnet", roundness=False, size=ones, refine=False, thorough=rigid)
    assert icp_config().size == ones
    assert FitConfig().with_unit(0.2).middle == replace(FitConfig().middle, unit_m=0.2)


def test_the_size_of_extents_is_the_height_and_the_mean_width() -> None:
    primitive = toy_cup_primitive()
    own = np.ptp(primitive.vertices, axis=0)
    wide = 0.08 / own[:2].mean()
    assert size_of_extents(primitive, np.array([0.06, 0.1, 0.02])) == pytest.approx((wide, wide, 0.02 / own[2]))


@pytest.mark.parametrize(
    "nonsense",
    [{"kept_share": 0.0}, {"kept_share": 1.1}, {"num_kept": 0}, {"size": (1.0, 1.0)}, {"size": (1.0, 0.0, 1.0)},
     {"prune_margin": -1.0}, {"rival_margin": -1.0}, {"rival_margin_quick": -1.0}, {"hypotheses": ()},
     {"hypotheses": ("afloat",)}, {"start": "icp"}],
)  # fmt: skip
def test_a_fit_that_cannot_be_is_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        FitConfig(**nonsense)


@pytest.mark.parametrize(
    "edge",
    [{"kept_share": 1.0}, {"num_kept": 1}, {"prune_margin": 0.0}, {"rival_margin": 0.0}, {"rival_margin_quick": 0.0}],
)
def test_a_fit_at_the_edge_of_what_can_be_is_one(edge: dict) -> None:
    assert FitConfig(**edge)


@pytest.mark.parametrize(
    "nonsense",
    [{"steps": ()}, {"steps": (0.1, 0.0)}, {"misfit": 0.0}, {"silhouette": (0.0, 1.0)}, {"scale_slack": 0.0},
     {"ellipticity": 0.0}, {"num_points": 19}, {"num_samples": 19}, {"num_modes": 0}, {"unit_m": 0.0},
     {"effective_points": 0.0}],
)  # fmt: skip
def test_a_refinement_that_cannot_be_is_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        RefineConfig(**nonsense)
    assert RefineConfig(num_points=20, num_samples=20, num_modes=1)


@pytest.fixture(scope="module")
def cup_view() -> LevelView:
    """A cup seen from one side, without its picture."""
    return make_level_view(see(random_cup(np.random.default_rng(2)), 5)[1])


def _numbers(states) -> np.ndarray:
    return np.array([[*s.R.ravel(), *s.t, *s.log_scale, s.axis_sigma_rad, s.rest_cost] for s in states])


def test_starts_stand_and_lie_where_they_have_been(cup_view: LevelView) -> None:
    for name, primitive in (("cup", toy_cup_primitive()), ("wedge", wedge_primitive())):
        states = make_starts(primitive, cup_view, ("upright", "upside_down", "lying"))
        assert_known(f"starts {name}", _numbers(states))
        straight = replace(cup_view, cloud=replace(cup_view.cloud, viewpoint=None))
        assert_known(f"starts {name} unseen", _numbers(make_starts(primitive, straight, ("upright", "lying"))))


def test_a_frame_faces_as_nearly_as_its_axis_lets_it() -> None:
    R = _frame(np.array([0.0, 0.6, 0.8]), np.array([0.3, 0.5, 0.1]))
    np.testing.assert_allclose(R[:, 2], [0.0, 0.6, 0.8])
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, 1] @ [0.3, 0.5, 0.1] == pytest.approx(0.0, abs=1e-12)
    assert R[:, 0] @ [0.3, 0.5, 0.1] > 0


def test_samples_of_the_surface_are_those_of_old() -> None:
    primitive = wedge_primitive()
    samples = surface_samples(primitive)
    assert len(samples.mean) == 1500
    assert_known("surface samples", np.hstack([samples.local(np.array([0.5, -0.2, 0.1])), samples.weights]))
    assert_known("surface faces", samples.face)
    assert primitive.size_m == pytest.approx(float(np.cbrt(np.ptp(primitive.vertices, axis=0).prod())))
    flat = replace(primitive, vertices=primitive.vertices * [1, 1, 1e-3])
    assert_known("size of what is flat", [flat.size_m])


def test_a_shape_model_and_its_ellipticity_are_those_of_old() -> None:
    for name, primitive in (("cup", toy_cup_primitive()), ("wedge", wedge_primitive())):
        model = shape_model(primitive, 300, 2)
        for part in ("mean", "flat_modes", "point_modes", "edges", "edge_modes", "scale_precision", "scale_sigma"):
            assert_known(f"shape model of a {name}: {part}", getattr(model, part), rel=1e-4)
        assert_known(f"ellipticity of a {name}", ellipticity_gram(primitive), rel=1e-4)
        assert_known(f"circular share of a {name}", [circular_share(primitive, limit) for limit in (1e-3, 0.01, 0.02)])


def test_refinements_end_where_they_have_ended(cup_view: LevelView) -> None:
    primitive = toy_cup_primitive()
    states = make_starts(primitive, cup_view, ("upright", "lying"))
    config = RefineConfig(steps=(0.1, 0.05), num_points=150, num_samples=300, num_modes=3)
    for name, own in (
        ("whole", config),
        ("round", replace(config, ellipticity=0.01, num_modes=5)),
        ("rigid", replace(config, estimate_scale=False, estimate_modes=False, support=False, free_space=False)),
    ):
        found = refine(states, primitive, cup_view, own)
        assert_known(f"refined {name}", _numbers(found), rel=1e-4)
        assert_known(f"refined {name} modes", [state.coefficients for state in found], rel=1e-4)
        assert_known(f"refined {name} costs", [[state.cost, state.residual_m] for state in found], rel=1e-4)
    assert_known("evaluated", [[s.cost, s.residual_m] for s in evaluate_states(states, primitive, cup_view, config)])


def test_fits_of_a_cup_end_where_they_have_ended() -> None:
    detection = see(random_cup(np.random.default_rng(2)), 5)[1]
    fit = fit_primitive(detection, toy_cup_primitive(), config=FitConfig(hypotheses=("upright", "lying")))
    found = [*fit.T_world_object.ravel(), *fit.scale, *fit.coefficients, fit.residual_m, fit.margin]
    assert fit.hypothesis == "upright"
    assert_known("fit of a cup", found, rel=1e-3)


def test_a_round_body_is_tried_as_ever(cup_view: LevelView) -> None:
    primitive, config = toy_cup_primitive(), FitConfig()
    states = refine(make_starts(primitive, cup_view, ("upright",)), primitive, cup_view, config.middle)
    tried = try_circular(states[0], primitive, cup_view, config)
    assert_known("try circular", [*_numbers([tried]).ravel(), tried.cost, *tried.coefficients], rel=1e-4)


def _hidden() -> LevelView:
    """A plate seen from the front, whose right half lies behind something with a straight edge."""
    y, z = np.meshgrid(np.linspace(-0.05, 0.01, 40), np.linspace(0.0, 0.1, 60))
    points = np.column_stack([0.02 * np.cos(20 * y).ravel(), y.ravel(), z.ravel()])
    normals = np.tile([1.0, 0.0, 0.0], (len(points), 1))
    viewpoint = np.array([0.6, 0.0, 0.2])
    view = toy_evidence(points, normals, viewpoint=viewpoint, floor_seen=False)
    return replace(view, silhouette=guessed_silhouette(points, viewpoint, TABLETOP))


def test_what_hides_a_half_is_found_as_ever() -> None:
    view = _hidden()
    for straight in (True, False):
        found = cut_off(view, edge="clear" if straight else None)
        assert found.silhouette is not None
        assert_known(f"cut off {straight}: free", found.silhouette.free_range_m > 0)
        assert_known(f"cut off {straight}: floor", np.minimum(found.floor_sigma_m, 9.0))
        assert (found.cut is not None) == straight
        if found.cut is not None:
            assert_known("cut off", found.cut, rel=1e-4)


@pytest.mark.parametrize(("count", "is_edge"), [(7, False), (8, True)])
def test_an_edge_is_eight_pixels_long_at_least(count: int, is_edge: bool) -> None:
    outline = np.column_stack([np.arange(count), 2 * np.arange(count)])
    found = _straight_edge(outline, np.ones(count, dtype=bool), EDGES["clear"])
    assert (found is not None) == is_edge
    if found is not None:
        assert np.abs(found[0] @ [1.0, 2.0]) < 1e-9
        assert _straight_edge(outline, np.arange(count) > 0, EDGES["clear"]) is None


def test_the_network_of_pcrnet_is_the_papers_and_is_given_unit_clouds(cup_view: LevelView) -> None:
    sizes = [tuple(p.shape) for p in PCRNet().parameters()]
    assert sizes[:10:2] == [(64, 3), (64, 64), (64, 64), (128, 64), (1024, 128)]
    assert sizes[10::2] == [(1024, 2048), (512, 1024), (256, 512), (7, 256)]
    primitive = wedge_primitive()
    template, cloud, centre, radius = network_input(wedge_state(), primitive, cup_view.points)
    assert template.shape == cloud.shape == (128, 3)
    assert float((template**2).sum(axis=1).mean()) == pytest.approx(1.0)
    assert_known("network input", [*template.ravel(), *cloud.ravel(), *centre, radius], rel=1e-4)
