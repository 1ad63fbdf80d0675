"""Known or unknown: the evidence of look and fit, the models, and how they are learnt."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from recorded_calls import recorded
from toy_completions import toy_completion
from toy_wedge import wedge_primitive

from gfp_grasp import openset as room
from gfp_grasp.detect import distance_in
from gfp_grasp.misfit import Misfit
from gfp_grasp.openset import (
    LogisticModel,
    evidence_of_fit,
    evidence_of_look,
    load_models,
    probability_by_look,
    probability_unknown,
)
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import TABLETOP, FittedPrimitive

PRIMITIVE = wedge_primitive()


def test_a_logistic_model_tells_the_probability() -> None:
    model = LogisticModel((2.0, -1.0), 0.5)
    assert model.probability((0.0, 0.5)) == 0.5
    assert model.probability((1.0, 0.0)) == pytest.approx(1 / (1 + np.exp(-2.5)))
    assert model.probability((1e6, 0.0)) == pytest.approx(1.0)


def test_a_look_is_doubtful_where_it_is_far_from_all_prototypes_and_the_classifier_unsure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = recorded(monkeypatch, "gfp_grasp.detect.distance_in", 0.045)
    recorded(monkeypatch, "gfp_grasp.openset.sureness", 0.8)
    detection = replace(toy_completion().detection, proposal=SimpleNamespace(embedding="embedding"))  # type: ignore[arg-type]
    evidence = evidence_of_look(detection, "library")  # type: ignore[arg-type]
    assert asked.only[0] == ("embedding", "library", TABLETOP)
    np.testing.assert_allclose(evidence, [np.log(0.05), np.log(0.2 / 0.8)])


def test_distance_in_a_library_is_that_of_the_nearest_prototype_of_all_its_classes() -> None:
    library = PrimitiveLibrary.shipped()
    embedding = np.asarray(library.primitive("mug").prototypes[3], dtype=float)
    assert distance_in(embedding, library) == pytest.approx(0.0, abs=1e-6)
    others = [library.primitive(name).prototypes @ embedding for name in library.names if not name.startswith("mug")]
    nearest = max(float(own.max()) for own in others)
    assert distance_in(embedding, library.without("mug")) == pytest.approx(1 - nearest, abs=1e-6)
    assert nearest < 0.999


def test_a_fit_is_doubtful_where_size_and_shape_are_odd_and_it_misses_what_was_seen() -> None:
    scale, coefficients = np.array([1.2, 0.9, 1.1]), np.array([1.0, -2.0, 0.5])
    fit = FittedPrimitive(PRIMITIVE, np.eye(4), scale, coefficients, 0.001)
    evidence = evidence_of_fit(fit, Misfit(0.02, 0.0, 0.09, 0.7))
    precision = np.linalg.inv(PRIMITIVE.log_scale_cov + 1e-4 * np.eye(3))
    odd_size = float(np.sqrt(np.log(scale) @ precision @ np.log(scale) / 3))
    np.testing.assert_allclose(evidence, [odd_size, 1.75**0.5, float(np.log(0.02)), 0.3, 0.0])
    exact = evidence_of_fit(
        replace(fit, scale=np.ones(3), coefficients=np.zeros(3), spread_m=np.zeros(len(PRIMITIVE.vertices))),
        Misfit(0.0, 0.0, 0.0, 0.0),
    )
    np.testing.assert_allclose(exact, [0.0, 0.0, np.log(0.003), 0.0, 1.0])


@pytest.fixture
def models(monkeypatch: pytest.MonkeyPatch) -> None:
    look, both = LogisticModel((1.0, 0.0), 0.0), LogisticModel((0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.5), 0.0)
    monkeypatch.setattr(room, "load_models", lambda: (look, both))


@pytest.mark.usefixtures("models")
def test_the_look_alone_tells_some() -> None:
    assert probability_by_look((np.log(9.0), 5.0)) == pytest.approx(0.9)


@pytest.mark.usefixtures("models")
def test_look_and_fit_together_tell_the_rest() -> None:
    assert probability_unknown((7.0, 2.0), (7.0, 7.0, 7.0, 0.5, 1.0)) == pytest.approx(1 / (1 + np.exp(-2.0)))


def test_the_shipped_models_doubt_more_the_farther_off_everything_is() -> None:
    look, both = load_models()
    near, far = (np.log(0.01), -4.0), (np.log(0.3), 1.0)
    assert look.probability(near) < 0.1 < 0.9 < look.probability(far)
    assert both.probability((*near, 0.7, 0.7, np.log(0.005), 0.0, 0.0)) < 0.1
    assert both.probability((*far, 3.0, 1.5, np.log(0.08), 0.3, 0.0)) > 0.9
