"""What a completion gives back: its fit or its box, its parts, and its files."""

from pathlib import Path

import numpy as np
import pytest
from recorded_calls import recorded
from toy_completions import toy_completion, toy_fit


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
    assert named.export("a.xml", assets="files") == Path("written")
    named.export("a.ply")
    toy_completion(category="").export(Path("b.urdf"))
    (mesh, parts, path), more = export.calls[0]
    np.testing.assert_array_equal(more.pop("up"), (0.0, 1.0, 0.0))
    assert (mesh, parts, path, more) == (named.mesh, named.parts, Path("a.xml"), {"name": "tea_pot", "assets": "files"})
    assert (export.calls[1][0][1], export.calls[1][1]["assets"]) == ((), "embedded")
    assert (len(export.calls[2][0][1]), export.calls[2][1]["name"]) == (2, "object")


def test_parts_are_made_once_within_the_completion_s_own_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    made = toy_completion()
    answer = made.__dict__.pop("collision")
    collide = recorded(monkeypatch, "gfp_grasp.collision.collision_of", answer)
    assert made.collision is made.collision is answer
    assert collide.only == ((made.shape,), {"config": made.collision_config})
