"""The answer to one object: by class where that holds, else of no class, else the hull; and who is asked when."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from recorded_calls import Recorder, recorded
from seen_wedge import body, seen, without_view
from toy_completions import toy_completion
from toy_primitive import toy_cup_primitive

from gfp_grasp import answers as room
from gfp_grasp.answers import Clock, CompleteConfig, answer, by_class
from gfp_grasp.errors import FitDiverged, NoSurface
from gfp_grasp.level import make_level_view
from gfp_grasp.misfit import Misfit
from gfp_grasp.transforms import invert_T, make_T
from gfp_grasp.types import CompletedShape, FittedPrimitive

FAULT = "60% of it lies where nothing was seen to be"
GOOD, BAD = Misfit(0.0, 0.0, 0.0, 0.0), Misfit(0.0, 0.0, 0.6, 0.0)


def fitted() -> FittedPrimitive:
    primitive = toy_cup_primitive()
    T = make_T(t=np.array([0.0, 0.2, 0.0]))
    return FittedPrimitive(primitive, T, np.ones(3), np.zeros(len(primitive.modes)), 0.001)


class Answers:
    """Stands for those who answer and those who judge: by class, class-free, hull; the look, the fit, the misfit."""

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        *,
        by_look: float = 0.05,
        unknown: float = 0.1,
        misfits: list[Misfit] | None = None,
        fits: bool = True,
        surface: bool = True,
        cut_off: bool = False,
    ) -> None:
        self.view, self.detection = "view", toy_completion(scores={"mug": 0.6, "cup": 0.4}).detection
        box = toy_completion().shape
        self.shapes = {
            "class": replace(box, fit=fitted(), made_by="primitive"),
            "classfree": replace(box, made_by="classfree"),
            "hull": replace(box, made_by="hull"),
        }
        self.evidence_of_look = recorded(patch, "gfp_grasp.answers.evidence_of_look", "look")
        self.evidence_of_fit = recorded(patch, "gfp_grasp.answers.evidence_of_fit", "fit")
        self.cut_off = recorded(patch, "gfp_grasp.answers.is_cut_off", cut_off)
        self.by_look = recorded(patch, "gfp_grasp.answers.probability_by_look", by_look)
        self.unknown = recorded(patch, "gfp_grasp.answers.probability_unknown", unknown)
        misfits = [GOOD, GOOD] if misfits is None else misfits
        self.misfit = Recorder()
        left = iter(misfits)
        patch.setattr("gfp_grasp.answers.misfit_of", lambda *a: self.misfit(*a) or next(left))
        self.by_class = self._maker(patch, "answers.by_class", "class", None if fits else FitDiverged("nothing fits"))
        free = None if surface else NoSurface("all is empty")
        self.classfree = self._maker(patch, "classfree.complete.complete_level", "classfree", free)
        self.hull = self._maker(patch, "answers.complete_hull", "hull", None)

    def _maker(self, patch: pytest.MonkeyPatch, name: str, shape: str, error: Exception | None) -> Recorder:
        asked = Recorder()

        def make(*told: Any, **named: Any) -> CompletedShape:
            asked(*told, **named)
            if error is not None:
                raise error
            return self.shapes[shape]

        patch.setattr(f"gfp_grasp.{name}", make)
        return asked

    def answer(self, *, given: bool = False, **config: Any) -> CompletedShape:
        detection = replace(self.detection, scores={"mug": 1.0}) if given else self.detection
        return answer(self.view, detection, CompleteConfig(**config), Clock({}))  # type: ignore[arg-type]


def test_what_its_class_explains_is_answered_by_class(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, unknown=0.49)
    shape = made.answer(unknown_above=0.5)
    assert shape is made.shapes["class"]
    assert made.evidence_of_look.only[0] == (made.detection, CompleteConfig().library)
    assert made.by_look.only[0] == ("look",)
    assert made.unknown.only[0] == ("look", "fit")
    assert made.evidence_of_fit.only[0] == (made.shapes["class"].fit, GOOD)
    assert made.misfit.only[0] == (made.shapes["class"].mesh, "view")
    assert not made.classfree.calls


def test_what_is_likelier_of_no_class_is_answered_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, unknown=0.5)
    shape = made.answer(unknown_above=0.5)
    assert (shape.made_by, shape.fit) == ("classfree", None)
    assert shape.note == "it is of no class with a probability of 0.50"
    assert made.classfree.only[0] == ("view",)
    assert not made.hull.calls


def test_where_the_look_tells_it_nothing_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, by_look=0.97, misfits=[GOOD])
    shape = made.answer()
    assert (shape.made_by, shape.note) == ("classfree", "it is of no class with a probability of 0.97")
    assert not made.by_class.calls


@pytest.mark.parametrize(
    ("by_look", "above", "cut_off", "made_by"),
    [
        (0.79, 0.9, False, "primitive"),
        (0.8, 0.9, False, "classfree"),
        (0.8, 0.9, True, "primitive"),
        (0.9, 0.9, True, "classfree"),
        (0.69, 0.7, False, "primitive"),
        (0.7, 0.7, True, "classfree"),
    ],
)
def test_the_look_alone_need_not_be_as_sure_as_look_and_fit_unless_an_end_is_hidden(
    by_look: float, above: float, cut_off: bool, made_by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Answers(monkeypatch, by_look=by_look, cut_off=cut_off)
    assert made.answer(unknown_above=above).made_by == made_by
    if 0.8 <= by_look < above:  # else it is not asked for
        assert made.cut_off.only[0] == ("view",)
    else:
        assert not made.cut_off.calls


def test_an_answer_in_doubt_that_misses_a_tenth_of_the_points_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    off = replace(GOOD, away=0.15)
    assert Answers(monkeypatch, unknown=0.4, misfits=[off]).answer().made_by == "primitive"
    shape = Answers(monkeypatch, unknown=0.6, misfits=[off, GOOD]).answer()
    assert (shape.made_by, shape.note) == ("classfree", "15% of what was seen of the object is far from its surface")


@pytest.mark.parametrize(("by_look", "unlikely"), [(0.69, True), (0.7, False)])
def test_unlikely_primitives_are_not_tried_where_the_look_is_doubtful(
    by_look: float, unlikely: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Answers(monkeypatch, by_look=by_look)
    made.answer()
    assert made.by_class.only[1] == {"unlikely": unlikely}


def test_a_class_that_was_given_is_not_doubted_but_its_answer_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, by_look=0.97, unknown=0.99)
    assert made.answer(given=True).made_by == "primitive"
    assert not made.by_look.calls
    assert not made.unknown.calls
    assert Answers(monkeypatch).answer(given=True, unknown_above=0.0).made_by == "primitive"
    made = Answers(monkeypatch, misfits=[BAD, GOOD])
    shape = made.answer(given=True)
    assert (shape.made_by, shape.note) == ("classfree", FAULT)


def test_nothing_is_doubted_where_the_config_says_never(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, by_look=1.0, unknown=1.0, misfits=[BAD])
    assert made.answer(unknown_above=1.0, fall_back=False).made_by == "primitive"
    assert not made.evidence_of_look.calls
    assert not made.misfit.calls  # nor is anything checked


def test_an_answer_that_contradicts_what_was_seen_gives_way_and_the_note_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = Answers(monkeypatch, unknown=0.9, misfits=[BAD, GOOD])
    shape = made.answer()
    assert shape.note == f"it is of no class with a probability of 0.90; {FAULT}"
    assert shape.made_by == "classfree"
    assert [call[0][0] for call in made.misfit.calls] == [made.shapes[n].mesh for n in ("class", "classfree")]


def test_what_no_primitive_fits_is_answered_without_one(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Answers(monkeypatch, fits=False)
    shape = made.answer()
    assert (shape.made_by, shape.note) == ("classfree", "nothing fits")
    with pytest.raises(FitDiverged, match="nothing fits"):
        Answers(monkeypatch, fits=False).answer(fall_back=False)


@pytest.mark.parametrize(("surface", "why"), [(True, FAULT), (False, "all is empty")])
def test_where_the_class_free_completion_does_not_hold_the_hull_answers(
    surface: bool, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Answers(monkeypatch, unknown=0.95, misfits=[GOOD, BAD], surface=surface)
    shape = made.answer()
    assert shape.made_by == "hull"
    first = "it is of no class with a probability of 0.95"
    assert shape.note == f"{first}; nor does the class-free completion hold: {why}"
    assert made.hull.only[0] == ("view",)


def test_the_hull_is_checked_by_nobody_and_never_fails() -> None:
    detection, _ = seen()
    for view in (make_level_view(detection), make_level_view(without_view(detection))):
        shape = room.complete_hull(view)
        level = body()
        level.apply_transform(invert_T(view.T_world_level))
        assert shape.made_by == "hull"
        assert shape.mesh.is_volume
        hull = trimesh.convex.convex_hull(view.cloud.points)
        assert shape.mesh.volume == pytest.approx(hull.volume, rel=1e-6)
        assert 0.2 < shape.observed.mean() < 0.9


class Chain:
    """Stages in the place of the real ones; the fit is a toy cup that was moved, and the deformation keeps a share."""

    def __init__(self, patch: pytest.MonkeyPatch, kept: float) -> None:
        self.fit = fitted()
        num = len(self.fit.primitive.vertices)
        self.detection = toy_completion(scores={"mug": 0.512, "cup": 0.488}).detection
        self.view = SimpleNamespace(cloud="cloud", sigma_m=0.0021)
        self.deformed = SimpleNamespace(kept=kept, vertices=np.full((num, 3), 0.25), sigma_m="sigma")
        self.observed, self.sigma_m = np.arange(num) % 2 == 0, np.full(num, 0.003)
        self.candidates = recorded(patch, "gfp_grasp.recognition.candidate_primitives", "candidates")
        self.register = recorded(patch, "gfp_grasp.recognition.fit_best", self.fit)
        self.deform = recorded(patch, "gfp_grasp.answers.deform", self.deformed)
        self.mark = recorded(patch, "gfp_grasp.answers.mark_observed", (self.observed, self.sigma_m))
        self.clock = Clock({"detect": 5.0})

    def complete(self, **changes: Any) -> CompletedShape:
        config = CompleteConfig(rival_share=0.5, subcategories=False, **changes)
        return by_class(self.view, self.detection, config, self.clock)  # type: ignore[arg-type]


def test_a_class_answers_by_its_fit_deformed(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(monkeypatch, kept=1.0)
    made = chain.complete()
    assert chain.candidates.only[1] == {"rival_share": 0.5, "subcategories": False}
    assert chain.register.only == ((chain.view, "candidates"), {"config": CompleteConfig().fit})
    assert chain.deform.only == ((chain.fit, chain.view), {"config": CompleteConfig().deform})
    (vertices, faces, cloud), named = chain.mark.only
    assert (vertices is chain.deformed.vertices, cloud) == (True, "cloud")
    assert named == {"sensor_sigma_m": 0.0021, "sigma_m": "sigma"}
    np.testing.assert_array_equal(faces, chain.fit.primitive.faces)
    np.testing.assert_array_equal(made.mesh.vertices, chain.deformed.vertices)
    np.testing.assert_array_equal(made.mesh.faces, faces)
    assert (made.fit, made.made_by, made.note) == (chain.fit, "primitive", "")
    np.testing.assert_array_equal(made.observed, chain.observed)
    np.testing.assert_array_equal(made.sigma_m, chain.sigma_m)
    assert list(chain.clock.laps) == ["detect", "register", "deform", "mark"]


@pytest.mark.parametrize(("kept", "method", "looked"), [(1.0, "gfpnet", 0), (0.9, "gfpnet", 1), (1.0, "none", 1)])
def test_a_fit_that_may_cross_itself_is_looked_at_where_its_deformation_was_not_kept(
    kept: float, method: Any, looked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = Chain(monkeypatch, kept)
    better = replace(chain.fit, residual_m=0.002)
    solid = recorded(monkeypatch, "gfp_grasp.answers._solid", better)
    deform = CompleteConfig(deform=replace(CompleteConfig().deform, method=method)).deform
    made = chain.complete(deform=deform)
    assert len(solid.calls) == looked
    assert [call[0][0] for call in chain.deform.calls] == [chain.fit, better][: 1 + looked]
    assert all(call[1] == {"config": deform} for call in chain.deform.calls)
    assert made.fit is not None
    assert made.fit.residual_m == (0.002 if looked else 0.001)
    chain = Chain(monkeypatch, kept)
    recorded(monkeypatch, "gfp_grasp.answers._solid", chain.fit)
    chain.complete(deform=deform)
    assert len(chain.deform.calls) == 1


def test_seconds_are_counted_by_stage_and_stages_of_before_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([10.0, 11.0, 13.0, 17.0])
    monkeypatch.setattr("gfp_grasp.answers.time.perf_counter", lambda: next(ticks))
    before = {"detect": 0.5}
    clock = Clock(before)
    for name in ("detect", "mark", "mark"):
        clock.lap(name)
    assert clock.laps == {"detect": 1.5, "mark": 6.0}
    assert before == {"detect": 0.5}


def part(name: str, keep: str) -> Any:
    return SimpleNamespace(name=name, keep=keep)


@pytest.mark.parametrize(
    ("rule", "unseen", "missing"),
    [
        ("card", {"lid", "handle"}, ["lid"]),
        ("card", {"handle"}, []),
        ("seen", {"lid", "handle"}, ["lid", "handle"]),
        ("always", {"lid", "handle"}, []),
    ],
)
def test_optional_parts_are_kept_by_the_rule(
    rule: str, unseen: set[str], missing: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gfp_grasp.answers.part_is_seen", lambda fit, name, view: name not in unseen)
    whole = toy_cup_primitive()
    body = replace(whole)
    asked: list[Any] = []

    class Primitive:
        spec = SimpleNamespace(optional_parts=(part("lid", "seen"), part("handle", "always")))

        def without(self, names: list[str]) -> Any:
            asked.append(names)
            return body if names else self

    fit = FittedPrimitive(whole, np.eye(4), np.ones(3), np.zeros(len(whole.modes)), 0.001)
    object.__setattr__(fit, "primitive", Primitive())
    made = room._with_parts_seen(fit, "view", rule)  # type: ignore[arg-type]
    assert asked == [missing]
    assert (made.primitive is body) == bool(missing)
    assert (made is fit) != bool(missing)


def test_modes_are_drawn_back_until_the_surface_does_not_cross_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    primitive = toy_cup_primitive()
    fit = FittedPrimitive(primitive, np.eye(4), np.ones(3), np.full(len(primitive.modes), 1.0), 0.001)

    def crossing_times(times: int) -> Recorder:
        answers = iter([[0]] * times + [[]] * 99)
        asked = Recorder()
        monkeypatch.setattr("gfp_grasp.answers.crossing_faces", lambda *a: asked(*a) or next(answers))
        return asked

    crossing_times(0)
    assert room._solid(fit) is fit
    asked = crossing_times(2)
    np.testing.assert_allclose(room._solid(fit).coefficients, 0.75**2)
    np.testing.assert_allclose(asked.calls[1][0][0], primitive.shape(np.full(5, 0.75), np.ones(3)))
    asked = crossing_times(11)
    np.testing.assert_allclose(room._solid(fit).coefficients, 0.75**11)
    asked = crossing_times(50)
    np.testing.assert_array_equal(room._solid(fit).coefficients, 0.0)
    assert len(asked.calls) == 12
