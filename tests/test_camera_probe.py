"""Which OpenGL is tried, in which order, and how the one that works is found and kept."""

import os

import pytest

from gfp_grasp.camera import opengl_probe


@pytest.mark.parametrize(
    ("asked", "system", "candidates"),
    [
        (None, "Linux", ("egl", "osmesa")),
        (None, "Darwin", ("cgl",)),
        (None, "Windows", ("glfw",)),
        (" OSMesa ", "Linux", ("osmesa",)),
        ("egl", "Darwin", ("egl",)),
        ("glfw", "Linux", ("glfw",)),
        ("cgl", "Linux", ("cgl",)),
        ("off", "Linux", ()),
        ("disable", "Linux", ()),
        ("disabled", "Linux", ()),
        ("false", "Linux", ()),
        ("0", "Linux", ()),
    ],
)
def test_the_user_may_choose_the_opengl_that_is_tried(
    monkeypatch: pytest.MonkeyPatch, asked: str | None, system: str, candidates: tuple[str, ...]
) -> None:
    monkeypatch.delenv("GFP_GRASP_GL", raising=False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    if asked is not None:
        monkeypatch.setenv("MUJOCO_GL", asked)
    monkeypatch.setattr(opengl_probe.platform, "system", lambda: system)
    tried: list[str] = []
    monkeypatch.setattr(opengl_probe, "_works", lambda name: bool(tried.append(name)))
    assert opengl_probe.opengl_backend() == "none"
    assert tuple(tried) == candidates
    assert os.environ["GFP_GRASP_GL"] == "none"
    monkeypatch.delenv("GFP_GRASP_GL")


def test_the_first_opengl_that_works_is_kept_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GFP_GRASP_GL", "egl")
    monkeypatch.setattr(opengl_probe, "_works", lambda name: pytest.fail("asked again"))
    assert opengl_probe.opengl_backend() == "egl"
    monkeypatch.delenv("GFP_GRASP_GL")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(opengl_probe.platform, "system", lambda: "Linux")
    monkeypatch.setattr(opengl_probe, "_works", lambda name: name == "osmesa")
    assert opengl_probe.opengl_backend() == "osmesa"
    assert os.environ["GFP_GRASP_GL"] == "osmesa"
    monkeypatch.delenv("GFP_GRASP_GL")


def test_the_probe_is_asked_in_a_child_that_finds_this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict = {}

    def run(command: list[str], **options) -> object:
        asked.update(options, command=command)
        return type("Done", (), {"returncode": asked["code"], "stdout": asked["says"]})()

    monkeypatch.setattr(opengl_probe.subprocess, "run", run)
    for code, says, works in ((0, b"mujoco talks. works", True), (1, b"works", False), (0, b"wrong", False)):
        asked.update(code=code, says=says)
        assert opengl_probe._works("osmesa") == works
    assert asked["command"][-1] == "osmesa"
    assert asked["env"]["MUJOCO_GL"] == asked["env"]["GFP_GRASP_GL"] == "osmesa"
    assert asked["env"]["PYTHONPATH"].split(os.pathsep) == [place for place in opengl_probe.sys.path if place]
    assert asked["timeout"] == 30.0


def test_a_probe_that_hangs_or_cannot_start_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    for error in (OSError("no such file"), opengl_probe.subprocess.TimeoutExpired("probe", 30.0)):

        def fail(*_, error=error, **__) -> None:
            raise error

        monkeypatch.setattr(opengl_probe.subprocess, "run", fail)
        assert not opengl_probe._works("egl")
