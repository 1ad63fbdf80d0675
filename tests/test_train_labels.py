"""Labels for GFPNet: how a fit is drawn onto the true surface, which labels are kept, and how they are found again."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from moments import assert_known
from toy_primitive import random_cup, toy_cup_primitive

from gfp_grasp.deform import TemplatePoints, patch_unit_m
from gfp_grasp.errors import FitDiverged, TooFewPoints
from gfp_grasp.meshes import sample_surface, vertex_normals
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train import View
from gfp_grasp.train import labels as module
from gfp_grasp.train.labels import Label, _cached_label, _card_id, _label, _primitives_of, draw_onto, make_labels
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import FittedPrimitive

LIBRARY = PrimitiveLibrary.shipped()
T_WORLD_OBJECT = make_T(rotation_about((0, 0, 1), 0.7), (0.1, -0.2, 0.0))


def _toy_fit() -> FittedPrimitive:
    primitive = toy_cup_primitive()
    return FittedPrimitive(primitive, np.eye(4), np.array([1.05, 0.95, 1.1]), np.array([0.5, -0.4, 0.3, 0, 0]), 0.0)


def test_a_fit_is_drawn_onto_the_true_surface_as_ever() -> None:
    points, normals, _ = sample_surface(random_cup(np.random.default_rng(4)), 4000, np.random.default_rng(0))
    fit = _toy_fit()
    moved, residual_m = draw_onto(fit.primitive, fit.primitive.shape(fit.coefficients, fit.scale), points, normals)
    assert_known("label", moved)
    assert_known("label residual", [residual_m])


def test_vertices_without_an_agreeing_surface_count_as_twice_the_residual_that_is_too_much(monkeypatch) -> None:
    monkeypatch.setattr(module, "_STAGES", ())
    fit = _toy_fit()
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    normals = vertex_normals(vertices, fit.primitive.faces)
    moved, residual_m = draw_onto(fit.primitive, vertices, vertices, normals)
    np.testing.assert_array_equal(moved, vertices)
    assert residual_m == pytest.approx(0.0, abs=1e-12)
    far_m = 2 / 15 * patch_unit_m(fit.primitive)
    # Of points that lie along the surface, two thirds of the turn of a normal is too much, a third of it is not.
    for degrees, wanted in ((59.0, 0.0), (61.0, far_m), (180.0, far_m)):
        aside = np.cross(normals, [0.36, 0.48, 0.8])
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        leaning = np.cos(np.radians(degrees)) * normals + np.sin(np.radians(degrees)) * aside
        apart = vertices + 10.0 * np.arange(len(vertices))[:, None]  # so that a vertex has no other neighbour
        monkeypatch.setattr(module, "vertex_normals", lambda *_: normals)
        assert draw_onto(fit.primitive, apart, apart, leaning)[1] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize(("others", "is_found"), [(7, True), (8, False)])
def test_an_agreeing_surface_is_looked_for_among_the_nearest_eight(monkeypatch, others: int, is_found: bool) -> None:
    primitive = toy_cup_primitive()
    normals = vertex_normals(primitive.vertices, primitive.faces)
    apart = 10.0 * np.arange(len(normals))[:, None] * np.ones(3)
    monkeypatch.setattr(module, "_STAGES", ())
    monkeypatch.setattr(module, "vertex_normals", lambda *_: normals)
    layers = [apart + 1e-4 * (k + 1) * normals for k in range(others)] + [apart + 1e-3 * normals]
    facing = [-normals] * others + [normals]
    residual_m = draw_onto(primitive, apart, np.concatenate(layers), np.concatenate(facing))[1]
    assert residual_m == pytest.approx(1e-3 if is_found else 2 / 15 * patch_unit_m(primitive))


def _view(seed: int = 3, shift: float = 0.0, family: str = "cup") -> View:
    source = ObjectSource(f"{family}-{seed}", family, family=family, seed=seed)
    points = np.random.default_rng(seed).normal(size=(50, 3)) + shift
    return View(source, points, np.array([0.4, 0.1, 0.5]), T_WORLD_OBJECT, "upright")


def _some_label() -> Label:
    rng = np.random.default_rng(0)
    template = TemplatePoints(rng.normal(size=(6, 3)), rng.normal(size=(6, 3)), rng.random(6) > 0.5)
    parts = (rng.normal(size=(9, 3)), rng.normal(size=(9, 3)))
    return Label("mug", ("handle",), *parts, template, rng.normal(size=3), rng.normal(size=4), rng.normal(size=3))


def _assert_same(one: Label, other: Label, *, atol: float = 1e-6) -> None:
    assert (one.primitive, one.without) == (other.primitive, other.without)
    for name in ("vertices", "target", "viewpoint", "coefficients", "scale"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=atol, err_msg=name)
        assert getattr(one, name).dtype == np.float64
    np.testing.assert_allclose(one.template.points, other.template.points, atol=atol)
    np.testing.assert_allclose(one.template.normals, other.template.normals, atol=atol)
    np.testing.assert_array_equal(one.template.mirrored, other.template.mirrored)


def test_a_label_is_made_once_and_read_afterwards_whatever_its_verdict(tmp_path: Path, monkeypatch) -> None:
    made: list = []
    verdicts = {3: (_some_label(), "kept"), 4: (None, "folded")}

    def label(view, fit, num_modes, *, support, library):
        made.append((view.seed, fit, library))
        return verdicts[view.seed]

    monkeypatch.setattr(module, "_label", label)
    fit = FitConfig()
    for _ in range(2):
        kept, verdict = _cached_label(_view(3), folder=tmp_path, fit=fit, library=LIBRARY)
        assert verdict == "kept"
        assert kept is not None
        _assert_same(kept, _some_label())
        assert _cached_label(_view(4), folder=tmp_path, fit=fit, library=LIBRARY) == (None, "folded")
    assert made == [(3, fit, LIBRARY), (4, fit, LIBRARY)]
    files = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.npz"))
    assert len(files) == 2
    assert all(path.parent.name == "cup" and len(path.stem) == 20 for path in files)


def test_modes_and_support_are_drawn_by_the_points_of_a_view_as_ever(tmp_path: Path, monkeypatch) -> None:
    drawn: list[tuple[int, bool]] = []
    monkeypatch.setattr(
        module,
        "_label",
        lambda view, fit, num_modes, *, support, library: (drawn.append((num_modes, support)), (None, ""))[1],
    )
    for seed in range(24):
        _cached_label(_view(seed), folder=tmp_path, fit=FitConfig(), library=LIBRARY)
    assert_known("modes of labels", drawn)
    assert {modes for modes, _ in drawn} == {1000, 8, 3}
    assert sum(modes == 1000 for modes, _ in drawn) == pytest.approx(12, abs=5)


def test_another_registration_or_another_primitive_makes_another_label(tmp_path: Path, monkeypatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(module, "_label", lambda *_, **__: (calls.append(1), (None, "not fitted"))[1])
    other = replace(FitConfig(), hypotheses=("lying",))
    for fit in (FitConfig(), other, FitConfig()):
        _cached_label(_view(), folder=tmp_path, fit=fit, library=LIBRARY)
    assert len(calls) == 2
    monkeypatch.setattr(module, "_card_id", lambda library, family: b"another")
    _cached_label(_view(), folder=tmp_path, fit=other, library=LIBRARY)
    assert len(calls) == 3
    monkeypatch.undo()
    assert _card_id(LIBRARY, "mug") == str(LIBRARY.primitive("mug").card["shape_sha256"]).encode()
    kinds = LIBRARY.members_of("cup")
    assert _card_id(LIBRARY, "cup") == "".join(str(kind.card["shape_sha256"]) for kind in kinds).encode()


def test_primitives_with_few_modes_keep_the_first_ones_and_the_scale() -> None:
    (mug,) = _primitives_of(LIBRARY, "mug", 3)
    whole = LIBRARY.primitive("mug")
    np.testing.assert_array_equal(mug.modes, whole.modes[:3])
    np.testing.assert_array_equal(mug.explained, whole.explained[:3])
    samples = whole.coefficient_samples
    np.testing.assert_array_equal(mug.coefficient_samples, np.hstack([samples[:, :3], samples[:, -3:]]))
    assert [len(variant.primitive.modes) for variant in mug.variants] == [3]
    assert len(_primitives_of(LIBRARY, "mug", 1000)[0].modes) == len(whole.modes)
    assert [kind.name for kind in _primitives_of(LIBRARY, "cup", 2)] == [k.name for k in LIBRARY.members_of("cup")]


@pytest.fixture
def mug_fit(monkeypatch) -> FittedPrimitive:
    """The fit that registration gives for every view of these tests, exactly where the mug stands."""
    mug = LIBRARY.primitive("mug")
    fit = FittedPrimitive(mug, T_WORLD_OBJECT, np.ones(3), np.full(len(mug.modes), 0.3), 0.0)
    asked: list = []

    def best(level, candidates, *, config):
        asked.append((level, candidates, config))
        return fit

    def level_view(detection):
        return SimpleNamespace(T_world_level=np.eye(4), detection=detection)

    monkeypatch.setattr(module, "fit_best", best)
    monkeypatch.setattr(module, "make_level_view", level_view)
    monkeypatch.setattr(module, "template_points", lambda fit, level: (fit, level))
    monkeypatch.setattr(module, "part_is_seen", lambda fit, part, level: False)
    monkeypatch.setattr(module, "draw_onto", lambda primitive, *_: (primitive.vertices, 0.0))
    return fit


def _label_of(view: View, *, support: bool = True, num_modes: int = 1000) -> tuple[Label | None, str]:
    return _label(view, FitConfig(), num_modes, support=support, library=LIBRARY)


def test_a_label_is_of_the_body_whose_parts_were_seen_and_in_its_own_frame(mug_fit, monkeypatch) -> None:
    drawn: list = []

    def drawing(primitive, vertices, points, normals):
        drawn.append((points, normals))
        return primitive.vertices + 1.0, 0.0

    monkeypatch.setattr(module, "draw_onto", drawing)
    view = _view(family="mug")
    label, verdict = _label_of(view)
    assert verdict == "kept"
    assert label is not None
    assert (label.primitive, label.without) == ("mug", ("handle",))
    body = mug_fit.primitive.without(["handle"])
    assert body is not None
    np.testing.assert_allclose(label.vertices, body.shape(mug_fit.coefficients, np.ones(3)))
    np.testing.assert_allclose(label.target, body.vertices + 1.0)
    np.testing.assert_allclose(label.viewpoint, apply_T(invert_T(T_WORLD_OBJECT), view.viewpoint))
    np.testing.assert_array_equal(label.coefficients, mug_fit.coefficients)
    assert label.template[0].primitive is body  # pyright: ignore[reportIndexIssue]
    # The fit stands where the object stands: its samples are those of the mesh itself.
    expected, normals, _ = sample_surface(view.source.load_mesh(), 12000, np.random.default_rng(view.seed))
    np.testing.assert_allclose(drawn[0][0], expected, atol=1e-12)
    np.testing.assert_allclose(drawn[0][1], normals, atol=1e-12)
    monkeypatch.setattr(module, "part_is_seen", lambda fit, part, level: part == "handle")
    whole, _ = _label_of(view)
    assert whole is not None
    assert whole.without == ()
    assert len(whole.vertices) == len(mug_fit.primitive.vertices)


@pytest.mark.parametrize("support", [True, False])
def test_registration_knows_how_the_object_rests_and_maybe_its_support(mug_fit, monkeypatch, support: bool) -> None:
    asked: list = []
    monkeypatch.setattr(
        module, "fit_best", lambda level, candidates, *, config: (asked.append((level, candidates, config)), mug_fit)[1]
    )
    _label_of(replace(_view(family="mug"), resting="lying"), support=support, num_modes=3)
    ((level, candidates, config),) = asked
    assert config == replace(FitConfig(), hypotheses=("lying",))
    assert (level.detection.support is not None) == support
    assert [(len(primitive.modes), evidence) for primitive, evidence in candidates] == [(3, 0.0)]


@pytest.mark.parametrize("error", [FitDiverged, TooFewPoints])
def test_what_is_not_fitted_has_no_label(mug_fit, monkeypatch, error: type[Exception]) -> None:
    def lost(*_, **__):
        raise error("no")

    monkeypatch.setattr(module, "fit_best", lost)
    assert _label_of(_view(family="mug")) == (None, "not fitted")


@pytest.mark.parametrize(("share", "verdict"), [(0.99, "kept"), (1.01, "residual")])
def test_a_label_that_stays_off_the_surface_is_dropped(mug_fit, monkeypatch, share: float, verdict: str) -> None:
    limit_m = patch_unit_m(mug_fit.primitive.without(["handle"]) or mug_fit.primitive) / 15
    monkeypatch.setattr(module, "draw_onto", lambda primitive, *_: (primitive.vertices, share * limit_m))
    assert _label_of(_view(family="mug"))[1] == verdict


@pytest.mark.parametrize(("share", "verdict"), [(0.0093, "kept"), (0.0115, "folded")])
def test_a_label_with_more_than_a_hundredth_of_crossings_is_dropped(mug_fit, monkeypatch, share, verdict) -> None:
    count = len((mug_fit.primitive.without(["handle"]) or mug_fit.primitive).vertices)
    monkeypatch.setattr(module, "crossing_faces", lambda *_: np.zeros((round(share * count), 2)))
    assert _label_of(_view(family="mug"))[1] == verdict


def test_labels_of_a_split_are_counted_by_their_verdict(tmp_path: Path, monkeypatch) -> None:
    asked: list = []
    views = [_view(seed) for seed in range(5)]

    def cached(family, split, **knobs):
        asked.append((family, split, knobs))
        return views

    def label(view, *, folder, fit, library):
        assert (folder, fit, library) == (tmp_path / "labels", FitConfig(), LIBRARY)
        return (_some_label(), "kept") if view.seed < 3 else (None, "folded")

    monkeypatch.setattr(module, "cached_views", cached)
    monkeypatch.setattr(module, "_cached_label", label)
    found, counts = make_labels("cup", "val", num_views=2, limit=7, runs=tmp_path)
    assert (len(found), counts) == (3, {"kept": 3, "folded": 2})
    knobs = {"num_views": 2, "limit": 7, "folder": tmp_path / "views", "workers": 1, "data": None}
    assert asked == [("cup", "val", knobs)]
    make_labels("cup", "val", runs=tmp_path, data=tmp_path)
    assert asked[1][2] == {**knobs, "num_views": 4, "limit": None, "data": tmp_path}
