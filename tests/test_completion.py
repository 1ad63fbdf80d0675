"""What a completion gives back: its fit or its box, its parts, and its files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recorded_calls import recorded
from toy_completions import toy_completion, toy_fit

from gfp_grasp.collision import CollisionConfig


def test_a_completion_tells_its_fit_or_what_was_observed_where_nothing_was_fitted() -> None:
    fit = toy_fit()
    fit.scale = np.array([1.0, 1.1, 1.2])
    fitted, bare = toy_completion(fit=fit, scores={"cup": 1.0}), toy_completion(category="box")
    assert (fitted.category, bare.category) == ("mug", "box")
    np.testing.assert_array_equal(fitted.T_world_object, fit.T_world_object)
    np.testing.assert_array_equal(bare.T_world_object, bare.detection.box.T_world_box)
    np.testing.assert_array_equal(fitted.scale, (1.0, 1.1, 1.2))
    np.testing.assert_array_equal(bare.scale, (1.0, 1.0, 1.0))
    assert (fitted.fit, bare.fit, fitted.scores) == (fit, None, {"cup": 1.0})
    assert bare.parts is bare.parts
    assert [part.is_watertight for part in bare.parts] == [True, True]


def test_a_completion_is_exported_under_its_class_with_parts_where_the_format_has_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    export = recorded(monkeypatch, "gfp_grasp.export.export_completion", Path("written"))
    named = toy_completion(category="tea pot", up=(0.0, 1.0, 0.0))
    assert named.export("a.xml", assets="files", contact=False) == Path("written")
    named.export("a.ply")
    toy_completion(category="").export(Path("b.urdf"))
    named.export("c.xml", name="kettle")
    (mesh, parts, path), more = export.calls[0]
    np.testing.assert_array_equal(more.pop("up"), (0.0, 1.0, 0.0))
    assert (mesh, parts, path) == (named.mesh, named.parts, Path("a.xml"))
    assert more == {"name": "tea_pot", "density": 600.0, "assets": "files", "contact": False}
    assert (export.calls[1][0][1], export.calls[1][1]["assets"], export.calls[1][1]["contact"]) == (
        (),
        "embedded",
        True,
    )
    assert (len(export.calls[2][0][1]), export.calls[2][1]["name"]) == (2, "object")
    assert export.calls[3][1]["name"] == "kettle"


def test_parts_are_made_once_within_the_completion_s_own_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    made = toy_completion()
    answer = made.__dict__.pop("collision")
    collide = recorded(monkeypatch, "gfp_grasp.collision.collision_of", answer)
    assert made.collision is made.collision
    assert made.collision.parts == answer.parts
    assert (made.collision.error_m, made.collision.notes) == (answer.error_m, answer.notes)
    assert collide.only == ((made.shape,), {"config": made.collision_config})


def test_parts_keep_to_the_completion_s_bounds_within_any_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halves of a box, 100 mm high: a leaning plane cuts only the upper one, and a level one lifts the lower."""
    made = toy_completion()
    answer = made.__dict__.pop("collision")
    collide = recorded(monkeypatch, "gfp_grasp.collision.collision_of", answer)
    leaning = np.array([0.6, 0.0, 0.8, 0.08])
    bounded, config = replace(made, bounds=np.array([leaning, [0.0, 0.0, -1.0, -0.02]])), CollisionConfig(max_parts=3)
    lower, upper = bounded.collide(config).parts
    assert collide.only == ((made.shape,), {"config": config})
    np.testing.assert_allclose(np.ptp(lower.vertices, axis=0), (0.06, 0.08, 0.03), atol=1e-12)
    assert lower.vertices[:, 2].min() == pytest.approx(0.02)
    reach = upper.vertices @ leaning[:3]
    assert reach.max() == pytest.approx(0.08)
    cut = upper.vertices[reach > 0.08 - 1e-9]
    np.testing.assert_allclose(sorted(cut.tolist()), [[0.0192, -0.04, 0.0856], [0.0192, 0.04, 0.0856]], atol=1e-12)
