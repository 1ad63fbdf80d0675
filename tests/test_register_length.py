"""How far an object goes on behind what hides an end of it: which end, and the mean of all lengths."""

from dataclasses import replace

import numpy as np
import pytest
from toy_primitive import toy_cup_primitive
from toy_wedge import toy_evidence, wedge_primitive, wedge_state

from gfp_grasp.register import FitConfig, PoseShape, RefineConfig
from gfp_grasp.register import length as room
from gfp_grasp.register.length import LengthTerm, hidden_end, settle_length
from gfp_grasp.register.posterior import NormalEquations, StateSurface, shape_model
from gfp_grasp.register.state import StateBatch, surface_samples
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import LevelView

PRIMITIVE = toy_cup_primitive()
EYE = np.array([0.6, 0.0, 0.3])
LIGHT = RefineConfig(num_points=200, num_samples=600, num_modes=5)
CONFIG = FitConfig(middle=LIGHT, thorough=replace(LIGHT, steps=(0.042, 0.031)))


def upright(**changes: object) -> PoseShape:
    values: dict[str, object] = {
        "R": rotation_about((0, 0, 1), 0.4),
        "t": np.zeros(3),
        "log_scale": np.zeros(3),
        "coefficients": np.zeros(len(PRIMITIVE.modes)),
        "axis_world": np.array([0.0, 0.0, 1.0]),
        "axis_sigma_rad": 0.1,
        "hypothesis": "upright",
    }
    return PoseShape(**{**values, **changes})  # type: ignore[arg-type]


def seen_below(height_m: float) -> LevelView:
    """What of the mean cup faces the viewpoint below a level edge of an occluder, on a floor that was seen."""
    samples = surface_samples(PRIMITIVE, 3000)
    points = samples.local(np.zeros(len(PRIMITIVE.modes)))
    corners = PRIMITIVE.vertices[PRIMITIVE.faces[samples.face]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    outside = np.hypot(*points[:, :2].T) > 0.6 * np.hypot(*PRIMITIVE.vertices[:, :2].T).max()
    outside &= np.einsum("ni,ni->n", normals[:, :2], points[:, :2]) > 0
    seen = outside & (np.einsum("ni,ni->n", normals, EYE - points) > 0) & (points[:, 2] < height_m)
    down = np.array([0.0, 0.0, height_m]) - EYE
    cut = np.cross(np.array([0.0, 1.0, 0.0]), down)
    cut *= np.sign(cut[2]) / np.linalg.norm(cut)
    return toy_evidence(points[seen], normals[seen], viewpoint=EYE, cut=cut, sigma_m=0.001)


@pytest.mark.parametrize(
    ("cut", "end"),
    [((0.2, 0.0, 1.0), 1), ((0.2, 0.0, -1.0), -1), ((0.0, 1.0, 0.1), 0), ((0.0, 1.0, 0.75), 1), (None, 0)],
)
def test_an_end_is_hidden_where_the_way_behind_the_edge_is_mostly_along_the_upright_axis(cut, end: int) -> None:
    tall = replace(PRIMITIVE, vertices=PRIMITIVE.vertices * (1.0, 1.0, 2.0))
    cut = None if cut is None else np.array(cut) / np.linalg.norm(cut)
    evidence = toy_evidence(PRIMITIVE.vertices[::9], viewpoint=EYE, cut=cut)
    assert hidden_end(upright(), tall, evidence) == end
    assert hidden_end(upright(t=np.array([0.0, 0.0, 0.4])), tall, evidence) == end  # even where it ends before the edge


def test_a_length_that_is_held_pulls_on_the_scale_along_the_axis_alone() -> None:
    primitive, state = wedge_primitive(), wedge_state()
    model = shape_model(primitive, 60, 3)
    sums = NormalEquations(StateSurface(StateBatch.of([state, state], 3), model), 0.01)
    LengthTerm(np.array([0.1, 0.4])).add(sums)
    assert sums.g[0] == pytest.approx(0.0)
    assert sums.g[1, 8] == pytest.approx(1e4 * 0.3)
    assert np.count_nonzero(sums.g) == 1
    assert sums.H[0, 8, 8] == 1e4
    assert np.count_nonzero(sums.H) == 2
    assert sums.cost == pytest.approx(0.0)


def test_a_cup_whose_rim_is_hidden_is_about_as_tall_as_its_class_and_its_rim_is_unsure() -> None:
    tall = float(np.ptp(PRIMITIVE.vertices[:, 2]))
    evidence = seen_below(0.6 * tall)
    short = upright(log_scale=np.array([0.0, 0.0, -0.3]))
    settled, spread_m = settle_length(short, PRIMITIVE, evidence, CONFIG, end=1)
    height = np.exp(settled.log_scale[2]) * np.ptp(PRIMITIVE.shape(settled.coefficients, np.ones(3))[:, 2])
    assert 0.8 * tall < height < 1.05 * tall  # something hides more of what is longer, so it is rather shorter
    assert height > 1.1 * 0.74 * tall  # than the likeliest one was
    assert settled.cost == short.cost  # that of the likeliest one: rivals are compared by it
    world = settled.world(PRIMITIVE.shape(settled.coefficients, np.ones(3)))
    assert world[:, 2].min() == pytest.approx(0.0, abs=0.003)
    low, high = world[:, 2] < 0.2 * tall, world[:, 2] > 0.9 * height
    sigma = float(np.sqrt(PRIMITIVE.log_scale_cov[2, 2]))
    assert 0.3 * sigma * tall < np.median(spread_m[high]) < 1.2 * sigma * tall
    assert np.median(spread_m[low]) < 0.2 * np.median(spread_m[high])


def test_the_end_that_was_seen_stays_where_it_is_whatever_the_length() -> None:
    for end, seen in ((1, "min"), (-1, "max")):
        state = upright(t=np.array([0.01, -0.02, 0.3]), log_scale=np.array([0.1, 0.0, 0.2]))
        local = PRIMITIVE.shape(state.coefficients, np.ones(3))
        longer = room._stretched(state, PRIMITIVE, 0.5, end)
        assert longer.log_scale == pytest.approx([0.1, 0.0, 0.5])
        ends = [getattr(s.world(local)[:, 2], seen)() for s in (state, longer)]
        assert ends[1] == pytest.approx(ends[0], abs=1e-12)
        assert np.ptp(longer.world(local)[:, 2]) == pytest.approx(np.exp(0.3) * np.ptp(state.world(local)[:, 2]))
