"""What OpenGL is told, and when it is asked, on any machine: a stand-in takes the place of the driver."""

from types import SimpleNamespace

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")

from gfp_grasp import camera  # noqa: E402
from gfp_grasp.camera import render  # noqa: E402
from gfp_grasp.errors import InvalidOption  # noqa: E402
from gfp_grasp.transforms import look_at  # noqa: E402

K = np.array([[200.0, 0.0, 30.5], [0.0, 160.0, 50.25], [0.0, 0.0, 1.0]])
T = look_at((0.35, 0.25, 0.4), (0, 0, 0.04))
BOX = '<mujoco><worldbody><geom type="box" size="{size}" pos="0 0 {z}"/></worldbody></mujoco>'


def _scene(size: str = ".2 .1 .05", z: float = 0.0):
    model = mujoco.MjModel.from_xml_string(BOX.format(size=size, z=z))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_the_frustum_reaches_half_a_pixel_beyond_the_outer_centres() -> None:
    eye = SimpleNamespace()
    render._aim(eye, K, 100, 80, T, 0.02, 7.0)
    np.testing.assert_allclose(eye.pos, T[:3, 3])
    np.testing.assert_allclose(eye.forward, T[:3, 2])
    np.testing.assert_allclose(eye.up, -T[:3, 1])
    left, right = (-0.5 - 30.5) / 200, (99.5 - 30.5) / 200
    assert eye.frustum_center == pytest.approx(0.02 * (left + right) / 2)
    assert eye.frustum_width == pytest.approx(0.02 * (right - left) / 2)  # MuJoCo's is half of the width
    assert eye.frustum_top == pytest.approx(0.02 * (0.5 + 50.25) / 160)
    assert eye.frustum_bottom == pytest.approx(-0.02 * (79.5 - 50.25) / 160)
    assert (eye.frustum_near, eye.frustum_far) == (0.02, 7.0)


def test_colours_are_read_as_the_geoms_that_were_drawn_in_them() -> None:
    kinds = mujoco.mjtObj
    geoms = [
        SimpleNamespace(segid=0, objtype=kinds.mjOBJ_GEOM, objid=5),
        SimpleNamespace(segid=299, objtype=kinds.mjOBJ_GEOM, objid=3),
        SimpleNamespace(segid=1, objtype=kinds.mjOBJ_SITE, objid=9),
        SimpleNamespace(segid=-1, objtype=kinds.mjOBJ_GEOM, objid=8),
        *[SimpleNamespace(segid=-1, objtype=kinds.mjOBJ_GEOM, objid=8)] * 300,
    ]
    scene = SimpleNamespace(ngeom=304, geoms=geoms)
    colour = np.array([[[1, 0, 0], [2, 0, 0], [0, 0, 0], [44, 1, 0]]], dtype=np.uint8)  # 44 + 256 is 300
    assert render._geom_ids(scene, colour).tolist() == [[5, -1, -1, 3]]


@pytest.mark.parametrize(
    ("backend", "works", "same", "draws"),
    [
        ("rays", "egl", True, False),
        ("opengl", "egl", False, True),
        ("auto", "egl", True, True),
        ("auto", "egl", False, False),
        ("auto", "none", True, False),
    ],
)
def test_opengl_is_asked_where_it_works_and_gives_the_same_picture(
    monkeypatch: pytest.MonkeyPatch, backend: str, works: str, same: bool, draws: bool
) -> None:
    drawn: list[dict] = []

    def draw(*_, **options):
        drawn.append(options)
        return np.array([[0.5, 4.0]]), np.array([[7, 2]])

    monkeypatch.setattr(render, "opengl_backend", lambda: works)
    monkeypatch.setattr(render, "_same_in_opengl", lambda *_: same)
    monkeypatch.setattr(render, "_opengl_depth", lambda _: SimpleNamespace(draw=draw))
    depth, geom = render.render_depth(*_scene(), K=K, width=2, height=1, T_world_camera=T, backend=backend)  # type: ignore[arg-type]
    assert bool(drawn) == draws
    if draws:
        np.testing.assert_array_equal(depth, np.array([[0.5, 0.0]], dtype=np.float32))  # 4 m is beyond the limit of 3 m
        assert geom.tolist() == [[7, -1]]
        assert (drawn[0]["width"], drawn[0]["height"]) == (2, 1)


def test_opengl_that_does_not_draw_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render, "opengl_backend", lambda: "none")
    with pytest.raises(InvalidOption, match="does not draw"):
        render.render_depth(*_scene(), K=K, width=2, height=1, T_world_camera=T, backend="opengl")


def test_rays_reach_the_limit_along_the_optical_axis_in_the_corners_too() -> None:
    wide, down = camera.intrinsics(40, 30, 80.0), look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
    scene = _scene("9 9 .01", z=0.05)
    depth, geom = render.render_depth(*scene, K=wide, width=40, height=30, T_world_camera=down, backend="rays")
    np.testing.assert_allclose(depth, 2.94, atol=1e-5)
    assert (geom == 0).all()
    for farthest_m, seen in ((2.9, False), (2.95, True)):
        depth, geom = render.render_depth(
            *scene, K=wide, width=40, height=30, T_world_camera=down, backend="rays", farthest_m=farthest_m
        )
        assert (depth > 0).all() == (geom == 0).all() == seen
        assert (depth > 0).any() == seen


def test_skewed_pictures_and_see_through_geoms() -> None:
    model, _ = _scene()
    assert render._same_in_opengl(model, K)
    skewed = K.copy()
    skewed[0, 1] = 1.0
    assert not render._same_in_opengl(model, skewed)
    ball = '<mujoco><worldbody><geom size="0.1" {}/><geom type="box" size=".1 .1 .1"/></worldbody></mujoco>'
    for attributes, same in (("", False), ('group="3"', True), ('rgba="1 1 1 0"', True), ('rgba="1 1 1 .1"', False)):
        assert render._same_in_opengl(mujoco.MjModel.from_xml_string(ball.format(attributes)), K) == same
