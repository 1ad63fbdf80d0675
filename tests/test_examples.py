"""The examples run, and write what they say."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidOption
from gfp_grasp.examples.learn import AboutTheCloud, learn, main, make
from gfp_grasp.types import REASONS

needs_sb3 = pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="stable-baselines3")


@pytest.fixture
def folder(tmp_path: Path) -> str:
    mesh = trimesh.creation.cylinder(0.03, 0.14, sections=32)
    mesh.apply_translation((0, 0, 0.07))
    (tmp_path / "objects").mkdir()
    mesh.export(tmp_path / "objects" / "bottle__plain.ply")
    return str(tmp_path / "objects")


@pytest.fixture
def env(folder: str) -> AboutTheCloud:
    return make(folder, "test", 1)


def test_a_level_grasp_across_the_narrow_side_holds_a_cylinder(env):
    observation, _ = env.reset(seed=0)
    np.testing.assert_allclose(observation[3:], 0.6, atol=0.1)
    info = env.step(np.array([0.0, 1.0, 0.0, 0.9], dtype=np.float32))[4]
    assert info["is_success"]


def test_every_corner_of_the_four_numbers_is_a_grasp(env):
    env.reset(seed=0)
    for corner in np.stack(np.meshgrid(*[[-1.0, 1.0]] * 4), axis=-1).reshape(-1, 4)[::3]:
        assert env.step(corner)[4]["reason"] in REASONS


@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is not None, reason="it is installed")
def test_without_stable_baselines_the_extra_is_named(folder):
    with pytest.raises(InvalidOption, match=r"pip install 'gfp-grasp\[learn\]'"):
        learn(folder)


@needs_sb3
@pytest.mark.slow
def test_a_short_training_runs_and_writes_its_figures(folder, tmp_path, capsys):
    path = tmp_path / "learn.json"
    main(["--objects", folder, "--attempts", "12", "--held-out", "5", "--json", str(path)])
    report = json.loads(path.read_text())
    assert report["settings"] == {"objects": folder, "attempts": 12, "held_out": 5, "limit": 16, "seed": 0}
    for name in ("random", "trained"):
        row = report[name]
        assert row["attempts"] == 5
        low, high = row["interval"]
        assert 0 <= low <= row["rate"] == row["held"] / 5 <= high <= 1
    assert capsys.readouterr().out.count("of 5") == 2
